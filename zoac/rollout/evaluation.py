"""Fixed evaluation episodes: the same starts and disturbances for every tuner, seed and machine.

Because all controllers meet the same episodes, differences between them are paired.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zoac.core.measures import Constraint, Metric
from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.rollout.constraints import violations
from zoac.specs.spec import Spec


def evaluation_proposals(x: np.ndarray, episodes: int, seed: int) -> list[Proposal]:
    """Return one whole-episode proposal per evaluation episode, each for another environment.

    Args:
        x: Mapped parameters (d,).
        episodes: How many of the fixed episodes.
        seed: The seed of the evaluation episodes, not of the run.
    """
    return [
        Proposal(x=x, env_index=k, seed=stream_seed(seed, "evaluation", k)) for k in range(episodes)
    ]


def evaluation_row(
    segments: Sequence[Segment],
    metrics: Sequence[Metric],
    constraints: Sequence[Constraint] = (),
    specs: Sequence[Spec] = (),
) -> dict[str, Any]:
    """Return the numbers of an evaluation, with undiscounted plain costs.

    Metrics leave out steps that failed; the mean over no step at all is None. If an episode failed,
    `failed_episodes` has their `count` and why the `first` did.

    Raises:
        ConfigError: If a metric or constraint does not return one number per step.
    """
    costs = np.array([s.costs.sum() for s in segments])
    with np.errstate(invalid="ignore"):  # a response that ended early has an infinite objective
        mean, std = costs.mean(), costs.std(ddof=1) if len(costs) > 1 else 0.0
    row: dict[str, Any] = {
        "cost_mean": float(mean),
        "cost_std": float(std),
        "cost_per_episode": costs.tolist(),
        "episode_lengths": [s.length for s in segments],
        "terminations": sum(s.terminated for s in segments),
        **violations(segments, constraints, specs),
    }
    if failures := [s.failure for s in segments if s.failure is not None]:
        row["failed_episodes"] = {"count": len(failures), "first": failures[0]}
    for metric in metrics:
        measured = [s.measured() for s in segments]
        values = np.concatenate([np.zeros(0), *(metric.values(s) for s in measured if s.length)])
        if metric.reduce == "sum":
            row[metric.name] = _sum(values)
        else:
            row[metric.name] = float(values.mean()) if len(values) else None
    return row


def _sum(values: np.ndarray) -> int | float:
    """Return the sum of values (T,); counts stay whole numbers."""
    whole = np.all(np.isfinite(values)) and np.all(values == np.floor(values))
    return int(values.sum()) if whole else float(values.sum())
