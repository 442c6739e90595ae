"""Nonlinear MPC by sequential quadratic programmes, batched over environments.

Roll the predictive model out along a plan, linearise about the rollout, solve the quadratic
programme, take its solution as the next plan, and so on. Each environment goes its own way: what
one environment's solver did never changes another environment's numbers.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, replace
from typing import Literal, Protocol, get_args

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.core.types import Count
from zoac.mpc.compiled import compiled
from zoac.mpc.problem import LinearisedProblem, Solution, Solver, Sparsity, Status
from zoac.mpc.solvers.scaling import units

About = Literal["zero", "shifted"]

CONVERGED = 1e-9
"""A plan has converged when no input changes by more than this part of its range. For an input
without two bounds: of the plan's magnitude, or of what undoes the rollout's errors if larger."""

MAX_LINEARISATIONS = 50
"""Limit on `linearisations: converged`."""

# As plain numbers: comparing an array with a member of an enum takes five times as long.
_SOLVED, _NOT_FINITE = int(Status.SOLVED), int(Status.NOT_FINITE)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MpcOptions:
    """How the MPC plans.

    Args:
        horizon: N_p, steps that it looks ahead.
        linearisations: Quadratic programmes a step; "converged": until the plan stands still
            (`CONVERGED`), at most `MAX_LINEARISATIONS`.
        initial_guess: What the first one is linearised about: the rollout with zero input,
            which makes the controller a function of the observation alone; or last step's plan
            shifted by one step (real-time iteration), which it then remembers.

    Raises:
        ConfigError: If an option is out of range or unknown.
    """

    horizon: Count = 25
    linearisations: Count | Literal["converged"] = 3
    initial_guess: About = "zero"

    def __post_init__(self) -> None:
        if self.horizon < 1:
            raise ConfigError(f"mpc.horizon: must be at least 1, got {self.horizon}")
        count = self.linearisations
        if count != "converged" and (isinstance(count, str) or count < 1):
            raise ConfigError(
                f"mpc.linearisations: expected a number from 1 or 'converged', got {count!r}"
            )
        if self.initial_guess not in get_args(About):
            raise ConfigError(
                f"mpc.initial_guess: unknown {self.initial_guess!r}; "
                f"{suggest(self.initial_guess, get_args(About))}"
            )


class PredictiveModel(Protocol):
    """A discrete-time model x_{k+1} = F_theta(x_k, u_k) of n environments, with its Jacobians."""

    input_low: np.ndarray
    input_high: np.ndarray
    sparsity: Sparsity

    def linearise(
        self, theta: np.ndarray, start: np.ndarray, inputs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Roll out from `start` (n, nx) along `inputs` (n, N, nu) and linearise about it.

        Returns:
            States (n, N + 1, nx), dF/dX (n, N, nx, nx) and dF/dU (n, N, nx, nu).
        """
        ...


@dataclass(frozen=True, eq=False, slots=True)
class Objective:
    """What n environments minimise; see `LinearisedProblem`.

    Args:
        reference: (n, N, nx), for x_1 .. x_N.
        state_weights: (n, N, nx), discounts included.
        input_weights: (n, N, nu), discounts included.
    """

    reference: np.ndarray
    state_weights: np.ndarray
    input_weights: np.ndarray


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """What the search found for n environments.

    Args:
        inputs: (n, N, nu), finite and inside the box whatever happened.
        status: (n,) int8, the worst `Status` of the step, after a retry.
        retried: (n,) bool, a robust solve was needed.
        linearisations: (n,) int64, quadratic programmes posed.
        seconds: Wall time of the solver's calls, all environments together.
    """

    inputs: np.ndarray
    status: np.ndarray
    retried: np.ndarray
    linearisations: np.ndarray
    seconds: float

    @property
    def failed(self) -> np.ndarray:
        """Environments (n,) bool whose solver failed, the retry included."""
        return self.status != _SOLVED


