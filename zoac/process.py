"""Lanes spread over workers; `executor=process`: the workers are processes of this machine."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from zoac.errors import ZoacError
from zoac.executor import Executor, nothing
from zoac.segments import Proposal, Segment
from zoac.task import Task
from zoac.worker import receive, send


class WorkerError(ZoacError):
    """A worker died again and again on the same work."""


class Handle(ABC):
    """This side of one worker. A worker that dies is replaced and its request begun anew.

    Args:
        lanes: Ids of the worker's tuning lanes.
    """

    def __init__(self, lanes: list[int]) -> None:
        self.lanes = lanes
        # Where the lanes stood after their last request; None: at their very beginning.
        self.lane_states: dict[int, Any] | None = None

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

    A worker that dies is replaced, put back to where its lanes stood, and its work redone.
    """

    _workers: Sequence[Handle] = ()

    @abstractmethod
    def _launch(self, task: Task, groups: list[list[int]], seed: int) -> Sequence[Handle]:
        """Return a worker for each group of lanes."""

    def _spread(self, task: Task, lanes: int, seed: int, workers: int) -> None:
        """Start workers, one for each group of lanes."""
        parts = np.array_split(np.arange(lanes), min(workers, lanes))
        self._workers = self._launch(task, [[int(lane) for lane in p] for p in parts], seed)
        self._worker_of = {lane: w for w in self._workers for lane in w.lanes}

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
            worker.begin("evaluate", [_in_lane(proposals[i], k) for k, i in enumerate(part)])
        meanwhile()
        return [segment for worker, _ in parts for segment in worker.finish()]

    def state(self) -> dict[int, Any]:
        """See `Executor.state`."""
        return {lane: state for w in self._workers for lane, state in w.call("state").items()}

    def restore(self, state: Mapping[int, Any]) -> None:
        """See `Executor.restore`."""
        for worker in self._workers:
            worker.lane_states = {lane: state[lane] for lane in worker.lanes}
            worker.call("restore", worker.lane_states)

    @property
    def worker_seconds(self) -> float:
        """See `Executor.worker_seconds`."""
        return sum(w.processor_seconds for w in self._workers)

    def close(self) -> None:
        """See `Executor.close`."""
        for worker in self._workers:
            worker.close()


def _in_lane(proposal: Proposal, lane: int) -> Proposal:
    return Proposal(proposal.z, lane, proposal.horizon, proposal.branch, proposal.seed)


class Process(Spread):
    """Groups of neighbouring lanes, each in a process of its own."""

    def __init__(
        self,
        *,
        workers: Annotated[int, Field(ge=1)] | None = None,
        attempts: Annotated[int, Field(ge=1)] = 3,
    ) -> None:
        """
        Args:
            workers: Number of processes; None: one a processor core.
            attempts: How often the same work may be begun before the run is given up.
        """
        self._count = workers or os.cpu_count() or 1
        self._attempts = attempts

    def start(self, task: Task, lanes: int, seed: int) -> None:
        """See `Executor.start`."""
        self._spread(task, lanes, seed, self._count)

    def _launch(self, task: Task, groups: list[list[int]], seed: int) -> Sequence[Handle]:
        return [_ProcessHandle(task, group, seed, self._attempts) for group in groups]


class _ProcessHandle(Handle):
    """This side of one worker process."""

    def __init__(self, task: Task, lanes: list[int], seed: int, attempts: int) -> None:
        super().__init__(lanes)
        self._task, self._seed, self._attempts = task, seed, attempts
        self._earlier_seconds = self._seconds = 0.0
        self._request: tuple[str, tuple[Any, ...]] = ("state", ())
        self._start_process()

    def begin(self, method: str, *arguments: Any) -> None:
        """See `Handle.begin`."""
        self._request = (method, arguments)
        with contextlib.suppress(OSError):  # it has died: `finish` notices and sends again
            send(self._input, self._request)

    def finish(self) -> Any:
        """See `Handle.finish`."""
        for attempt in range(1, self._attempts + 1):
            try:
                return self._reply()
            except (EOFError, OSError):
                status = self._process.wait()
                if attempt == self._attempts:
                    break
                self._start_process()
                self.begin(*_flat(self._request))
        raise WorkerError(
            f"the worker process of lanes {self.lanes[0]} to {self.lanes[-1]} died "
            f"{self._attempts} times on the same work ({_death(status)}). Memory may be short: "
            "try fewer executor.workers or fewer lanes"
        )

    @property
    def processor_seconds(self) -> float:
        """See `Handle.processor_seconds`."""
        return self._earlier_seconds + self._seconds

    def close(self) -> None:
        """See `Handle.close`."""
        self._process.kill()
        self._process.wait()
        self._input.close()
        self._output.close()

    def _start_process(self) -> None:
        self._earlier_seconds += self._seconds
        self._seconds = 0.0
        # Not a fork, which would copy locked threads; not multiprocessing's spawn, which would
        # run a user's script again.
        path = os.pathsep.join(p for p in sys.path if p)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "zoac.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
            cwd=Path.cwd(),
            # Ctrl-C is for this process to handle: workers end with it.
            start_new_session=os.name == "posix",
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout
        unfinished = self._request
        try:
            send(self._input, ("start", (self._task, self.lanes, self._seed)))
            self._reply()
            if self.lane_states is not None:
                send(self._input, ("restore", (self.lane_states,)))
                self._reply()
        except (EOFError, OSError):
            raise WorkerError(
                f"a worker process could not be started ({_death(self._process.wait())})"
            ) from None
        self._request = unfinished

    def _reply(self) -> Any:
        result, error, self._seconds = receive(self._output)
        if error is not None:
            raise error
        return result


def _flat(request: tuple[str, tuple[Any, ...]]) -> tuple[Any, ...]:
    method, arguments = request
    return (method, *arguments)


def _death(status: int) -> str:
    return f"killed by signal {-status}" if status < 0 else f"exit status {status}"
