"""What the specs of a task come to before anything is tuned."""

from __future__ import annotations

import numpy as np

from zoac.check.samples import Found
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.evaluation import evaluation_proposals
from zoac.rollout.task import Task
from zoac.specs.verdict import over_episodes

EPISODES = 5
"""Evaluation episodes, the first of a run's."""


def baseline_specs(task: Task) -> Found:
    """Return whether the specs can be judged, and what they come to with the baseline values.

    Without baseline values the middle of the bounds takes their place.
    """
    x, which = np.zeros(task.space.dimension), "in the middle of the bounds"
    if task.baseline is not None:
        x, which = task.space.normalise(task.baseline), "with the baseline values"
    engine = RolloutEngine(task, range(EPISODES), [0] * EPISODES)
    try:
        segments = engine.rollout(evaluation_proposals(x, EPISODES, seed=0))
        limit = task.horizon.steps
    finally:
        engine.close()
    if all(segment.terminated and segment.length < limit for segment in segments):
        return False, (
            f"every episode terminates {which}, the first after {segments[0].length} of {limit} "
            "steps, so no whole response can be judged; give baseline values with which episodes "
            "last, and return truncated, not terminated, where time is over"
        )
    told = [
        f"{label}: {row['value']:.4g}" + {True: ", met", False: ", not met", None: ""}[row["met"]]
        for label, row in over_episodes(segments, task.specs).items()
    ]
    return True, f"{which}, over {EPISODES} episodes: {'; '.join(told)}"
