"""Read run folders. The files identify a run; the name of its folder does not matter."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from zoac.analysis.data.runs import Collection, Method, Run, order
from zoac.core.errors import RunFolderError
from zoac.core.types import is_number
from zoac.runs import schema
from zoac.runs.schema import METRICS, RESULT, RUN

OF_EVERY_ROW = ("env_steps", "wall_seconds")
"""Numbers that every row of `metrics.jsonl` has."""

AGREED = ("env_steps", "cost_mean", "cost_per_episode", "parameters")
"""Keys on which the final evaluation and the result must agree."""


def load(root: str | Path, *, trust_code: bool = False) -> Collection:
    """Read every run folder below `root`, or `root` itself; skip folders that begin with a dot.

    A folder that `zoac.analysis.compact` wrote is read likewise.

    Args:
        root: The folder.
        trust_code: Whether a replay of these runs may load code that is not zoac's own.

    Raises:
        RunFolderError: If `root` is no folder, holds no run, or two folders hold the same run.
    """
    from zoac.analysis import compact  # whose command loads runs

    root = Path(root)
    if not root.is_dir():
        what = f"{str(root)!r} is a file" if root.is_file() else f"no folder {str(root)!r}"
        raise RunFolderError(f"{what}; expected a run folder, or a folder of run folders")
    runs: list[Run] = []
    skipped: list[str] = []
    if (root / compact.RUNS).is_file():
        runs += compact.read(root)
    for folder in _candidates(root):
        try:
            runs.append(read(folder))
        except RunFolderError as error:
            reason = str(error).removeprefix(f"{folder}: ").removeprefix(f"{folder}/")
            skipped.append(f"{folder}: {reason}")
    if not runs:
        found = "".join(f"\n  {item}" for item in skipped)
        raise RunFolderError(f"no readable run below {str(root)!r}{':' if found else ''}{found}")
    runs = [replace(run, trusted=trust_code) for run in sorted(runs, key=order)]
    _refuse_copies(runs)
    return Collection(tuple(runs), tuple(skipped))


def read(folder: Path) -> Run:
    """Read one run folder.

    Raises:
        RunFolderError: If it is damaged, or its files do not belong together.
    """
    identity = schema.read_run(folder)
    done = schema.is_done(folder)
    metrics = schema.read_metrics(folder) if done or (folder / METRICS).exists() else []
    _refuse_rows(folder, metrics)
    if not done:
        return Run(folder, identity, metrics, None)
    result = schema.read_result(folder)
    if not (metrics and metrics[-1].get("final")):
        raise RunFolderError(
            f"{folder}: the run is finished, but {METRICS} does not end with its final "
            "evaluation; the end of the file is lost"
        )
    for key in AGREED:
        end, told = schema.plain(metrics[-1].get(key)), schema.plain(result[key])
        if end != told:
            raise RunFolderError(
                f"{folder}: the final evaluation in {METRICS} and {RESULT} disagree on {key}: "
                f"{end!r} and {told!r}"
            )
    return Run(folder, identity, metrics, result)


def _refuse_rows(folder: Path, metrics: Sequence[dict[str, Any]]) -> None:
    """Refuse rows that no single run writes."""
    last: dict[str, Any] = {"env_steps": 0}
    for number, row in enumerate(metrics, start=1):
        if missing := [key for key in OF_EVERY_ROW if not is_number(row.get(key))]:
            raise RunFolderError(f"{folder}: {METRICS} has a record without {', '.join(missing)}")
        if last.get("final") or row["env_steps"] < last["env_steps"]:
            after = "the final evaluation" if last.get("final") else f"step {last['env_steps']:,}"
            raise RunFolderError(
                f"{folder}: {METRICS} holds rows of several runs: line {number} is of step "
                f"{row['env_steps']:,} and follows {after}"
            )
        last = row


def _candidates(root: Path) -> Iterator[Path]:
    """Yield folders that are runs, or that look as if they should be."""
    for folder, children, files in os.walk(root, followlinks=True):
        empty = not (files or children)
        children[:] = sorted(c for c in children if not c.startswith(".") and c != "checkpoint")
        if RUN in files or (not children and (empty or {METRICS, RESULT} & set(files))):
            yield Path(folder)


def _refuse_copies(runs: Sequence[Run]) -> None:
    seen: dict[tuple[Method, int], Run] = {}
    for run in runs:
        other = seen.setdefault((run.method, run.seed), run)
        if other is run:
            continue
        folders = f"{run.method}, seed {run.seed}: {other.folder} and {run.folder}"
        differences = schema.differing_keys(other.config, run.config)
        if not differences:
            raise RunFolderError(f"two folders hold the same run, {folders}; move one away")
        told = "".join(f"\n  {key}: {a!r} and {b!r}" for key, (a, b) in differences.items())
        raise RunFolderError(
            f"two folders hold runs of one name that are not the same run, {folders}:{told}\n"
            "read them apart, or move one away"
        )
