"""The tracking MPC as a function of its 19 parameters and the observation."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from zoac.core.controller import Diagnostics, Memory, Parameters
from zoac.core.errors import ControllerError
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.mpc.compiled import compiled
from zoac.mpc.controller.numbers import by_name
from zoac.mpc.problem import PENALTY, Solver, StateBounds
from zoac.mpc.sqp import MpcOptions, Objective, SequentialQp, check_solver, shifted
from zoac.tasks.mpc_tracking.path import SPEED
from zoac.tasks.mpc_tracking.vehicle import INPUTS, STATES, TRUE_PARAMETERS, BicycleModel

WeightLayout = Literal["separate", "aliased"]

DISCOUNT = 0.99
FIXED_STAGE_U = 1e-2
"""Scaling all weights alike changes nothing, so the stage weight of u is fixed."""

_MODEL = (
    Parameter("I_z", 1e3, 2e3, unit="kg m^2"),
    Parameter("k_f", -16e4, -8e4, unit="N/rad"),
    Parameter("k_r", -16e4, -8e4, unit="N/rad"),
    Parameter("l_f", 0.8, 2.2, unit="m"),
    Parameter("l_r", 0.8, 2.2, unit="m"),
    Parameter("m", 1e3, 2e3, unit="kg"),
)
_STAGE = tuple(f"stage_{name}" for name in STATES if name != "u")
_TERMINAL = tuple(f"terminal_{name}" for name in STATES)
_INPUT = tuple(f"input_{name}" for name in INPUTS)

SPACE = ParameterSpace(
    [
        *_MODEL,
        *(Parameter(name, 1e-6, 1e2, "log") for name in (*_STAGE, *_TERMINAL, *_INPUT)),
    ]
)

NOMINAL = {
    **{p.name: float(value) for p, value in zip(_MODEL, TRUE_PARAMETERS, strict=True)},
    **dict(zip(_STAGE, (1e-6, 0.04, 0.1, 1e-6, 0.02), strict=True)),
    **dict(zip(_TERMINAL, (1e-6, 0.04, 0.1, 0.01, 1e-6, 0.02), strict=True)),
    **dict(zip(_INPUT, (5.0, 0.05), strict=True)),
}
"""True model, weights of the real cost, scaled so that the weight of u is 1e-2."""

TERMINAL_READ = {
    "separate": _TERMINAL,
    "aliased": (*_INPUT, *_TERMINAL[:4]),
}
"""Which parameters are the terminal weights of x, y, phi, u, v, omega.

