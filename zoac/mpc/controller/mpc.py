"""Your own MPC: a model, weights, bounds and a reference, as a controller that can be tuned."""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from zoac.core.controller import Diagnostics, Memory, Parameters
from zoac.core.errors import ConfigError, ControllerError, suggest
from zoac.mpc.controller.numbers import Numbers, by_name
from zoac.mpc.controller.outputs import ModelWithOutputs
from zoac.mpc.controller.programme import Programme, Weighed
from zoac.mpc.controller.reference import Reference
from zoac.mpc.models.dynamics import made_of
from zoac.mpc.problem import Solver
from zoac.mpc.sqp import About, MpcOptions, SequentialQp, check_solver, shifted

SOLVERS = {
    "clarabel": "clarabel_qp.ClarabelSolver",
    "cvxpy": "cvxpy_qp.CvxpySolver",
    "riccati": "riccati.Riccati",
}
"""Name -> module and class; each loads its own library."""

Weights = Mapping[str | tuple[str, str], float]
Bounds = tuple[float | None, float | None]


class Mpc:
    """An MPC as a batched controller for `zoac.tune`; every number in it can be tuned.

        mpc = Mpc(model, horizon=20, weights={"angle": 10.0, "rate": 1.0, "torque": 0.1},
                  bounds={"torque": (-2.0, 2.0), "angle": (-1.0, 1.0)})
        zoac.tune(env=env, controller=mpc, space=mpc.space("weight"))

    At step t it minimises, over the inputs of `horizon` steps and with e the error of the state,

        sum_{k=0..N-1} discount^k (|e_k|^2_Q + |u_k|^2_R + 2 e_k' S u_k + |u_k - u_{k-1}|^2_Rd)
        + discount^N |e_N|^2_P + penalties of states beyond soft bounds at k = 1..N

    by sequential quadratic programmes (`zoac.mpc.sqp`), and returns the first input.
    """

    def __init__(
        self,
        model: Any,
        horizon: int = 20,
        *,
        weights: Weights,
        terminal: Weights | Literal["riccati"] | None = None,
        rate_weights: Mapping[str, float] | None = None,
        bounds: Mapping[str, Bounds] | None = None,
        rate_bounds: Mapping[str, float] | None = None,
        hard: Sequence[str] = (),
        penalty: float | Mapping[str, float] | None = None,
        reference: Mapping[str, float | slice] | Callable[[np.ndarray], Any] | None = None,
        state: Sequence[int] | Callable[[np.ndarray], np.ndarray] | None = None,
        discount: float = 1.0,
        initial_input: Mapping[str, float] | None = None,
        linearisations: int | Literal["converged"] = 3,
        initial_guess: About = "zero",
        undamped: int = 10,
        solver: str | Solver = "clarabel",
    ) -> None:
        """
        Args:
            model: A `CasadiModel`, a `FunctionModel`, or what has their attributes and methods.
            horizon: N, steps that it looks ahead.
            weights: Q, R and S: a weight for each state or input by name (0 where there is none),
                and entries beside the diagonal by pair, `{("angle", "torque"): 0.2}`. Where tuned
                entries make the matrix indefinite, its negative eigenvalues count as 0.
            terminal: P, likewise, of states; "riccati": the cost to go of the linear-quadratic
                regulator at the constant reference, without bounds; None: the weights of states.
            rate_weights: Rd, of changes of inputs from step to step.
            bounds: (low, high) of inputs and states by name; None: none on that side.
            rate_bounds: Largest change of an input from step to step, hard.
            hard: States whose bounds are hard. Where no plan keeps them, the step counts as failed:
                the controller applies the last plan of this step that was solved, or the input's
                reference, else 0, clipped to its bounds.
            penalty: Cost of a state beyond a soft bound, per unit and step; by name, or one number
                for all. None: 1,000 times the largest weight of a state. While the penalty exceeds
                the bound's multiplier, the bound is kept wherever that is possible.
            reference: Of states and inputs: numbers by name; or slices of the observation, one
                column, which is then held, or `horizon` of them, for x_1 .. x_N; or a function of
                observations (n, o) that returns (n, N, nx), or what broadcasts to it.
            state: Columns of the observation that are the state, or a function of observations
                (n, o) that returns states (n, nx); None: the first nx columns.
            discount: In (0, 1], from step to step.
            initial_input: Input before the first step, for rates; by default 0, clipped to its
                bounds.
            linearisations: Quadratic programmes a step, or "converged"; see
                `zoac.mpc.sqp.MpcOptions`.
            initial_guess: Likewise: "zero" (the inputs' reference, else 0, clipped), or "shifted",
                last step's plan (real-time iteration with `linearisations=1`).
            undamped: Linearisations after which plans are averaged; see `SequentialQp` there.
            solver: "clarabel", "cvxpy" (slow, plain), "riccati" (fastest, no bounds on states,
                rates or tuned bounds), or a `zoac.mpc.problem.Solver`.

        Raises:
            ConfigError: If something cannot be used, or the solver cannot take it.
        """
        self._given = {k: v for k, v in locals().items() if k not in ("self", "model", "__class__")}
        self.model = model
        self.undamped = undamped
        self.options = MpcOptions(horizon, linearisations, initial_guess)
        self.numbers = numbers = Numbers()
        for name, value in model.parameters.items():
            numbers.add("model", name, value)
        self.programme = Programme(
            model, numbers, weights=weights, terminal=terminal, rate_weights=rate_weights,
            bounds=bounds, rate_bounds=rate_bounds, hard=hard, penalty=penalty, discount=discount,
        )  # fmt: skip
        self.reference = Reference(reference, model.states, model.inputs, horizon, numbers)
        columns = range(len(model.states)) if state is None else state
        self.columns = None if callable(columns) else list(columns)
        """Columns of the observation that are the state; None: a function computes it."""
        if self.columns is not None and len(self.columns) != len(model.states):
            expected = f"{len(model.states)} columns of the observation"
            raise ConfigError(f"state={state!r}: expected {expected}")
        before = by_name("initial_input", initial_input, model.inputs)
        self.before = self.programme.clip(np.array([before.get(i, 0.0) for i in model.inputs]))
        """The input (nu,) before the first step."""
        self._solver = _solver(solver)
        self._searches: dict[frozenset[str], tuple[ModelWithOutputs, SequentialQp]] = {}
        self._last: tuple[Any, Weighed, SequentialQp] | None = None
        self._search(frozenset())

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy is built anew: compiled programmes and CasADi's buffers are left behind.
        return made_of, (type(self), {"model": self.model, **self._given})

    def space(self, *names: str, within: float = 100.0, **bounds: Any) -> dict[str, dict[str, Any]]:
        """Return bounds of what is tuned, for `zoac.tune(space=...)`; today's values are in it.

            mpc.space("weight", "terminal", mass={"low": 0.5, "high": 2.0, "unit": "kg"})

        Args:
            names: Numbers, such as "weight_angle", or groups of them: "weight", "terminal",
                "rate_weight", "low", "high", "max_rate", "penalty", "reference", "model". Their
                bounds are value / within and value * within, on a log scale; in a group, those
                that are 0 stay as they are.
            within: That factor.
            bounds: Others, by name, as `zoac.tune` takes them: `(low, high)`,
                `(low, high, "log")`, or a dict with `low`, `high`, `scale`, `unit`.

        Raises:
            ConfigError: If a name is unknown, or today's value lies outside.
        """
        space = self.numbers.space(names, within, bounds)
        self.programme.check_space(space)
        return space

    def init(self, n: int) -> Memory:
        """Return what n controllers remember: their plan if it is shifted, inputs for rates."""
        memory = {}
        if self.options.initial_guess == "shifted":
            memory["plan"] = np.full((n, self.options.horizon, len(self.model.inputs)), np.nan)
        if self.programme.rates:
            memory["input"] = np.tile(self.before, (n, 1))
        return memory

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return the inputs (n, nu), the memory and diagnostics; see `Controller`.

        Diagnostics, n rows each: `prediction` (n, nx), the model's next state; `solver_status`,
        `solver_failed`, `solver_retried`, `solver_seconds`, `linearisations`, as of a
        `zoac.mpc.sqp.Plan`.

        Raises:
            ControllerError: If observations do not fit the model or the reference.
        """
        programme = self.programme
        weighed, search = self._weigh(params, len(obs))
        state = self._state(obs)
        objective, theta = programme.objective(weighed, self.reference(obs, weighed.values))
        start = np.zeros((len(obs), weighed.outputs.size))
        start[:, weighed.outputs.states] = state
        if programme.rates:
            start[:, weighed.outputs.before] = memory["input"][:, programme.rates]
        plan = search.plan(theta, start, objective, self._guess(objective.rest, memory))
        actions = plan.inputs[:, 0].copy()
        after = {"plan": plan.inputs, "input": actions}
        diagnostics = plan.diagnostics(self.model.predict(weighed.theta, state, actions))
        return actions, {name: after[name] for name in memory}, diagnostics

    def export(
        self, parameters: Mapping[str, float], path: str | Path, observation: int | None = None
    ) -> Path:
        """Write the controller as a C file without dependencies; return the path.

        It holds `mpc_init` and `mpc_step`, and computes what `act` does at these parameters.

        Args:
            parameters: Values of tuned numbers by name; others keep theirs.
            path: `.c`.
            observation: Length of the observation; None: as far as states and reference read it.

        Raises:
            ConfigError: If something of the controller has no form in C, or a parameter is unknown
                or out of range.
        """
        from zoac.mpc.export.code import write_c
        from zoac.mpc.export.embedded import of_mpc

        return write_c(of_mpc(self, parameters, observation), path)

    def _weigh(self, params: Parameters, n: int) -> tuple[Weighed, SequentialQp]:
        """Return weights and search, those of the last call while parameters stay the same."""
        key = n, *params, *[np.asarray(value).tobytes() for value in params.values()]
        if self._last is None or self._last[0] != key:
            tuned = self.programme.tuned_bounds(params)
            outputs, search = self._search(tuned)
            values = self.numbers.rows(params, n)
            rest, horizon = self.reference.of_rest(values, n), self.options.horizon
            self._last = key, self.programme.weigh(outputs, values, rest, horizon, tuned), search
        return self._last[1:]

    def _search(self, tuned: frozenset[str]) -> tuple[ModelWithOutputs, SequentialQp]:
        """Return the search for a plan where the bounds of these inputs are tuned."""
        if tuned not in self._searches:
            outputs = self.programme.outputs(tuned | self.reference.of_inputs)
            check_solver(self._solver, self.programme.bounded(tuned))
            search = SequentialQp(outputs, self._solver, self.options.linearisations, self.undamped)
            self._searches[tuned] = outputs, search
        return self._searches[tuned]

    def _state(self, obs: np.ndarray) -> np.ndarray:
        """Return the states (n, nx) that observations (n, o) tell."""
        nx = len(self.model.states)
        if self.columns is None:
            states = np.asarray(self._given["state"](obs.copy()), dtype=np.float64)
            if states.shape != (len(obs), nx):
                raise ControllerError(
                    f"state=...: expected states of shape {(len(obs), nx)}, got {states.shape}"
                )
            return states
        if not -obs.shape[1] <= min(self.columns) <= max(self.columns) < obs.shape[1]:
            raise ControllerError(
                f"the model has {nx} states, the observation {obs.shape[1]} numbers; say by "
                "state=... how the state is read from it"
            )
        return np.take(obs, self.columns, axis=1)  # in C's order, unlike obs[:, columns]

    def _guess(self, rest: np.ndarray, memory: Memory) -> np.ndarray:
        guess = np.repeat(rest[:, None], self.options.horizon, axis=1)
        if "plan" not in memory:
            return guess
        last = shifted(memory["plan"])
        return np.where(np.isnan(last), guess, last)


def _solver(given: str | Solver) -> Solver:
    if not isinstance(given, str):
        return given
    if given not in SOLVERS:
        raise ConfigError(f"solver={given!r}: {suggest(given, SOLVERS)}")
    module, _, name = SOLVERS[given].partition(".")
    return getattr(import_module(f"zoac.mpc.solvers.{module}"), name)()