class SequentialQp:
    """The search for a plan: a pure function of its arguments."""

    def __init__(
        self, model: PredictiveModel, solver: Solver, linearisations: int | Literal["converged"]
    ) -> None:
        self._model = model
        self._solver = solver
        self._until_converged = linearisations == "converged"
        self._limit = MAX_LINEARISATIONS if linearisations == "converged" else linearisations
        self._range = model.input_high - model.input_low
        self._checked = False

    def plan(
        self, theta: np.ndarray, start: np.ndarray, objective: Objective, guess: np.ndarray
    ) -> Plan:
        """Plan from `start` (n, nx), beginning with `guess` (n, N, nu).

        An environment whose solve fails twice keeps the last plan of this call that did solve, else
        zero input (clipped to the box), and stops there.

        Raises:
            ConfigError: In the first call, if the model's Jacobians are not as sparse as it says.
        """
        n = len(start)
        inputs = np.empty_like(guess)
        status = np.empty(n, dtype=np.int8)
        retried = np.zeros(n, dtype=bool)
        count = np.empty(n, dtype=np.int64)
        seconds = 0.0
        env_indices: slice | np.ndarray = slice(None)  # those that go on; below, only they
        before = guess
        for posed in range(1, self._limit + 1):
            problem = self._linearise(theta, start, objective, before)
            if not self._checked:
                _check_sparsity(problem)
                self._checked = True
            attempt = _Attempt(self._solver, problem)
            after, ends = attempt.inputs, None
            seconds += attempt.seconds
            if attempt.troubled:
                ends = attempt.status != _SOLVED
                retried[env_indices] |= attempt.retried
                zero = np.clip(0.0, problem.input_low, problem.input_high)
                after = np.where(ends[:, None, None], zero if posed == 1 else before, after)
            if self._until_converged:
                change = np.abs(after - before)
                stands = (change <= CONVERGED * self._scale(problem, after)).all((1, 2))
                ends = stands if ends is None else ends | stands
            if posed < self._limit and (ends is None or not ends.any()):
                before = after
                continue
            inputs[env_indices], status[env_indices], count[env_indices] = (
                after,
                attempt.status,
                posed,
            )
            if posed == self._limit or ends is None or ends.all():
                break
            on = ~ends
            env_indices = np.arange(n)[env_indices][on]
            theta, start, before = theta[on], start[on], after[on]
            objective = Objective(
                objective.reference[on], objective.state_weights[on], objective.input_weights[on]
            )
        return Plan(inputs, status, retried, count, seconds)

    def _scale(self, problem: LinearisedProblem, plan: np.ndarray) -> np.ndarray:
        """Return what a change of each input is measured by, (n, 1, nu) or (nu,)."""
        boxed = np.isfinite(self._range)
        if boxed.all():
            return self._range
        size = np.maximum(np.abs(plan).max(axis=1), units(problem, always=True).inputs)
        return np.where(boxed, self._range, size)[:, None]

    def _linearise(
        self, theta: np.ndarray, start: np.ndarray, objective: Objective, inputs: np.ndarray
    ) -> LinearisedProblem:
        states, a, b = self._model.linearise(theta, start, inputs)
        return LinearisedProblem(
            states=states,
            inputs=inputs,
            a=a,
            b=b,
            reference=objective.reference,
            state_weights=objective.state_weights,
            input_weights=objective.input_weights,
            input_low=self._model.input_low,
            input_high=self._model.input_high,
            sparsity=self._model.sparsity,
        )


def _check_sparsity(problem: LinearisedProblem) -> None:
    """Solvers leave out what is said to be zero: a wrong word would be a wrong plan."""
    if problem.sparsity is None:
        return
    for name, jacobian, can_be in (
        ("dF/dX", problem.a, problem.sparsity.a),
        ("dF/dU", problem.b, problem.sparsity.b),
    ):
        largest = np.abs(jacobian).max((0, 1), initial=0.0)
        wrong = np.argwhere((largest > 0.0) & ~can_be)
        if len(wrong):
            i, j = wrong[0]
            raise ConfigError(
                f"the model's `sparsity` says that {name}[{i}, {j}] is always zero, but it is "
                f"{largest[i, j]:.6g} here: mark every entry that can be other than zero"
            )


class _Attempt:
    """One solve of n problems; what failed is solved once more, carefully.

    Problems that are not finite never reach a solver that does not screen them itself.
    """

    def __init__(self, solver: Solver, problem: LinearisedProblem) -> None:
        self._solver = solver
        self._problem = problem
        self.seconds = 0.0
        finite = None if solver.screens else _finite(problem)
        if finite is None or finite.all():
            answer = self._timed(problem)
            self.inputs, self.status = answer.inputs, answer.status
        else:
            self.inputs = np.zeros_like(problem.inputs)
            self.status = np.full(len(finite), _NOT_FINITE, dtype=np.int8)
            self._solve_some(finite, robust=False)
        self.troubled = np.count_nonzero(self.status) > 0  # SOLVED is zero
        if self.troubled:
            self.retried = (self.status != _SOLVED) & (self.status != _NOT_FINITE)
            self._solve_some(self.retried, robust=True)
            for env_index in np.flatnonzero(self.status):
                sentence = Status(self.status[env_index]).sentence
                _log.info("row %d of %d: %s", env_index, len(self.status), sentence)

    def _solve_some(self, mask: np.ndarray, robust: bool) -> None:
        if mask.any():
            answer = self._timed(_take(self._problem, mask), robust)
            self.inputs, self.status = self.inputs.copy(), self.status.copy()
            self.inputs[mask] = answer.inputs
            self.status[mask] = answer.status

    def _timed(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        began = time.perf_counter()
        answer = self._solver.solve(problem, robust)
        self.seconds += time.perf_counter() - began
        return answer


_PER_ENV = ("states", "inputs", "a", "b", "reference", "state_weights", "input_weights")


def _take(problem: LinearisedProblem, mask: np.ndarray) -> LinearisedProblem:
    return replace(problem, **{name: getattr(problem, name)[mask] for name in _PER_ENV})


def _finite(problem: LinearisedProblem) -> np.ndarray:
    """Return for each environment (n,) whether all its numbers are finite."""
    n = len(problem.a)
    return _finite_rows(*[getattr(problem, name).reshape(n, -1) for name in _PER_ENV])


@compiled()
def _finite_rows(
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: np.ndarray,
    e: np.ndarray,
    f: np.ndarray,
    g: np.ndarray,
) -> np.ndarray:
    finite = np.ones(len(a), dtype=np.bool_)
    for env_index in range(len(a)):
        for rows in (a, b, c, d, e, f, g):
            bad = 0
            for i in range(rows.shape[1]):
                bad += not np.isfinite(rows[env_index, i])
            finite[env_index] &= bad == 0
    return finite
