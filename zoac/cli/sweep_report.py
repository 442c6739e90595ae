"""What became of the jobs of a sweep, whichever launcher ran them and wherever.

Each job keeps a note, `<sweep folder>/<number>.json`, from its first moment on. So the end of a
sweep can tell of jobs that ran in other processes, those included that died without a word.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from zoac.core.errors import ZoacError
from zoac.runs.schema import write_json
from zoac.training.lifeline import GRACE

RUNNING, STOPPED, FAILED, DONE = "running", "stopped", "failed", "done"


@contextmanager
def noted(folder: Path, number: int, overrides: Sequence[str]) -> Iterator[bool]:
    """Keep the note of one job; its failure is noted and goes no further, for its siblings' sake.

    Yields whether this job of this sweep has begun before: a scheduler has put it back in its
    queue, or repeats it after a crash.

    Args:
        folder: The sweep's folder.
        number: The job's number in the sweep.
        overrides: What makes this job.
    """
    path = folder / f"{number}.json"
    again = path.exists()
    folder.mkdir(parents=True, exist_ok=True)
    named = " ".join(overrides)
    note = {"job": named, "host": platform.node(), "pid": os.getpid()}
    write_json(path, {**note, "state": RUNNING})
    try:
        yield again
    except ZoacError as error:
        print(f"error in {named}: {error}", file=sys.stderr)
        write_json(path, {**note, "state": FAILED, "reason": str(error)})
    except Exception as error:
        print(f"error in {named}:", file=sys.stderr)
        traceback.print_exc()
        reason = f"{type(error).__name__}: {error}"
        trace = traceback.format_exc()
        write_json(path, {**note, "state": FAILED, "reason": reason, "traceback": trace})
    except BaseException:  # a signal
        write_json(path, {**note, "state": STOPPED})
        raise
    else:
        write_json(path, {**note, "state": DONE})


def end(folder: Path, let_go: Callable[[], None]) -> None:
    """Ask the jobs of a sweep on this machine to stop, and wait until they have or time is over.

    Args:
        folder: The sweep's folder.
        let_go: Ends the jobs' lifeline, see `zoac.training.lifeline`.
    """
    let_go()
    deadline = time.monotonic() + GRACE
    while time.monotonic() < deadline and any(n["state"] == RUNNING for n in _notes(folder)):
        time.sleep(0.05)


def has_begun(folder: Path) -> bool:
    """Tell whether any job of the sweep has."""
    return any(folder.glob("[0-9]*.json"))


def report(folder: Path) -> tuple[str, bool]:
    """Return what became of a sweep's jobs, in words, and whether all that began are done.

    Args:
        folder: The sweep's folder.
    """
    notes = _notes(folder)
    if not notes:
        return "the sweep has no jobs: no value of what it goes through was found", False
    lines = {
        FAILED: [f"{n['job']}: {n['reason']}" for n in notes if n["state"] == FAILED],
        STOPPED: [n["job"] for n in notes if n["state"] == STOPPED],
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
    return "\n".join(paragraphs), len(paragraphs) == 1


def _notes(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(p.read_text(encoding="utf-8")) for p in folder.glob("[0-9]*.json")]


def _where(note: dict[str, Any]) -> str:
    return f"{note['job']} (process {note['pid']} on {note['host']})"


def _known_dead(note: dict[str, Any]) -> bool:
    """Tell whether the job's process was one of this machine and is gone."""
    if os.name != "posix" or note["host"] != platform.node():
        return False
    try:
        os.kill(note["pid"], 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        return False
    return False
