"""What an MPC computes with its parameters fixed, ready to be written in another language."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError
from zoac.mpc.controller.outputs import ModelWithOutputs
from zoac.mpc.controller.reference import Reference
from zoac.mpc.sqp import MAX_LINEARISATIONS, MpcOptions, Objective


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
        undamped: Programmes of a step after which plans are averaged; see `SequentialQp`.
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
    undamped: int = MAX_LINEARISATIONS


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


def of_mpc(mpc: Any, parameters: Mapping[str, float], observation: int | None) -> EmbeddedMpc:
    """Return what an `Mpc` (which imports this module) computes at fixed parameters.

    Raises:
        ConfigError: If something of it has no form in C.
    """
    programme, reference, state = mpc.programme, mpc.reference, mpc.columns
    if state is None or reference.function is not None:
        what = "state" if state is None else "reference"
        instead = "columns" if state is None else "numbers or slices"
        raise ConfigError(
            f"export to C: {what}=... is a function of Python's; give {instead} of the observation"
        )
    if programme.of_regulator and reference.columns:
        raise ConfigError(
            "export to C: terminal='riccati' changes with a reference that is observed; give "
            "terminal weights by name"
        )
    programme.check(parameters)
    length = _length(state, reference) if observation is None else observation
    if not -length <= min(state) <= max(state) < length:
        raise ConfigError(
            f"export to C: state={state} is not in an observation of {length} numbers"
        )
    outputs = programme.outputs(reference.of_inputs)
    # The reference is affine in the observation: what it is at zero, and by each of its entries.
    observations = np.vstack([np.zeros(length), np.eye(length)])
    given = {name: np.full(length + 1, value) for name, value in parameters.items()}
    values = mpc.numbers.rows(given, length + 1)
    rest = reference.of_rest(values, length + 1)
    weighed = programme.weigh(outputs, values, rest, mpc.options.horizon, frozenset())
    objective, theta = programme.objective(weighed, reference(observations, values))
    targets = objective.reference.reshape(length + 1, -1)
    outer = programme.box(mpc.numbers.values)
    low, high = programme.box({name: value[0] for name, value in values.items()})
    return EmbeddedMpc(
        step=_step(mpc.model, outputs, theta[0]),
        options=mpc.options,
        observation=length,
        state=state,
        before=[(outputs.before.start + i, j) for i, j in enumerate(programme.rates)],
        initial_input=mpc.before,
        objective=objective.take(np.array([0])),
        reference=objective.reference[0],
        preview=np.ascontiguousarray((targets[1:] - targets[0]).T),
        # As in `act`, a tuned bound only narrows the bounds that the MPC was built with.
        box=(np.maximum(low, outer[0]), np.minimum(high, outer[1])),
        undamped=mpc.undamped,
    )


def _length(state: list[int], reference: Reference) -> int:
    if min(state) < 0:
        raise ConfigError(f"export to C: state={state} needs export(..., observation=its length)")
    ends = [i + 1 for i in state]
    for columns in reference.columns:
        if columns.stop is None or columns.stop < 0 or (columns.start or 0) < 0:
            raise ConfigError(f"export to C: {columns} needs export(..., observation=its length)")
        ends.append(columns.stop)
    return max(ends)


def _step(model: Any, outputs: ModelWithOutputs, theta: np.ndarray) -> Any:
    """Return (z, u) -> next z of a model with outputs, as `ModelWithOutputs` linearises it."""
    import casadi

    own, matrices = np.split(theta, [len(model.parameters)])
    x, u = casadi.SX.sym("x", len(model.states)), casadi.SX.sym("u", len(model.inputs))
    rest = casadi.SX.sym("rest", outputs.size - len(model.states))
    after, point = model_step(model, own)(x, u), casadi.vertcat(x, u)
    changes = (u[j] - rest[i] for i, j in enumerate(outputs.rates))
    parts = [after, *(u[j] for j in outputs.rates), *changes, *(u[j] for j in outputs.copies)]
    for part, seen in ((outputs.stage, point), (outputs.end, after)):
        size = part.stop - part.start
        rows, matrices = np.split(matrices, [size * size])
        parts += [casadi.DM(rows.reshape(size, size)) @ seen] if size else []
    return casadi.Function("step", [casadi.vertcat(x, rest), u], [casadi.vertcat(*parts)])
