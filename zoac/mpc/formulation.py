"""The linearised optimal control problem, stated once in CVXPY.

The decision variables are the errors e_k = x_k - reference_k, k = 1..N, and the inputs u_k,
k = 0..N-1. In these, `LinearisedProblem` reads

    minimise    sum_k |e_k|^2_{w_k} + sum_k |u_k|^2_{r_k}
    subject to  e_1     = b_0 u_0 + g_0,
                e_{k+1} = a_k e_k + b_k u_k + g_k,    k = 1..N-1,
                low <= u_k <= high,

with the gap g_k = states_{k+1} + a_k (reference_k - states_k) - b_k inputs_k - reference_{k+1}
(the term with a_0 vanishes, since x_0 = states_0). Errors rather than states keep the objective
diagonal and linear in the weights, so that a new problem is only new numbers (DPP).

The numbers are scaled, problem by problem: states, inputs and cost by their units
(`zoac.mpc.solvers.scaling`), the objective then so that the rollout costs about 1,000. An
interior-point method begins at slacks of about 1 whatever the numbers; scaled so, it needs a fifth
fewer iterations in closed loop, and its plans are no less accurate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cvxpy as cp
import numpy as np

from zoac.mpc.compiled import compiled
from zoac.mpc.problem import LinearisedProblem
from zoac.mpc.solvers.scaling import Units

_ROLLOUT_COST = 1e3
_OBJECTIVE_SCALES = 0.1, 100.0  # beyond, the tolerances would mean too little or ask too much


@dataclass(frozen=True, slots=True)
class Layout:
    """Sizes and sparsity: all that distinguishes one canonical form from another.

    Args:
        horizon: N.
        nx: Number of states.
        nu: Number of inputs.
        a: Row and column of each nonzero entry of a_k.
        b: Row and column of each nonzero entry of b_k.
        low: Which inputs have a lower bound; an infinite one is none.
        high: Which have an upper bound.
    """

    horizon: int
    nx: int
    nu: int
    a: tuple[tuple[int, int], ...]
    b: tuple[tuple[int, int], ...]
    low: tuple[bool, ...]
    high: tuple[bool, ...]

    @classmethod
    def of(cls, problem: LinearisedProblem) -> Layout:
        """Return the layout of `problem`."""
        _, horizon, nx, nu = problem.b.shape
        sparsity = problem.sparsity
        a, b = b"\1" * (nx * nx), b"\1" * (nx * nu)
        if sparsity is not None:
            a, b = sparsity.a.tobytes(), sparsity.b.tobytes()
        bounds = np.isfinite((problem.input_low, problem.input_high)).tobytes()
        return _layout(horizon, nx, nu, a, b, bounds)

    @property
    def dynamics_size(self) -> int:
        """Length of the parameter `dynamics`."""
        return (
            len(self.a) * (self.horizon - 1) + (len(self.b) + self.nx) * self.horizon + 2 * self.nu
        )

    @property
    def weights_size(self) -> int:
        """Length of the parameter `weights`."""
        return (self.nx + self.nu) * self.horizon


@lru_cache
def _layout(horizon: int, nx: int, nu: int, a: bytes, b: bytes, bounds: bytes) -> Layout:
    def entries(mask: bytes, columns: int) -> tuple[tuple[int, int], ...]:
        return tuple(divmod(place, columns) for place, nonzero in enumerate(mask) if nonzero)

    finite = tuple(map(bool, bounds))
    return Layout(horizon, nx, nu, entries(a, nx), entries(b, nu), finite[:nu], finite[nu:])


@dataclass(frozen=True, slots=True)
class Formulation:
    """The CVXPY problem, with its two parameters and two variables.

    Args:
        problem: The problem.
        dynamics: Flat parameter: each entry of a over k = 1..N-1, each entry of b over
            k = 0..N-1, each component of the gap over k, then low and high.
        weights: Flat nonnegative parameter: w (N, nx), then r (N, nu), component by component.
        errors: Variable (N, nx).
        inputs: Variable (N, nu).
    """

    problem: cp.Problem
    dynamics: cp.Parameter
    weights: cp.Parameter
    errors: cp.Variable
    inputs: cp.Variable


def build_problem(layout: Layout) -> Formulation:
    """State the problem for one layout.

    Two flat parameters, cut into slices, rather than one per quantity: CVXPY spends its time
    per parameter.
    """
    horizon = layout.horizon
    errors = cp.Variable((horizon, layout.nx), name="errors")
    inputs = cp.Variable((horizon, layout.nu), name="inputs")
    dynamics = cp.Parameter(layout.dynamics_size, name="dynamics")
    weights = cp.Parameter(layout.weights_size, name="weights", nonneg=True)

    read = _Slices(dynamics)
    a = {entry: read.next(horizon - 1) for entry in layout.a}
    b = {entry: read.next(horizon) for entry in layout.b}
    gap = [read.next(horizon) for _ in range(layout.nx)]
    low, high = read.next(layout.nu), read.next(layout.nu)

    constraints = []
    for i in range(layout.nx):
        driven = gap[i]
        for (row, j), coefficient in b.items():
            if row == i:
                driven = driven + cp.multiply(coefficient, inputs[:, j])
        later = driven[1:]
        for (row, j), coefficient in a.items():
            if row == i:
                later = later + cp.multiply(coefficient, errors[:-1, j])
        constraints += [errors[0, i] == driven[0], errors[1:, i] == later]
    for j in range(layout.nu):
        constraints += [inputs[:, j] >= low[j]] if layout.low[j] else []
        constraints += [inputs[:, j] <= high[j]] if layout.high[j] else []

    read = _Slices(weights)
    cost = [
        cp.sum(cp.multiply(read.next(variable.size, variable.shape), cp.square(variable)))
        for variable in (errors, inputs)
    ]
    problem = cp.Problem(cp.Minimize(sum(cost)), constraints)
    return Formulation(problem, dynamics, weights, errors, inputs)


class _Slices:
    """Cuts a flat parameter into consecutive pieces."""

    def __init__(self, parameter: cp.Parameter) -> None:
        self._parameter = parameter
        self._next = 0

    def next(self, length: int, shape: tuple[int, ...] | None = None) -> cp.Expression:
        start, self._next = self._next, self._next + length
        piece = self._parameter[start : self._next]
        return piece if shape is None else cp.reshape(piece, shape, order="F")


def write_parameters(
    problem: LinearisedProblem,
    layout: Layout,
    units: Units,
    dynamics: np.ndarray,
    weights: np.ndarray,
) -> None:
    """Write each problem's parameters, in `units`, into `dynamics` and `weights`, n rows each."""
    a_entries, b_entries = _entries(layout)
    _write(
        a_entries,
        b_entries,
        problem.a,
        problem.b,
        problem.states,
        problem.inputs,
        problem.reference,
        problem.state_weights,
        problem.input_weights,
        np.where(layout.low, problem.input_low, 0.0),
        np.where(layout.high, problem.input_high, 0.0),
        units.states,
        units.inputs,
        units.cost,
        dynamics,
        weights,
    )


