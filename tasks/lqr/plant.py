"""A double integrator with quadratic cost, vectorised over environments.

x = (position [m], speed [m/s]), x' = A x + B u + w with u [m/s^2] and w ~ N(0, I noise^2) at every
step; cost x'Q x + u'R u at the state before the step. Observation (2): x. Action (1): u.
"""

import numpy as np
from gymnasium.spaces import Box
from scipy.linalg import solve_discrete_are

from zoac.envs.base import ArrayVecEnv

SAMPLE_TIME = 0.1  # [s]
A = np.array([[1.0, SAMPLE_TIME], [0.0, 1.0]])
B = np.array([[0.5 * SAMPLE_TIME**2], [SAMPLE_TIME]])
Q = np.diag([1.0, 0.1])
R = np.array([[0.1]])
DIVERGED = 1e3
"""Size of a state component beyond which an episode ends."""
TERMINATION_COST = 1e4


def optimal_gain(weights: np.ndarray = Q) -> np.ndarray:
    """Return the gain K (2,) of u = -K x that is optimal for state weights (2, 2) and no end."""
    p = solve_discrete_are(A, B, weights, R)
    return np.linalg.solve(R + B.T @ p @ B, B.T @ p @ A)[0]


class LqrVecEnv(ArrayVecEnv):
    """n double integrators side by side; options as of the task `zoac.tasks.lqr.Lqr`."""

    def __init__(
        self, num_envs: int = 1, noise: float = 0.02, max_episode_steps: int = 200
    ) -> None:
        super().__init__(
            num_envs,
            Box(-np.inf, np.inf, (2,), dtype=np.float64),
            Box(-np.inf, np.inf, (1,), dtype=np.float64),
            max_episode_steps,
        )
        self._noise = noise
        self._x = np.zeros((num_envs, 2))
        self._w = np.zeros((num_envs, max_episode_steps, 2))
        self.arrays = {"x": self._x, "w": self._w}

    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        self._x[env_index] = (1.0, 0.0) if demonstration else rng.uniform(-1.0, 1.0, 2)
        self._w[env_index] = (
            0.0 if demonstration else rng.normal(0.0, self._noise, self._w[env_index].shape)
        )

    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # Written out, because the bits of a matrix product depend on the other environments.
        x, v, u = self._x[:, 0].copy(), self._x[:, 1].copy(), actions[:, 0]
        cost = Q[0, 0] * x * x + Q[1, 1] * v * v + R[0, 0] * u * u
        # An environment past its time limit goes on with its last draw.
        steps = np.minimum(self._steps, self._w.shape[1] - 1)
        w = self._w[np.arange(self.num_envs), steps]
        self._x[:, 0] = x + A[0, 1] * v + B[0, 0] * u + w[:, 0]
        self._x[:, 1] = v + B[1, 0] * u + w[:, 1]
        diverged = np.abs(self._x).max(axis=1) > DIVERGED
        return cost + np.where(diverged, TERMINATION_COST, 0.0), diverged

    def _observe(self) -> np.ndarray:
        return self._x.copy()
