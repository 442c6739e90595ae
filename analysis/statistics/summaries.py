"""What runs had reached within a budget, and a method's summary over its seeds."""

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
class Outcome:
    """What one run had reached within a budget.

    Args:
        seed: The run's.
        costs: Of each episode of that evaluation, (E,).
        prediction_error: Mean over them.
        violations: Share of them that violate a constraint; None without constraints.
        wall_seconds: Until then.
        compute_seconds: Likewise.
        choices: What the tuner chose.
    """

    seed: int
    costs: np.ndarray
    prediction_error: float | None
    violations: float | None
    wall_seconds: float
    compute_seconds: float
    choices: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Summary:
    """One method over its seeds. Numbers that cannot be had are None.

    Args:
        method: Which.
        label: For people to read.
        tuned: Whether it spent environment steps on tuning.
        seeds: Those that count.
        missing: Those that others have and this method lacks.
        not_finite: Those whose cost is not a number; if there is any, nothing is averaged.
        scores: Costs, seeds by episodes.
        cost: Mean cost and its interval.
        cost_std: Mean and standard deviation over seeds.
        iqm: Interquartile mean of the seeds' costs, and its interval.
        minus_nominal: Mean cost less that of the nominal controller, paired.
        prediction_error: Over seeds.
        violations: Share of its own evaluation's episodes that violate a constraint, over seeds;
            None without constraints.
        wall_seconds: Over seeds, evaluation included.
        compute_seconds: Likewise, over all processes.
        choices: What its tuner chose in every seed: start, noise model, recommendation, ...
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


def outcome(run: Run, budget: int | None = None) -> Outcome:
    """Return what `run` had reached at the end, or at its last evaluation within `budget`.

    Raises:
        RunFolderError: If it was not evaluated within `budget`.
    """
    row = run.outcome
    if budget is not None and run.tuned and budget < row["env_steps"]:
        earlier = [row for row in run.evaluations if row["env_steps"] <= budget]
        if not earlier:
            raise RunFolderError(f"{run.folder}: no evaluation within {budget} environment steps")
        row = earlier[-1]
    error, violations = row.get("prediction_error"), row.get("violations")
    costs = np.array(row["cost_per_episode"], dtype=np.float64)
    return Outcome(
        run.seed,
        costs,
        None if error is None else float(error),
        None if violations is None else violations / len(costs),
        float(row["wall_seconds"]),
        float(row.get("compute_seconds", "nan")),
        run.identity.get("tuner_choices", {}),
    )


def scores_of(outcomes: list[Outcome], tuned: bool, episodes: int) -> Scores | None:
    """Return the costs of the first `episodes`; None if one is not finite."""
    # The first episodes are the same however many there are.
    costs = np.stack([o.costs[:episodes] for o in outcomes])
    return Scores(costs, tuned) if np.isfinite(costs).all() else None


def summary_of(
    method: Method,
    label: str,
    outcomes: list[Outcome],
    wanted: list[int],
    scores: Scores | None,
    nominal: Scores | None,
    nominal_label: str,
    random_seed: int,
) -> Summary:
    """Return a method's summary.

    Args:
        method: Which.
        label: For people to read.
        outcomes: Of its runs.
        wanted: Seeds that it should have.
        scores: Its costs.
        nominal: The nominal controller's; None: there is none, or this is it.
        nominal_label: For people to read.
        random_seed: Of the bootstrap.
    """
    seeds = tuple(o.seed for o in outcomes)
    tuned = scores.tuned if scores is not None else method.tuner != NOMINAL
    errors = [o.prediction_error for o in outcomes if o.prediction_error is not None]
    violations = [o.violations for o in outcomes if o.violations is not None]
    cost = iqm = minus_nominal = None
    if scores is not None:
        name = f"analysis {label}"
        cost = summarise(scores, stream(random_seed, name))
        iqm = summarise(scores, stream(random_seed, name, 1), statistic=interquartile_mean)
        if nominal is not None:
            minus_nominal = paired_difference(
                scores, nominal, claim_stream(random_seed, label, nominal_label)
            )
    return Summary(
        method=method,
        label=label,
        tuned=tuned,
        seeds=seeds,
        missing=tuple(s for s in wanted if s not in seeds) if tuned else (),
        not_finite=tuple(o.seed for o in outcomes if not np.isfinite(o.costs).all()),
        scores=scores,
        cost=cost,
        cost_std=None if scores is None else _over_seeds(scores.per_seed, tuned),
        iqm=iqm,
        minus_nominal=minus_nominal,
        prediction_error=_over_seeds(errors, tuned),
        violations=_over_seeds(violations, tuned),
        wall_seconds=mean_std([o.wall_seconds for o in outcomes]),
        compute_seconds=mean_std([o.compute_seconds for o in outcomes]),
        choices=_common([o.choices for o in outcomes]),
    )


def _common(choices: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what is the same in all."""
    if not choices:
        return {}
    first, *others = choices
    return {k: v for k, v in first.items() if all(o.get(k) == v for o in others)}


def _over_seeds(values: Sequence[float] | np.ndarray, tuned: bool) -> MeanStd | None:
    # The copies of a controller that was not tuned do not scatter.
    return mean_std(values if tuned else values[:1])
