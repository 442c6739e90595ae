"""A small environment and task whose every number can be worked out by hand."""

from __future__ import annotations

import ctypes
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box

from zoac.core.measures import Metric
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.core.state import Encoded, OwnObject
from zoac.envs.base import ArrayVecEnv
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.executors import worker
from zoac.rollout.task import Task
from zoac.runs import checkpoint


def needs_its_library(target: str) -> None:
    """Skip the test if a tuner, by its `_target_`, is an extra whose library is not installed."""
    _, extra, rest = target.partition("zoac.baselines.extras.")
    if extra:
        library = rest.partition(".")[0]
        pytest.importorskip(library, reason=f"{target} needs zoac[{library}]")


class CountingVecEnv(ArrayVecEnv):
    """Observation: (episode number of the environment, step, the episode's random number).

    Cost: the action plus the random number. Terminates after `ends_after` steps, if given.
    """

    def __init__(self, n: int, max_episode_steps: int, ends_after: int | None) -> None:
        box = Box(-np.inf, np.inf, (3,), np.float64)
        super().__init__(n, box, Box(-np.inf, np.inf, (1,), np.float64), max_episode_steps)
        self._ends_after = ends_after
        self.arrays = {"x": np.zeros((n, 3))}

    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        x = self.arrays["x"][env_index]
        x[:] = x[0] + 1, 0, rng.normal()

    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = self.arrays["x"]
        x[:, 1] += 1
        ended = np.full(self.num_envs, False)
        if self._ends_after is not None:
            ended = x[:, 1] >= self._ends_after
        return actions[:, 0] + x[:, 2], ended

    def _observe(self) -> np.ndarray:
        return self.arrays["x"].copy()


class EchoController:
    """Acts with parameter `a`; remembers how often it has acted in this episode."""

    def init(self, n: int) -> dict[str, np.ndarray]:
        return {"count": np.zeros(n)}

    def act(self, params: Any, obs: np.ndarray, memory: Any) -> Any:
        count = memory["count"] + 1
        return params["a"][:, None].copy(), {"count": count}, {"count": count, "a": params["a"]}


class CountingTask(Task):
    """Parameters a and b in [0, 10]; b does nothing."""

    space = ParameterSpace([Parameter("a", 0.0, 10.0), Parameter("b", 0.0, 10.0)])
    metrics = (Metric("mean_a", lambda s: s.diagnostics["a"]),)
    baseline = {"a": 1.0, "b": 2.0}

    def __init__(self, max_episode_steps: int = 7, ends_after: int | None = None) -> None:
        self._options = (max_episode_steps, ends_after)

    def make_env(self, n: int) -> CountingVecEnv:
        return CountingVecEnv(n, *self._options)

    def make_controller(self) -> EchoController:
        return EchoController()


def engine(task: Task, env_indices: list[int], seed: int = 0) -> RolloutEngine:
    return RolloutEngine(task, env_indices, [stream_seed(seed, "lane", i) for i in env_indices])


def same_segment(one: Segment, other: Segment) -> bool:
    """Tell whether two segments are equal to the last bit."""
    return (
        np.array_equal(one.observations, other.observations)
        and np.array_equal(one.actions, other.actions)
        and np.array_equal(one.commands, other.commands)
        and np.array_equal(one.costs, other.costs)
        and (one.terminated, one.truncated) == (other.terminated, other.truncated)
        and all(np.array_equal(v, other.diagnostics[k]) for k, v in one.diagnostics.items())
    )


def proposal(env_index: int, a: float = 5.0, **kind: Any) -> Proposal:
    """A proposal for `CountingTask` with parameter a in physical units."""
    return Proposal(x=np.array([a / 5.0 - 1.0, 0.0]), env_index=env_index, **kind)


class _Raising(EchoController):
    def act(self, params, obs, memory):
        raise ZeroDivisionError("in the controller")


class RaisingTask(CountingTask):
    """Its controller raises."""

    def make_controller(self):
        return _Raising()


class TwoFacedError(Exception):
    """Does not survive a pickle."""

    def __init__(self, what: str, where: str) -> None:
        super().__init__(f"{what} at {where}")


class _BrokenVecEnv(CountingVecEnv):
    def __init__(self, n: int, error: Exception) -> None:
        super().__init__(n, 7, None)
        self._error = error

    def _advance(self, actions: np.ndarray) -> Any:
        raise self._error


class BrokenPlantTask(CountingTask):
    """Its environment raises at every step or, if told so, cannot even be made."""

    def __init__(self, kind: str, at_start: bool = False) -> None:
        super().__init__()
        self._kind, self._at_start = kind, at_start

    def make_env(self, n: int) -> CountingVecEnv:
        error = {
            "system": ConnectionError("the bench does not answer"),
            "two-faced": TwoFacedError("sparks", "the bench"),
        }[self._kind]
        if self._at_start:
            raise error
        return _BrokenVecEnv(n, error)


class _LockedVecEnv(CountingVecEnv):
    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.lock = threading.Lock()

    def state(self, env_indices: Any) -> Any:
        return super().state(env_indices), OwnObject(self.lock)

    def restore(self, env_indices: Any, state: Any) -> Any:
        return super().restore(env_indices, state[0])


class LockedTask(CountingTask):
    """The state of its environments is taken by no pickle."""

    def make_env(self, n: int) -> CountingVecEnv:
        return _LockedVecEnv(n, *self._options)


