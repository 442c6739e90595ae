"""Methods side by side: each over its seeds, what is missing, which claims the data support."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from zoac.analysis.data.fairness import refuse_unequal, unmixed
from zoac.analysis.data.runs import Collection, Method, Run
from zoac.analysis.figures.labels import family, method_labels, tuner_names
from zoac.analysis.pages.formatting import estimate
from zoac.analysis.statistics.intervals import (
    MIN_SEEDS,
    UNKNOWN,
    Interval,
    MeanStd,
    Scores,
    interquartile_mean,
    mean_std,
    paired_difference,
    probability_of_improvement,
    summarise,
)
from zoac.core.errors import RunFolderError
from zoac.core.seeding import stream

NOMINAL = "nominal"


@dataclass(frozen=True)
class Claim:
    """The comparison of two methods.

    Args:
        first: Label of one method.
        second: Label of the other.
        difference: Mean cost of the first minus that of the second, paired.
        improvement: Probability that a seed of the first costs less; unknown if one is not tuned.
    """

    first: str
    second: str
    difference: Interval
    improvement: Interval

    def __str__(self) -> str:
        d, p = self.difference, self.improvement
        pair = f"{self.first} - {self.second} = {estimate(d, sign=True)}"
        if not d.exists:
            return f"{pair}: no claim, fewer than {MIN_SEEDS} seeds"
        means = f"{pair}: {self._said(d.side(), 'costs less on average')}"
        if not p.exists:
            return means
        seeds = f"P({self.first} better) = {p.estimate:.2f} [{p.low:.3f}, {p.high:.3f}]"
        return f"{means}; {seeds}: {self._said(-p.side(of=0.5), 'is the better more often')}"

    def _said(self, side: int, what: str) -> str:
        return "no claim" if side == 0 else f"{self.first if side < 0 else self.second} {what}"


@dataclass(frozen=True, eq=False)
class Summary:
    """One method over its seeds. Numbers that cannot be had are NaN.

    Args:
        method: Task, tuner and variant.
        label: Name of the method in tables.
        tuned: Whether tuning took environment steps.
        seeds: Seeds that count.
        missing: Seeds that other methods have and this one lacks.
        not_finite: Seeds whose cost is not finite; if there is one, nothing is averaged.
        intervals: `cost`, the mean; `iqm`, the interquartile mean of the seeds; `minus_nominal`,
            the mean minus that of the nominal controller, paired.
        means: Over the seeds: `cost`, `prediction_error`, `violations` (fraction of the episodes
            that violate a constraint or break a hard spec), and `wall_seconds` and
            `compute_seconds`, summed over all processes, both including evaluation.
        choices: What the tuner chose in every seed: start, noise model, recommendation, ...
    """

    method: Method
    label: str
    tuned: bool
    seeds: tuple[int, ...]
    missing: tuple[int, ...]
    not_finite: tuple[int, ...]
    intervals: Mapping[str, Interval]
    means: Mapping[str, MeanStd]
    choices: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Comparison:
    """All methods of one task.

    Args:
        task: Name of the task.
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


def compare(
    collection: Collection,
    task: str,
    *,
    variant: str | None = None,
    budget: int | None = None,
    seeds: Sequence[int] | None = None,
    expected: Sequence[Method] = (),
) -> Comparison:
    """Summarise and compare all methods of `task` and of its regularised twin.

    Args:
        collection: The runs.
        task: Name of the task.
        variant: Use only runs of this variant.
        budget: Use the last evaluation of each run within so many environment steps.
        seeds: Seeds that every tuned method should have; default: all seeds of all methods.
        expected: Methods of tuners that are listed even where there is no run.

    Raises:
        RunFolderError: If there is no such finished run, or runs must not be averaged or compared.
    """
    collection = collection.of_task(*family(task)).of_variant(variant)
    runs = [
        run for run in collection.runs if seeds is None or run.seed in seeds or _is_untuned(run)
    ]
    groups = unmixed(run for run in runs if run.result is not None)
    if not groups:
        if others := sorted({run.seed for run in collection.finished}):
            raise RunFolderError(
                f"no finished run of task {task!r} with these seeds; "
                f"there are {', '.join(map(str, others))}"
            )
        raise RunFolderError(f"no finished run of task {task!r}; see the folders left out")
    refuse_unequal([group[0] for group in groups.values()])
    wanted = sorted(seeds if seeds is not None else {r.seed for r in runs if not _is_untuned(r)})
    rows = {m: {run.seed: reached(run, budget) for run in group} for m, group in groups.items()}
    all_rows = [row for found in rows.values() for row in found.values()]
    episodes = min(len(row["cost_per_episode"]) for row in all_rows)
    known_tuners = {(m.task, m.tuner) for m in groups}
    missing = {m for m in expected if (m.task, m.tuner) not in known_tuners}
    methods = sorted({run.method for run in runs} | missing, key=lambda method: method.rank)
    labels = method_labels(methods, tuner_names(runs))
    nominal = next((labels[m] for m in groups if m.tuner == NOMINAL), None)
    scores = {}
    for method, found in rows.items():
        costs = np.stack([_costs(row)[:episodes] for row in found.values()])
        if np.isfinite(costs).all():
            scores[method] = Scores(costs, groups[method][0].tuned)
    known = [(labels[method], scores[method]) for method in methods if method in scores]
    judged = _claims(known)
    minus_nominal = {c.first: c.difference for c in judged if c.second == nominal}
    summaries = [
        _summary(
            method, labels[method], groups.get(method, []), rows.get(method, {}), wanted,
            scores.get(method), minus_nominal.get(labels[method], UNKNOWN),
        )
        for method in methods
    ]  # fmt: skip
    notes = _notes(summaries, all_rows, [run for group in groups.values() for run in group])
    notes += [f"left out {item}" for item in collection.left_out]
    return Comparison(task, tuple(summaries), judged, tuple(notes), budget, episodes)


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


