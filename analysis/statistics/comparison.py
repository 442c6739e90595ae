"""Methods side by side: what is missing, and which claims the data carry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zoac.analysis.data.fairness import refuse_mixed, refuse_unequal
from zoac.analysis.data.runs import Collection, Method, Run, by_method
from zoac.analysis.figures.labels import TASKS, family, method_labels
from zoac.analysis.statistics.claims import Claim, claims
from zoac.analysis.statistics.summaries import (
    NOMINAL,
    Outcome,
    Summary,
    outcome,
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
    scores = {m: scores_of(outcomes[m], groups[m][0].tuned, episodes) for m in groups}
    summaries = []
    for method in methods:
        reference = scores.get(nominal) if nominal and method != nominal else None
        summaries.append(
            summary_of(
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
