"""What became of the jobs of a sweep, whichever launcher ran them and wherever.

Each job keeps a note, `<sweep folder>/<number>.json`, from its first moment on. So the end of a
sweep can tell of jobs that ran in other processes, those included that died without a word.
"""

import json
import os
import platform
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zoac.core.errors import ZoacError, as_text
from zoac.run import sweep_table
from zoac.runs.schema import write_json
from zoac.runs.training.lifeline import GRACE

RUNNING, STOPPED, FAILED, DONE = "running", "stopped", "failed", "done"

GIVEN = "given.json"
"""File of a sweep's folder with the overrides as they were typed."""


def outcome(result: Mapping[str, Any], folder: Path, done_already: bool) -> dict[str, Any]:
    """Return what a job's line and the table say of a run, from its `result.json` and folder."""
    return {
        "before": result.get("baseline_cost_mean"),
        "after": result["cost_mean"],
        "seconds": result["wall_seconds"],
        "folder": str(folder),
        "variant": result["variant"],
        "warnings": len(result["warnings"]),
        "done_already": done_already,
    }


@dataclass
class Job:
    """One job of a sweep while it runs.

    Args:
        again: Whether this job of this sweep has begun before: a scheduler has put it back in its
            queue, or repeats it after a crash.
        outcome: From the function of that name; empty until the run has ended.
    """

    again: bool
    outcome: Mapping[str, Any] = field(default_factory=dict)


@contextmanager
def noted(
    folder: Path, number: int, overrides: Sequence[str], identity: Mapping[str, Any]
) -> Iterator[Job]:
    """Keep the note of one job in the sweep's folder, and print a line at its end.

    A failure is noted and goes no further, for its siblings' sake.
    """
    path = folder / f"{number}.json"
    job = Job(again=path.exists())
    folder.mkdir(parents=True, exist_ok=True)
    note = {"job": " ".join(overrides), "host": platform.node(), "pid": os.getpid()}
    note |= {**identity, "more": _more(folder, overrides)}
    named = sweep_table.name(note)
    write_json(path, {**note, "state": RUNNING})
    try:
        yield job
    except ZoacError as error:
        print(f"error in {named}: {error}", file=sys.stderr)
        write_json(path, {**note, "state": FAILED, "reason": str(error)})
    except Exception as error:
        trace = traceback.format_exc()
        print(f"error in {named}:\n{trace}", end="", file=sys.stderr)
        write_json(path, {**note, "state": FAILED, "reason": as_text(error), "traceback": trace})
    except BaseException:  # a signal
        write_json(path, {**note, "state": STOPPED})
        raise
    else:
        if job.outcome:
            note |= job.outcome
            print(sweep_table.line(note), flush=True)
        write_json(path, {**note, "state": DONE})


def keep_given(folder: Path, overrides: Sequence[str]) -> None:
    """Note the overrides of a sweep as they were typed, before its jobs begin."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / GIVEN, {"overrides": list(overrides)})


def _more(folder: Path, overrides: Sequence[str]) -> str:
    """Return what tells a job from its siblings beside task, tuner and seed."""
    given = set()
    if (folder / GIVEN).is_file():
        given = set(json.loads((folder / GIVEN).read_text(encoding="utf-8"))["overrides"])
    named = ("task=", "tuner=", "seed=", "method=", "experiment=", "launcher=")
    swept = [o.partition("=") for o in overrides if o not in given and not o.startswith(named)]
    return " ".join(f"{key.rpartition('.')[2]}={value}" for key, _, value in swept)


def end(folder: Path, let_go: Callable[[], None]) -> None:
    """End the lifeline of a sweep's jobs, and wait until they have stopped or time is over."""
    let_go()
    deadline = time.monotonic() + GRACE
    while time.monotonic() < deadline and any(n["state"] == RUNNING for n in _notes(folder)):
        time.sleep(0.05)


def has_begun(folder: Path) -> bool:
    """Tell whether any job of the sweep has."""
    return any(folder.glob("[0-9]*.json"))


def report(folder: Path) -> tuple[str, bool]:
    """Return what became of a sweep's jobs, a table first, and whether all that began are done."""
    notes = _notes(folder)
    if not notes:
        return "the sweep has no jobs: no value of what it goes through was found", False
    lines = {
        FAILED: [f"{sweep_table.name(n)}: {n['reason']}" for n in notes if n["state"] == FAILED],
        STOPPED: [sweep_table.name(n) for n in notes if n["state"] == STOPPED],
    }
    going = [n for n in notes if n["state"] == RUNNING]
    lines["died without a word (killed, or out of memory)"] = [
        _where(n) for n in going if _known_dead(n)
    ]
    lines["not at their end: still running, or dead"] = [
        _where(n) for n in going if not _known_dead(n)
    ]
    paragraphs = [f"{sum(n['state'] == DONE for n in notes)} job(s) of the sweep done"]
    for what, named in lines.items():
        if named:
            indented = "".join(f"\n  {line}" for line in sorted(named))
            paragraphs.append(f"{len(named)} job(s) of the sweep {what}:{indented}")
    return "\n".join([*sweep_table.table(notes), *paragraphs]), len(paragraphs) == 1


def _notes(folder: Path) -> list[dict[str, Any]]:
    paths = sorted(folder.glob("[0-9]*.json"), key=lambda path: int(path.stem))
    return [json.loads(path.read_text(encoding="utf-8")) for path in paths]


def _where(note: dict[str, Any]) -> str:
    return f"{sweep_table.name(note)} (process {note['pid']} on {note['host']})"


def _known_dead(note: dict[str, Any]) -> bool:
    """Tell whether the job's process was one of this machine and is gone."""
    if os.name != "posix" or note["host"] != platform.node():
        return False
    try:
        os.kill(note["pid"], 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # another user's
        pass
    return False
