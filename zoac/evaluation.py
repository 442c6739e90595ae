"""Fixed evaluation episodes: the same starts and disturbances for every tuner, seed and machine.

Because all controllers meet the same episodes, differences between them are paired.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zoac.constraints import violations
from zoac.seeding import stream_seed
from zoac.segments import Proposal, Segment
from zoac.task import Constraint, Metric


def evaluation_proposals(z: np.ndarray, episodes: int, seed: int) -> list[Proposal]:
    """Return one whole-episode proposal per evaluation episode, each in a lane of its own.

    Args:
        z: Mapped parameters (d,).
        episodes: How many of the fixed episodes.
        seed: The seed of the evaluation episodes, not of the run.
    """
    return [Proposal(z=z, lane=k, seed=stream_seed(seed, "evaluation", k)) for k in range(episodes)]


def evaluation_row(
    segments: Sequence[Segment],
    metrics: Sequence[Metric],
    constraints: Sequence[Constraint] = (),
) -> dict[str, Any]:
    """Return the numbers of an evaluation, with undiscounted plain costs."""
    costs = np.array([s.costs.sum() for s in segments])
    row: dict[str, Any] = {
        "cost_mean": float(costs.mean()),
        "cost_std": float(costs.std(ddof=1)) if len(costs) > 1 else 0.0,
        "cost_per_episode": costs.tolist(),
        "episode_lengths": [s.length for s in segments],
        "terminations": sum(s.terminated for s in segments),
        **violations(segments, constraints),
    }
    for metric in metrics:
        values = np.concatenate([np.asarray(metric.per_step(s)) for s in segments])
        row[metric.name] = float(values.mean()) if metric.reduce == "mean" else int(values.sum())
    return row
