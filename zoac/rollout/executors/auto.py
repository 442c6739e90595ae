"""`executor=auto`: worker processes where steps are slow enough to pay, else this process.

The first batches run in this process. What a step takes there decides, once, where all others run.
Numbers do not depend on it: workers take over only after a segment of theirs had the same bits.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from zoac.core.errors import as_text
from zoac.core.segments import Proposal, Segment
from zoac.core.types import Count
from zoac.rollout.executors.base import Executor, Serial
from zoac.rollout.executors.host import Method
from zoac.rollout.executors.process import Process, usable_cores
from zoac.rollout.task import Task

PATIENCE = 1.0
"""Seconds of rollouts before it is decided: about what it costs to start workers."""

SLOW = 1e-4
"""Seconds a step from which on workers may pay; messages take as long as faster ones."""


class Auto(Executor):
    """Environments in this process, or in worker processes once that pays."""

    def __init__(self, *, workers: Count | None = None) -> None:
        """
        Args:
            workers: Number of worker processes at most; None: one a core that this process may
                use.
        """
        self._workers = workers
        self._current: Executor = Serial()
        self._candidate: Process | None = None  # workers that have not shown what they give

    def start(self, task: Task, num_envs: int, seed: int) -> None:
        self._made_of = (task, num_envs, seed)
        self._decided = min(num_envs, self._workers or usable_cores()) == 1
        self._untouched = True  # no tuning environment has moved yet
        self._seconds, self._steps = 0.0, 0
        self._current = Serial()
        self._current.start(task, num_envs, seed)

    def run(
        self, method: Method, proposals: Sequence[Proposal], background_update: Callable[[], None]
    ) -> list[Segment]:
        first: list[Segment] = []
        if self._candidate is not None:
            first = self._in_both(method, proposals[:1])
        begun = time.perf_counter()
        segments = first + self._current.run(method, proposals[len(first) :], background_update)
        if not self._decided:
            self._seconds += time.perf_counter() - begun
            self._steps += sum(segment.length for segment in segments)
            self._untouched &= method == "evaluate"
            if self._seconds > PATIENCE:
                self._decided = True
                self._decide()
        return segments

    def _decide(self) -> None:
        """Start worker processes if that pays and can be done."""
        task, _, _ = self._made_of
        if self._seconds / self._steps < SLOW:
            return self._stay(f"{self._pace}, too short for workers")
        if not self._untouched and task.save_fault is not None:
            return self._stay("the environment or controller cannot be moved")
        self._candidate = Process(workers=self._workers)
        try:
            self._candidate.start(*self._made_of)
            if not self._untouched:
                self._candidate.restore(self._current.state())
        except Exception as error:  # whatever a user's task raises when it is sent or made there
            self._stay(f"no worker can be started ({as_text(error)})")

    def _in_both(self, method: Method, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run one proposal here and in the workers, which take over if they give the same bits."""
        assert self._candidate is not None
        here = self._current.run(method, proposals, lambda: None)
        try:
            there = self._candidate.run(method, proposals, lambda: None)
        except Exception as error:  # of a worker alone, since it is not raised here
            self._stay(f"workers cannot take over ({as_text(error)})")
            return here
        if not all(map(_same, here, there)):
            self._stay("workers give other numbers; something outside steers the task")
            return here
        self._current.close()
        self._current, self._candidate = self._candidate, None
        self.tell(f"executor=auto: {self._pace}: worker processes take over")
        return here

    def _stay(self, reason: str) -> None:
        self._close_candidate()
        self.tell(f"executor=auto: {reason}: all runs in one process")

    @property
    def _pace(self) -> str:
        return f"a step takes {1e3 * self._seconds / self._steps:.2g} ms"

    def state(self) -> dict[int, Any]:
        return self._current.state()

    def restore(self, state: Mapping[int, Any]) -> None:
        self._untouched = False
        self._current.restore(state)

    @property
    def worker_seconds(self) -> float:
        return self._current.worker_seconds

    def close(self) -> None:
        self._close_candidate()
        self._current.close()

    def _close_candidate(self) -> None:
        if self._candidate is not None:
            self._candidate.close()
            self._candidate = None


def _same(one: Segment, other: Segment) -> bool:
    """Tell whether two segments are equal to the last bit, clocks in their diagnostics excepted."""
    return (one.terminated, one.truncated) == (other.terminated, other.truncated) and all(
        np.array_equal(getattr(one, part), getattr(other, part), equal_nan=True)
        for part in ("observations", "actions", "commands", "costs")
    )
