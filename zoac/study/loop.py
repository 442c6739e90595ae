"""The experiments of a `for` loop over a study."""

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

from zoac.core.errors import RunFolderError, StudyError, StudyFinished, TrialsPending
from zoac.runs.lock import HeldError, locked
from zoac.study.state.trial import Trial

CARRIED_OUT = ".carried-out"
"""File of a study's folder that is locked while one process runs whatever is left."""

PATIENCE = 10.0
"""Seconds after which a loop that waits for results says so."""


def experiments_left(
    folder: Path, workers: int, pending: Callable[[], list[Trial]], ask: Callable[..., Trial]
) -> Iterator[Trial]:
    """Yield the experiments of a study that are left; see `Study.__iter__`.

    Args:
        folder: The study's.
        workers: How many experiments may be under way at once.
        pending: Returns the trials that have no result now.
        ask: `Study.ask`.
    """

    def is_pending(trial: Trial) -> bool:
        return trial.number in {one.number for one in pending()}

    with ExitStack() as held:
        left: list[Trial] = []
        # With several workers, or where another process has the lock, a trial without a result may
        # be under way elsewhere; otherwise an earlier loop was stopped in it.
        if workers == 1 and _locked(folder, held):
            left = pending()
        while True:
            interrupted = [trial for trial in left if is_pending(trial)]
            try:
                trial = interrupted[0] if interrupted else _asked(ask, folder)
            except StudyFinished:
                return
            yield trial
            if is_pending(trial):
                raise StudyError(f"trial {trial.number} has no result; tell or abandon it first")


def _locked(folder: Path, held: ExitStack) -> bool:
    """Lock a study until `held` ends; return whether that was possible."""
    try:
        held.enter_context(locked(folder / CARRIED_OUT))
    except HeldError:
        return False
    except OSError as error:
        raise RunFolderError(f"cannot write {folder}: {error.strerror}") from None
    return True


def _asked(ask: Callable[..., Trial], folder: Path) -> Trial:
    """Return the next trial; say what it depends on if it is long in coming."""
    try:
        return ask(wait=PATIENCE)
    except TrialsPending as error:
        print(f"{folder}: waiting: {error}", file=sys.stderr, flush=True)
    return ask(wait=math.inf)
