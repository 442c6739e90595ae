"""A plant that runs away: its numbers leave float32, and nothing of them reaches the answer."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box

import zoac
from tests.runs.test_schema import strict
from zoac.runs.schema import METRICS, RESULT, RUN


class RunsAway(gym.Env):
    """x grows by a fifth a step; with a gain far off it passes 1e20, or more, within an episode."""

    observation_space = action_space = Box(-np.inf, np.inf, (1,), np.float64)

    def __init__(self, growth: float = 1.2) -> None:
        self.growth, self.x = growth, 1.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = 1.0
        return np.array([self.x]), {}

    def step(self, action):
        self.x = self.growth * self.x + 0.5 * float(action[0])
        return np.array([self.x]), -(self.x**2), False, False, {}


@pytest.mark.parametrize(
    ("tuner", "penalty"), [("zoac", None), ("zoac", 1e6), ("zoac_plus", 1e6), ("es", None)]
)
def test_no_parameter_is_lost_and_every_file_is_json(tuner, penalty, tmp_path):
    result = zoac.tune(
        env=RunsAway, controller=lambda p, o: -p["k"] * o, space={"k": (-5.0, 15.0)},
        tuner=tuner, budget=900, max_episode_steps=60, failure_penalty=penalty, quiet=True,
        folder=tmp_path / "run", episodes=2, final_episodes=2, num_envs=4,
    )  # fmt: skip
    assert -5.0 <= result.parameters["k"] <= 15.0
    for name in (RUN, RESULT):
        strict((tmp_path / "run" / name).read_text())
    for line in (tmp_path / "run" / METRICS).read_text().splitlines():
        strict(line)
    header = result.export(tmp_path / "gains.h").read_text()
    assert "nan" not in header
