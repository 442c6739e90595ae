"""Units in which a linearised problem is solved, so that its numbers are of order one.

A problem in micrometres and one in metres are the same problem, but an interior-point method with
absolute tolerances tells them apart. So states, inputs and cost each get a unit, from the
problem's own data:

- an input between two bounds: half the width of its box;
- another input: what it would take to undo the rollout's errors;
- a state: what the inputs, one unit each, can move it by within nx steps;
- the cost: the largest weight in these units.

All but the first are powers of two, which scale without rounding, and are 1 while the data are
within `STATE_RANGE` or `COST_RANGE` of it: a well-scaled problem is solved as it stands.
"""

from typing import NamedTuple

import numpy as np

from zoac.mpc.compiled import compiled
from zoac.mpc.problem import LinearisedProblem

STATE_RANGE, INPUT_RANGE, COST_RANGE = 2.0**7, 2.0**10, 2.0**20
"""What is between 1 / range and range keeps its own unit."""


class Units(NamedTuple):
    """Units of n problems.

    Args:
        states: (n, nx).
        inputs: (n, nu).
        cost: (n,).
    """

    states: np.ndarray
    inputs: np.ndarray
    cost: np.ndarray


def units(problem: LinearisedProblem, always: bool = False) -> Units:
    """Return the units of each of the n problems.

    Args:
        problem: The problems.
        always: Scale what is within the ranges too.
    """
    n, _, nx, nu = problem.b.shape
    found = Units(np.empty((n, nx)), np.empty((n, nu)), np.empty(n))
    half = 0.5 * (problem.input_high - problem.input_low)
    ranges = (1.0, 1.0, 1.0) if always else (STATE_RANGE, INPUT_RANGE, COST_RANGE)
    _find(np.where(np.isfinite(half), half, 0.0), problem.data, ranges, found)
    return found


@compiled(error_model="numpy")
def _find(
    boxes: np.ndarray,
    data: tuple[np.ndarray, ...],
    ranges: tuple[float, float, float],
    found: Units,
) -> None:
    """Write the units of each problem; `boxes` (nu,) is 0 for an input that is free or fixed."""
    rollout, _, a, b, reference, state_weights, input_weights = data
    states, inputs, cost = found
    n, horizon, nx, nu = b.shape
    state_range, input_range, cost_range = ranges
    free = not np.all(boxes > 0)
    for env_index in range(n):
        reach = np.zeros((nx, nu))  # by how much one unit of each input moves each state
        early = reach
        squared = np.zeros(nu)
        for k in range(horizon if free else min(nx, horizon)):
            moved = np.abs(b[env_index, k])
            for i in range(nx):
                for other in range(nx):
                    factor = abs(a[env_index, k, i, other])
                    for j in range(nu):
                        moved[i, j] += factor * reach[other, j]
            reach = moved
            if k < nx:
                early = reach
            if not free:
                continue
            for j in range(nu):
                error, curvature = 0.0, input_weights[env_index, k, j]
                for i in range(nx):
                    weight = state_weights[env_index, k, i]
                    error += (
                        weight * (rollout[env_index, k + 1, i] - reference[env_index, k, i]) ** 2
                    )
                    curvature += weight * reach[i, j] ** 2
                squared[j] = max(squared[j], error / curvature)
        for j in range(nu):
            inputs[env_index, j] = boxes[j]
            if boxes[j] == 0:
                inputs[env_index, j] = 1.0
                if _far(np.sqrt(squared[j]), input_range):
                    inputs[env_index, j] = _power_of_two(np.sqrt(squared[j]))
        any_far = False
        for i in range(nx):
            states[env_index, i] = 0.0
            for j in range(nu):
                states[env_index, i] += early[i, j] * inputs[env_index, j]
            if states[env_index, i] == 0:  # no input moves it
                for k in range(horizon):
                    error = abs(rollout[env_index, k + 1, i] - reference[env_index, k, i])
                    states[env_index, i] = max(states[env_index, i], error)
            any_far |= _far(states[env_index, i], state_range)
        largest = 0.0
        for i in range(nx):
            states[env_index, i] = _power_of_two(states[env_index, i]) if any_far else 1.0
            for k in range(horizon):
                largest = max(largest, state_weights[env_index, k, i] * states[env_index, i] ** 2)
        for j in range(nu):
            for k in range(horizon):
                largest = max(largest, input_weights[env_index, k, j] * inputs[env_index, j] ** 2)
        cost[env_index] = _power_of_two(largest) if _far(largest, cost_range) else 1.0


@compiled(error_model="numpy")
def _far(size: float, limit: float) -> bool:
    return size > 0 and not (1 / limit <= size <= limit)


@compiled(error_model="numpy")
def _power_of_two(size: float) -> float:
    """Return the power of two nearest `size`; 1 for 0 and for what a double cannot square."""
    return float(2.0 ** np.round(np.log2(size))) if 1e-150 < size < 1e150 else 1.0
