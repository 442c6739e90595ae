"""Solvers of the linearised optimal control problem; each file is one."""
