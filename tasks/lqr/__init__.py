"""A linear system with quadratic cost, whose best gains are known."""

from zoac.tasks.lqr.plant import LqrLanes, optimal_gain
from zoac.tasks.lqr.task import Lqr

__all__ = ["Lqr", "LqrLanes", "optimal_gain"]
