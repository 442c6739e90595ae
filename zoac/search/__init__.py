"""Search for a tuner's own options, on Optuna."""
