"""Predictive models of an MPC: by CasADi, or from a function of NumPy or numba."""
