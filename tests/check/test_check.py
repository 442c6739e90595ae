"""Each verdict against a task that is broken in just that."""

import time

import numpy as np
import pytest

from tests.envs.test_adapters import Drift, Integrator
from tests.support import CountingTask
from zoac import check
from zoac.check import environment
from zoac.check.__main__ import main
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.envs import gymnasium_adapter
from zoac.tasks.user_task import user_task


def act(params, obs):
    return -params["k"] * obs[0] + params["bias"]


def task(env=Drift, controller=act, **changes):
    options = {"space": {"k": (0.0, 1.0), "bias": (-0.1, 0.1)}, "max_episode_steps": 20}
    return user_task(env=env, controller=controller, **{**options, **changes})


@pytest.mark.parametrize("changes", [{}, {"controller": Integrator(), "space": {"k": (0.0, 1.0)}}])
def test_a_sound_task_passes_every_check(changes):
    assert [v for v in check.check(task(**changes)) if not v.good] == []


class Skewed(ParameterSpace):
    def normalise(self, parameters):
        return super().normalise(parameters) * 0.9


def test_a_transform_that_does_not_come_back_is_named():
    space = Skewed([Parameter("k", 0, 1), Parameter("bias", -1, 1)])
    skewed = user_task(env=Drift, controller=act, space=space)
    good, text = check.round_trip(skewed)
    assert not good
    assert "comes back" in text


def test_start_values_outside_their_bounds_are_named():
    broken = task()
    broken.baseline = {"k": 7.0, "bias": 0.0}
    verdict = next(check.check(broken))
    assert (verdict.good, "'k': 7.0 lies outside" in verdict.text) == (False, True)


class Huge(Drift):
    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, reward if abs(self.x) < 1 else np.nan, *rest


@pytest.mark.parametrize(
    ("changes", "told"),
    [({"env": Huge}, "the cost nan"), ({"controller": lambda p, o: [0.0, 0.0]}, "shape")],
)
def test_a_cost_or_an_action_that_cannot_be_used_is_named(changes, told):
    (verdict,) = [v for v in check.check(task(**changes)) if v.name == "shapes and bounds"]
    assert not verdict.good
    assert told in verdict.text


@pytest.mark.parametrize(
    ("controller", "told"),
    [
        (act, "not ended after 1,000 steps"),
        (lambda p, o: 1.0, "nothing ends an episode for certa"),
    ],
)
def test_an_environment_without_a_time_limit_is_named(controller, told, monkeypatch):
    monkeypatch.setattr(gymnasium_adapter, "MAX_EPISODE_STEPS", 1000)
    verdicts = check.check(task(controller=controller, max_episode_steps=None))
    (verdict,) = [v for v in verdicts if v.name == "episodes end"]
    assert not verdict.good
    assert told in verdict.text


class Unseeded(Drift):
    def step(self, action):
        self.x += 0.1 * np.random.default_rng().normal()
        return super().step(action)


class Carried(Drift):
    wear = 0.0

    def step(self, action):
        self.wear += 0.01
        self.x += self.wear
        return super().step(action)


@pytest.mark.parametrize(
    ("env", "message"), [(Unseeded, "same seed differ"), (Carried, "earlier episode shows")]
)
def test_an_environment_whose_seed_does_not_decide_is_named(env, message):
    good, text = check.determinism(task(env))
    assert not good
    assert message in text


class Handle:
    """What deepcopy does not copy, like a handle of a C library."""

    def __init__(self):
        self.value = 0.0

    def __deepcopy__(self, memo):
        return self


class Shared(Drift):
    def reset(self, **options):
        self.handle = Handle()
        return super().reset(**options)

    def step(self, action):
        self.handle.value += 0.1
        self.x += self.handle.value
        return super().step(action)


def test_an_environment_that_is_made_twice_is_named():
    one = Drift()
    found = {verdict.name: verdict for verdict in check.check(task(lambda: one))}
    assert "returned the same Drift again" in found["seeded determinism"].text


def test_an_environment_that_cannot_be_restored_is_named():
    good, text = check.env_state(task(Shared))
    assert not good
    assert "deepcopy" in text


def test_a_function_with_hidden_state_is_named():
    seen = []

    def secretive(params, obs):
        seen.append(obs[0])
        return act(params, obs) + 0.01 * len(seen)

    assert not check.hidden_state(task(controller=secretive))[0]


class Vandal:
    """A batched controller that writes into its observation."""

    def init(self, n):
        return {}

    def act(self, params, obs, memory):
        obs *= 0.5
        return -params["k"][:, None] * obs + params["bias"][:, None], memory, {}


def test_a_controller_that_changes_its_observation_is_named():
    good, text = check.hidden_state(task(controller=Vandal()))
    assert not good
    assert "changes the observation" in text


def test_a_parameter_without_effect_is_named():
    good, text = check.dead_parameters(CountingTask())
    assert not good
    assert text.endswith("steps: b")


def test_a_slow_step_is_named(monkeypatch):
    def slow(params, obs):
        time.sleep(0.002)
        return act(params, obs)

    monkeypatch.setattr(environment, "SLOW", 0.001)
    assert not check.time_per_step(task(controller=slow))[0]


def test_what_raises_fails_its_check_and_the_others_go_on():
    class Broken(Drift):
        def step(self, action):
            raise KeyError("sensor")

    verdicts = list(check.check(task(Broken)))
    assert len(verdicts) == len(check.CHECKS)
    assert any("raised KeyError: 'sensor'" in v.text for v in verdicts)


def test_the_command_prints_a_line_each_and_says_by_its_code(capsys):
    assert main(["task=pid_acc"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(check.CHECKS)
    assert all(line.startswith("ok") for line in lines)
    assert main(["task=pidacc"]) == 1
    assert "did you mean 'pid_acc'" in capsys.readouterr().err


def test_the_command_fails_if_a_check_does(monkeypatch, capsys):
    monkeypatch.setattr("zoac.config.factory.build_task", lambda config: task(Unseeded))
    assert main(["task=pid_acc"]) == 1
    assert "FAIL seeded determinism" in capsys.readouterr().out
