"""Methods side by side: what is missing, and which claims the data support."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from zoac.analysis.data.fairness import refuse_mixed, refuse_unequal
from zoac.analysis.data.runs import Collection, Method, Run, by_method
from zoac.analysis.figures.labels import TASKS, family, method_labels, tuner_names
from zoac.analysis.statistics.claims import Claim, claims
from zoac.analysis.statistics.summaries import (
    NOMINAL,
    Summary,
    costs_of,
    reached,
    scores_of,
    summary_of,
)
from zoac.core.errors import RunFolderError

TABLE2 = (
    Method("mpc_tracking", "zoac", None),
    Method("mpc_tracking_reg", "zoac", None),
    Method("mpc_tracking", "bo", None),
    Method("mpc_tracking", "cmaes", None),
    Method("mpc_tracking", NOMINAL, None),
)
"""The rows of the paper's Table II, in its order."""


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
    whole_table: bool = True,
) -> Comparison:
    """Summarise and compare all methods of `task` and of its regularised twin.

    Args:
        collection: The runs.
        task: Name of the task.
        variant: Use only runs of this variant.
        budget: Use the last evaluation of each run within so many environment steps.
        seeds: Seeds that every tuned method should have; default: all seeds of all methods.
        random_seed: Seed of the bootstrap.
        whole_table: Whether to list rows of Table II of which there is no run.

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
    for group in groups.values():
        refuse_mixed(group)
    refuse_unequal([group[0] for group in groups.values()])
    wanted = sorted(seeds if seeds is not None else {r.seed for r in runs if not _is_untuned(r)})
    rows = {m: {run.seed: reached(run, budget) for run in group} for m, group in groups.items()}
    all_rows = [row for found in rows.values() for row in found.values()]
    episodes = min(len(costs_of(row)) for row in all_rows)
    expected = _expected(task, groups) if whole_table else set()
    methods = _order({run.method for run in runs} | expected)
    labels = method_labels(methods, tuner_names(runs))
    nominal = next((m for m, group in groups.items() if _is_untuned(group[0])), None)
    scores = {m: scores_of([*rows[m].values()], groups[m][0].tuned, episodes) for m in groups}
    summaries = []
    for method in methods:
        reference = scores.get(nominal) if nominal and method != nominal else None
        summaries.append(
            summary_of(
                method,
                labels[method],
                rows.get(method, {}),
                wanted,
                scores.get(method),
                (labels[nominal], reference) if nominal and reference else None,
                [run.identity.get("tuner_choices", {}) for run in groups.get(method, [])],
                random_seed,
            )
        )
    known = [(s.label, s.scores) for s in summaries if s.scores is not None]
    notes = [
        *_missing_notes(summaries),
        *_violation_notes(all_rows),
        *_timing_notes([run for group in groups.values() for run in group]),
        *(f"left out {item}" for item in collection.left_out),
    ]
    return Comparison(
        task, tuple(summaries), claims(known, random_seed), tuple(notes), budget, episodes
    )


def _is_untuned(run: Run) -> bool:
    return run.result is not None and not run.tuned


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


def _violation_notes(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    # The log has no violations per episode, so they cannot be counted over the common episodes.
    numbers = sorted({len(costs_of(r)) for r in rows if r.get("violations") is not None})
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
