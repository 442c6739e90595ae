"""A plant and a controller of one's own: a cart moves to its goal, and must keep requirements.

python examples/cart.py
"""

import gymnasium as gym
import numpy as np

import zoac
from zoac import specs


class Cart(gym.Env):
    """A cart moves to x = 1 m under a force of at most 5 N; its mass differs by episode."""

    dt = 0.05  # [s] of a step
    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,))
    action_space = gym.spaces.Box(-5.0, 5.0, (1,))

    def reset(self, *, seed=None, options=None):
        """Begin an episode at rest in x = 0; `self.np_random` is made from the seed."""
        super().reset(seed=seed)
        self.state, self.mass = np.zeros(2), self.np_random.uniform(0.8, 1.2)
        return self.state.copy(), {}

    def step(self, action):
        """Return observation, reward, terminated, truncated and info."""
        x, v = self.state
        acceleration = (float(action[0]) - 0.5 * v) / self.mass
        self.state = np.array([x + self.dt * v, v + self.dt * acceleration])
        return self.state.copy(), -((1.0 - x) ** 2), False, False, {}


def pd(params, obs):
    """Return the force [N]."""
    return params["kp"] * (1.0 - obs[0]) - params["kd"] * obs[1]


result = zoac.tune(
    env=Cart,
    controller=pd,
    space={
        "kp": {"low": 0, "high": 20, "unit": "N/m", "baseline": 4.0},
        "kd": {"low": 0, "high": 20, "unit": "N s/m", "baseline": 1.0},
    },
    signals={"x": zoac.observation(0, unit="m"), "goal": 1.0, "u": zoac.action(0, unit="N")},
    specs=[
        specs.overshoot("x", "goal", max=0.05),
        specs.settling_time("x", "goal", max=2.5),
    ],
    max_episode_steps=100,
    budget=60_000,
)
print(result)
result.plot("cart.png")  # the responses before and after, with the limits
