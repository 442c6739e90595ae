"""Run folders as pandas frames. What a run is stands in its files, never in a folder's name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from zoac.analysis import compact_format
from zoac.errors import RunFolderError, suggest
from zoac.records import (
    METRICS,
    RESULT,
    RUN,
    is_done,
    read_metrics,
    read_result,
    read_run,
)

IDENTITY = ("task", "tuner", "seed", "variant", "config_hash")
"""Keys on which a run's files must agree."""

NEEDED = {
    RUN: (*IDENTITY, "config", "parameters", "nominal"),
    METRICS: ("kind", "env_steps", "wall_seconds"),
    RESULT: (*IDENTITY, "env_steps", "cost_per_episode", "parameters", "wall_seconds"),
}
"""Keys without which a file says too little."""


class Method(NamedTuple):
    """What is averaged over seeds."""

    task: str
    tuner: str
    variant: str | None

    def __str__(self) -> str:
        variant = f" ({self.variant})" if self.variant else ""
        return f"{self.tuner}{variant} on {self.task}"


@dataclass(frozen=True, eq=False)
class Run:
    """One run folder, read.

    Args:
        folder: Where it lies.
        identity: run.json.
        metrics: The lines of metrics.jsonl.
        result: result.json; None while the run is not finished.
    """

    folder: Path
    identity: Mapping[str, Any]
    metrics: Sequence[Mapping[str, Any]]
    result: Mapping[str, Any] | None

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
    def outcome(self) -> Mapping[str, Any]:
        """result.json.

        Raises:
            RunFolderError: If the run is not finished.
        """
        if self.result is None:
            raise RunFolderError(f"{self.folder}: {unfinished(self)}")
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


class Skipped(NamedTuple):
    """A folder that was left out, and why."""

    folder: Path
    reason: str

    def __str__(self) -> str:
        return f"{self.folder}: {self.reason}"


@dataclass(frozen=True, eq=False)
class Collection:
    """All that lies below one folder.

    Args:
        runs: Every run that could be read, finished or not, in order of identity.
        skipped: Folders that are empty or damaged.
    """

    runs: tuple[Run, ...]
    skipped: tuple[Skipped, ...]

    @property
    def finished(self) -> tuple[Run, ...]:
        """Runs that have a result."""
        return tuple(run for run in self.runs if run.result is not None)

    @property
    def left_out(self) -> tuple[Skipped, ...]:
        """Skipped folders and unfinished runs."""
        waiting = (Skipped(r.folder, unfinished(r)) for r in self.runs if r.result is None)
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

    def of_task(self, *tasks: str) -> Collection:
        """Return the runs of the named tasks, with every skipped folder.

        Raises:
            RunFolderError: If there is none.
        """
        runs = tuple(run for run in self.runs if run.method.task in tasks)
        if not runs:
            known = {run.method.task for run in self.runs}
            raise RunFolderError(f"no run of task {tasks[0]!r}; {suggest(tasks[0], known)}")
        return Collection(runs, self.skipped)

    def of_variant(self, variant: str) -> Collection:
        """Return the runs of the named variant, and untuned ones, with every skipped folder.

        Args:
            variant: Its name; `WITHOUT_VARIANT`: runs that have none.

        Raises:
            RunFolderError: If there is none.
        """
        known = variants(self.runs)
        if variant not in known:
            raise RunFolderError(f"no run of variant {variant!r}; {suggest(variant, known)}")
        runs = (r for r in self.runs if _variant(r) == variant or (r.result and not r.tuned))
        return Collection(tuple(runs), self.skipped)


WITHOUT_VARIANT = "none"
"""What runs without a variant are called where variants are chosen."""


def variants(runs: Iterable[Run]) -> list[str]:
    """Return the variants that there are, `WITHOUT_VARIANT` among them."""
    return sorted({_variant(run) for run in runs})


def _variant(run: Run) -> str:
    return run.method.variant or WITHOUT_VARIANT


def unfinished(run: Run) -> str:
    """Say how far an unfinished run got."""
    steps = max((int(row["env_steps"]) for row in run.metrics), default=0)
    return f"unfinished, {steps} of {run.config['budget']} environment steps; relaunch resumes it"


def load(root: str | Path) -> Collection:
    """Read every run folder below `root`, or `root` itself; skip folders that begin with a dot.

    A folder that `zoac.analysis.compact` wrote is read likewise.

    Raises:
        RunFolderError: If `root` is no folder, holds no run, or two folders hold the same run.
    """
    root = Path(root)
    if not root.is_dir():
        raise RunFolderError(f"no folder {str(root)!r}; expected the folder that holds the runs")
    runs: list[Run] = []
    skipped: list[Skipped] = []
    if compact_format.is_compact(root):
        runs += [Run(root / r.name, r.identity, r.metrics, r.result) for r in _compact(root)]
    for folder in _candidates(root):
        try:
            runs.append(read(folder))
        except RunFolderError as error:
            reason = str(error).removeprefix(f"{folder}: ").removeprefix(f"{folder}/")
            skipped.append(Skipped(folder, reason))
    if not runs:
        found = "".join(f"\n  {item}" for item in skipped)
        raise RunFolderError(f"no readable run below {str(root)!r}{':' if found else ''}{found}")
    runs.sort(key=_order)
    _refuse_copies(runs)
    return Collection(tuple(runs), tuple(skipped))


