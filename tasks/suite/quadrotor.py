"""A quadrotor that follows a Lissajous curve in wind: RotorPy's AscTec Hummingbird.

Equations of motion, numbers and controller (Mellinger and Kumar, ICRA 2011) are those of RotorPy
3.0 (Folk, Paulos and Kumar, 2023). So are the weights of the cost, from its `hover_reward`.
"""

from typing import Any

import gymnasium as gym
import numpy as np

from zoac.mpc.compiled import compiled

SAMPLE_TIME, STEPS, SUBSTEPS = 0.01, 200, 4  # [s]
SPACE = {
    "kp_xy": (0.5, 50.0, "log"), "kp_z": (0.5, 50.0, "log"), "kd_xy": (0.5, 50.0, "log"),
    "kd_z": (0.5, 50.0, "log"), "kp_att": (10.0, 3000.0, "log"), "kd_att": (2.0, 200.0, "log"),
}  # fmt: skip
MAX_DISTANCE = 5.0
"""Farther from the curve [m] an episode ends, and each step that is left costs this much."""

GRAVITY, MASS = 9.81, 0.5  # [m/s^2], [kg]
INERTIA = np.array([3.65e-3, 3.68e-3, 7.03e-3])  # [kg m^2]
ARM = 0.17 * np.sqrt(0.5)  # a rotor's distance from each axis [m]
ROTORS = ARM * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
SPIN = np.array([1.0, -1.0, 1.0, -1.0])
LIFT, TORQUE = 5.57e-6, 1.36e-7  # [N s^2], [N m s^2]
ROTOR_DRAG = np.array([1.19e-4, 1.19e-4, 2.32e-4])  # [kg/rad]
TRANSLATIONAL_LIFT = 3.39e-3  # [kg/m]
DRAG = np.array([0.5e-2, 0.5e-2, 1e-2])  # [kg/m]
MOTOR_LAG, MAX_SPEED = 0.005, 1500.0  # [s], [rad/s]
HOVER = np.sqrt(MASS * GRAVITY / (4 * LIFT))  # [rad/s]
MIXER = np.vstack([np.ones(4), ROTORS[:, 1], -ROTORS[:, 0], TORQUE / LIFT * SPIN])
"""Thrust and moments (4) of four rotors' forces (4)."""
UNMIXER = np.linalg.inv(MIXER)


@compiled()
def _rotation(q: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) from body to world of a unit quaternion (i, j, k, w)."""
    i, j, k, w = q
    return np.array(
        [
            [1 - 2 * (j * j + k * k), 2 * (i * j - k * w), 2 * (i * k + j * w)],
            [2 * (i * j + k * w), 1 - 2 * (i * i + k * k), 2 * (j * k - i * w)],
            [2 * (i * k - j * w), 2 * (j * k + i * w), 1 - 2 * (i * i + j * j)],
        ]
    )


@compiled()
def rates(state: np.ndarray, command: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """Return the derivative (17,) of position, velocity, quaternion, body rates, rotor speeds.

    Args:
        state: (17,), in SI units.
        command: Speeds of the rotors (4,) [rad/s].
        wind: (3,) [m/s].
    """
    v, q, w, speeds = state[3:6], state[6:10], state[10:13], state[13:17]
    turn = _rotation(q / np.sqrt((q * q).sum()))
    air = turn.T @ (v - wind)
    force = -np.sqrt((air * air).sum()) * DRAG * air
    moment = np.zeros(3)
    for r in range(4):
        arm = np.array([ROTORS[r, 0], ROTORS[r, 1], 0.0])
        local = air + np.cross(w, arm)
        pull = -speeds[r] * ROTOR_DRAG * local
        pull[2] += LIFT * speeds[r] ** 2 + TRANSLATIONAL_LIFT * (local[0] ** 2 + local[1] ** 2)
        force += pull
        moment += np.cross(arm, pull)
        moment[2] += SPIN[r] * TORQUE * speeds[r] ** 2
    out = np.empty(17)
    out[0:3] = v
    out[3:6] = turn @ force / MASS
    out[5] -= GRAVITY
    out[6:9] = 0.5 * (q[3] * w + np.cross(q[:3], w))
    out[9] = -0.5 * (q[:3] * w).sum()
    out[10:13] = (moment - np.cross(w, INERTIA * w)) / INERTIA
    out[13:17] = (command - speeds) / MOTOR_LAG
    return out


@compiled()
def advanced(state: np.ndarray, command: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """Return the state (17,) a sample later, by the classical Runge-Kutta method."""
    h = SAMPLE_TIME / SUBSTEPS
    for _ in range(SUBSTEPS):
        a = rates(state, command, wind)
        b = rates(state + h / 2 * a, command, wind)
        c = rates(state + h / 2 * b, command, wind)
        d = rates(state + h * c, command, wind)
        state = state + h / 6 * (a + 2 * b + 2 * c + d)
        state[6:10] /= np.sqrt((state[6:10] ** 2).sum())
    return state


@compiled()
def rotor_speeds(gains: np.ndarray, state: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return what the controller commands (4,) [rad/s].

    Args:
        gains: (6,), in the order of `SPACE`.
        state: (17,).
        reference: Position, velocity and acceleration (9,); the heading is 0.
    """
    kp = np.array([gains[0], gains[0], gains[1]])
    kd = np.array([gains[2], gains[2], gains[3]])
    x, v, w = state[0:3], state[3:6], state[10:13]
    wanted = reference[6:9] - kp * (x - reference[0:3]) - kd * (v - reference[3:6])
    wanted = MASS * (wanted + np.array([0.0, 0.0, GRAVITY]))
    turn = _rotation(state[6:10])
    up = wanted / np.sqrt((wanted * wanted).sum())
    left = np.cross(up, np.array([1.0, 0.0, 0.0]))
    left /= np.sqrt((left * left).sum())
    ahead = np.cross(left, up)
    goal = np.stack((ahead, left, up)).T
    skew = 0.5 * (goal.T @ turn - turn.T @ goal)
    tilt = np.array([-skew[1, 2], skew[0, 2], -skew[0, 1]])
    moment = INERTIA * (-gains[4] * tilt - gains[5] * w) + np.cross(w, INERTIA * w)
    squares = UNMIXER @ np.append((wanted * turn[:, 2]).sum(), moment) / LIFT
    return np.sign(squares) * np.sqrt(np.abs(squares))


