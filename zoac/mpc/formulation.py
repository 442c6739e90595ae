"""The linearised optimal control problem, stated once in CVXPY.

The decision variables are the errors e_k = x_k - reference_k, k = 1..N, and the inputs u_k,
k = 0..N-1. In these, `LinearisedProblem` reads

    minimise    sum_k |e_k|^2_{w_k} + sum_k |u_k|^2_{r_k}
    subject to  e_1     = b_0 u_0 + g_0,
                e_{k+1} = a_k e_k + b_k u_k + g_k,    k = 1..N-1,
                low <= u_k <= high,
                low <= x_k <= high, where states are bounded, softly with x_k beyond by a slack s_k
                that costs penalty s_k,

with the gap g_k = states_{k+1} + a_k (reference_k - states_k) - b_k inputs_k - reference_{k+1}
(the term with a_0 vanishes, since x_0 = states_0). Errors rather than states keep the objective
diagonal and linear in the weights, so that a new problem is only new numbers (DPP).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cvxpy as cp
import numpy as np

from zoac.mpc.problem import LinearisedProblem, Sparsity

Entries = tuple[tuple[int, int], ...]


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
        state_low: Positions of the states that have a lower bound.
        state_high: Of those that have an upper bound.
        soft: Of those whose bounds are soft.
    """

    horizon: int
    nx: int
    nu: int
    a: Entries
    b: Entries
    low: tuple[bool, ...]
    high: tuple[bool, ...]
    state_low: tuple[int, ...] = ()
    state_high: tuple[int, ...] = ()
    soft: tuple[int, ...] = ()

    @classmethod
    def of(cls, problem: LinearisedProblem) -> Layout:
        """Return the layout of `problem`."""
        _, horizon, nx, nu = problem.b.shape
        a, b = _entries(problem.sparsity, nx, nu)
        low, high = (tuple(np.isfinite(side).tolist()) for side in problem.box)
        layout = cls(horizon, nx, nu, a, b, low, high)
        if (given := problem.bounds) is None:
            return layout
        bounded = np.isfinite((given.low[0], given.high[0]))
        soft = bounded.any(axis=0) & np.isfinite(given.penalty[0])
        below, above, slack = (tuple(np.flatnonzero(m).tolist()) for m in (*bounded, soft))
        return replace(layout, state_low=below, state_high=above, soft=slack)

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

    @property
    def bounds_size(self) -> int:
        """Length of the parameter `bounds`; 0: there is none."""
        return (len(self.state_low) + len(self.state_high)) * self.horizon + len(self.soft)


@lru_cache
def _entries(sparsity: Sparsity | None, nx: int, nu: int) -> list[Entries]:
    full = np.ones((nx, nx)), np.ones((nx, nu))
    masks = full if sparsity is None else (sparsity.a, sparsity.b)
    return [tuple((i, j) for i, j in np.argwhere(mask).tolist()) for mask in masks]


@dataclass(frozen=True, slots=True)
class Formulation:
    """The CVXPY problem, with its parameters and variables.

    Args:
        problem: The problem.
        parameters: By name, each flat: "dynamics": each entry of a over k = 1..N-1, each entry of
            b over k = 0..N-1, each component of the gap over k, then low and high; "weights": w
            (N, nx), then r (N, nu), component by component, nonnegative; "bounds", if states are
            bounded: each lower bound less the reference over k, each upper one likewise, then the
            penalties.
        inputs: Variable (N, nu).
        of_bounds: The constraints of lower and upper bounds, in the order of the layout.
    """

    problem: cp.Problem
    parameters: dict[str, cp.Parameter]
    inputs: cp.Variable
    of_bounds: tuple[list[cp.Constraint], list[cp.Constraint]]


CANON_BACKEND = "COO"
"""CVXPY's way to the canonical form that is quickest where there are many parameters."""


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
    parameters = {"dynamics": dynamics, "weights": weights}
    below, above = [], []
    if layout.bounds_size:
        parameters["bounds"] = cp.Parameter(layout.bounds_size, name="bounds")
        read = _Slices(parameters["bounds"])
        slacks = {i: cp.Variable(horizon, name=f"slack_{i}") for i in layout.soft}
        below = [errors[:, i] >= read.next(horizon) - slacks.get(i, 0.0) for i in layout.state_low]
        above = [errors[:, i] <= read.next(horizon) + slacks.get(i, 0.0) for i in layout.state_high]
        cost += [read.next(1) * cp.sum(slack) for slack in slacks.values()]
        constraints += [*below, *above, *(slack >= 0 for slack in slacks.values())]
    problem = cp.Problem(cp.Minimize(sum(cost)), constraints)
    return Formulation(problem, parameters, inputs, (below, above))


class _Slices:
    """Cuts a flat parameter into consecutive pieces."""

    def __init__(self, parameter: cp.Parameter) -> None:
        self._parameter = parameter
        self._next = 0

    def next(self, length: int, shape: tuple[int, ...] | None = None) -> cp.Expression:
        start, self._next = self._next, self._next + length
        piece = self._parameter[start : self._next]
        return piece if shape is None else cp.reshape(piece, shape, order="F")
