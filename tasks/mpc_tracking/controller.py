"""The tracking MPC as a function of its 19 parameters and the observation."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from zoac.core.controller import Diagnostics, Memory, Parameters
from zoac.core.errors import ControllerError
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.mpc.controller.mpc import Mpc
from zoac.mpc.controller.numbers import by_name
from zoac.mpc.problem import Solver
from zoac.mpc.sqp import MAX_LINEARISATIONS, MpcOptions, check_solver
from zoac.tasks.mpc_tracking.path import SPEED
from zoac.tasks.mpc_tracking.vehicle import (
    INPUT_HIGH,
    INPUT_LOW,
    INPUTS,
    STATES,
    TRUE_PARAMETERS,
    BicycleModel,
)

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
    """U_t = pi_theta(observation): an `Mpc` whose numbers are the task's 19 parameters."""

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
        options = options or MpcOptions()
        low, high = (by_name(f"mpc.{side}", getattr(options, side), STATES)
                     for side in ("state_low", "state_high"))  # fmt: skip
        pairs = {name: (low.get(name, -np.inf), high.get(name, np.inf)) for name in (*low, *high)}
        of_states = {name: pair for name, pair in pairs.items() if np.isfinite(pair).any()}
        check_solver(solver, "task.mpc.state_low and state_high" * bool(of_states))
        ones: dict[Any, float] = dict.fromkeys((*STATES, *INPUTS), 1.0)
        self._length = 6 + 3 * options.horizon
        limits = zip(INPUT_LOW.tolist(), INPUT_HIGH.tolist(), strict=True)
        self._mpc = Mpc(
            BicycleModel(),
            options.horizon,
            weights=ones | {"u": FIXED_STAGE_U},
            terminal=dict.fromkeys(STATES, 1.0),
            bounds=dict(zip(INPUTS, limits, strict=True)) | of_states,
            hard=tuple(of_states) if options.state_bounds == "hard" else (),
            penalty=options.state_penalty,
            reference={name: slice(6 + i, None, 3) for i, name in enumerate(("x", "y", "phi"))}
            | {"u": SPEED},
            discount=DISCOUNT,
            linearisations=options.linearisations,
            initial_guess=options.initial_guess,
            undamped=MAX_LINEARISATIONS,
            solver=solver,
        )
        terminal = (f"terminal_{name}" for name in STATES)
        self._read = {
            **{p.name: p.name for p in _MODEL},
            **{name.replace("stage", "weight"): name for name in _STAGE},
            **{name.replace("input", "weight"): name for name in _INPUT},
            **dict(zip(terminal, TERMINAL_READ[weights], strict=True)),
        }
        """Number of the MPC -> parameter of the task."""

    def init(self, n: int) -> Memory:
        """Return {} or, with `initial_guess: shifted`, {"plan": (n, N_p, 2)}."""
        return self._mpc.init(n)

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return the inputs (n, 2), the memory and diagnostics; see `Mpc.act`.

        Raises:
            ControllerError: If the observation's length does not fit the horizon.
        """
        if obs.shape[1] != self._length:
            raise ControllerError(
                f"an MPC with horizon {self._mpc.options.horizon} reads observations of shape "
                f"(n, {self._length}), got {obs.shape}"
            )
        return self._mpc.act({to: params[name] for to, name in self._read.items()}, obs, memory)

    def export(
        self, parameters: Mapping[str, float], path: str | Path, observation: int | None = None
    ) -> Path:
        """Write the controller as a C file; see `zoac.mpc.Mpc.export`.

        Raises:
            ConfigError: If it solves programmes until they converge.
        """
        given = {to: parameters[name] for to, name in self._read.items()}
        return self._mpc.export(given, path, self._length)
