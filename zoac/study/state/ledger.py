"""The trials of a study, as the rows of its journal give them; `journal.py` keeps them on disk."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.core.errors import NothingWorksError, RunFolderError, StudyError, StudyFinished
from zoac.study.state.journal import Journal
from zoac.study.state.trial import KEYS, Trial, ended

if TYPE_CHECKING:
    import pandas as pd

HOPELESS = 10
"""First experiments of which one must not fail."""

COLUMNS = ("number", "state", "cost", "violation", "by", "reason", "asked", "ended")
"""Of a study's history, before parameters and measured values."""


class Ledger:
    """The trials of a study, as its journal tells them; for several threads."""

    def __init__(self, folder: Path, limits: Mapping[str, float]) -> None:
        self._journal, self._limits = Journal(folder), limits
        self.mutex = threading.RLock()  # who holds it may ask the tuner
        self._trials: list[Trial] = []
        self._results: dict[int, Mapping[str, Any]] = {}

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Hold the study, which one process and thread has at a time, with all that is known."""
        with self.mutex, self._journal.writing():
            self.refreshed()
            yield

    def write(self, kind: str, number: int, content: Mapping[str, Any]) -> None:
        """Write a row of the journal; `writing` must be held."""
        self._journal.append({"kind": kind, "number": number, "time": time.time(), **content})
        self.refreshed()

    def abandon_overdue(self, limit: float) -> None:
        """Abandon the trials that were asked for more than `limit` [s] ago; hold `writing`."""
        for trial in self.trials:
            if trial.pending and time.time() - trial.asked > limit:
                reason = {"reason": f"no result within {limit:g} s"}
                self.write("abandoned", trial.number, reason)

    def refreshed(self) -> Ledger:
        """Take in what was written since; return this ledger."""
        with self.mutex:
            for row in self._journal.news():
                self._take(row["number"], row)
        return self

    def _take(self, number: int, row: Mapping[str, Any]) -> None:
        if row["kind"] == "asked":
            if number != len(self._trials) + 1:
                raise RunFolderError(f"the journal asks for trial {number} out of turn")
            x = tuple(row["x"])
            asked = Trial(number, row["parameters"], x, by=row["by"], asked=row["time"])
            self._trials.append(asked)
            return
        if not (trial := self.trial(number)).pending:
            raise RunFolderError(f"the journal has two results of trial {number}")
        self._trials[number - 1] = ended(trial, row, self._limits)
        self._results[number] = row

    def has(self, number: int, result: Mapping[str, Any]) -> bool:
        """Tell whether a trial has this very result already; refuse another one."""
        trial = self.trial(number)
        if trial.pending:
            return False
        known = self._results[number]
        compared = ("kind", "reason", "excess", "specs", *KEYS)
        if all(known.get(key) == result.get(key) for key in compared):
            return True
        raise StudyError(f"trial {number} has a result already: {told(trial)}")

    def trial(self, number: int) -> Trial:
        """Return a trial; a `StudyError` if there is none of this number."""
        if not isinstance(number, int) or not 1 <= number <= len(self._trials):
            known = f"1 to {len(self._trials)}" if self._trials else "none so far"
            raise StudyError(f"there is no trial {number!r}; asked: {known}")
        return self._trials[number - 1]

    @property
    def trials(self) -> list[Trial]:
        """All trials, by number."""
        return list(self._trials)

    def next_number(self, experiments: int) -> int:
        """Return the number of the next trial, unless there is to be none."""
        first = self._trials[:HOPELESS]
        if len(first) == HOPELESS and all(t.state in ("failed", "abandoned") for t in first):
            reasons = dict.fromkeys(str(first[i].reason) for i in (0, -1))
            raise NothingWorksError(
                f"each of the first {HOPELESS} experiments failed, so that there is nothing to "
                f"learn from: {'; '.join(reasons)}\nMend that, and begin a new study"
            )
        if len(self._trials) == experiments:
            out = sum(trial.pending for trial in self._trials)
            more = f"; {out} of them have no result yet" if out else ""
            raise StudyFinished(f"all {experiments} experiments have been asked for{more}")
        return len(self._trials) + 1

    def best(self, x: np.ndarray | None = None) -> Trial:
        """Return the trial of the least violation, and of the least cost among equals.

        Args:
            x: Look only at trials with these normalised parameters (d,), failed ones if there is
                no other.
        """
        there = [t for t in self._trials if x is None or _is_at(t, x)]
        if good := [t for t in there if t.state == "told"]:
            return min(good, key=lambda trial: trial.rank)
        if x is not None and there:
            return there[0]
        first = next((t for t in self._trials if t.reason), None)
        why = f"; trial {first.number}: {first.reason}" if first else ""
        raise StudyError(f"no experiment has succeeded yet{why}")

    def frame(self) -> pd.DataFrame:
        """Return a row for each trial."""
        import pandas as pd

        rows = []
        for t in self._trials:
            row = {name: getattr(t, name) for name in COLUMNS}
            for kind in ("parameters", "metrics", "constraints", "specs"):
                for name, value in getattr(t, kind).items():
                    row[f"{kind}.{name}" if name in row else name] = value
            rows.append(row)
        frame = pd.DataFrame(rows, columns=None if rows else list(COLUMNS))
        return frame.astype({"cost": float, "ended": float})


def told(trial: Trial) -> str:
    """Return a trial's result in words."""
    if trial.state == "told":
        return f"cost {trial.cost:.6g}"
    return trial.state + (f" ({trial.reason})" if trial.reason else "")


def _is_at(trial: Trial, x: np.ndarray) -> bool:
    return bool(np.allclose(trial.x, np.clip(x, -1.0, 1.0), rtol=0.0, atol=1e-9))