class _Slow(EchoController):
    def act(self, params: Any, obs: np.ndarray, memory: Any) -> Any:
        time.sleep(SlowTask.seconds)
        return super().act(params, obs, memory)


class SlowTask(CountingTask):
    """Every call of the controller takes `seconds`."""

    seconds = 0.05

    def make_controller(self) -> EchoController:
        return _Slow()


class _Waiting(EchoController):
    def __init__(self, sign: Path) -> None:
        self._sign = sign

    def act(self, params: Any, obs: np.ndarray, memory: Any) -> Any:
        for _ in range(3000):
            if self._sign.exists():
                return super().act(params, obs, memory)
            time.sleep(0.01)
        raise TimeoutError("nobody gave the sign")


class WaitingTask(CountingTask):
    """Its controller acts once a file exists."""

    def __init__(self, sign: Path) -> None:
        super().__init__()
        self._sign = sign

    def make_controller(self) -> EchoController:
        return _Waiting(self._sign)


class _Stuck(EchoController):
    def __init__(self, sign: Path, holds_interpreter: bool) -> None:
        self._sign = sign
        self._sleep = ctypes.PyDLL(None).sleep if holds_interpreter else time.sleep

    def act(self, params: Any, obs: np.ndarray, memory: Any) -> Any:
        self._sign.touch()
        self._sleep(600)


class StuckTask(CountingTask):
    """Its controller touches a file and does not come back for ten minutes.

    Args:
        holds_interpreter: Whether no other thread of Python can run in that time.
    """

    def __init__(self, sign: Path, holds_interpreter: bool) -> None:
        super().__init__()
        self._stuck = (sign, holds_interpreter)

    def make_controller(self) -> EchoController:
        return _Stuck(*self._stuck)


class SimulatorTask(CountingTask):
    """Its controller starts a program, says so by a file named by its process, and waits for it."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder

    def make_controller(self) -> EchoController:
        return _Simulator(self._folder)


class SmallGroupTask(CountingTask):
    """An environment of one environment cannot be made."""

    def make_env(self, n: int) -> CountingVecEnv:
        if n == 1:
            raise ConnectionError("the second bench does not answer")
        return super().make_env(n)


class ForkedWorker:
    """A worker process as `guard.started` returns it, but forked from this one: 1% of the time.

    It knows what this process knows, so it is for tests in which that makes no difference.
    """

    def __init__(self, *_arguments: Any, **_options: Any) -> None:
        requests, to_worker = os.pipe()
        from_worker, replies = os.pipe()
        self.returncode: int | None = None
        self._waiting = threading.Lock()  # two threads may close the same worker
        self.pid = os.fork()
        if self.pid == 0:
            try:
                os.setpgid(0, 0)  # it leads a group, which is killed as one
                # As after an exec: else workers would keep each other's pipes.
                first, second = sorted((requests, replies))
                os.closerange(3, first)
                os.closerange(first + 1, second)
                os.closerange(second + 1, 1024)
                sys.stdin, sys.stdout = os.fdopen(requests), os.fdopen(replies, "w")
                sys.stderr = os.fdopen(2, "w")
                worker.main()
            finally:
                os._exit(1)
        os.close(requests)
        os.close(replies)
        self.stdin, self.stdout = os.fdopen(to_worker, "wb"), os.fdopen(from_worker, "rb")
        os.setpgid(self.pid, self.pid)  # here too: it may be killed before it has done so

    def poll(self, options: int = os.WNOHANG) -> int | None:
        with self._waiting:
            if self.returncode is None and (ended := os.waitpid(self.pid, options))[0]:
                self.returncode = os.waitstatus_to_exitcode(ended[1])
            return self.returncode

    def wait(self) -> int | None:
        return self.poll(0)


def marked(mark: str) -> list[int]:
    """Return the processes that were started with `mark` in their environment, on Linux."""
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):  # it has ended, or is somebody else's
            if mark.encode() in path.read_bytes():
                found.append(int(path.parent.name))
    return found


def end_within(seconds: float, mark: str) -> bool:
    """Tell whether all processes with `mark` in their environment end in so many seconds."""
    deadline = time.monotonic() + seconds
    while marked(mark):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


class _Simulator(EchoController):
    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def act(self, params: Any, obs: np.ndarray, memory: Any) -> Any:
        with subprocess.Popen(["sleep", "600"]):
            (self._folder / f"sign.{os.getpid()}").touch()


class _Suicidal(EchoController):
    def act(self, params: Any, obs: np.ndarray, memory: Any) -> Any:
        os.kill(os.getpid(), signal.SIGKILL)


class SuicidalTask(CountingTask):
    """The controller kills the process that it runs in."""

    def make_controller(self) -> EchoController:
        return _Suicidal()


class Traps:
    """Leaves traces when its pickle is opened."""

    def __init__(self, trace: Path) -> None:
        self._trace = trace

    def __reduce__(self) -> Any:
        return Path.touch, (self._trace,)


def with_a_trap(path: Path, trace: Path) -> None:
    """Put a prepared pickle into a checkpoint, as somebody else might."""
    header, _, body = path.read_bytes().partition(b"\n")
    length = json.loads(header)["plain"]
    encoded = Encoded(body[:length], pickle.dumps([Traps(trace)]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checkpoint, "encode", lambda state: encoded)
        checkpoint.save(path.parent, None)
