"""What runs reached within a budget, and the summary of a method over its seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zoac.analysis.data.runs import Method, Run
from zoac.analysis.statistics.claims import claim_stream
from zoac.analysis.statistics.stats import (
    Interval,
    MeanStd,
    Scores,
    interquartile_mean,
    mean_std,
    paired_difference,
    summarise,
)
from zoac.core.errors import RunFolderError
from zoac.core.seeding import stream

NOMINAL = "nominal"


@dataclass(frozen=True, eq=False)
class Summary:
    """One method over its seeds. Numbers that cannot be had are None.

    Args:
        method: Task, tuner and variant.
        label: Name of the method in tables.
        tuned: Whether tuning took environment steps.
        seeds: Seeds that count.
        missing: Seeds that other methods have and this one lacks.
        not_finite: Seeds whose cost is not finite; if there is one, nothing is averaged.
        scores: Costs, seeds by episodes.
        cost: Mean cost and its interval.
        cost_std: Mean and standard deviation of the cost over seeds.
        iqm: Interquartile mean of the seeds' costs and its interval.
        minus_nominal: Mean cost minus that of the nominal controller, paired.
        prediction_error: Over seeds.
        violations: Fraction of the episodes of the evaluation that violate a constraint or
            break a hard spec, over seeds; None without either.
        wall_seconds: Over seeds, including evaluation.
        compute_seconds: Over seeds, including evaluation, summed over all processes.
        choices: What the tuner chose in every seed: start, noise model, recommendation, ...
    """

    method: Method
    label: str
    tuned: bool
    seeds: tuple[int, ...]
    missing: tuple[int, ...]
    not_finite: tuple[int, ...]
    scores: Scores | None
    cost: Interval | None
    cost_std: MeanStd | None
    iqm: Interval | None
    minus_nominal: Interval | None
    prediction_error: MeanStd | None
    violations: MeanStd | None
    wall_seconds: MeanStd | None
    compute_seconds: MeanStd | None
    choices: Mapping[str, Any]


def reached(run: Run, budget: int | None = None) -> Mapping[str, Any]:
    """Return the final record of `run`, or that of its last evaluation within `budget`.

    Raises:
        RunFolderError: If it was not evaluated within `budget`.
    """
    if budget is None or not run.tuned or budget >= run.outcome["env_steps"]:
        return run.outcome
    earlier = [row for row in run.evaluations if row["env_steps"] <= budget]
    if not earlier:
        raise RunFolderError(f"{run.folder}: no evaluation within {budget} environment steps")
    return earlier[-1]


def costs_of(row: Mapping[str, Any]) -> np.ndarray:
    """Return the cost of each episode of an evaluation, (E,); NaN where none was recorded."""
    return np.array(row["cost_per_episode"], dtype=np.float64)


def scores_of(rows: Sequence[Mapping[str, Any]], tuned: bool, episodes: int) -> Scores | None:
    """Return the costs of the first `episodes`, the same in all rows, if they are finite."""
    costs = np.stack([costs_of(row)[:episodes] for row in rows])
    return Scores(costs, tuned) if np.isfinite(costs).all() else None


def summary_of(
    method: Method,
    label: str,
    rows: Mapping[int, Mapping[str, Any]],
    wanted: Sequence[int],
    scores: Scores | None,
    nominal: tuple[str, Scores] | None,
    choices: Sequence[Mapping[str, Any]],
    random_seed: int,
) -> Summary:
    """Return the summary of a method.

    Args:
        method: Task, tuner and variant.
        label: Name of the method in tables.
        rows: What each seed reached, see `reached`.
        wanted: Seeds that the method should have.
        scores: Costs of the method.
        nominal: Label and costs of the nominal controller, if there are any to compare with.
        choices: What the tuner of each run chose.
        random_seed: Seed of the bootstrap.
    """
    tuned = scores.tuned if scores is not None else method.tuner != NOMINAL
    cost = iqm = minus_nominal = None
    if scores is not None:
        name = f"analysis {label}"
        cost = summarise(scores, stream(random_seed, name))
        iqm = summarise(scores, stream(random_seed, name, 1), statistic=interquartile_mean)
        if nominal is not None:
            rng = claim_stream(random_seed, label, nominal[0])
            minus_nominal = paired_difference(scores, nominal[1], rng)

    def over_seeds(values: Sequence[float] | np.ndarray) -> MeanStd | None:
        # The seeds of a controller that was not tuned are copies.
        return mean_std(values if tuned else values[:1])

    found = list(rows.values())
    errors = [r["prediction_error"] for r in found if r.get("prediction_error") is not None]
    violations = [
        r["violations"] / len(costs_of(r)) for r in found if r.get("violations") is not None
    ]
    return Summary(
        method=method,
        label=label,
        tuned=tuned,
        seeds=tuple(rows),
        missing=tuple(s for s in wanted if s not in rows) if tuned else (),
        not_finite=tuple(s for s, r in rows.items() if not np.isfinite(costs_of(r)).all()),
        scores=scores,
        cost=cost,
        cost_std=None if scores is None else over_seeds(scores.per_seed),
        iqm=iqm,
        minus_nominal=minus_nominal,
        prediction_error=over_seeds(errors),
        violations=over_seeds(violations),
        wall_seconds=mean_std([r["wall_seconds"] for r in found]),
        compute_seconds=mean_std([r.get("compute_seconds", np.nan) for r in found]),
        choices={
            k: v for k, v in (choices or [{}])[0].items() if all(o.get(k) == v for o in choices)
        },
    )
