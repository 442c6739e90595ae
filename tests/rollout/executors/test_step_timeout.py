"""A step that never returns is ended, its worker replaced, and the episode has failed."""

import ctypes
import threading
import time
from contextlib import closing

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box

import zoac
from tests.support import same_segment
from zoac.core.errors import ConfigError, EnvironmentFailure
from zoac.core.segments import Proposal
from zoac.rollout.executors.base import Serial
from zoac.rollout.executors.process import Process
from zoac.tasks.user_task import user_task


class Slow(gymnasium.Env):
    """An integrator; now and then, as its state has it, a step does not return."""

    observation_space = Box(-np.inf, np.inf, (1,), np.float64)
    action_space = Box(-2.0, 2.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.steps = self.np_random.uniform(0.5, 1.5), 0
        return np.array([self.x]), {}

    def step(self, action):
        self.x += 0.1 * float(action[0]) + 0.01 * self.np_random.standard_normal()
        self.steps += 1
        if self.steps > 3 and 1e4 * self.x % 1.0 < 0.012:
            self.get_stuck()
        return np.array([self.x]), -(self.x**2), False, self.steps >= 20, {}

    def get_stuck(self):
        raise RuntimeError("the step does not return")


class InPython(Slow):
    def get_stuck(self):
        time.sleep(600)


class InLibrary(Slow):
    def get_stuck(self):
        ctypes.PyDLL(None).sleep(600)  # no other thread of Python can run meanwhile


class Unsavable(InPython):
    def __init__(self):
        self.lock = threading.Lock()


def p(parameters, seen):
    return -parameters["k"] * seen


SPACE = {"k": (0.0, 3.0)}


def tuned(env, **options):
    given = {"tuner": "random", "executor": "process", "step_timeout": 0.5, "num_envs": 2,
             "failure_penalty": 50.0, "budget": 60, "episodes": 1, "final_episodes": 1,
             "quiet": True, **options}  # fmt: skip
    return zoac.tune(env=env, controller=p, space=SPACE, **given)


PLAN = [
    Proposal(np.array([x]), env_index, **kind)
    for x, kind in ((0.5, {"horizon": 8}), (0.7, {"horizon": 8, "restore": True}), (0.2, {}))
    for env_index in (0, 1, 2)
]


def rolled_out(executor, env):
    """Return the segments of two rollouts."""
    task = user_task(env=env, controller=p, space=SPACE)
    task.failure_penalty = 50.0
    task.step_timeout = 0.5 if isinstance(executor, Process) else None
    executor.start(task, 3, seed=19)
    with closing(executor):
        return executor.rollout(PLAN) + executor.rollout(PLAN)


def test_segments_are_those_of_steps_that_raise(forked_workers):
    expected = rolled_out(Serial(), Slow)
    found = rolled_out(Process(workers=2), InLibrary)
    failed = [bool(segment.failure) for segment in expected]
    assert np.flatnonzero(failed).tolist() == [4, 10, 16]  # two in one request
    for one, other in zip(found, expected, strict=True):
        assert same_segment(one, other)
        assert bool(one.failure) == bool(other.failure)
        assert not one.failure or "step did not return within step_timeout=0.5 s" in one.failure


def test_environments_that_cannot_be_saved_begin_new_episodes(forked_workers):
    found = tuned(Unsavable)
    assert found.env_steps >= 60
    assert found.record["failures"] > 0
    assert "did not return" in found.record["first_failure"]


def test_without_a_price_the_run_ends(forked_workers):
    with pytest.raises(EnvironmentFailure, match=r"did not return.*With failure_penalty=<cost>"):
        tuned(InPython, failure_penalty=None)


@pytest.mark.parametrize("executor", ["serial", "auto"])
def test_executors_that_cannot_refuse_it(executor):
    with pytest.raises(ConfigError, match=rf"step_timeout=0.5: executor={executor} cannot end"):
        tuned(InPython, executor=executor)


def test_environments_that_step_all_at_once_refuse_it(forked_workers):
    with pytest.raises(ConfigError, match="PidAccVecEnv are stepped all at once"):
        zoac.tune(task="pid_acc", tuner="random", executor="process", step_timeout=0.1,
                  budget=100, quiet=True)  # fmt: skip
