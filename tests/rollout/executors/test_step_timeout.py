"""A step that never returns is ended, its worker replaced, and the episode has failed."""

import ctypes
import threading
import time

import gymnasium
import numpy as np
import pandas as pd
import pytest
from gymnasium.spaces import Box

import zoac
from zoac.core.errors import ConfigError, EnvironmentFailure


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


def tuned(env, **options):
    given = {"tuner": "zoac_plus", "executor": "process", "step_timeout": 2.0, "num_envs": 4,
             "failure_penalty": 50.0, "budget": 400, "episodes": 4, "final_episodes": 4,
             "quiet": True, **options}  # fmt: skip
    return zoac.tune(env=env, controller=p, space={"k": (0.0, 3.0)}, **given)


@pytest.mark.parametrize("env", [InPython, InLibrary])
def test_a_run_is_the_same_as_with_steps_that_raise(env):
    expected = tuned(Slow, step_timeout=None, executor="serial")
    found = tuned(env)
    assert expected.record["failures"] > 1
    assert found.record["failures"] == expected.record["failures"]
    assert found.parameters == expected.parameters
    assert found.cost_per_episode == expected.cost_per_episode
    pd.testing.assert_series_equal(found.history["cost_mean"], expected.history["cost_mean"])
    assert "step did not return within step_timeout=2 s" in found.record["first_failure"]


def test_environments_that_cannot_be_saved_begin_new_episodes():
    found = tuned(Unsavable, tuner="random", budget=120, step_timeout=1.0)
    assert found.env_steps >= 120
    assert found.record["failures"] > 0
    assert "did not return" in found.record["first_failure"]


def test_without_a_price_the_run_ends():
    with pytest.raises(EnvironmentFailure, match=r"did not return.*With failure_penalty=<cost>"):
        tuned(InPython, failure_penalty=None)


@pytest.mark.parametrize("executor", ["serial", "auto"])
def test_executors_that_cannot_refuse_it(executor):
    with pytest.raises(ConfigError, match=rf"step_timeout=2: executor={executor} cannot end"):
        tuned(InPython, executor=executor)


def test_environments_that_step_all_at_once_refuse_it():
    with pytest.raises(ConfigError, match="PidAccVecEnv are stepped all at once"):
        zoac.tune(task="pid_acc", tuner="random", executor="process", step_timeout=1.0,
                  budget=100, quiet=True)  # fmt: skip
