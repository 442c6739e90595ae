"""Lanes spread over workers, whatever these are: processes here, actors of a cluster elsewhere."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import cloudpickle
import numpy as np

from zoac.executor import Executor, nothing
from zoac.segments import Proposal, Segment
from zoac.task import Task


class Handle(ABC):
    """This side of one worker. A worker that dies is replaced and its request begun anew.

    Making a handle begins to start its worker; `ready` waits for it.

    Args:
        lanes: Ids of the worker's tuning lanes.
    """

    def __init__(self, lanes: list[int]) -> None:
        self.lanes = lanes
        # `zoac.worker.saved` after the lanes' last request; None: they are at their beginning.
        self.lane_states: bytes | None = None

    @abstractmethod
    def ready(self) -> None:
        """Wait until the worker has made its lanes.

        Raises:
            WorkerError: If the worker cannot be started.
        """

    @abstractmethod
    def begin(self, method: str, *arguments: Any) -> None:
        """Send a request to a method of `zoac.worker.Worker`, without waiting."""

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


class Spread(Executor):
    """Groups of neighbouring lanes, each at a worker of its own.

    A worker that dies is replaced, put back to where its lanes stood, and its work redone. Where
    the lanes cannot be saved the run ends with a message instead.
    """

    def __init__(self) -> None:
        self._workers: list[Handle] = []

    @abstractmethod
    def _launch(self, task: Task, lanes: list[int], seed: int) -> Handle:
        """Begin to start a worker for a group of lanes."""

    def _spread(self, task: Task, lanes: int, seed: int, workers: int) -> None:
        """Begin to start workers, one for each group of lanes; where one fails, end all."""
        self._workers = []
        try:
            for part in np.array_split(np.arange(lanes), min(workers, lanes)):
                self._workers.append(self._launch(task, part.tolist(), seed))
        except BaseException:
            self.close()
            raise
        self._worker_of = {lane: w for w in self._workers for lane in w.lanes}

    def _wait(self) -> None:
        """Wait until all workers are ready; where one is not, end all."""
        try:
            for worker in self._workers:
                worker.ready()
        except BaseException:
            self.close()
            raise

    def rollout(
        self, proposals: Sequence[Proposal], meanwhile: Callable[[], None] = nothing
    ) -> list[Segment]:
        """See `Executor.rollout`."""
        shares: dict[Handle, list[int]] = {w: [] for w in self._workers}
        for index, proposal in enumerate(proposals):
            shares[self._worker_of[proposal.lane]].append(index)
        requests = {w: [proposals[i] for i in share] for w, share in shares.items() if share}
        for worker, request in requests.items():
            worker.begin("rollout", request)
        meanwhile()
        segments: dict[int, Segment] = {}
        for worker in requests:
            done, worker.lane_states = worker.finish()
            segments.update(zip(shares[worker], done, strict=True))
        return [segments[i] for i in range(len(proposals))]

    def evaluate(
        self, proposals: Sequence[Proposal], meanwhile: Callable[[], None] = nothing
    ) -> list[Segment]:
        """See `Executor.evaluate`."""
        parts = [
            (worker, part)
            for worker, part in zip(
                self._workers,
                np.array_split(np.arange(len(proposals)), len(self._workers)),
                strict=True,
            )
            if len(part)
        ]
        for worker, part in parts:
            # A worker's evaluation lanes count from 0; the episode comes from the seed alone.
            worker.begin("evaluate", [replace(proposals[i], lane=k) for k, i in enumerate(part)])
        meanwhile()
        return [segment for worker, _ in parts for segment in worker.finish()]

    def state(self) -> dict[int, Any]:
        """See `Executor.state`."""
        return {lane: state for w in self._workers for lane, state in w.call("state").items()}

    def restore(self, state: Mapping[int, Any]) -> None:
        """See `Executor.restore`."""
        for worker in self._workers:
            worker.lane_states = cloudpickle.dumps({lane: state[lane] for lane in worker.lanes})
            worker.call("restore", worker.lane_states)

    @property
    def worker_seconds(self) -> float:
        """See `Executor.worker_seconds`."""
        return sum(w.processor_seconds for w in self._workers)

    def close(self) -> None:
        """See `Executor.close`."""
        for worker in self._workers:
            worker.close()
