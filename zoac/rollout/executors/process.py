"""`executor=process`: groups of environments in processes of this machine."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import cloudpickle

from zoac.core.errors import WorkerError
from zoac.core.seeding import stream_seed
from zoac.core.state import pickled
from zoac.rollout.executors import guard
from zoac.rollout.executors.pool import ATTEMPTS, Handle, Pool
from zoac.rollout.executors.step_watch import Call, StepWatch
from zoac.rollout.executors.worker import CANNOT_BE_SAVED, read, write
from zoac.rollout.task import Task

Request = tuple[str, tuple[Any, ...]]
"""A method of `Worker` and its arguments."""


class Process(Pool):
    """Groups of neighbouring environments, each in a process of its own."""

    def _cores(self) -> int:
        return usable_cores()

    def _worker(self, task: Task, env_indices: list[int], seed: int) -> Handle:
        return _ProcessHandle(task, env_indices, seed)


def usable_cores() -> int:
    """Return how many processor cores this process may use.

    A launcher that runs jobs side by side tells each its share in the variable ZOAC_CORES.
    """
    if (part := os.environ.get("ZOAC_CORES", "")).isdecimal():
        return max(1, int(part))
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _ProcessHandle(Handle):
    """This side of one worker process."""

    def __init__(self, task: Task, env_indices: list[int], seed: int) -> None:
        super().__init__(env_indices)
        self._task, self._seed = task, seed
        self._watch = None if task.step_timeout is None else StepWatch(task.step_timeout)
        self._earlier_seconds = self._seconds = 0.0
        self._restarts = 0
        self._start_process()

    def ready(self) -> None:
        watched = None if self._watch is None else self._watch.path
        steps: list[Request] = [("start", (self._task, self.env_indices, self._seed, watched))]
        if self.env_states is not None:
            steps.append(("restore", (self.env_states,)))
        for step in steps:
            try:
                write(self._input, pickled(step))
                _, error = self._reply()
            except (EOFError, OSError):
                raise WorkerError(
                    f"a worker process could not be started ({_death(self._process.wait())})"
                ) from None
            if error is not None:  # may be an OSError of a user's environment
                raise error

    def begin(self, method: str, *arguments: Any) -> None:
        self._request: Request = (method, arguments)
        self._send(())

    def _send(self, hung: Sequence[Call]) -> None:
        """Send the request, in which some calls of environments never return."""
        method, arguments = self._request
        with contextlib.suppress(OSError):  # it has died: `finish` notices and sends again
            write(self._input, pickled((method, (*arguments, hung) if hung else arguments)))

    def finish(self) -> Any:
        deaths, hung = 0, list[Call]()
        while True:
            known = len(hung)
            try:
                with self._watching(hung):
                    result, error = self._reply()
                break
            except EOFError:  # nobody is there any more
                deaths += len(hung) == known
            if deaths == ATTEMPTS:
                raise WorkerError(
                    f"the worker process of {self} died {deaths} times on the same work "
                    f"({_death(self._process.wait())}). Memory may be short: "
                    "try fewer executor.workers or fewer environments"
                )
            self._end_process()
            if len(hung) > known and self.env_states == CANNOT_BE_SAVED:  # new episodes begin
                self._restarts += 1
                self._seed = stream_seed(self._seed, "restart", self._restarts)
                self.env_states = None
            self._start_process()
            self.ready()
            self._send(hung)
        if error is not None:
            raise error
        return result

    def _watching(self, hung: list[Call]) -> AbstractContextManager[None]:
        """Return a context in which a worker is killed whose environment does not return."""
        if self._watch is None:
            return contextlib.nullcontext()
        return self._watch.watching(lambda: guard.kill(self._process), hung)

    @property
    def processor_seconds(self) -> float:
        return self._earlier_seconds + self._seconds

    def close(self) -> None:
        self._end_process()
        if self._watch is not None:
            self._watch.close()

    def _end_process(self) -> None:
        guard.kill(self._process)
        self._process.wait()
        for stream in (self._input, self._output):
            with contextlib.suppress(OSError):  # what was not sent yet has no reader any more
                stream.close()

    def _start_process(self) -> None:
        self._earlier_seconds += self._seconds
        self._seconds = 0.0
        # Not a fork, which would copy locked threads; not multiprocessing's spawn, which would
        # run a user's script again.
        path = os.pathsep.join(p for p in sys.path if p)
        try:
            self._process = guard.started(
                [sys.executable, "-m", "zoac.rollout.executors.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
                cwd=Path.cwd(),
            )
        except OSError as error:  # too many processes, or too little memory
            raise WorkerError(
                f"a worker process could not be started ({error.strerror}); try fewer "
                "executor.workers"
            ) from error
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout

    def _reply(self) -> tuple[Any, Exception | None]:
        """Return result and error of the request, as `zoac.rollout.executors.worker.answered` does.

        Raises:
            EOFError: If the process has died.
        """
        result, error, self._seconds = cloudpickle.loads(read(self._output))
        return result, error


def _death(status: int) -> str:
    return f"killed by signal {-status}" if status < 0 else f"exit status {status}"
