"""Nonlinear MPC by sequential quadratic programmes, batched over environments.

Roll the predictive model out along a plan, linearise about the rollout, solve the quadratic
programme, take its solution as the next plan, and so on. Each environment goes its own way: what
one environment's solver did never changes another environment's numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np

from zoac.core.controller import Diagnostics
from zoac.core.errors import ConfigError, suggest
from zoac.core.types import Count, NonNegative
from zoac.mpc.attempt import Attempt
from zoac.mpc.problem import LinearisedProblem, Solver, Sparsity, StateBounds, Status
from zoac.mpc.solvers.scaling import units

About = Literal["zero", "shifted"]
Softness = Literal["soft", "hard"]

CONVERGED = 1e-9
"""A plan has converged when no input changes by more than this part of its range. For an input
without two bounds: of the plan's magnitude, or of what undoes the rollout's errors if larger."""

MAX_LINEARISATIONS = 50
"""Limit on `linearisations: converged`."""

_SOLVED = int(Status.SOLVED)


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
        state_low: Lower bounds X_min of states by name, such as {"v": -0.5}; None: none.
        state_high: Upper bounds X_max, likewise.
        state_bounds: "soft": a state may be beyond them at a price, exact penalties; "hard": where
            no plan keeps them, the step counts as failed.
        state_penalty: Price of a state beyond a soft bound by one unit, at each step; None: 1,000
            times the largest stage weight of a state.

    Raises:
        ConfigError: If an option is out of range or unknown.
    """

    horizon: Count = 25
    linearisations: Count | Literal["converged"] = 3
    initial_guess: About = "zero"
    state_low: dict[str, float] | None = None
    state_high: dict[str, float] | None = None
    state_bounds: Softness = "soft"
    state_penalty: NonNegative | None = None

    def __post_init__(self) -> None:
        if self.horizon < 1:
            raise ConfigError(f"mpc.horizon: must be at least 1, got {self.horizon}")
        count = self.linearisations
        if count != "converged" and (isinstance(count, str) or count < 1):
            raise ConfigError(
                f"mpc.linearisations: expected a number from 1 or 'converged', got {count!r}"
            )
        for name, kinds in (("initial_guess", About), ("state_bounds", Softness)):
            if (value := getattr(self, name)) not in get_args(kinds):
                raise ConfigError(
                    f"mpc.{name}: unknown {value!r}; {suggest(value, get_args(kinds))}"
                )


class PredictiveModel(Protocol):
    """A discrete-time model x_{k+1} = F_theta(x_k, u_k) of n environments, with its Jacobians."""

    input_low: np.ndarray
    input_high: np.ndarray

    @property
    def sparsity(self) -> Sparsity | None:
        """Which entries of the Jacobians can be other than zero; None: any."""
        ...

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
        rest: (n, nu), inputs inside the box, applied where no programme was solved.
        bounds: On the states; None: none.
    """

    reference: np.ndarray
    state_weights: np.ndarray
    input_weights: np.ndarray
    rest: np.ndarray
    bounds: StateBounds | None = None

    def take(self, rows: np.ndarray) -> Objective:
        """Return those of some environments, by mask or index."""
        return Objective(
            self.reference[rows],
            self.state_weights[rows],
            self.input_weights[rows],
            self.rest[rows],
            None if self.bounds is None else self.bounds.take(rows),
        )


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

    def diagnostics(self, prediction: np.ndarray) -> Diagnostics:
        """Return what a controller reports of the step, beside the model's next state (n, nx)."""
        n = len(self.status)
        return {
            "prediction": prediction,
            "solver_status": self.status,
            "solver_failed": self.status != _SOLVED,
            "solver_retried": self.retried,
            "solver_seconds": np.full(n, self.seconds / max(n, 1)),
            "linearisations": self.linearisations,
        }


def shifted(plan: np.ndarray) -> np.ndarray:
    """Return a plan (n, N, nu) one step later; its last input is held."""
    return np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)


class SequentialQp:
    """The search for a plan: a pure function of its arguments."""

    def __init__(
        self,
        model: PredictiveModel,
        solver: Solver,
        linearisations: int | Literal["converged"],
        undamped: int = MAX_LINEARISATIONS,
    ) -> None:
        """
        Args:
            model: What is linearised.
            solver: Of the quadratic programmes.
            linearisations: Programmes a step.
            undamped: After so many, the next linearisation is about the mean of the last two plans,
                which ends most cycles.
        """
        self._undamped = undamped
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
        `objective.rest`, and stops there.

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
            if problem.sparsity is not None and not self._checked:
                problem.sparsity.check(problem.a, problem.b)
                self._checked = True
            attempt = Attempt(self._solver, problem)
            after, ends = attempt.inputs, None
            seconds += attempt.seconds
            if attempt.troubled:
                ends = attempt.status != _SOLVED
                retried[env_indices] |= attempt.retried
                last = objective.rest[:, None] if posed == 1 else before
                after = np.where(ends[:, None, None], last, after)
            if self._until_converged:
                change = np.abs(after - before)
                stands = (change <= CONVERGED * self._scale(problem, after)).all((1, 2))
                ends = stands if ends is None else ends | stands
            following = after if posed < self._undamped else 0.5 * (before + after)
            if posed < self._limit and (ends is None or not ends.any()):
                before = following
                continue
            inputs[env_indices], status[env_indices] = after, attempt.status
            count[env_indices] = posed
            if posed == self._limit or ends is None or ends.all():
                break
            on = ~ends
            env_indices = np.arange(n)[env_indices][on]
            theta, start, before = theta[on], start[on], following[on]
            objective = objective.take(on)
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
            bounds=objective.bounds,
        )


def check_solver(solver: Solver, what: str) -> None:
    """Raise ConfigError if `what` needs bounds on states and the solver takes none; "": nothing."""
    if what and not solver.bounds_states:
        raise ConfigError(
            f"the solver {type(solver).__name__.lower()} takes bounds on inputs alone, not {what}; "
            "use the solver clarabel"
        )
