"""A ring road with two lanes of traffic and one car that is driven, vectorised over episodes.

The traffic of a lane keeps its gaps and moves at the lane's speed, which changes every 10 s.
Observation (8): own speed [m/s]; gap [m] and speed difference [m/s] to the car ahead in the own
lane, and ahead and behind in the other one (positive: it gets away); time since the last
change of lanes [s]. Action (2): acceleration [m/s^2]; change lanes where above 0.5.
"""

import numpy as np
from gymnasium.spaces import Box

from zoac.envs.base import ArrayVecEnv

SAMPLE_TIME = 0.2  # [s]
RING = 500.0  # [m]
CARS = 6  # in each lane
CAR = 5.0  # length [m]
WANTED = 28.0  # speed that the driver wants [m/s]
A_LOW, A_HIGH = -6.0, 2.0  # [m/s^2]
STEPS_PER_DRAW = 50  # a lane keeps its speed for 10 s
SPEEDS = (16.0, 26.0)  # of lanes [m/s]
CHANGE_COST = 0.5
COLLISION_COST = 500.0


class LaneChangeVecEnv(ArrayVecEnv):
    """n drives side by side."""

    def __init__(self, num_envs: int = 1, max_episode_steps: int = 300) -> None:
        """
        Args:
            num_envs: Number of drives n.
            max_episode_steps: Time limit, in steps of 0.2 s.
        """
        super().__init__(
            num_envs,
            Box(-np.inf, np.inf, (8,), dtype=np.float64),
            Box(np.array([A_LOW, 0.0]), np.array([A_HIGH, 1.0]), dtype=np.float64),
            max_episode_steps,
        )
        n = num_envs
        draws = -(-max_episode_steps // STEPS_PER_DRAW)
        self._v, self._road, self._waited = np.zeros(n), np.zeros(n, np.int64), np.zeros(n)
        self._ahead = np.zeros((n, 2, CARS))  # of each car, from 0 to RING [m]
        self._speeds = np.zeros((n, draws, 2))
        self._now = np.zeros((n, 2))  # speeds of the lanes
        self.arrays = {
            "v": self._v, "road": self._road, "waited": self._waited, "ahead": self._ahead,
            "speeds": self._speeds, "now": self._now,
        }  # fmt: skip
        self._row = np.arange(n)

    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        if demonstration:
            rng = np.random.default_rng(0)
        slots = np.arange(CARS) * RING / CARS + RING / (2 * CARS)
        jitter = rng.uniform(-0.25, 0.25, (2, CARS)) * RING / CARS
        self._ahead[env_index] = slots + jitter
        self._speeds[env_index] = rng.uniform(*SPEEDS, self._speeds[env_index].shape)
        self._now[env_index] = self._speeds[env_index, 0]
        self._road[env_index] = rng.integers(2)
        self._v[env_index] = self._now[env_index, self._road[env_index]]
        self._waited[env_index] = 10.0

    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a = np.clip(actions[:, 0], A_LOW, A_HIGH)
        change = actions[:, 1] > 0.5
        self._road[:] = np.where(change, 1 - self._road, self._road)
        self._waited[:] = np.where(change, 0.0, self._waited + SAMPLE_TIME)
        self._v[:] = np.maximum(self._v + SAMPLE_TIME * a, 0.0)
        # An environment past its time limit goes on with its last draw.
        draw = np.minimum(self._steps // STEPS_PER_DRAW, self._speeds.shape[1] - 1)
        self._now[:] = self._speeds[self._row, draw]
        moved = SAMPLE_TIME * (self._now - self._v[:, None])
        self._ahead[:] = (self._ahead + moved[:, :, None]) % RING
        own = self._ahead[self._row, self._road]
        collided = (own.min(axis=1) < CAR) | (own.max(axis=1) > RING - CAR)
        cost = ((WANTED - self._v) / 10.0) ** 2 + 0.05 * a * a + CHANGE_COST * change
        return cost + COLLISION_COST * collided, collided

    def _applied(self, actions: np.ndarray) -> np.ndarray:
        applied = super()._applied(actions)
        applied[:, 1] = actions[:, 1] > 0.5
        return applied

    def _observe(self) -> np.ndarray:
        own, other = self._ahead[self._row, self._road], self._ahead[self._row, 1 - self._road]
        speed, next_speed = self._now[self._row, self._road], self._now[self._row, 1 - self._road]
        return np.stack(
            [
                self._v,
                own.min(axis=1) - CAR,
                speed - self._v,
                other.min(axis=1) - CAR,
                next_speed - self._v,
                RING - other.max(axis=1) - CAR,
                self._v - next_speed,
                self._waited,
            ],
            axis=1,
        )
