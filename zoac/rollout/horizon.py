"""How long a task's episodes are, which a trial tells where there is no time limit."""

from contextlib import closing
from typing import Literal, NamedTuple

import numpy as np

from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.task import Task

EPISODES = 3
"""Episodes from which the length of those without a time limit is told."""


class Horizon(NamedTuple):
    """How long the episodes of a task are.

    Args:
        steps: Of the longest one.
        source: "limit": that is the time limit; "truncation": the environment truncated its first
            episodes by itself; "termination": they terminated, and others may be longer.
    """

    steps: int
    source: Literal["limit", "truncation", "termination"]

    @property
    def remark(self) -> str:
        """What the first lines of a run say of it; nothing where there is a time limit."""
        told = {
            "limit": "",
            "truncation": "truncated by the environment itself after {:,} steps",
            "termination": f"no time limit; {{:,}} steps in the longest of {EPISODES}, with which "
            "the tuner plans; give max_episode_steps if others take longer",
        }
        return told[self.source].format(self.steps)


def horizon_of(task: Task) -> Horizon:
    """Return the time limit; where there is none, run episodes with the baseline parameters.

    Without baseline parameters those in the middle of the space are taken. The task keeps what was
    found, so that its episodes are run once.

    Raises:
        ConfigError: If an episode does not end.
    """
    kept = vars(task)
    if "horizon" not in kept:
        kept["horizon"] = _found(task)
    horizon: Horizon = kept["horizon"]
    return horizon


def _found(task: Task) -> Horizon:
    env = task.make_env(1)
    env.close()
    if env.limited:
        return Horizon(env.max_episode_steps, "limit")
    x = (
        np.zeros(task.space.dimension)
        if task.baseline is None
        else task.space.normalise(task.baseline)
    )
    with closing(RolloutEngine(task, [0], [1])) as engine:
        segments = engine.rollout([Proposal(x, 0)] * EPISODES)
    last = max(segments, key=lambda s: s.length)
    return Horizon(last.length, "truncation" if last.truncated else "termination")
