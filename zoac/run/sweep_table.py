"""What a sweep prints of its jobs: a line for each, and a table at the end."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

WIDTH = 80
"""Columns that lines keep to, folders excepted."""


def line(note: Mapping[str, Any]) -> str:
    """Return the line of a job that is done, from its note."""
    ends = [f"cost {_costs(note)}", f"{_seconds(note)} s"]
    if note["done_already"]:
        ends[1] = "done already"
    if note["warnings"]:
        ends.append(f"{note['warnings']} warning" + "s" * (note["warnings"] > 1))
    told = ", ".join(ends)
    return f"{_shortened(name(note), WIDTH - len(told) - 2)}: {told}"


def name(note: Mapping[str, Any]) -> str:
    """Return what tells a job from its siblings."""
    return f"{note['task']} {note['tuner']} seed={note['seed']} {note['more']}".rstrip()


def table(notes: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a table of all jobs; [] if no job is done."""
    done = [note for note in notes if "folder" in note]
    if not done:
        return []
    rows = [("task", "tuner", "seed", "cost before", "", "after", "seconds", "")]
    for note in notes:
        before, arrow, after = _costs(note).rpartition("-> ") if note in done else ("", "", "")
        seconds = _seconds(note) if note in done else note["state"]
        identity = str(note["task"]), str(note["tuner"]), str(note["seed"])
        rows.append((*identity, before.strip(), arrow.strip(), after, seconds, note["more"]))
    widths = [max(len(row[i]) for row in rows) for i in range(7)]
    told = []
    for row in rows:
        cells = [f"{cell:{'<' if i < 3 else '>'}{widths[i]}}" for i, cell in enumerate(row[:7])]
        fixed = "  ".join(cells)
        first, *others = textwrap.wrap(row[7], max(20, WIDTH - len(fixed) - 2)) or [""]
        told.append(f"{fixed}  {first}".rstrip())
        told += [f"{'':{len(fixed)}}  {other}" for other in others]
    return ["", *told, *_folders(done)]


def _folders(done: Sequence[Mapping[str, Any]]) -> list[str]:
    variants = {note["variant"] for note in done}
    roots = {_root(note) for note in done}
    last = f"/variant={next(iter(variants))}" if len(variants) == 1 else "/variant=<...>"
    pattern = "<task>/<tuner>/seed=<seed>" + ("" if variants == {None} else last)
    lines = [f"folders: {root}/{pattern}" for root in sorted(roots)]
    return [*lines, f"report: python -m zoac.analysis.report {' '.join(sorted(roots))}"]


def _root(note: Mapping[str, Any]) -> str:
    """Return the folder that `<task>/<tuner>/seed=<seed>[/variant=...]` lies in."""
    return str(Path(note["folder"]).parents[2 + (note["variant"] is not None)])


def _costs(note: Mapping[str, Any]) -> str:
    """Return the mean costs of the baseline, if there is one, and of the answer."""
    before = "" if note["before"] is None else f"{_number(note['before'])} -> "
    return before + _number(note["after"])


def _seconds(note: Mapping[str, Any]) -> str:
    seconds = note["seconds"]
    return f"{seconds:.1f}" if seconds < 9.95 else f"{seconds:.0f}"


def _number(value: float | None) -> str:
    return "not finite" if value is None or not math.isfinite(value) else f"{value:.4g}"


def _shortened(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: max(0, width - 3)]}..."
