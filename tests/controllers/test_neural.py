"""Policies fit their environment."""

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, MultiBinary

import zoac
from tests.envs.test_adapters import Drift
from zoac.controllers.neural import linear, neural
from zoac.core.errors import ConfigError


def test_a_linear_policy_is_linear_before_the_bounds():
    act, space = linear("Pendulum-v1")
    assert list(space) == ["weight_0_0", "weight_0_1", "weight_0_2", "bias_0_0"]
    params = {name: 0.01 * (k + 1) for k, name in enumerate(space)}
    weights = np.array(list(params.values()))
    obs = np.array([0.5, -0.5, 4.0])
    u = weights[:3] @ (obs / [1.0, 1.0, 8.0]) / np.sqrt(3) + weights[3]
    assert act(params, obs) == pytest.approx(2.0 * np.tanh(u))


def test_a_neural_policy_has_a_layer_between():
    act, space = neural("Pendulum-v1", hidden=5)
    assert len(space) == 5 * 3 + 5 + 5 + 1
    params = dict.fromkeys(space, 0.5)
    layer = np.tanh(0.5 * np.ones((5, 3)) @ np.array([1.0, 0.0, 0.0]) / np.sqrt(3) + 0.5)
    expected = 2.0 * np.tanh(0.5 * layer.sum() / np.sqrt(5) + 0.5)
    assert act(params, np.array([1.0, 0.0, 0.0])) == pytest.approx(expected)


@pytest.mark.parametrize("name", ["CartPole-v1", "Acrobot-v1", "MountainCarContinuous-v0"])
def test_actions_are_the_environments(name):
    act, space = neural(name, hidden=3)
    rng, env = np.random.default_rng(0), gymnasium.make(name)
    obs, _ = env.reset(seed=0)
    for _ in range(5):
        action = act({k: rng.uniform(*bounds) for k, bounds in space.items()}, obs)
        discrete = isinstance(env.action_space, gymnasium.spaces.Discrete)
        given = int(action[0]) if discrete else action.astype(np.float32)
        assert env.action_space.contains(given)
        obs, *_ = env.step(given)


def test_it_is_tuned_like_any_controller():
    act, space = linear(Drift)
    result = zoac.tune(env=Drift, controller=act, space=space, tuner="random", budget=800,
                       num_envs=4,
                       max_episode_steps=20, episodes=1, final_episodes=2, quiet=True)  # fmt: skip
    assert result.parameters["weight_0_0"] < 0.0  # it pushes back


def test_other_spaces_are_refused():
    class Odd(Drift):
        action_space = MultiBinary(2)

    with pytest.raises(ConfigError, match="Box or Discrete of actions"):
        linear(Odd)


def test_observations_are_normalised_by_what_random_actions_show():
    env = gymnasium.make("Pendulum-v1")
    env.action_space.seed(0)
    seen = []
    for seed in range(2):
        seen.append(env.reset(seed=seed)[0])
        over = False
        while not over:
            obs, _, terminated, truncated, _ = env.step(env.action_space.sample())
            seen.append(obs)
            over = terminated or truncated
    mean, std = np.mean(seen, axis=0), np.std(seen, axis=0)
    act, space = linear("Pendulum-v1", random_episodes=2)
    params = dict.fromkeys(space, 0.0) | {"weight_0_2": 0.3}
    for deviations in (-2.0, 0.0, 1.0):
        expected = 2.0 * np.tanh(0.3 * deviations / np.sqrt(3))
        assert act(params, mean + deviations * std) == pytest.approx(expected, abs=1e-5)


def test_a_number_that_stays_the_same_is_not_divided_by_zero():
    class Still(Drift):
        observation_space = Box(-np.inf, np.inf, (2,), np.float64)

        def reset(self, **options):
            return np.append(super().reset(**options)[0], 7.0), {}

        def step(self, action):
            obs, *rest = super().step(action)
            return np.append(obs, 7.0), *rest

    act, space = linear(Still, random_episodes=1)
    assert act(dict.fromkeys(space, 0.0) | {"weight_0_1": 1.0}, np.array([0.0, 7.0])) == 0.0
