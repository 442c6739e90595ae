"""`executor=auto`: worker processes where steps are slow enough to pay, else this process.

Environments begin in this process. If steps turn out to be slow, workers start beside them. Once
they are there, one batch runs in them and then here: they take over if they give the same bits.
Environments come back if workers turn out to be no faster. Numbers depend on none of this.
"""

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from typing import Any

import numpy as np

from zoac.core.errors import UnsavableError, WorkerError, as_text
from zoac.core.segments import Proposal, Segment
from zoac.core.types import Count
from zoac.rollout.executors.base import Executor, Serial, nothing
from zoac.rollout.executors.host import Method
from zoac.rollout.executors.process import Process, usable_cores
from zoac.rollout.task import Task

PATIENCE = 1.0
"""Seconds of rollouts before workers are thought of: about what it costs to start them."""

SLOW = 1e-4
"""Seconds a step from which on workers may pay; messages take as long as faster ones."""

TRIAL = 2.0
"""Seconds of rollouts in workers before they are compared with this process."""

GAIN = 0.9
"""Workers are kept if they take less than this part of the time."""


class Auto(Executor):
    """Environments in this process, or in worker processes once that pays."""

    def __init__(self, *, workers: Count | None = None) -> None:
        """
        Args:
            workers: Number of worker processes at most; None: one a core that this process may
                use.
        """
        self._most = workers
        self._serial, self._processes = Serial(), Process(workers=workers)
        self._starting: Future[None] | None = None  # the start of workers that have not taken over

    def start(self, task: Task, num_envs: int, seed: int) -> None:
        self._made_of = (task, num_envs, seed)
        self._current: Executor = self._serial
        self._settled = min(num_envs, self._most or usable_cores()) == 1
        self._untouched = True  # no environment has moved yet
        self._starting = None
        self._calls, self._spent = 0, 0.0
        self._seconds = defaultdict[Executor, float](float)
        self._steps = Counter[Executor]()
        self._serial.start(task, num_envs, seed)

    def run(
        self, method: Method, proposals: Sequence[Proposal], background_update: Callable[[], None]
    ) -> list[Segment]:
        here = self._current is self._serial
        if self._settled or not (here or method == "rollout"):
            return self._current.run(method, proposals, background_update)
        if not here or method == "evaluate":
            return self._measured(method, proposals)
        if self._untouched and self._is_slow() and not self._is_movable():
            self._start_workers()
            self._wait_for_workers()
        segments: dict[int, Segment] = {}
        for batch in _batches(proposals):
            asked = [proposals[i] for i in batch]
            there = self._starting is not None and self._starting.done()
            found = self._in_both(asked) if there else self._measured(method, asked)
            segments.update(zip(batch, found, strict=True))
            self._untouched = False
        return [segments[i] for i in range(len(proposals))]

    def _measured(self, method: Method, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run proposals where environments are, and see whether they should be elsewhere."""
        begun, current = time.perf_counter(), self._current
        segments = current.run(method, proposals, nothing)
        seconds = time.perf_counter() - begun
        if self._settled or self._starting is not None:  # workers that start take time from others
            return segments
        self._calls += 1
        self._spent += seconds
        if self._calls == 2:  # the first call, which may have compiled something, is left out
            self._seconds[current] = self._steps[current] = 0
        self._seconds[current] += seconds
        self._steps[current] += sum(segment.length for segment in segments)
        if current is self._processes:
            self._judge_workers()
        elif self._calls > 1 and self._spent > PATIENCE:
            if not self._is_slow():
                self._stay(f"{self._pace()}, too short for workers")
            elif self._untouched or self._is_movable():
                self._start_workers()
            else:
                self._stay("the environment or controller cannot be moved")
        return segments

    def _step_seconds(self, executor: Executor) -> float:
        return self._seconds[executor] / self._steps[executor]

    def _pace(self) -> str:
        return f"a step takes {1e3 * self._step_seconds(self._serial):.2g} ms"

    def _is_slow(self) -> bool:
        return self._spent > PATIENCE and self._step_seconds(self._serial) >= SLOW

    def _is_movable(self) -> bool:
        """Tell whether environments can leave this process after they have moved."""
        task, _, _ = self._made_of
        return task.save_fault is None

    def _start_workers(self) -> None:
        if self._starting is not None:
            return
        try:
            self._processes.launch(*self._made_of)
        except WorkerError as error:
            self._stay(str(error))
        else:
            self._starting = ThreadPoolExecutor(1).submit(self._processes.wait)

    def _wait_for_workers(self) -> None:
        wait([] if self._starting is None else [self._starting])

    def _in_both(self, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run proposals here and in the workers, which take over if they give the same bits."""
        assert self._starting is not None
        starting, self._starting = self._starting, None
        told, there = "no worker can be started", list[Segment]()
        try:
            starting.result()
            told = "workers cannot take over"
            if not self._untouched:
                self._processes.restore(self._serial.state())
            there = self._processes.rollout(proposals)
        except Exception as error:  # one of the rollout's comes again here
            fault = f"{told} ({as_text(error)})"
        else:
            fault = ""
        here = self._serial.rollout(proposals)
        if not fault and not all(map(_same, here, there)):
            fault = "workers give other numbers; something outside steers the task"
        if fault:
            self._stay(fault)
        else:
            self._current, self._settled = self._processes, not self._is_movable()
            self._say(f"{self._pace()}: worker processes take over")
        return here

    def _judge_workers(self) -> None:
        """Settle once it is seen whether workers are faster."""
        if self._seconds[self._processes] <= TRIAL:
            return
        self._settled = True
        if self._step_seconds(self._processes) > GAIN * self._step_seconds(self._serial):
            with suppress(UnsavableError):
                self._serial.restore(self._processes.state())
                self._stay("worker processes are no faster")

    def _stay(self, reason: str) -> None:
        """Settle for this process."""
        self._processes.close()
        self._current, self._settled = self._serial, True
        self._say(f"{reason}: all runs in one process")

    def _say(self, choice: str) -> None:
        self.tell(f"executor=auto: {choice}")

    def state(self) -> dict[int, Any]:
        return self._current.state()

    def restore(self, state: Mapping[int, Any]) -> None:
        self._untouched = False
        self._current.restore(state)

    @property
    def worker_seconds(self) -> float:
        return self._processes.worker_seconds

    def close(self) -> None:
        self._processes.close()
        self._wait_for_workers()
        self._serial.close()


def _batches(proposals: Sequence[Proposal]) -> Iterable[list[int]]:
    """Return the indices of each environment's first proposals, of the second ones, ..."""
    batches: dict[int, list[int]] = defaultdict(list)
    before: Counter[int] = Counter()
    for index, proposal in enumerate(proposals):
        batches[before[proposal.env_index]].append(index)
        before[proposal.env_index] += 1
    return batches.values()


def _same(one: Segment, other: Segment) -> bool:
    """Tell whether two segments are equal to the last bit, clocks in their diagnostics excepted."""
    return (one.terminated, one.truncated) == (other.terminated, other.truncated) and all(
        np.array_equal(getattr(one, part), getattr(other, part), equal_nan=True)
        for part in ("observations", "actions", "commands", "costs")
    )
