"""The vehicle on its path, vectorised over environments.

Observation (81): the state X_t, then N_p = 25 points (x_r, y_r, phi_r) of the path ahead.
Action (2): front wheel angle delta [rad] and acceleration a [m/s^2].
"""

import math
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from zoac.envs.base import ArrayVecEnv, SingleEnv
from zoac.mpc.compiled import compiled
from zoac.tasks.mpc_tracking import path
from zoac.tasks.mpc_tracking.vehicle import INPUT_HIGH, INPUT_LOW, TRUE_PARAMETERS, advance, six

MAX_LATERAL_ERROR = 4.0  # [m]
MAX_HEADING_ERROR = math.pi / 4  # [rad]
MAX_SPEED_ERROR = 4.0  # [m/s]
TERMINATION_COST = 1000.0


class MpcTrackingVecEnv(ArrayVecEnv):
    """n vehicles side by side; `gymnasium.make_vec("zoac/MpcTracking-v0")`."""

    metadata = {**ArrayVecEnv.metadata, "render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        horizon: int = 25,
        max_episode_steps: int = 200,
    ) -> None:
        """
        Args:
            num_envs: Number of environments n.
            render_mode: None or "rgb_array".
            horizon: Number of path points in the observation, N_p.
            max_episode_steps: Time limit.
        """
        self._observation_size = 6 + 3 * horizon
        super().__init__(
            num_envs,
            Box(-np.inf, np.inf, (self._observation_size,), dtype=np.float64),
            Box(INPUT_LOW, INPUT_HIGH, dtype=np.float64),
            max_episode_steps,
            render_mode,
        )
        self.arrays = {"state": np.zeros((num_envs, 6)), "input": np.zeros((num_envs, 2))}
        self.arrays["state"][:, 3] = path.SPEED  # an environment not yet begun can stand in a step

    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        start = demonstration_start() if demonstration else random_start(rng)
        self.arrays["state"][env_index] = start
        self.arrays["input"][env_index] = 0.0

    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cost = np.empty(self.num_envs)
        terminated = np.empty(self.num_envs, dtype=np.bool_)
        # A steering or an engine saturates: what goes beyond the bounds is not applied.
        applied = np.asarray(actions, dtype=np.float64).clip(INPUT_LOW, INPUT_HIGH)
        self.arrays["input"][:] = applied
        _advance_envs(self.arrays["state"], applied, cost, terminated)
        return cost, terminated

    def _observe(self) -> np.ndarray:
        observations = np.empty((self.num_envs, self._observation_size))
        _observe_envs(self.arrays["state"], observations)
        return observations

    def _frame(self, env_index: int) -> np.ndarray:
        # Loads matplotlib, which tuning does not need.
        from zoac.tasks.mpc_tracking.figures import draw
        from zoac.tasks.rendering import frame

        states, steering = self.arrays["state"][env_index][None], self.arrays["input"][env_index, 0]
        return frame(lambda axes: draw(axes, states, float(steering)))


def random_start(rng: np.random.Generator) -> np.ndarray:
    """Return the state (6,) at the beginning of an episode."""
    x = rng.uniform(0.0, 100.0)
    y = path.lateral(x) + np.clip(rng.normal(0.0, 0.2), -0.5, 0.5)
    phi = path.heading(x) + np.clip(rng.normal(0.0, 0.05), -0.1, 0.1)
    u = rng.uniform(17.5, 18.5)
    v = u * math.tan(np.clip(rng.normal(0.0, 0.05), -0.1, 0.1))
    omega = np.clip(rng.normal(0.0, 0.05), -0.1, 0.1)
    return np.array([x, y, phi, u, v, omega])


def demonstration_start() -> np.ndarray:
    """Return the state (6,) from which Fig. 6 is drawn."""
    x, u = 8.0, 17.6
    y, phi = path.lateral(x) + 0.25, path.heading(x) + 0.04
    return np.array([x, y, phi, u, u * math.tan(0.03), 0.05])


@compiled(error_model="numpy")
def _advance_envs(
    states: np.ndarray, actions: np.ndarray, cost: np.ndarray, terminated: np.ndarray
) -> None:
    for env_index in range(len(states)):
        delta, a = actions[env_index, 0], actions[env_index, 1]
        after = advance(TRUE_PARAMETERS, six(states[env_index]), delta, a)
        for i in range(6):
            states[env_index, i] = after[i]
        x, y, phi, u, _, omega = after
        off, turned, faster = y - path.lateral(x), phi - path.heading(x), u - path.SPEED
        # The paper's r, at the state after the step.
        cost[env_index] = (
            faster * faster
            + 4.0 * (off * off)
            + 10.0 * (turned * turned)
            + 2.0 * (omega * omega)
            + 500.0 * (delta * delta)
            + 5.0 * (a * a)
        )
        terminated[env_index] = not (  # so that a state that is not a number ends the episode
            abs(off) <= MAX_LATERAL_ERROR
            and abs(turned) <= MAX_HEADING_ERROR
            and abs(faster) <= MAX_SPEED_ERROR
        )
        if terminated[env_index]:
            cost[env_index] += TERMINATION_COST


@compiled(error_model="numpy")
def _observe_envs(states: np.ndarray, observations: np.ndarray) -> None:
    for env_index in range(len(states)):
        observations[env_index, :6] = states[env_index]
        path.preview(states[env_index, 0], observations[env_index, 6:])


def make_single(render_mode: str | None = None, **options: Any) -> SingleEnv:
    """Return one environment as a `gymnasium.Env`; `gymnasium.make("zoac/MpcTracking-v0")`."""
    return SingleEnv(MpcTrackingVecEnv(num_envs=1, render_mode=render_mode, **options))
