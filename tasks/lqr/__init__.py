"""A linear system with quadratic cost, whose best gains are known."""

from zoac.tasks.lqr.plant import LqrVecEnv, optimal_gain
from zoac.tasks.lqr.task import Lqr

__all__ = ["Lqr", "LqrVecEnv", "optimal_gain"]
