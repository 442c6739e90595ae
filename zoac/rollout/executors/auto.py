"""`executor=auto`: worker processes where steps are slow enough to pay, else this process.

The first batches run in this process. What a step takes there decides, once, where all others run.
Numbers do not depend on it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

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
        begun = time.perf_counter()
        segments = self._current.run(method, proposals, background_update)
        if not self._decided:
            self._seconds += time.perf_counter() - begun
            self._steps += sum(segment.length for segment in segments)
            self._untouched &= method == "evaluate"
            if self._seconds > PATIENCE:
                self._decided = True
                self.tell(f"executor=auto: {self._decide()}")
        return segments

    def _decide(self) -> str:
        """Move to worker processes if that pays and can be done; say what was chosen."""
        task, _, _ = self._made_of
        stay = "all runs in one process"
        pace = f"a step takes {1e3 * self._seconds / self._steps:.2g} ms"
        if self._seconds / self._steps < SLOW:
            return f"{pace}, too short for workers: {stay}"
        if not self._untouched and task.save_fault is not None:
            return f"the environment or controller cannot be moved: {stay}"
        processes = Process(workers=self._workers)
        try:
            processes.start(*self._made_of)
            if not self._untouched:
                processes.restore(self._current.state())
        except Exception as error:  # whatever a user's task raises when it is sent or made there
            processes.close()
            return f"no worker can be started ({as_text(error)}): {stay}"
        self._current.close()
        self._current = processes
        return f"{pace}: worker processes take over"

    def state(self) -> dict[int, Any]:
        return self._current.state()

    def restore(self, state: Mapping[int, Any]) -> None:
        self._untouched = False
        self._current.restore(state)

    @property
    def worker_seconds(self) -> float:
        return self._current.worker_seconds

    def close(self) -> None:
        self._current.close()
