"""The numerically stable bicycle model of the paper and its Jacobians.

State X = (x, y, phi, u, v, omega) [m, m, rad, m/s, m/s, rad/s], input U = (delta, a)
[rad, m/s^2], model parameters theta = (I_z, k_f, k_r, l_f, l_r, m)
[kg m^2, N/rad, N/rad, m, m, kg].

Every environment is computed by itself in scalar loops: no library call spans environments, so an
environment's bits do not depend on its neighbours.
"""

import math
from types import FunctionType
from typing import Any

import numpy as np

from zoac.mpc.compiled import compiled
from zoac.mpc.problem import Sparsity
from zoac.tasks.mpc_tracking.path import STEP

State = tuple[float, float, float, float, float, float]
Theta = tuple[float, float, float, float, float, float]

STATES = ("x", "y", "phi", "u", "v", "omega")
INPUTS = ("delta", "a")
INPUT_HIGH = np.array([2 * math.pi / 15, 3.0])
INPUT_LOW = -INPUT_HIGH
TRUE_PARAMETERS: Theta = (1536.7, -128916.0, -85944.0, 1.06, 1.85, 1412.0)
"""I_z, k_f, k_r, l_f, l_r, m of the plant (Table I)."""


@compiled(error_model="numpy")
def advance(theta: Theta, state: State, delta: float, a: float) -> State:
    """Return F_theta(state, (delta, a)): the paper's predictive model."""
    inertia, k_f, k_r, l_f, l_r, m = theta
    x, y, phi, u, v, omega = state
    cos, sin = math.cos(phi), math.sin(phi)
    moment = l_f * k_f - l_r * k_r
    lateral = (
        m * u * v + STEP * moment * omega - STEP * k_f * delta * u - STEP * m * u * u * omega
    ) / (m * u - STEP * (k_f + k_r))
    yaw = (inertia * u * omega + STEP * moment * v - STEP * l_f * k_f * delta * u) / (
        inertia * u - STEP * (l_f * l_f * k_f + l_r * l_r * k_r)
    )
    return (
        x + STEP * (u * cos - v * sin),
        y + STEP * (v * cos + u * sin),
        phi + STEP * omega,
        u + STEP * a,
        lateral,
        yaw,
    )


@compiled(error_model="numpy")
def write_jacobians(
    theta: Theta, state: State, delta: float, after: State, a: np.ndarray, b: np.ndarray
) -> None:
    """Write dF/dX (6, 6) into `a` and dF/dU (6, 2) into `b`; `after` is F at the same point.

    Entries that are always zero (`BicycleModel.sparsity`) are left as they are.
    """
    inertia, k_f, k_r, l_f, l_r, m = theta
    _, _, phi, u, v, omega = state
    _, _, _, _, v_after, omega_after = after
    cos, sin = math.cos(phi), math.sin(phi)
    moment = l_f * k_f - l_r * k_r
    a[0, 0] = 1.0
    a[0, 2] = -STEP * (u * sin + v * cos)
    a[0, 3] = STEP * cos
    a[0, 4] = -STEP * sin
    a[1, 1] = 1.0
    a[1, 2] = STEP * (u * cos - v * sin)
    a[1, 3] = STEP * sin
    a[1, 4] = STEP * cos
    a[2, 2] = 1.0
    a[2, 5] = STEP
    a[3, 3] = 1.0
    b[3, 1] = STEP
    # The last two rows are quotients p/q: (p/q)' = (p' - (p/q) q') / q.
    q = m * u - STEP * (k_f + k_r)
    a[4, 3] = (m * v - STEP * k_f * delta - 2.0 * STEP * m * u * omega - v_after * m) / q
    a[4, 4] = m * u / q
    a[4, 5] = STEP * (moment - m * u * u) / q
    b[4, 0] = -STEP * k_f * u / q
    q = inertia * u - STEP * (l_f * l_f * k_f + l_r * l_r * k_r)
    a[5, 3] = (inertia * omega - STEP * l_f * k_f * delta - omega_after * inertia) / q
    a[5, 4] = STEP * moment / q
    a[5, 5] = inertia * u / q
    b[5, 0] = -STEP * l_f * k_f * u / q


@compiled(error_model="numpy")
def six(values: np.ndarray) -> State:
    """Return the entries of an array (6,) as a tuple: numbers, not a view, inside the loops."""
    return (values[0], values[1], values[2], values[3], values[4], values[5])


@compiled(error_model="numpy")
def _roll_out_and_linearise(
    theta: np.ndarray, inputs: np.ndarray, states: np.ndarray, a: np.ndarray, b: np.ndarray
) -> None:
    for env_index in range(len(inputs)):
        model = six(theta[env_index])
        state = six(states[env_index, 0])
        for k in range(inputs.shape[1]):
            delta = inputs[env_index, k, 0]
            after = advance(model, state, delta, inputs[env_index, k, 1])
            write_jacobians(model, state, delta, after, a[env_index, k], b[env_index, k])
            for i in range(6):
                states[env_index, k + 1, i] = after[i]
            state = after


class BicycleModel:
    """The predictive model of n environments, each with its own parameters theta."""

    states = STATES
    inputs = INPUTS
    parameters = dict(zip(("I_z", "k_f", "k_r", "l_f", "l_r", "m"), TRUE_PARAMETERS, strict=True))
    input_low = INPUT_LOW
    input_high = INPUT_HIGH
    sparsity = Sparsity(
        a=np.array(
            [
                [1, 0, 1, 1, 1, 0],
                [0, 1, 1, 1, 1, 0],
                [0, 0, 1, 0, 0, 1],
                [0, 0, 0, 1, 0, 0],
                [0, 0, 0, 1, 1, 1],
                [0, 0, 0, 1, 1, 1],
            ],
            dtype=bool,
        ),
        b=np.array([[0, 0], [0, 0], [0, 0], [0, 1], [1, 0], [1, 0]], dtype=bool),
    )

    @property
    def function(self) -> Any:
        """CasADi's function of (x, u, p) that returns the next state; needs zoac[casadi]."""
        import casadi

        # `advance` itself, with CasADi's cos and sin for those of `math`.
        plain = advance.py_func  # type: ignore[attr-defined]
        symbolic = FunctionType(plain.__code__, {**plain.__globals__, "math": casadi})
        x, u, p = (casadi.SX.sym(name, size) for name, size in (("x", 6), ("u", 2), ("p", 6)))
        after = symbolic(casadi.vertsplit(p), casadi.vertsplit(x), u[0], u[1])
        return casadi.Function("step", [x, u, p], [casadi.vertcat(*after)])

    def linearise(
        self, theta: np.ndarray, start: np.ndarray, inputs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `zoac.mpc.sqp.PredictiveModel`; theta (n, 6) in the order of `parameters`."""
        n, horizon, _ = inputs.shape
        states = np.empty((n, horizon + 1, 6))
        states[:, 0] = start
        a = np.zeros((n, horizon, 6, 6))
        b = np.zeros((n, horizon, 6, 2))
        _roll_out_and_linearise(theta, inputs, states, a, b)
        return states, a, b

    def predict(self, theta: np.ndarray, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Return F_theta(states (n, 6), inputs (n, 2)) (n, 6)."""
        return self.linearise(theta, states, inputs[:, None])[0][:, 1]