def _compact(root: Path) -> list[compact_format.Record]:
    try:
        return list(compact_format.read(root))
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise RunFolderError(
            f"{root}: its {compact_format.RUNS}, {compact_format.EVALUATIONS} and "
            f"{compact_format.METHODS} cannot be read together ({type(error).__name__}: {error}); "
            "write them anew with python -m zoac.analysis.compact"
        ) from None


def read(folder: Path) -> Run:
    """Read one run folder.

    Raises:
        RunFolderError: If it is damaged, or its files do not belong together.
    """
    identity = _complete(folder, RUN, read_run(folder))
    done = is_done(folder)
    lines = read_metrics(folder) if done or (folder / METRICS).exists() else []
    metrics = [_complete(folder, METRICS, line) for line in lines]
    if not done:
        return Run(folder, identity, metrics, None)
    result = _complete(folder, RESULT, read_result(folder))
    for key in IDENTITY:
        if result.get(key) != identity.get(key):
            raise RunFolderError(
                f"{folder}: run.json and result.json disagree on {key}: "
                f"{identity.get(key)!r} and {result.get(key)!r}"
            )
    if not (metrics and metrics[-1].get("final")):
        raise RunFolderError(
            f"{folder}: the run is finished, but {METRICS} does not end with its final "
            "evaluation; the end of the file is lost"
        )
    return Run(folder, identity, metrics, result)


def _complete(folder: Path, file: str, record: Any) -> dict[str, Any]:
    missing = [key for key in NEEDED[file] if not isinstance(record, dict) or key not in record]
    if missing:
        raise RunFolderError(f"{folder}: {file} has a record without {', '.join(missing)}")
    return record


def by_method(runs: Iterable[Run]) -> dict[Method, list[Run]]:
    """Group runs by method, seeds in order."""
    groups: dict[Method, list[Run]] = {}
    for run in sorted(runs, key=_order):
        groups.setdefault(run.method, []).append(run)
    return groups


def results_frame(runs: Iterable[Run]) -> pd.DataFrame:
    """Return one row per finished run: its identity and every number of its result."""
    rows = [{**_identity(run), **_numbers(run.outcome)} for run in runs if run.result is not None]
    return pd.DataFrame(rows)


def evaluations_frame(runs: Iterable[Run]) -> pd.DataFrame:
    """Return one row per evaluation while tuning, with `parameters.NAME` columns."""
    rows = [{**_identity(run), **_numbers(row)} for run in runs for row in run.evaluations]
    return pd.DataFrame(rows)


def numbers(record: Mapping[str, Any]) -> dict[str, float]:
    """Return the entries of `record` that are numbers; True and False are none."""
    return {
        key: value
        for key, value in record.items()
        if isinstance(value, (int, float)) and not isinstance(value, bool)
    }


def _candidates(folder: Path) -> Iterator[Path]:
    """Yield folders that are runs, or that look as if they should be."""
    is_run = (folder / RUN).is_file()
    if is_run:
        yield folder
    children = sorted(
        child
        for child in folder.iterdir()
        if child.is_dir() and not child.name.startswith(".") and child.name != "checkpoint"
    )
    for child in children:
        yield from _candidates(child)
    if not is_run and not children:
        files = {file.name for file in folder.iterdir()}
        if not files or files & {METRICS, RESULT}:
            yield folder


def _refuse_copies(runs: Sequence[Run]) -> None:
    seen: dict[tuple[Method, int], Path] = {}
    for run in runs:
        other = seen.setdefault((run.method, run.seed), run.folder)
        if other != run.folder:
            raise RunFolderError(
                f"two folders hold the same run, {run.method}, seed {run.seed}: "
                f"{other} and {run.folder}; move one away"
            )


def _order(run: Run) -> tuple[str, str, str, int]:
    return run.method.task, run.method.tuner, run.method.variant or "", run.seed


def _identity(run: Run) -> dict[str, Any]:
    return {**run.method._asdict(), "seed": run.seed}


def _numbers(record: Mapping[str, Any]) -> dict[str, Any]:
    parameters = record.get("parameters") or {}
    named = {f"parameters.{name}": value for name, value in parameters.items()}
    return {**numbers(record), **named}
