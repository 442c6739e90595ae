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
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp
import numpy as np
from numba import njit

from zoac.mpc.solvers.base import LinearisedProblem, Sparsity


@dataclass(frozen=True, slots=True)
class Layout:
    """Sizes and sparsity: all that distinguishes one canonical form from another.

    Args:
        horizon: N.
        nx: Number of states.
        nu: Number of inputs.
        a: Row and column of each nonzero entry of a_k.
        b: Row and column of each nonzero entry of b_k.
    """

    horizon: int
    nx: int
    nu: int
    a: tuple[tuple[int, int], ...]
    b: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, problem: LinearisedProblem) -> Layout:
        """Return the layout of `problem`."""
        _, horizon, nx, nu = problem.b.shape
        sparsity = problem.sparsity or Sparsity(np.ones((nx, nx), bool), np.ones((nx, nu), bool))
        a, b = (
            tuple((int(i), int(j)) for i, j in np.argwhere(mask))
            for mask in (sparsity.a, sparsity.b)
        )
        return cls(horizon, nx, nu, a, b)

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


@dataclass(frozen=True, slots=True)
class Statement:
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


def state_problem(layout: Layout) -> Statement:
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
        constraints += [inputs[:, j] >= low[j], inputs[:, j] <= high[j]]

    read = _Slices(weights)
    cost = [
        cp.sum(cp.multiply(read.next(variable.size, variable.shape), cp.square(variable)))
        for variable in (errors, inputs)
    ]
    problem = cp.Problem(cp.Minimize(sum(cost)), constraints)
    return Statement(problem, dynamics, weights, errors, inputs)


class _Slices:
    """Cuts a flat parameter into consecutive pieces."""

    def __init__(self, parameter: cp.Parameter) -> None:
        self._parameter = parameter
        self._next = 0

    def next(self, length: int, shape: tuple[int, ...] | None = None) -> cp.Expression:
        start, self._next = self._next, self._next + length
        piece = self._parameter[start : self._next]
        return piece if shape is None else cp.reshape(piece, shape, order="F")


def parameter_values(problem: LinearisedProblem, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Return the values (n, ...) of `dynamics` and `weights` for each of the n problems."""
    n = len(problem.a)
    dynamics = np.empty((n, layout.dynamics_size))
    weights = np.empty((n, layout.weights_size))
    _write_dynamics(
        np.array(layout.a, dtype=np.int64).reshape(-1, 2),
        np.array(layout.b, dtype=np.int64).reshape(-1, 2),
        problem.a,
        problem.b,
        problem.states,
        problem.inputs,
        problem.reference,
        dynamics,
    )
    dynamics[:, -2 * layout.nu : -layout.nu] = problem.input_low
    dynamics[:, -layout.nu :] = problem.input_high
    states = layout.nx * layout.horizon
    weights[:, :states] = problem.state_weights.transpose(0, 2, 1).reshape(n, -1)
    weights[:, states:] = problem.input_weights.transpose(0, 2, 1).reshape(n, -1)
    return dynamics, weights


@njit(cache=True)
def _write_dynamics(
    a_entries: np.ndarray,
    b_entries: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    states: np.ndarray,
    inputs: np.ndarray,
    reference: np.ndarray,
    dynamics: np.ndarray,
) -> None:
    n, horizon, nx, _ = b.shape
    for lane in range(n):
        to = 0
        first_gap = len(a_entries) * (horizon - 1) + len(b_entries) * horizon
        gap = dynamics[lane, first_gap : first_gap + nx * horizon].reshape(nx, horizon)
        for i in range(nx):
            for k in range(horizon):
                gap[i, k] = states[lane, k + 1, i] - reference[lane, k, i]
        for i, j in a_entries:
            for k in range(1, horizon):
                gap[i, k] += a[lane, k, i, j] * (reference[lane, k - 1, j] - states[lane, k, j])
                dynamics[lane, to] = a[lane, k, i, j]
                to += 1
        for i, j in b_entries:
            for k in range(horizon):
                gap[i, k] -= b[lane, k, i, j] * inputs[lane, k, j]
                dynamics[lane, to] = b[lane, k, i, j]
                to += 1