def _costs(row: Mapping[str, Any]) -> np.ndarray:
    """Return the cost of each episode of an evaluation, (E,); NaN where none was recorded."""
    return np.array(row["cost_per_episode"], dtype=np.float64)


def _summary(
    method: Method,
    label: str,
    runs: Sequence[Run],
    rows: Mapping[int, Mapping[str, Any]],
    wanted: Sequence[int],
    scores: Scores | None,
    minus_nominal: Interval,
) -> Summary:
    """Return the summary of a method with its runs, and with what each seed reached."""
    tuned = scores.tuned if scores is not None else method.tuner != NOMINAL
    cost = iqm = UNKNOWN
    if scores is not None:
        name = f"analysis {label}"
        cost = summarise(scores, stream(0, name))
        iqm = summarise(scores, stream(0, name, 1), statistic=interquartile_mean)

    def over_seeds(values: Sequence[float]) -> MeanStd:
        # The seeds of a controller that was not tuned are copies.
        return mean_std(values if tuned else values[:1])

    found = list(rows.values())
    errors = [r["prediction_error"] for r in found if r.get("prediction_error") is not None]
    violated = [r["violations"] / len(_costs(r)) for r in found if r.get("violations") is not None]
    choices = [run.identity.get("tuner_choices", {}) for run in runs] or [{}]
    return Summary(
        method=method,
        label=label,
        tuned=tuned,
        seeds=tuple(rows),
        missing=tuple(s for s in wanted if s not in rows) if tuned else (),
        not_finite=tuple(s for s, r in rows.items() if not np.isfinite(_costs(r)).all()),
        intervals={"cost": cost, "iqm": iqm, "minus_nominal": minus_nominal},
        means={
            "cost": over_seeds([] if scores is None else scores.per_seed.tolist()),
            "prediction_error": over_seeds(errors),
            "violations": over_seeds(violated),
            "wall_seconds": mean_std([r["wall_seconds"] for r in found]),
            "compute_seconds": mean_std([r.get("compute_seconds", np.nan) for r in found]),
        },
        choices={k: v for k, v in choices[0].items() if all(o.get(k) == v for o in choices)},
    )


def _claims(methods: Sequence[tuple[str, Scores]]) -> tuple[Claim, ...]:
    """Return a claim for each pair of labelled methods, in order."""
    made = []
    for (first, a), (second, b) in combinations(methods, 2):
        rng = stream(0, f"analysis {first} - {second}")
        both = a.tuned and b.tuned
        improvement = probability_of_improvement(a.per_seed, b.per_seed) if both else UNKNOWN
        made.append(Claim(first, second, paired_difference(a, b, rng), improvement))
    return tuple(made)


def _is_untuned(run: Run) -> bool:
    return run.result is not None and not run.tuned


def _notes(
    summaries: Sequence[Summary], rows: Sequence[Mapping[str, Any]], runs: Sequence[Run]
) -> list[str]:
    """Return what is missing or not comparable in the summaries, their records and their runs."""
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
    # The log has no violations per episode, so they cannot be counted over the common episodes.
    numbers = {len(_costs(r)) for r in rows if r.get("violations") is not None}
    if len(numbers) > 1:
        notes.append(
            "shares of episodes in violation are over all episodes of each evaluation, "
            f"{min(numbers)} to {max(numbers)}, not only the shared ones"
        )
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
