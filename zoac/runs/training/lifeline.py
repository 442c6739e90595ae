"""Processes that end with the process that started them, however that one ends.

A job of a sweep on this machine follows the sweep's lifeline: a locked file, which the system
unlocks when the process of the sweep ends. The job then stops after its iteration, with a
checkpoint, and its process ends within `GRACE` seconds.
"""

import os
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import cache
from pathlib import Path

from zoac.runs.lock import HeldError, locked

GRACE = 3.0
"""Seconds in which a job may finish its iteration and write a checkpoint."""

SWEEP = "ZOAC_SWEEP"
"""Environment variable with a sweep's folder, for its jobs."""

TERMINAL = "ZOAC_SWEEP_TERMINAL"
"""Environment variable with the process of a sweep whose jobs print on its terminal."""

_POLL = 0.25
_cut = threading.Event()


def sweep() -> Path | None:
    """Return the folder of the sweep whose jobs this process starts or runs, if there is one."""
    return Path(os.environ[SWEEP]) if SWEEP in os.environ else None


def shares_terminal() -> bool:
    """Tell whether other jobs of the sweep print where this one does."""
    return TERMINAL in os.environ


def is_sweep() -> bool:
    """Tell whether the sweep's jobs run in this very process, one after the other."""
    return os.environ.get(TERMINAL) == str(os.getpid())


def hold(folder: Path) -> Callable[[], None]:
    """Hold the lifeline of a sweep until this process ends; return what lets go of it sooner."""
    folder.mkdir(parents=True, exist_ok=True)
    held = ExitStack()
    held.enter_context(locked(_file(folder)))
    return held.close


@cache
def follow(folder: Path) -> None:
    """End this process `GRACE` seconds after nobody holds a sweep's lifeline, if it has one."""
    if not _file(folder).exists():
        return
    with suppress(HeldError), locked(_file(folder)):
        _cut.set()
    threading.Thread(target=_watch, args=(_file(folder),), daemon=True).start()


def is_cut() -> bool:
    """Tell whether the sweep that this process works for has ended."""
    return _cut.is_set()


def _watch(file: Path) -> None:
    with locked(file, wait=True, poll=_POLL):
        _cut.set()
    time.sleep(GRACE)
    os._exit(1)


def _file(folder: Path) -> Path:
    return folder / ".lifeline"
