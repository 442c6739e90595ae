"""A first-order plant whose step response, and so every spec, is known in closed form."""

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box

import zoac


class FirstOrder(Env):
    """y' = (u - y) / T, sampled exactly every `dt` = 0.05 s; an episode is 2 s, or ends early."""

    dt = 0.05

    def __init__(self, steps=40, ends_after=None, terminates=False):
        self.observation_space = Box(-np.inf, np.inf, (1,), np.float64)
        self.action_space = Box(-np.inf, np.inf, (1,), np.float64)
        self.steps, self.ends_after, self.terminates = steps, ends_after, terminates

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.y, self.t = 0.0, 0
        return np.array([self.y]), {}

    def step(self, action):
        decay = np.exp(-0.05)
        self.y = decay * self.y + (1 - decay) * float(action[0])
        self.t += 1
        over = self.t >= self.steps
        early = self.ends_after is not None and self.t >= self.ends_after
        terminated = early or (over and self.terminates)
        return np.array([self.y]), 0.0, terminated, over and not terminated, {}


def proportional(params, obs):
    return [params["k"] * (1.0 - obs[0])]


SIGNALS = {"y": zoac.observation(0, unit="m"), "r": 1.0, "u": zoac.action(0)}


def tuned(**options):
    """Tune the gain; by default the error must be below 0.2, which needs k > 4, and u small."""
    given = {
        "env": FirstOrder, "controller": proportional,
        "space": {"k": {"low": 0.5, "high": 12.0, "baseline": 1.0}}, "tuner": "random",
        "budget": 1200, "eval_every": 1200, "num_envs": 2, "signals": SIGNALS,
        "max_episode_steps": 40,
        "specs": [zoac.specs.steady_state_error("y", "r", max=0.2)],
        "objective": zoac.specs.peak("u"), "episodes": 3, "final_episodes": 4, "quiet": True,
    }  # fmt: skip
    return zoac.tune(**{**given, **options})


class Short(FirstOrder):
    """The same, but every episode ends early."""

    def __init__(self):
        super().__init__(ends_after=7)


class Diverging(FirstOrder):
    """The same, but an episode ends where |y| > 50."""

    def step(self, action):
        observation, reward, _, truncated, info = super().step(action)
        diverged = abs(self.y) > 50
        return observation, reward, diverged, truncated and not diverged, info
