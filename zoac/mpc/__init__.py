"""Model predictive control: problem, linearisation, solvers."""