@lru_cache
def _entries(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    a, b = (np.array(e, dtype=np.int64).reshape(-1, 2) for e in (layout.a, layout.b))
    return a, b


@compiled(error_model="numpy")
def _write(
    a_entries: np.ndarray,
    b_entries: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    states: np.ndarray,
    inputs: np.ndarray,
    reference: np.ndarray,
    state_weights: np.ndarray,
    input_weights: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    state_units: np.ndarray,
    input_units: np.ndarray,
    cost_units: np.ndarray,
    dynamics: np.ndarray,
    weights: np.ndarray,
) -> None:
    n, horizon, nx, nu = b.shape
    gap = len(a_entries) * (horizon - 1) + len(b_entries) * horizon  # where the gaps begin
    for env_index in range(n):
        to = 0
        cost = 0.0
        x_unit, u_unit = state_units[env_index], input_units[env_index]
        for i in range(nx):
            for k in range(horizon):
                error = (states[env_index, k + 1, i] - reference[env_index, k, i]) / x_unit[i]
                weight = state_weights[env_index, k, i] * x_unit[i] ** 2 / cost_units[env_index]
                dynamics[env_index, gap + i * horizon + k] = error
                weights[env_index, i * horizon + k] = weight
                cost += weight * error * error
        for entry in range(len(a_entries)):
            i, j = a_entries[entry, 0], a_entries[entry, 1]
            for k in range(1, horizon):
                value = a[env_index, k, i, j] * (x_unit[j] / x_unit[i])
                dynamics[env_index, to] = value
                to += 1
                before = (reference[env_index, k - 1, j] - states[env_index, k, j]) / x_unit[j]
                dynamics[env_index, gap + i * horizon + k] += value * before
        for entry in range(len(b_entries)):
            i, j = b_entries[entry, 0], b_entries[entry, 1]
            for k in range(horizon):
                value = b[env_index, k, i, j] / x_unit[i]
                dynamics[env_index, to] = value * u_unit[j]
                to += 1
                dynamics[env_index, gap + i * horizon + k] -= value * inputs[env_index, k, j]
        to += nx * horizon
        for j in range(nu):
            dynamics[env_index, to + j] = low[j] / u_unit[j]
            dynamics[env_index, to + nu + j] = high[j] / u_unit[j]
            for k in range(horizon):
                weight = input_weights[env_index, k, j] / cost_units[env_index]
                weights[env_index, (nx + j) * horizon + k] = weight * u_unit[j] * u_unit[j]
                cost += weight * inputs[env_index, k, j] * inputs[env_index, k, j]
        weights[env_index] *= min(
            max(_ROLLOUT_COST / cost, _OBJECTIVE_SCALES[0]), _OBJECTIVE_SCALES[1]
        )
