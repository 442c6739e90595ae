"""What an MPC computes with its parameters fixed, ready to be written in another language."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError
from zoac.mpc.sqp import MpcOptions, Objective

Read = Callable[[np.ndarray], Objective]


@dataclass(frozen=True, eq=False)
class EmbeddedMpc:
    """An MPC whose parameters are numbers; the state z may hold outputs beside the model's state.

    Args:
        step: CasADi function of (z, u) that returns the next z.
        options: Horizon N, linearisations, initial guess.
        observation: Length of the observation.
        state: Columns of the observation that begin z.
        before: Position in z, and input, of each input of the step before.
        initial_input: (nu,), the input before the first step.
        objective: One row; its reference is replaced by the two below.
        reference: (N, nz), at an observation of zeros.
        preview: (N * nz, observation), by how much each entry of the observation moves it.
        box: Lower and upper bounds of the inputs, (nu,) each.
        outer_box: Those that clip what is applied where no programme was solved.
    """

    step: Any
    options: MpcOptions
    observation: int
    state: list[int]
    before: list[tuple[int, int]]
    initial_input: np.ndarray
    objective: Objective
    reference: np.ndarray
    preview: np.ndarray
    box: tuple[np.ndarray, np.ndarray]
    outer_box: tuple[np.ndarray, np.ndarray]

    @property
    def rest(self) -> np.ndarray:
        """The inputs (nu,) applied where no programme was solved, and the first guess."""
        given = self.objective.rest
        return np.clip(0.0 if given is None else given[0], *self.outer_box)


def linear_in(read: Read, observation: int) -> tuple[Objective, np.ndarray, np.ndarray]:
    """Return an objective (one row), its reference (N, nz) and the reference's slope, as above.

    Args:
        read: Returns the objective at observations (n, o); its reference is affine in them.
        observation: Their length o.
    """
    given = read(np.vstack([np.zeros(observation), np.eye(observation)]))
    targets = given.reference.reshape(observation + 1, -1)
    first = given.take(np.array([0]))
    return first, given.reference[0], np.ascontiguousarray((targets[1:] - targets[0]).T)


def model_step(model: Any, theta: np.ndarray) -> Any:
    """Return a model's CasADi function of (x, u) to the next state, at given parameters.

    Raises:
        ConfigError: If the model is not written in CasADi's symbols.
    """
    function = getattr(model, "function", None)
    if function is None:
        raise ConfigError(
            f"export to C: the model is a {type(model).__name__}, of which CasADi knows no "
            "formula; give the same function to zoac.mpc.CasadiModel"
        )
    import casadi

    x, u = (casadi.SX.sym(name, function.size1_in(i)) for i, name in enumerate("xu"))
    return casadi.Function("step", [x, u], function.call([x, u, theta])[:1])


def check_exportable(embedded: EmbeddedMpc) -> None:
    """See that a fixed number of programmes with consistent bounds is solved each step.

    Raises:
        ConfigError: If not.
    """
    if embedded.options.linearisations == "converged":
        raise ConfigError(
            "export to C: linearisations='converged' has no bound on its time; set "
            "linearisations=5, which differs by 1e-7 of the input's range where it converges at "
            "all, and tune with that"
        )
    bounds = embedded.objective.bounds
    pairs = [embedded.box] if bounds is None else [embedded.box, (bounds.low[0], bounds.high[0])]
    for low, high in pairs:
        if (low > high).any():
            raise ConfigError("export to C: a tuned lower bound is above its upper bound")
