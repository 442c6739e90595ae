"""Car following under the constant time headway policy, vectorised over environments.

State x = (clearance error dd [m], speed error dv [m/s], ego acceleration a_f [m/s^2]); eq. (11).
Observation (10): x_t, x_{t-1}, x_{t-2}, u_{t-1}. Action (1): increment of the desired
acceleration u [m/s^2].
"""

from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box

from zoac.envs.base import ArrayVecEnv, SingleEnv
from zoac.mpc.compiled import compiled

GAIN = 1.0  # K_L
TIME_CONSTANT = 0.45  # T_L [s]
HEADWAY = 2.5  # tau_h [s]
SAMPLE_TIME = 0.1  # T_s [s]
U_LOW, U_HIGH = -1.5, 0.6  # [m/s^2]
STEPS_PER_DRAW = 30  # the preceding car's acceleration holds for 3 s
MAX_CLEARANCE_ERROR = 5.0  # [m]
MAX_SPEED_ERROR = 1.0  # [m/s]
TERMINATION_COST = 1000.0

Jerk = Literal["rate", "increment", "commanded_increment"]

# Fig. 5: acceleration of the preceding car [m/s^2] up to and including a step.
DEMONSTRATION = (
    (90, 0.05), (120, 0.15), (150, -0.10), (180, 0.0), (210, -0.20), (240, 0.15), (270, 0.05),
)  # fmt: skip


class PidAccVecEnv(ArrayVecEnv):
    """n car-following episodes side by side; `gymnasium.make_vec("zoac/PidAcc-v0")`.

    Its options are those of the task `zoac.tasks.pid_acc.PidAcc`. A saturated u hides the cost of
    the first two kinds of `jerk`.
    """

    metadata = {**ArrayVecEnv.metadata, "render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        num_envs: int = 1,
        render_mode: str | None = None,
        preceding_std: float = 0.05,
        jerk: Jerk = "rate",
        max_episode_steps: int = 1000,
    ) -> None:
        super().__init__(
            num_envs,
            Box(-np.inf, np.inf, (10,), dtype=np.float64),
            Box(np.array([U_LOW]), np.array([U_HIGH]), dtype=np.float64),
            max_episode_steps,
            render_mode,
        )
        self._preceding_std = preceding_std
        self._jerk_weight = 0.1 / SAMPLE_TIME**2 if jerk == "rate" else 0.1
        self._commanded = jerk == "commanded_increment"
        # dd, dv, a_f at t, t-1 and t-2, then u_{t-1}: what is observed is all that lasts.
        self._history = np.zeros((num_envs, 10))
        draws = -(-max_episode_steps // STEPS_PER_DRAW)
        self._preceding = np.zeros((num_envs, draws * STEPS_PER_DRAW))
        self.arrays = {"history": self._history, "preceding": self._preceding}

    def _start(self, env_index: int, rng: np.random.Generator, demonstration: bool) -> None:
        self._history[env_index] = 0.0
        if demonstration:
            self._preceding[env_index] = demonstration_profile(self._preceding.shape[1])
            return
        draws = rng.normal(0.0, self._preceding_std, self._preceding.shape[1] // STEPS_PER_DRAW)
        self._preceding[env_index] = np.repeat(np.clip(draws, U_LOW, U_HIGH), STEPS_PER_DRAW)

    def _advance(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _advance_envs(
            self._history, self._preceding, self._steps, actions, self._jerk_weight, self._commanded
        )

    def _applied(self, actions: np.ndarray) -> np.ndarray:
        before = self._history[:, 9:]
        return np.clip(before + np.clip(actions, U_LOW, U_HIGH), U_LOW, U_HIGH) - before

    def _observe(self) -> np.ndarray:
        return self._history.copy()

    def _frame(self, env_index: int) -> np.ndarray:
        # Loads matplotlib, which tuning does not need.
        from zoac.tasks.pid_acc.figures import draw
        from zoac.tasks.rendering import frame

        return frame(lambda axes: draw(axes, self._history[env_index]))


@compiled()
def _advance_envs(
    history: np.ndarray,
    preceding: np.ndarray,
    steps: np.ndarray,
    actions: np.ndarray,
    jerk_weight: float,
    commanded: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Advance every environment by one step, in place; return cost (n,) and terminated (n,)."""
    n = history.shape[0]
    cost, terminated = np.empty(n), np.empty(n, dtype=np.bool_)
    for env_index in range(n):
        x = history[env_index]
        dd, dv, af, previous = x[0], x[1], x[2], x[9]
        # An environment past its time limit goes on with its last draw.
        w = preceding[env_index, min(steps[env_index], preceding.shape[1] - 1)]
        increment = min(max(actions[env_index, 0], U_LOW), U_HIGH)
        u = min(max(previous + increment, U_LOW), U_HIGH)
        du = increment if commanded else u - previous
        for k in range(8, 2, -1):
            x[k] = x[k - 3]
        # Forward Euler of eq. (11): all three from the values at t.
        x[0] = dd + SAMPLE_TIME * (dv - HEADWAY * af)
        x[1] = dv + SAMPLE_TIME * (w - af)
        x[2] = af + SAMPLE_TIME * ((GAIN * u - af) / TIME_CONSTANT)
        x[9] = u
        # Eq. (14), at the state after the step.
        dd, dv, af = x[0], x[1], x[2]
        driver = 0.25 * dv + 0.02 * dd - af
        r = 0.1 * dv * dv + 0.06 * dd * dd + u * u + jerk_weight * du * du + 0.5 * driver * driver
        over = abs(dd) > MAX_CLEARANCE_ERROR or abs(dv) > MAX_SPEED_ERROR
        cost[env_index] = r + TERMINATION_COST if over else r
        terminated[env_index] = over
    return cost, terminated


def demonstration_profile(steps: int) -> np.ndarray:
    """Return the preceding car's acceleration [m/s^2] of Fig. 5, shape (steps,)."""
    lasts, accelerations = zip(*DEMONSTRATION, strict=True)
    return np.array([*accelerations, 0.0])[np.searchsorted(lasts, np.arange(steps))]


def make_single(render_mode: str | None = None, **options: Any) -> SingleEnv:
    """Return one environment as a `gymnasium.Env`; `gymnasium.make("zoac/PidAcc-v0")`."""
    return SingleEnv(PidAccVecEnv(num_envs=1, render_mode=render_mode, **options))
