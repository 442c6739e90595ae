"""Parameters and episodes to try a task with."""

import numpy as np

from zoac.core.segments import Proposal, Segment
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.task import Task

STEPS = 120
"""Steps of an episode that are looked at."""

DRAWS = 16
"""Parameter sets that are tried."""

Found = tuple[bool, str]
"""Whether a check is passed, and what it found."""


def draws(task: Task, n: int) -> np.ndarray:
    """Return n mapped parameter sets (n, d), always the same ones."""
    return np.random.default_rng(0).uniform(-0.9, 0.9, (n, task.space.dimension))


def segments(task: Task) -> list[Segment]:
    """Return the beginnings of episodes under different parameters, the baseline values first."""
    x = draws(task, DRAWS)
    if task.baseline is not None:
        x[0] = task.space.normalise(task.baseline)
    group = RolloutEngine(task, range(DRAWS), list(range(100, 100 + DRAWS)))
    try:
        return group.rollout([Proposal(x[k], k, horizon=STEPS) for k in range(DRAWS)])
    finally:
        group.close()
