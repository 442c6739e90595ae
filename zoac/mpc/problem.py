"""What every solver of the linearised optimal control problem takes and returns."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import ClassVar, Protocol

import numpy as np

from zoac.core.errors import ConfigError


class Status(enum.IntEnum):
    """How a solve ended; `sentence` says it to a person, with the remedy."""

    sentence: str

    def __new__(cls, value: int, sentence: str = "") -> Status:
        member = int.__new__(cls, value)
        member._value_, member.sentence = value, sentence
        return member

    SOLVED = 0, "The problem was solved to tolerance."
    INACCURATE = 1, "The solver stopped near the solution, short of its tolerance."
    ITERATION_LIMIT = 2, "The solver used all its iterations; raise its limit."
    NUMERICAL_FAILURE = 3, "The solver failed numerically; the weights may be too far apart."
    NOT_FINITE = 4, "The problem's data are not finite; the model left its valid range."
    INFEASIBLE = 5, "No plan keeps the hard bounds; widen them or make them soft."


@dataclass(frozen=True, eq=False, slots=True)
class Sparsity:
    """Which entries of a model's Jacobians can be other than zero.

    A solver may use it or not; entries outside must be zero.

    Args:
        a: (nx, nx) bool, of the Jacobian with respect to the state.
        b: (nx, nu) bool, of the Jacobian with respect to the input.
    """

    a: np.ndarray
    b: np.ndarray

    def check(self, a: np.ndarray, b: np.ndarray) -> None:
        """See that Jacobians are zero where a solver takes them to be.

        Args:
            a: (n, N, nx, nx), with respect to the state.
            b: (n, N, nx, nu), with respect to the input.

        Raises:
            ConfigError: If an entry outside is not zero; the plan would be wrong.
        """
        for name, jacobian, can_be in (("dF/dX", a, self.a), ("dF/dU", b, self.b)):
            largest = np.abs(jacobian).max((0, 1), initial=0.0)
            wrong = np.argwhere((largest > 0.0) & ~can_be)
            if len(wrong):
                i, j = wrong[0]
                raise ConfigError(
                    f"the model's `sparsity` says that {name}[{i}, {j}] is always zero, but it is "
                    f"{largest[i, j]:.6g} here: mark every entry that can be other than zero"
                )


PENALTY = 1e3
"""Default penalty of a soft bound on states, in terms of the largest stage weight of a state."""


@dataclass(frozen=True, eq=False, slots=True)
class StateBounds:
    """Bounds on the states x_1 .. x_N of n environments, the same along the horizon.

    Which states are bounded, on which side, and whether softly, is the same in all environments.

    Args:
        low: (n, nx); -inf: none.
        high: (n, nx); inf: none.
        penalty: (n, nx), cost of being beyond a bound by one unit, at each step. Such a bound is
            soft, and kept exactly where it can be while its multiplier is below the penalty; inf:
            the bound is hard.
    """

    low: np.ndarray
    high: np.ndarray
    penalty: np.ndarray

    def take(self, rows: np.ndarray) -> StateBounds:
        """Return those of some environments, by mask or index."""
        return StateBounds(self.low[rows], self.high[rows], self.penalty[rows])


@dataclass(frozen=True, eq=False, slots=True)
class LinearisedProblem:
    """n quadratic programmes, one for each environment, linearised about a rollout of the model.

    minimise    sum_{k=1..N} |x_k - reference_k|^2_{state_weights_k}
              + sum_{k=0..N-1} |u_k|^2_{input_weights_k}
              + sum_{k=1..N} penalty (what x_k is beyond its bounds)
    subject to  x_0 = states_0,
                x_{k+1} = states_{k+1} + a_k (x_k - states_k) + b_k (u_k - inputs_k),
                input_low <= u_k <= input_high,
                state_low <= x_k <= state_high, where the bounds are hard,

    where |e|^2_w = sum_i w_i e_i^2. Discounts are folded into the weights. All arrays are
    C-contiguous float64.

    Args:
        states: (n, N + 1, nx), the rollout that the model was linearised about.
        inputs: (n, N, nu), the inputs of that rollout, inside the box.
        a: (n, N, nx, nx), Jacobians with respect to the state.
        b: (n, N, nx, nu), Jacobians with respect to the input.
        reference: (n, N, nx), for x_1 .. x_N.
        state_weights: (n, N, nx), nonnegative, for x_1 .. x_N.
        input_weights: (n, N, nu), positive, for u_0 .. u_{N-1}.
        input_low: (nu,).
        input_high: (nu,).
        sparsity: Of `a` and `b`, if the model knows it; None: any entry may be nonzero.
        bounds: On the states; None: none.
    """

    states: np.ndarray
    inputs: np.ndarray
    a: np.ndarray
    b: np.ndarray
    reference: np.ndarray
    state_weights: np.ndarray
    input_weights: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    sparsity: Sparsity | None = None
    bounds: StateBounds | None = None

    @property
    def data(self) -> tuple[np.ndarray, ...]:
        """The arrays that `PER_ENV` names."""
        return _DATA(self)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """The bounds of the inputs."""
        return self.input_low, self.input_high

    def take(self, rows: np.ndarray) -> LinearisedProblem:
        """Return the problems of some environments, by mask or index."""
        some = {name: getattr(self, name)[rows] for name in PER_ENV}
        bounds = None if self.bounds is None else self.bounds.take(rows)
        return replace(self, **some, bounds=bounds)


PER_ENV = ("states", "inputs", "a", "b", "reference", "state_weights", "input_weights")
"""Arrays of a `LinearisedProblem` that have one row for each environment."""

_DATA = attrgetter(*PER_ENV)


@dataclass(frozen=True, eq=False, slots=True)
class Solution:
    """Plans of n environments.

    Args:
        inputs: (n, N, nu), inside the box; meaningful where `status` is SOLVED.
        status: (n,) int8, values of `Status`.
        iterations: (n,) int64, the solver's own count.
    """

    inputs: np.ndarray
    status: np.ndarray
    iterations: np.ndarray


class Solver(Protocol):
    """A pure function of the problem: the same bits for the same problem, whatever came before.

    Attributes:
        screens: It looks for problems that are not finite itself and gives them the status
            NOT_FINITE; otherwise it is never shown one.
        bounds_states: It takes problems with `StateBounds`.
    """

    screens: ClassVar[bool]
    bounds_states: ClassVar[bool]

    def solve(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        """Solve the n problems.

        Args:
            problem: What to solve.
            robust: Use the solver's safer, slower settings (a retry after a failure).
        """
        ...
