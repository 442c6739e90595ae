"""An MPC from weights, bounds and a reference, on any predictive model."""
