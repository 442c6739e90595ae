"""The numbers of a linearised problem, as the parameters of `zoac.mpc.formulation`.

The numbers are scaled, problem by problem: states, inputs and cost by their units
(`zoac.mpc.solvers.scaling`), the objective then so that the rollout costs about 1,000. An
interior-point method begins at slacks of about 1 whatever the numbers; scaled so, it needs a fifth
fewer iterations in closed loop, and its plans are no less accurate.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from zoac.mpc.compiled import compiled
from zoac.mpc.formulation import Layout
from zoac.mpc.problem import LinearisedProblem
from zoac.mpc.solvers.scaling import Units

_ROLLOUT_COST = 1e3
_OBJECTIVE_SCALES = 0.1, 100.0  # beyond, the tolerances would mean too little or ask too much
_LARGEST_PENALTY = 1e3
"""Multipliers of many thousands cost an interior-point method its accuracy. But where no bound is
active, so small an objective does; a robust solve does without this."""


def write_parameters(
    problem: LinearisedProblem,
    layout: Layout,
    units: Units,
    parameters: np.ndarray,
    starts: Mapping[str, int],
    largest_penalty: float = _LARGEST_PENALTY,
) -> np.ndarray:
    """Write each problem's parameters, in `units`.

    Args:
        problem: The problems.
        layout: Theirs.
        units: Likewise.
        parameters: (n, ...), C-contiguous, what is written to.
        starts: Column at which the parameter of each name begins: dynamics, weights, bounds.
        largest_penalty: Limit on scaled penalties; the whole objective becomes smaller with them.

    Returns:
        By how much each problem's objective is multiplied (n,).
    """
    scales = np.empty(len(problem.b))
    box = np.where((layout.low, layout.high), problem.box, 0.0)
    begin = starts["dynamics"], starts["weights"]
    _write(_entries(layout), problem.data, box, units, parameters, begin, scales)
    scales /= units.cost
    if problem.bounds is not None and layout.bounds_size:
        given, soft, low, high = problem.bounds, layout.soft, layout.state_low, layout.state_high
        of_unit = units.states[:, None]
        pieces = [
            ((bound[:, None] - problem.reference) / of_unit)[:, :, list(which)].swapaxes(1, 2)
            for bound, which in ((given.low, low), (given.high, high))
        ]
        penalty = given.penalty[:, list(soft)] * units.states[:, list(soft)]
        largest = penalty.max(axis=1, initial=0.0) * scales
        less = np.minimum(largest_penalty / np.maximum(largest, 1e-300), 1.0)
        scales *= less
        parameters[:, begin[1] : begin[1] + layout.weights_size] *= less[:, None]
        penalty *= scales[:, None]
        bounds = parameters[:, starts["bounds"] : starts["bounds"] + layout.bounds_size]
        np.concatenate([*(p.reshape(len(p), -1) for p in pieces), penalty], axis=1, out=bounds)
    return scales


@lru_cache
def _entries(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    a, b = (np.array(e, dtype=np.int64).reshape(-1, 2) for e in (layout.a, layout.b))
    return a, b


@compiled(error_model="numpy")
def _write(
    entries: tuple[np.ndarray, np.ndarray],
    data: tuple[np.ndarray, ...],
    box: np.ndarray,
    units: Units,
    parameters: np.ndarray,
    begin: tuple[int, int],
    scales: np.ndarray,
) -> None:
    a_entries, b_entries = entries
    states, inputs, a, b, reference, state_weights, input_weights = data
    n, horizon, nx, nu = b.shape
    gap = len(a_entries) * (horizon - 1) + len(b_entries) * horizon  # where the gaps begin
    for env_index in range(n):
        dynamics = parameters[env_index, begin[0] :]
        weights = parameters[env_index, begin[1] : begin[1] + (nx + nu) * horizon]
        to = 0
        cost = 0.0
        x_unit, u_unit = units.states[env_index], units.inputs[env_index]
        cost_unit = units.cost[env_index]
        for i in range(nx):
            for k in range(horizon):
                error = (states[env_index, k + 1, i] - reference[env_index, k, i]) / x_unit[i]
                weight = state_weights[env_index, k, i] * x_unit[i] ** 2 / cost_unit
                dynamics[gap + i * horizon + k] = error
                weights[i * horizon + k] = weight
                cost += weight * error * error
        for entry in range(len(a_entries)):
            i, j = a_entries[entry, 0], a_entries[entry, 1]
            for k in range(1, horizon):
                value = a[env_index, k, i, j] * (x_unit[j] / x_unit[i])
                dynamics[to] = value
                to += 1
                before = (reference[env_index, k - 1, j] - states[env_index, k, j]) / x_unit[j]
                dynamics[gap + i * horizon + k] += value * before
        for entry in range(len(b_entries)):
            i, j = b_entries[entry, 0], b_entries[entry, 1]
            for k in range(horizon):
                value = b[env_index, k, i, j] / x_unit[i]
                dynamics[to] = value * u_unit[j]
                to += 1
                dynamics[gap + i * horizon + k] -= value * inputs[env_index, k, j]
        to += nx * horizon
        for j in range(nu):
            dynamics[to + j] = box[0, j] / u_unit[j]
            dynamics[to + nu + j] = box[1, j] / u_unit[j]
            for k in range(horizon):
                weight = input_weights[env_index, k, j] / cost_unit
                weights[(nx + j) * horizon + k] = weight * u_unit[j] * u_unit[j]
                cost += weight * inputs[env_index, k, j] * inputs[env_index, k, j]
        scales[env_index] = min(
            max(_ROLLOUT_COST / cost, _OBJECTIVE_SCALES[0]), _OBJECTIVE_SCALES[1]
        )
        weights *= scales[env_index]