The authors' code keeps 13 weights as (stage 5, input 2, terminal 6) and reads the terminal ones
two places too early: the input weights are also the terminal weights of x and y, what should
weigh x, y, phi, u weighs phi, u, v, omega, and the last two are never read.
"""


class TrackingMpc:
    """U_t = pi_theta(observation): the first input of the plan; see `zoac.mpc.sqp`."""

    def __init__(
        self, solver: Solver, options: MpcOptions | None = None, weights: WeightLayout = "separate"
    ) -> None:
        """
        Args:
            solver: Of the quadratic programmes.
            options: How it plans.
            weights: Each of the 13 weights its own (the paper), or `aliased` as in the authors'
                code (`TERMINAL_READ`).

        Raises:
            ConfigError: If a bound names no state, or the solver takes no bounds on states.
        """
        self._options = options = options or MpcOptions()
        self._model = BicycleModel()
        self._search = SequentialQp(self._model, solver, options.linearisations)
        horizon = options.horizon
        stage = [SPACE.names.index(name) for name in _STAGE]
        stage.insert(STATES.index("u"), SPACE.dimension)  # the fixed weight, after the last
        terminal = [SPACE.names.index(name) for name in TERMINAL_READ[weights]]
        inputs = [SPACE.names.index(name) for name in _INPUT]
        self._columns = (np.array(stage), np.array(terminal), np.array(inputs))
        self._discounts = DISCOUNT ** np.arange(horizon + 1)
        self._low = _by_state("state_low", options.state_low, -np.inf)
        self._high = _by_state("state_high", options.state_high, np.inf)
        self._bounded = bool(np.isfinite((self._low, self._high)).any())
        check_solver(solver, "task.mpc.state_low and state_high" * self._bounded)

    def init(self, n: int) -> Memory:
        """Return {} or, with `initial_guess: shifted`, {"plan": (n, N_p, 2)}."""
        if self._options.initial_guess == "zero":
            return {}
        return {"plan": np.zeros((n, self._options.horizon, 2))}

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return the inputs (n, 2), the memory and diagnostics; see `Controller`.

        Diagnostics are those of `zoac.mpc.Mpc.act`; `prediction` (n, 6) = F_theta(X_t, U_t).

        Raises:
            ControllerError: If the observation's length does not fit the horizon.
        """
        n = len(obs)
        expected = 6 + 3 * self._options.horizon
        if obs.shape != (n, expected):
            raise ControllerError(
                f"an MPC with horizon {self._options.horizon} reads observations of shape "
                f"(n, {expected}), got {obs.shape}"
            )
        values = np.empty((n, SPACE.dimension + 1))
        values[:, :-1] = np.concatenate([params[name] for name in SPACE.names]).reshape(-1, n).T
        values[:, -1] = FIXED_STAGE_U
        theta = values[:, : len(_MODEL)].copy()
        state = obs[:, :6].copy()
        guess = shifted(memory["plan"]) if memory else np.zeros((n, self._options.horizon, 2))
        plan = self._search.plan(theta, state, self._objective(values, obs), guess)
        actions = plan.inputs[:, 0].copy()
        diagnostics = plan.diagnostics(self._model.predict(theta, state, actions))
        return actions, ({"plan": plan.inputs} if memory else memory), diagnostics

    def export(
        self, parameters: Mapping[str, float], path: str | Path, observation: int | None = None
    ) -> Path:
        """Write the controller as a C file; see `zoac.mpc.Mpc.export`.

        Raises:
            ConfigError: If it solves programmes until they converge.
        """
        from zoac.mpc.export.code import write_c
        from zoac.mpc.export.embedded import EmbeddedMpc, linear_in, model_step

        values = np.array([*(parameters[name] for name in SPACE.names), FIXED_STAGE_U])
        length = 6 + 3 * self._options.horizon
        objective, reference, preview = linear_in(
            lambda obs: self._objective(np.tile(values, (len(obs), 1)), obs), length
        )
        return write_c(
            EmbeddedMpc(
                step=model_step(self._model, values[: len(_MODEL)]),
                options=self._options,
                observation=length,
                state=list(range(6)),
                before=[],
                initial_input=np.zeros(2),
                objective=objective,
                reference=reference,
                preview=preview,
                box=(self._model.input_low, self._model.input_high),
            ),
            path,
        )

    def _objective(self, values: np.ndarray, obs: np.ndarray) -> Objective:
        n, horizon = len(obs), self._options.horizon
        objective = Objective(
            reference=np.zeros((n, horizon, 6)),
            state_weights=np.empty((n, horizon, 6)),
            input_weights=np.empty((n, horizon, 2)),
        )
        _write_objective(
            obs,
            values,
            self._columns,
            self._discounts,
            objective.reference,
            objective.state_weights,
            objective.input_weights,
        )
        if not self._bounded:
            return objective
        return replace(objective, bounds=self._state_bounds(values[:, self._columns[0]]))

    def _state_bounds(self, weights: np.ndarray) -> StateBounds:
        """Return the bounds on the states of n environments, given their stage weights (n, 6)."""
        options, ones = self._options, np.ones((len(weights), 6))
        price = options.state_penalty
        penalty = ones * (PENALTY * weights.max(axis=1)[:, None] if price is None else price)
        penalty = np.full_like(ones, np.inf) if options.state_bounds == "hard" else penalty
        return StateBounds(ones * self._low, ones * self._high, penalty)


def _by_state(option: str, given: Mapping[str, float] | None, absent: float) -> np.ndarray:
    """Return bounds (6,) from those given by name."""
    bounds = by_name(f"mpc.{option}", given, STATES)
    return np.array([bounds.get(name, absent) for name in STATES], dtype=np.float64)


@compiled()
def _write_objective(
    obs: np.ndarray,
    values: np.ndarray,
    columns: tuple[np.ndarray, np.ndarray, np.ndarray],
    discounts: np.ndarray,
    reference: np.ndarray,
    state_weights: np.ndarray,
    input_weights: np.ndarray,
) -> None:
    stage, terminal, inputs = columns
    n, horizon, _ = reference.shape
    for env_index in range(n):
        for k in range(horizon):
            for i in range(3):
                reference[env_index, k, i] = obs[env_index, 6 + 3 * k + i]
            reference[env_index, k, 3] = SPEED
            weights = stage if k < horizon - 1 else terminal
            for i in range(6):
                state_weights[env_index, k, i] = values[env_index, weights[i]] * discounts[k + 1]
            for i in range(2):
                input_weights[env_index, k, i] = values[env_index, inputs[i]] * discounts[k]
