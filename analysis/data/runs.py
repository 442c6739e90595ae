"""Runs and collections of runs, read from their folders."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from zoac.core.errors import RunFolderError, suggest
from zoac.study.state.journal import Journal

REGULARISED = "_reg"
"""End of the name of a task whose tuner sees a regularised cost."""

FIRST = ("zoac", "bo", "cmaes")
"""Tuners that come first, in the order of the paper's Table II."""


class Method(NamedTuple):
    """Task, tuner and variant: runs of one method differ in their seeds only."""

    task: str
    tuner: str
    variant: str | None

    @property
    def row(self) -> str:
        """Its row in tables and figures: the tuner, `_reg` behind it with the regularised cost."""
        return self.tuner + REGULARISED if self.task.endswith(REGULARISED) else self.tuner

    @property
    def rank(self) -> tuple[bool, int, str, str, str]:
        """Its place in tables and figures: ZOAC first, the nominal controller last."""
        name = self.tuner
        place = FIRST.index(name) if name in FIRST else len(FIRST)
        return name == "nominal", place, name, self.task, self.variant or ""

    def __str__(self) -> str:
        variant = f" ({self.variant})" if self.variant else ""
        return f"{self.tuner}{variant} on {self.task}"


@dataclass(frozen=True, eq=False)
class Run:
    """One run.

    Args:
        folder: The run folder.
        identity: Content of run.json.
        metrics: Records of metrics.jsonl.
        result: Content of result.json; None while the run is not finished.
        trusted: Whether a replay may load code that is not zoac's own.
    """

    folder: Path
    identity: Mapping[str, Any]
    metrics: Sequence[Mapping[str, Any]]
    result: Mapping[str, Any] | None
    trusted: bool = False

    @property
    def method(self) -> Method:
        """Task, tuner and variant."""
        return Method(self.identity["task"], self.identity["tuner"], self.identity["variant"])

    @property
    def seed(self) -> int:
        """The run's seed."""
        return int(self.identity["seed"])

    @property
    def config(self) -> Mapping[str, Any]:
        """The resolved configuration."""
        return self.identity["config"]

    @cached_property
    def evaluations(self) -> list[Mapping[str, Any]]:
        """Metric rows of kind "eval" taken while tuning, in order."""
        return [row for row in self.metrics if row["kind"] == "eval" and not row.get("final")]

    @property
    def start(self) -> Mapping[str, Any] | None:
        """The parameters from which tuning began, if they were logged."""
        if not self.evaluations or self.evaluations[0]["env_steps"] > 0:
            return None
        return self.evaluations[0].get("parameters")

    @property
    def outcome(self) -> Mapping[str, Any]:
        """result.json.

        Raises:
            RunFolderError: If the run is not finished.
        """
        if self.result is None:
            raise RunFolderError(f"{self.folder}: {_unfinished(self)}")
        return self.result

    @property
    def costs(self) -> np.ndarray:
        """Final cost of each evaluation episode, (E,); NaN where none was recorded.

        Raises:
            RunFolderError: If the run is not finished, or only its mean was kept.
        """
        if "cost_per_episode" not in self.outcome:
            raise RunFolderError(
                f"{self.folder}: only means over the episodes were kept (zoac.analysis.compact "
                "--summary), which zoac.analysis.beyond reads; all else needs the runs themselves"
            )
        return np.array(self.outcome["cost_per_episode"], dtype=np.float64)

    @property
    def cost_mean(self) -> float:
        """Mean final cost over the evaluation episodes; NaN where none was recorded."""
        return float(np.array(self.outcome["cost_mean"], dtype=np.float64))

    @property
    def tuned(self) -> bool:
        """Whether any environment step went into tuning."""
        return self.outcome["env_steps"] > 0


@dataclass(frozen=True, eq=False)
class Collection:
    """All runs below one folder.

    Args:
        runs: Every run that could be read, finished or not, in order of identity.
        skipped: Folders that are empty or damaged, and why.
    """

    runs: tuple[Run, ...]
    skipped: tuple[str, ...]

    @property
    def finished(self) -> tuple[Run, ...]:
        """Runs that have a result."""
        return tuple(run for run in self.runs if run.result is not None)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Skipped folders and unfinished runs, and why."""
        waiting = (f"{r.folder}: {_unfinished(r)}" for r in self.runs if r.result is None)
        return (*self.skipped, *waiting)

    def some_finished(self) -> tuple[Run, ...]:
        """Return the finished runs.

        Raises:
            RunFolderError: If there is none.
        """
        if not self.finished:
            raise RunFolderError(
                f"no finished run among {len(self.runs)}; relaunching an unfinished one resumes it"
            )
        return self.finished

    def of_task(self, *tasks: str) -> Self:
        """Return the runs of the named tasks, with every skipped folder.

        Raises:
            RunFolderError: If there is none.
        """
        runs = tuple(run for run in self.runs if run.method.task in tasks)
        if not runs:
            known = {run.method.task for run in self.runs}
            raise RunFolderError(f"no run of task {tasks[0]!r}; {suggest(tasks[0], known)}")
        return replace(self, runs=runs)

    def of_rows(self, rows: Sequence[str]) -> Self:
        """Return the runs of the named rows (see `Method.row`), with every skipped folder.

        Raises:
            RunFolderError: If one has no run.
        """
        known = {run.method.row for run in self.runs}
        for row in rows:
            if row not in known:
                raise RunFolderError(f"no run of tuner {row!r}; {suggest(row, known)}")
        return replace(self, runs=tuple(r for r in self.runs if r.method.row in rows))

    def of_variant(self, variant: str | None) -> Self:
        """Return the runs of the named variant, and untuned ones, with every skipped folder.

        `WITHOUT_VARIANT` names runs that have none; None is all runs.

        Raises:
            RunFolderError: If there is none.
        """
        if variant is None:
            return self
        known = variants(self.runs)
        if variant not in known:
            raise RunFolderError(f"no run of variant {variant!r}; {suggest(variant, known)}")
        runs = (r for r in self.runs if _variant(r) == variant or (r.result and not r.tuned))
        return replace(self, runs=tuple(runs))


WITHOUT_VARIANT = "none"
"""Name by which runs without a variant are chosen."""


def variants(runs: Iterable[Run]) -> list[str]:
    """Return the variants that there are, `WITHOUT_VARIANT` among them."""
    return sorted({_variant(run) for run in runs})


def _variant(run: Run) -> str:
    return run.method.variant or WITHOUT_VARIANT


def _unfinished(run: Run) -> str:
    """Say how far an unfinished run or study got."""
    if "study" in run.identity:
        try:
            ended = sum(row["kind"] != "asked" for row in Journal(run.folder).news())
        except RunFolderError as error:
            return str(error)
        return f"unfinished, {ended} of {run.config['budget']} experiments; relaunch resumes it"
    steps = max((int(row["env_steps"]) for row in run.metrics), default=0)
    return f"unfinished, {steps} of {run.config['budget']} environment steps; relaunch resumes it"


def by_method(runs: Iterable[Run]) -> dict[Method, list[Run]]:
    """Group runs by method, seeds in order."""
    ordered = sorted(runs, key=order)
    return {method: list(group) for method, group in groupby(ordered, key=lambda r: r.method)}


def order(run: Run) -> tuple[str, str, str, int]:
    """Return the sort key of runs."""
    return run.method.task, run.method.tuner, run.method.variant or "", run.seed
