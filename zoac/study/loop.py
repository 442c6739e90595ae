"""The experiments of a `for` loop over a study."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

from zoac.core.errors import RunFolderError, StudyError, StudyFinished, TrialsPending
from zoac.runs.lock import HeldError, locked
from zoac.study.state.trial import Trial

if TYPE_CHECKING:
    from zoac.study.study import Study

CARRIED_OUT = ".carried-out"
"""File of a study's folder that is locked while one process runs whatever is left."""

PATIENCE = 10.0
"""Seconds after which a loop that waits for results says so."""


def experiments_left(study: Study) -> Iterator[Trial]:
    """Yield the experiments that are left; see `Study.__iter__`."""
    with ExitStack() as held:
        left = _interrupted(study, held)
        while True:
            try:
                trial = next(left, None) or _asked(study)
            except StudyFinished:
                return
            yield trial
            if study.trial(trial.number).pending:
                raise StudyError(f"trial {trial.number} has no result; tell or abandon it first")


def _interrupted(study: Study, held: ExitStack) -> Iterator[Trial]:
    """Return those trials that an earlier loop left without a result.

    With several workers a trial without a result may be under way elsewhere, and so it may while
    another process holds the lock. `held` keeps the lock until the loop ends.
    """
    if study.settings.workers > 1:
        return iter(())
    try:
        held.enter_context(locked(study.folder / CARRIED_OUT))
    except HeldError:
        return iter(())
    except OSError as error:
        raise RunFolderError(f"cannot write {study.folder}: {error.strerror}") from None
    return (trial for trial in study.pending if study.trial(trial.number).pending)


def _asked(study: Study) -> Trial:
    """Return the next trial; say what it depends on if it is long in coming."""
    try:
        return study.ask(wait=PATIENCE)
    except TrialsPending as error:
        print(f"{study.folder}: waiting: {error}", file=sys.stderr, flush=True)
    return study.ask(wait=math.inf)
