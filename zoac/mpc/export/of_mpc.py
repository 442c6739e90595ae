"""An `Mpc` at given parameters, as an `EmbeddedMpc`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi
import numpy as np

from zoac.core.errors import ConfigError
from zoac.mpc.controller.numbers import Numbers
from zoac.mpc.controller.outputs import ModelWithOutputs
from zoac.mpc.controller.programme import Programme
from zoac.mpc.controller.reference import Reference
from zoac.mpc.export.embedded import EmbeddedMpc, linear_in, model_step
from zoac.mpc.sqp import MpcOptions, Objective


def embedded(
    model: Any,
    numbers: Numbers,
    programme: Programme,
    reference: Reference,
    options: MpcOptions,
    state: list[int] | None,
    before: np.ndarray,
    parameters: Mapping[str, float],
    observation: int | None,
) -> EmbeddedMpc:
    """Return what an `Mpc` computes at fixed parameters.

    Args:
        model: Its model.
        numbers: All its numbers.
        programme: What it minimises.
        reference: Its reference.
        options: How it plans.
        state: Columns of the observation that are the state; None: a function computes it.
        before: (nu,), the input before the first step.
        parameters: Values that replace some of `numbers`.
        observation: Length of the observation; None: as far as the MPC reads it.

    Raises:
        ConfigError: If something of it has no form in C.
    """
    for what, is_function in (("state", state is None), ("reference", reference.is_function)):
        if is_function:
            raise ConfigError(
                f"export to C: {what}=... is a function of Python's; give "
                f"{'columns' if what == 'state' else 'numbers or slices'} of the observation"
            )
    if programme.of_regulator and reference.columns:
        raise ConfigError(
            "export to C: terminal='riccati' changes with a reference that is observed; give "
            "terminal weights by name"
        )
    assert state is not None
    length = _length(state, reference) if observation is None else observation
    values = numbers.rows({k: np.full(1, v) for k, v in parameters.items()}, 1)
    outputs = programme.outputs(reference.of_inputs)
    theta: list[np.ndarray] = []

    def read(observations: np.ndarray) -> Objective:
        n = len(observations)
        rows = {name: np.repeat(value, n) for name, value in values.items()}
        states, rest = reference(observations, rows)
        rest = programme.clip(rest)
        objective, of_rows = programme.objective(outputs, rows, states, rest, frozenset())
        theta.append(of_rows[0])
        return objective

    objective, target, preview = linear_in(read, length)
    return EmbeddedMpc(
        step=_step(model, outputs, theta[0]),
        options=options,
        observation=length,
        state=state,
        before=[(outputs.before.start + i, j) for i, j in enumerate(programme.rates)],
        initial_input=before,
        objective=objective,
        reference=target,
        preview=preview,
        box=programme.box({name: value[0] for name, value in values.items()}),
        outer_box=programme.box(numbers.values),
    )


def _length(state: list[int], reference: Reference) -> int:
    ends = [i + 1 for i in state]
    for columns in reference.columns:
        if columns.stop is None or columns.stop < 0 or (columns.start or 0) < 0:
            raise ConfigError(f"export to C: {columns} needs export(..., observation=its length)")
        ends.append(columns.stop)
    return max(ends)


def _step(model: Any, outputs: ModelWithOutputs, theta: np.ndarray) -> Any:
    """Return (z, u) -> next z of a model with outputs, as `ModelWithOutputs` linearises it."""
    own, matrices = np.split(theta, [len(model.parameters)])
    x, u = casadi.SX.sym("x", len(model.states)), casadi.SX.sym("u", len(model.inputs))
    rest = casadi.SX.sym("rest", outputs.size - len(model.states))
    before = rest[: len(outputs.rates)]
    after, point = model_step(model, own)(x, u), casadi.vertcat(x, u)
    rated = casadi.vertcat(*(u[j] for j in outputs.rates))
    parts = [after, rated, rated - before, *(u[j] for j in outputs.copies)]
    for part, seen in ((outputs.stage, point), (outputs.end, after)):
        size = part.stop - part.start
        rows, matrices = np.split(matrices, [size * size])
        parts += [casadi.DM(rows.reshape(size, size)) @ seen] if size else []
    return casadi.Function("step", [casadi.vertcat(x, rest), u], [casadi.vertcat(*parts)])
