"""Gymnasium's Pendulum-v1, vectorised over environments, with a mass and a length that can be set.

Observation (3): cos, sin of the angle from upright, angular velocity [rad/s]. Action (1): torque
[N m]. Cost: angle^2 + 0.1 velocity^2 + 0.001 torque^2, at the state before the step.
"""

import numpy as np
from gymnasium.spaces import Box

from zoac.envs.base import ArrayVecEnv

GRAVITY = 10.0  # [m/s^2]
SAMPLE_TIME = 0.05  # [s]
MAX_TORQUE = 2.0  # [N m]
MAX_SPEED = 8.0  # [rad/s]


class PendulumVecEnv(ArrayVecEnv):
    """n pendulums side by side; options as of the task `zoac.tasks.pendulum.Pendulum`."""

    def __init__(
        self,
        num_envs: int = 1,
        mass: float = 1.0,
        length: float = 1.0,
        max_episode_steps: int = 200,
    ) -> None:
        bounds = np.array([1.0, 1.0, MAX_SPEED])
        super().__init__(
            num_envs,
            Box(-bounds, bounds, dtype=np.float64),
            Box(-MAX_TORQUE, MAX_TORQUE, (1,), dtype=np.float64),
            max_episode_steps,
        )
        self._pull = 1.5 * GRAVITY / length
        self._push = 3.0 / (mass * length**2)
        self._angle, self._speed = np.zeros(num_envs), np.zeros(num_envs)
        self.arrays = {"angle": self._angle, "speed": self._speed}

    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        hanging = (np.pi, 0.0)
        drawn = hanging if demonstration else rng.uniform((-np.pi, -1.0), (np.pi, 1.0))
        self._angle[env_index], self._speed[env_index] = drawn

    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        torque = np.clip(actions[:, 0], -MAX_TORQUE, MAX_TORQUE)
        angle = (self._angle + np.pi) % (2 * np.pi) - np.pi
        cost = angle**2 + 0.1 * self._speed**2 + 0.001 * torque**2
        acceleration = self._pull * np.sin(self._angle) + self._push * torque
        self._speed[:] = np.clip(self._speed + SAMPLE_TIME * acceleration, -MAX_SPEED, MAX_SPEED)
        self._angle += SAMPLE_TIME * self._speed
        return cost, np.zeros(self.num_envs, dtype=bool)

    def _observe(self) -> np.ndarray:
        return np.stack([np.cos(self._angle), np.sin(self._angle), self._speed], axis=1)
