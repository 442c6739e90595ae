"""Methods side by side: summaries over seeds, what is missing, and which claims the data carry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zoac.analysis.claims import Claim, claim_stream, claims
from zoac.analysis.fairness import refuse_mixed, refuse_unequal
from zoac.analysis.labels import TASKS, family, method_labels
from zoac.analysis.runs import Collection, Method, Run, by_method
from zoac.analysis.stats import (
    Interval,
    Scores,
    Spread,
    interquartile_mean,
    paired_difference,
    spread,
    summarise,
)
from zoac.errors import RunFolderError
from zoac.seeding import stream

NOMINAL = "nominal"
TABLE2 = (
    Method("mpc_tracking", "zoac", None),
    Method("mpc_tracking_reg", "zoac", None),
    Method("mpc_tracking", "bo", None),
    Method("mpc_tracking", "cmaes", None),
    Method("mpc_tracking", NOMINAL, None),
)
"""The rows of the paper's Table II, in its order."""


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
        cost_spread: Mean and standard deviation over seeds.
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
    cost_spread: Spread | None
    iqm: Interval | None
    minus_nominal: Interval | None
    prediction_error: Spread | None
    violations: Spread | None
    wall_seconds: Spread | None
    compute_seconds: Spread | None
    choices: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Comparison:
    """All methods of one task.

    Args:
        task: Its name.
        summaries: One per method, tuned ones first.
        claims: One per pair of methods that both have a cost.
        notes: What is missing, left out or not comparable, one sentence each.
        budget: Environment steps; None for each run's own end.
        episodes: Number of shared evaluation episodes.
    """

    task: str
    summaries: tuple[Summary, ...]
    claims: tuple[Claim, ...]
    notes: tuple[str, ...]
    budget: int | None
    episodes: int

    @property
    def title(self) -> str:
        """The task's name for people to read."""
        return TASKS.get(self.task, self.task)


def compare(
    collection: Collection,
    task: str,
    *,
    variant: str | None = None,
    budget: int | None = None,
    seeds: Sequence[int] | None = None,
    random_seed: int = 0,
) -> Comparison:
    """Summarise and compare all methods of `task` and of its regularised twin.

    Args:
        collection: The runs.
        task: Name of the task.
        variant: Keep to runs of this variant.
        budget: Take each run where it stood after so many environment steps.
        seeds: Keep to these, which every tuned method should have; by default to all that any
            of them has.
        random_seed: Of the bootstrap.

    Raises:
        RunFolderError: If there is no such finished run, or runs must not be averaged or compared.
    """
    collection = collection.of_task(*family(task))
    if variant is not None:
        collection = collection.of_variant(variant)
    runs = collection.runs
    if seeds is not None:
        runs = tuple(run for run in runs if run.seed in seeds or _is_untuned(run))
    groups = by_method(run for run in runs if run.result is not None)
    if not groups:
        raise RunFolderError(f"no finished run of task {task!r}; see the folders left out")
    _check(groups)
    wanted = sorted(seeds if seeds is not None else {r.seed for r in runs if not _is_untuned(r)})
    outcomes = {m: [outcome(run, budget) for run in group] for m, group in groups.items()}
    episodes = min(len(o.costs) for group in outcomes.values() for o in group)
    methods = _order({run.method for run in runs} | _expected(task, groups))
    labels = method_labels(methods)
    nominal = next((m for m, group in groups.items() if _is_untuned(group[0])), None)
    scores = {m: _scores(outcomes[m], groups[m][0].tuned, episodes) for m in groups}
    summaries = []
    for method in methods:
        reference = scores.get(nominal) if nominal and method != nominal else None
        summaries.append(
            _summarise(
                method,
                labels[method],
                outcomes.get(method, []),
                wanted,
                scores.get(method),
                reference,
                labels[nominal] if nominal else "",
                random_seed,
            )
        )
    known = [(s.label, s.scores) for s in summaries if s.scores is not None]
    notes = [
        *_missing_notes(summaries),
        *_violation_notes([o for group in outcomes.values() for o in group]),
        *_timing_notes([run for group in groups.values() for run in group]),
        *(f"left out {item}" for item in collection.left_out),
    ]
    return Comparison(
        task, tuple(summaries), claims(known, random_seed), tuple(notes), budget, episodes
    )


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