class Quadrotor(gym.Env):
    """Observation: the state (17), then the curve's position, velocity and acceleration (9).

    Action: the commanded speeds of the rotors (4,) [rad/s]. Every episode draws the curve, the
    start and a constant wind [m/s].
    """

    observation_space = gym.spaces.Box(-np.inf, np.inf, (26,), np.float64)
    action_space = gym.spaces.Box(0.0, MAX_SPEED, (4,), np.float64)
    metadata = {"sample_time": SAMPLE_TIME}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Hover beside the curve, half a metre or less in each direction."""
        super().reset(seed=seed)
        rng = self.np_random
        self._size, self._rate = rng.uniform(0.5, 1.5, 2), rng.uniform(1.0, 3.0, 2)
        self._phase = np.array([rng.uniform(-np.pi, np.pi), 0.0])
        self._wind = rng.normal(0.0, 1.0, 3)
        self._count = 0
        self._follow()
        self._state = np.zeros(17)
        self._state[0:3] = self._reference[0:3] + rng.uniform(-0.5, 0.5, 3)
        self._state[9], self._state[13:17] = 1.0, HOVER
        return self._observed(), {}

    def _follow(self) -> None:
        """Put the reference where the curve is now."""
        angle = self._rate * self._count * SAMPLE_TIME + self._phase
        sine, cosine = self._size * np.sin(angle), self._size * np.cos(angle)
        parts = (sine, self._rate * cosine, -(self._rate**2) * sine)
        self._reference = np.concatenate([np.append(part, 0.0) for part in parts])

    def _observed(self) -> np.ndarray:
        return np.concatenate([self._state, self._reference])

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one sample; the cost is ||e|| + 0.1 ||e'|| + 1e-5 ||u|| before it."""
        error = np.linalg.norm(self._state[0:3] - self._reference[0:3])
        slip = np.linalg.norm(self._state[3:6] - self._reference[3:6])
        cost = float(error + 0.1 * slip + 1e-5 * np.linalg.norm(action))
        self._state = advanced(self._state, np.asarray(action, np.float64), self._wind)
        self._count += 1
        self._follow()
        lost = bool(error > MAX_DISTANCE)
        if lost:
            cost += MAX_DISTANCE * (STEPS - self._count)
        return self._observed(), -cost, lost, False, {}


def fly(p: dict[str, float], s: np.ndarray) -> np.ndarray:
    """Return the rotors' speeds (4,) [rad/s] for an observation (26,) by the gains `p`."""
    return rotor_speeds(np.array([p[name] for name in SPACE]), s[:17], s[17:])
