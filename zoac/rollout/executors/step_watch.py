"""Steps that never return: seen from the process that waits for a worker, and by the worker.

Both map one small file. The worker writes into it which environment is at a step; the other process
kills the worker once that has stood still for too long. Its replacement does the same work again,
up to that step, which then fails instead of being called.
"""

import os
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from zoac.core.errors import EnvironmentFailure

_NOWHERE = -1

Call = tuple[int, int]
"""An environment's row, and the number of one of its calls within a request, from 1."""


class StepClock:
    """The worker's side: tells which call of an environment is under way.

    Args:
        path: The file, as `StepWatch.path` names it.
        timeout: Seconds that a call may take, for messages.
    """

    def __init__(self, path: str, timeout: float) -> None:
        # Calls so far, row, calls of this row in this request.
        self._place = np.memmap(path, np.int64, "r+", shape=(3,))
        self._timeout = timeout
        self._total = 0
        self.begin(())

    def begin(self, hung: Collection[Call]) -> None:
        """Begin a request, in which these calls are known to never return."""
        self._hung = frozenset(hung)
        self._calls: Counter[int] = Counter()
        self._write(_NOWHERE)

    @contextmanager
    def call(self, row: int, method: str) -> Iterator[None]:
        """Tell that an environment's `reset` or `step` is called, and that it has returned.

        Raises:
            EnvironmentFailure: If it is one of those that never return.
        """
        self._calls[row] += 1
        if (row, self._calls[row]) in self._hung:
            raise EnvironmentFailure(
                f"the environment's {method} did not return within step_timeout={self._timeout:g} s"
            )
        self._total += 1
        self._write(row)
        try:
            yield
        finally:
            self._write(_NOWHERE)

    def _write(self, row: int) -> None:
        self._place[:] = self._total, row, self._calls[row]


class StepWatch:
    """The other side: ends a worker whose environment does not return within `timeout` seconds."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        descriptor, self.path = tempfile.mkstemp(prefix="zoac-steps-")
        os.close(descriptor)
        self._place = np.memmap(self.path, np.int64, "w+", shape=(3,))
        self._place[:] = 0, _NOWHERE, 0

    @contextmanager
    def watching(self, end: Callable[[], None], found: list[Call]) -> Iterator[None]:
        """Call `end` once a call does not return, and append that call to `found`."""
        over = threading.Event()
        thread = threading.Thread(target=self._watch, args=(end, found, over), daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def _watch(self, end: Callable[[], None], found: list[Call], over: threading.Event) -> None:
        place, since = None, time.monotonic()
        while not over.wait(min(0.5, self._timeout / 10)):
            if (now := self._place.tolist()) != place:
                place, since = now, time.monotonic()
                continue
            _, row, number = now
            if row != _NOWHERE and time.monotonic() - since > self._timeout:
                found.append((row, number))
                end()
                return

    def close(self) -> None:
        """Remove the file."""
        with suppress(OSError):
            Path(self.path).unlink()