def _is_untuned(run: Run) -> bool:
    return run.result is not None and not run.tuned


def _check(groups: dict[Method, list[Run]]) -> None:
    for group in groups.values():
        refuse_mixed(group)
    refuse_unequal([group[0] for group in groups.values()])


def _expected(task: str, groups: dict[Method, list[Run]]) -> set[Method]:
    """Return the rows of Table II for which there is no run of any variant."""
    found = {(m.task, m.tuner) for m in groups}
    wanted = TABLE2 if task == TABLE2[0].task else ()
    return {m for m in wanted if (m.task, m.tuner) not in found}


def _order(methods: set[Method]) -> list[Method]:
    tuners = list(dict.fromkeys(m.tuner for m in TABLE2 if m.tuner != NOMINAL))

    def key(m: Method) -> tuple[bool, int, str, str, str]:
        place = tuners.index(m.tuner) if m.tuner in tuners else len(tuners)
        return m.tuner == NOMINAL, place, m.tuner, m.task, m.variant or ""

    return sorted(methods, key=key)


def _scores(outcomes: list[Outcome], tuned: bool, episodes: int) -> Scores | None:
    # The first episodes are the same however many there are.
    costs = np.stack([o.costs[:episodes] for o in outcomes])
    return Scores(costs, tuned) if np.isfinite(costs).all() else None


def _summarise(
    method: Method,
    label: str,
    outcomes: list[Outcome],
    wanted: list[int],
    scores: Scores | None,
    nominal: Scores | None,
    nominal_label: str,
    random_seed: int,
) -> Summary:
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
        cost_spread=None if scores is None else _over_seeds(scores.per_seed, tuned),
        iqm=iqm,
        minus_nominal=minus_nominal,
        prediction_error=_over_seeds(errors, tuned),
        violations=_over_seeds(violations, tuned),
        wall_seconds=spread([o.wall_seconds for o in outcomes]),
        compute_seconds=spread([o.compute_seconds for o in outcomes]),
        choices=_common([o.choices for o in outcomes]),
    )


def _common(choices: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what is the same in all."""
    if not choices:
        return {}
    first, *others = choices
    return {k: v for k, v in first.items() if all(o.get(k) == v for o in others)}


def _over_seeds(values: Sequence[float] | np.ndarray, tuned: bool) -> Spread | None:
    # The copies of a controller that was not tuned do not scatter.
    return spread(values if tuned else values[:1])


def _missing_notes(summaries: Sequence[Summary]) -> list[str]:
    notes = []
    for s in summaries:
        if s.missing:
            which = ", ".join(map(str, s.missing))
            total = len(s.seeds) + len(s.missing)
            notes.append(f"{s.label}: {len(s.seeds)} of {total} seeds; missing: {which}")
        elif not s.seeds:
            notes.append(f"{s.label}: no finished run")
        if s.not_finite:
            which = ", ".join(map(str, s.not_finite))
            notes.append(f"{s.label}: the cost of seed {which} is not finite; nothing is averaged")
    return notes


def _violation_notes(outcomes: Sequence[Outcome]) -> list[str]:
    # Which episodes violate is not logged, so there is no counting anew over the shared ones.
    numbers = sorted({len(o.costs) for o in outcomes if o.violations is not None})
    if len(numbers) < 2:
        return []
    return [
        "shares of episodes in violation are over all episodes of each evaluation, "
        f"{numbers[0]} to {numbers[-1]}, not only the shared ones"
    ]


def _timing_notes(runs: Sequence[Run]) -> list[str]:
    notes = []
    tuned = [run for run in runs if run.tuned]
    for what, values in (
        ("executors", {str(run.config.get("executor")) for run in tuned}),
        ("machines", {str(run.identity.get("machine")) for run in tuned}),
    ):
        if len(values) > 1:
            notes.append(f"times come from {len(values)} different {what} and do not compare")
    commits = {str(run.identity.get("commit")) for run in runs}
    if len(commits) > 1:
        notes.append(f"runs come from {len(commits)} commits: {', '.join(sorted(commits))}")
    return notes
