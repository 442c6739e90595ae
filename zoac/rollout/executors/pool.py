"""Environments divided among workers: processes here, or actors of a cluster."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoac.core.segments import Proposal, Segment
from zoac.core.state import pickled
from zoac.core.types import Count
from zoac.rollout.executors.base import Executor
from zoac.rollout.executors.host import Method
from zoac.rollout.task import Task

ATTEMPTS = 3
"""How often the same work may be begun before the run is given up."""


class Handle(ABC):
    """This side of one worker. A worker that dies is replaced and its request begun anew.

    Making a handle begins to start its worker; `ready` waits for it.

    Args:
        env_indices: Of the worker's tuning environments.
    """

    def __init__(self, env_indices: list[int]) -> None:
        self.env_indices = env_indices
        # `zoac.rollout.executors.worker.saved` after the environments' last request; None: they are
        # at their beginning.
        self.env_states: bytes | None = None

    def __str__(self) -> str:
        return f"environments {self.env_indices[0]} to {self.env_indices[-1]}"

    @abstractmethod
    def ready(self) -> None:
        """Wait until the worker has made its environments.

        Raises:
            WorkerError: If the worker cannot be started.
        """

    @abstractmethod
    def begin(self, method: str, *arguments: Any) -> None:
        """Send a request to a method of `zoac.rollout.executors.worker.Worker`, without waiting."""

    @abstractmethod
    def finish(self) -> Any:
        """Return the result of the request.

        Raises:
            WorkerError: If workers die of it again and again.
        """

    @property
    @abstractmethod
    def processor_seconds(self) -> float:
        """Processor seconds of this worker and those it replaced, as far as they reported."""

    @abstractmethod
    def close(self) -> None:
        """End the worker."""

    def call(self, method: str, *arguments: Any) -> Any:
        """Send a request and return its result."""
        self.begin(method, *arguments)
        return self.finish()


class Pool(Executor):
    """Groups of neighbouring environments, each at a worker of its own.

    A worker that dies is replaced, its environments are restored, and its work is redone. Where
    they cannot be saved, the run ends with a message instead.
    """

    def __init__(self, *, workers: Count | None = None) -> None:
        """
        Args:
            workers: Number of workers; None: one a core that this process may use.
        """
        self._count = workers
        self._workers: list[Handle] = []

    def start(self, task: Task, num_envs: int, seed: int) -> None:
        """See `Executor.start`; where one worker cannot be started, all end."""
        self._workers = []
        count = min(self._count or self._cores(), num_envs)
        try:
            for part in np.array_split(np.arange(num_envs), count):
                self._workers.append(self._worker(task, part.tolist(), seed))
            for worker in self._workers:
                worker.ready()
        except BaseException:
            self.close()
            raise
        self._worker_of = {env_index: w for w in self._workers for env_index in w.env_indices}

    @abstractmethod
    def _cores(self) -> int:
        """Return how many workers there is room for."""

    @abstractmethod
    def _worker(self, task: Task, env_indices: list[int], seed: int) -> Handle:
        """Begin to start a worker for a group of environments."""

    def run(
        self, method: Method, proposals: Sequence[Proposal], background_update: Callable[[], None]
    ) -> list[Segment]:
        parts: dict[Handle, list[int]] = {w: [] for w in self._workers}
        if method == "rollout":
            for index, proposal in enumerate(proposals):
                parts[self._worker_of[proposal.env_index]].append(index)
        else:
            even = np.array_split(np.arange(len(proposals)), len(self._workers))
            parts = {w: part.tolist() for w, part in zip(self._workers, even, strict=True)}
            # A worker's evaluation environments count from 0; the episode comes from the seed.
            proposals = [replace(proposals[i], env_index=k)
                         for part in parts.values() for k, i in enumerate(part)]  # fmt: skip
        busy = {w: part for w, part in parts.items() if part}
        for worker, part in busy.items():
            worker.begin("run", method, [proposals[i] for i in part])
        background_update()
        segments: dict[int, Segment] = {}
        for worker, part in busy.items():
            done, env_states = worker.finish()
            if method == "rollout":
                worker.env_states = env_states
            segments.update(zip(part, done, strict=True))
        return [segments[i] for i in range(len(proposals))]

    def state(self) -> dict[int, Any]:
        return {
            env_index: state for w in self._workers for env_index, state in w.call("state").items()
        }

    def restore(self, state: Mapping[int, Any]) -> None:
        for worker in self._workers:
            worker.env_states = pickled(
                {env_index: state[env_index] for env_index in worker.env_indices}
            )
            worker.call("restore", worker.env_states)

    @property
    def worker_seconds(self) -> float:
        return sum(w.processor_seconds for w in self._workers)

    def close(self) -> None:
        for worker in self._workers:
            worker.close()
