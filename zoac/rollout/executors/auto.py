"""`executor=auto`: worker processes where steps are slow enough to pay, else this process.

Environments begin in this process. If steps turn out to be slow, workers start beside them. Once
they are there, one batch runs in both places: the workers take over if they give the same bits.
Environments come back if workers turn out to be no faster. Numbers depend on none of this.
"""

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from threading import Thread
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
        self._starting: Thread | None = None

    def start(self, task: Task, num_envs: int, seed: int) -> None:
        self._made_of = (task, num_envs, seed)
        self._current: Executor = self._serial
        self._settled = min(num_envs, self._most or usable_cores()) == 1
        self._untouched = True  # no environment has moved yet
        self._starting = None
        self._fault: Exception | None = None  # of a worker that could not be started
        self._calls, self._spent, self._step_seconds = 0, 0.0, 0.0
        self._trial_seconds = self._trial_here = 0.0
        self._serial.start(task, num_envs, seed)

    def run(
        self, method: Method, proposals: Sequence[Proposal], background_update: Callable[[], None]
    ) -> list[Segment]:
        if self._settled or (self._current is self._processes and method == "evaluate"):
            return self._current.run(method, proposals, background_update)
        if self._current is self._processes:
            return self._rollout_on_trial(proposals, background_update)
        if method == "evaluate":
            return self._run(method, proposals)
        if self._untouched and self._is_slow() and not self._is_movable():
            self._start_workers()
            self._wait_for_thread()
        segments: dict[int, Segment] = {}
        for batch in _batches(proposals):
            asked = [proposals[i] for i in batch]
            segments.update(zip(batch, self._run(method, asked), strict=True))
        return [segments[i] for i in range(len(proposals))]

    def _run(self, method: Method, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run proposals where environments are, and see whether they should be elsewhere."""
        if self._current is self._serial and not self._settled and self._workers_are_there():
            return self._take_over(method, proposals)
        begun = time.perf_counter()
        segments = self._current.run(method, proposals, nothing)
        self._untouched &= method == "evaluate"
        if self._current is self._serial and not self._settled:
            self._judge(time.perf_counter() - begun, segments)
        return segments

    def _judge(self, seconds: float, segments: Sequence[Segment]) -> None:
        """Begin to start workers, or settle for this process, once enough is known."""
        if self._starting is not None:  # workers that start take time from this process
            return
        self._calls += 1
        self._spent += seconds
        if self._calls <= 2:  # the first call, which may have compiled something, is left out
            self._seconds, self._steps = 0.0, 0
        self._seconds += seconds
        self._steps += _steps(segments)
        self._step_seconds = self._seconds / self._steps
        if self._calls > 1 and self._spent > PATIENCE:
            if not self._is_slow():
                self._stay(f"a step takes {1e3 * self._step_seconds:.2g} ms, too short for workers")
            elif self._untouched or self._is_movable():
                self._start_workers()
            else:
                self._stay("the environment or controller cannot be moved")

    def _is_slow(self) -> bool:
        return self._spent > PATIENCE and self._step_seconds >= SLOW

    def _is_movable(self) -> bool:
        """Tell whether environments can leave this process after they have moved."""
        task, _, _ = self._made_of
        return task.save_fault is None

    def _start_workers(self) -> None:
        if self._starting is None:
            try:
                self._processes.launch(*self._made_of)
            except WorkerError as error:
                self._stay(str(error))
                return
            self._starting = Thread(target=self._wait_for_workers, daemon=True)
            self._starting.start()

    def _wait_for_thread(self) -> None:
        if self._starting is not None:
            self._starting.join()

    def _wait_for_workers(self) -> None:
        try:
            self._processes.wait()
        except Exception as error:  # by the task's pickle, or whatever makes its environment
            self._fault = error

    def _workers_are_there(self) -> bool:
        """Tell whether all workers have started; settle for this process if one could not."""
        if self._starting is None or self._starting.is_alive():
            return False
        if self._fault is not None:
            self._stay(f"no worker can be started ({type(self._fault).__name__}: {self._fault})")
        return self._fault is None

    def _take_over(self, method: Method, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run proposals here and in the workers, which take over if they give the same bits."""
        checked = proposals if method == "rollout" else proposals[:1]
        begun = False
        here: list[Segment] = []

        def run_here() -> None:
            nonlocal begun
            begun = True
            here.extend(self._serial.run(method, checked, nothing))

        try:
            if not self._untouched:
                self._processes.restore(self._serial.state())
            there = self._processes.run(method, proposals, run_here)
        except Exception as error:
            if begun and not here:  # the rollout itself failed
                raise
            fault = as_text(error)
        else:
            same = all(map(_same, here, there))
            fault = "" if same else "workers give other numbers; something outside steers the task"
        self._untouched &= method == "evaluate"
        if not fault:
            self._current, self._settled = self._processes, not self._is_movable()
            self._say(f"a step takes {1e3 * self._step_seconds:.2g} ms: worker processes take over")
            return there
        self._stay(fault)
        return here if len(here) == len(proposals) else self._serial.run(method, proposals, nothing)

    def _rollout_on_trial(
        self, proposals: Sequence[Proposal], background_update: Callable[[], None]
    ) -> list[Segment]:
        """Run proposals in the workers, and settle once it is seen whether these are faster."""
        beside = 0.0

        def timed() -> None:
            nonlocal beside
            begun = time.perf_counter()
            background_update()
            beside = time.perf_counter() - begun

        begun = time.perf_counter()
        segments = self._processes.rollout(proposals, timed)
        self._trial_seconds += time.perf_counter() - begun
        self._trial_here += beside + self._step_seconds * _steps(segments)
        if self._trial_seconds > TRIAL:
            self._settled = True
            if self._trial_seconds > GAIN * self._trial_here:
                with suppress(UnsavableError):
                    self._serial.restore(self._processes.state())
                    self._stay("worker processes are no faster")
        return segments

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
        self._wait_for_thread()
        self._serial.close()


def _batches(proposals: Sequence[Proposal]) -> Iterable[list[int]]:
    """Return the indices of each environment's first proposals, of the second ones, ..."""
    batches: dict[int, list[int]] = defaultdict(list)
    before: Counter[int] = Counter()
    for index, proposal in enumerate(proposals):
        batches[before[proposal.env_index]].append(index)
        before[proposal.env_index] += 1
    return batches.values()


def _steps(segments: Sequence[Segment]) -> int:
    return sum(segment.length for segment in segments)


def _same(one: Segment, other: Segment) -> bool:
    """Tell whether two segments are equal to the last bit, clocks in their diagnostics excepted."""
    return (one.terminated, one.truncated) == (other.terminated, other.truncated) and all(
        np.array_equal(getattr(one, part), getattr(other, part), equal_nan=True)
        for part in ("observations", "actions", "commands", "costs")
    )
