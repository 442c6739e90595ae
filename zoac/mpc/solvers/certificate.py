"""Proof that a plan is optimal, from the problem's data alone, whatever its solver said of it."""

import numpy as np

from zoac.mpc.compiled import compiled
from zoac.mpc.problem import LinearisedProblem, Solution, StateBounds, Status
from zoac.mpc.solvers.scaling import units

EXCESS_COST = 1e-4
"""No plan is cheaper than a proven one by more than this part of its cost; or else"""

EXCESS_INPUT = 1e-6
"""no input of it moves by more than this part of its range, if each alone goes to its optimum."""

ROUNDING = 1e-3
"""Part of the penalties that counts as cost above: where a bound cannot be kept, they may be so
large that rounding alone exceeds 1e-4 of the rest."""

HARD = 1e-6
"""A hard bound is kept if a state is beyond it by no more than this, or this part of the state."""

REST = 1e-8
"""What bounds on states may leave between Lagrangian and cost where a plan costs next to nothing,
in units of cost."""


def certified(
    problem: LinearisedProblem, solution: Solution, multipliers: np.ndarray | None = None
) -> Solution:
    """Return `solution`, with the status INACCURATE where a plan said to be solved has no proof."""
    proven = is_optimal(problem, solution.inputs, multipliers)
    status = solution.status
    unproven = (status == Status.SOLVED) & ~proven
    if unproven.any():
        status = np.where(unproven, Status.INACCURATE, status).astype(np.int8)
    return Solution(solution.inputs, status, solution.iterations)


def is_optimal(
    problem: LinearisedProblem, inputs: np.ndarray, multipliers: np.ndarray | None = None
) -> np.ndarray:
    """Tell for each problem (n,) whether `inputs` (n, N, nu), inside the box, is its optimum.

    With g the objective's gradient by the adjoint equation and r the input weights, no plan is
    cheaper by more than the sum of g d - r d^2, d = clip(g / 2r, u - high, u - low): the objective
    less that of r alone is convex. That is compared to the plan's cost. A plan that costs next to
    nothing may fail there for rounding. It is then judged by |u - clip(u - g / h)|, h being the
    curvature in that input alone.

    With bounds on states, g is that of the Lagrangian, whose minimum no plan can cost less than.
    Any `multipliers` (n, N, nx) of them will do, positive where the state is pressed down by its
    upper bound, at most the penalty. What they leave between Lagrangian and cost counts as excess,
    and hard bounds must hold to 1e-6 of the state's size.
    """
    scale = problem.input_high - problem.input_low
    of_problem = units(problem)
    scales = np.where(np.isfinite(scale), scale, of_problem.inputs)
    none = np.empty((len(inputs), 0))
    bounds = problem.bounds or StateBounds(none, none, none)
    if problem.bounds is None or multipliers is None:
        multipliers = np.zeros((*inputs.shape[:2], bounds.low.shape[1]))
    pressed = np.clip(multipliers, -bounds.penalty[:, None], bounds.penalty[:, None])
    of_states = bounds.low, bounds.high, bounds.penalty, pressed
    return _judge(problem.data, problem.box, of_states, scales, of_problem.cost, inputs)


@compiled(error_model="numpy")
def _judge(
    data: tuple[np.ndarray, ...],
    box: tuple[np.ndarray, np.ndarray],
    bounds: tuple[np.ndarray, ...],
    scales: np.ndarray,
    cost_units: np.ndarray,
    inputs: np.ndarray,
) -> np.ndarray:
    states, rollout, a, b, reference, state_weights, input_weights = data
    (low, high), (state_low, state_high, penalty, multipliers) = box, bounds
    n, horizon, nx, nu = b.shape
    optimal = np.empty(n, dtype=np.bool_)
    bounded = state_low.shape[1]
    errors = np.empty((horizon, nx))
    gradient = np.empty((horizon, nu))
    for env_index in range(n):
        moved = np.zeros(nx)
        cost = penalised = left = 0.0
        kept = True
        for k in range(horizon):
            after = np.zeros(nx)
            for i in range(nx):
                for other in range(nx):
                    after[i] += a[env_index, k, i, other] * moved[other]
                for j in range(nu):
                    after[i] += b[env_index, k, i, j] * (
                        inputs[env_index, k, j] - rollout[env_index, k, j]
                    )
            moved = after
            for i in range(nx):
                errors[k, i] = states[env_index, k + 1, i] + moved[i] - reference[env_index, k, i]
                cost += state_weights[env_index, k, i] * errors[k, i] ** 2
            for j in range(nu):
                cost += input_weights[env_index, k, j] * inputs[env_index, k, j] ** 2
            for i in range(bounded):
                x = states[env_index, k + 1, i] + moved[i]
                bottom, top = state_low[env_index, i], state_high[env_index, i]
                multiplier = multipliers[env_index, k, i]
                beyond = max(x - top, bottom - x, 0.0)
                if penalty[env_index, i] < np.inf:
                    penalised += penalty[env_index, i] * beyond
                    left += penalty[env_index, i] * beyond
                elif beyond > HARD * (1.0 + abs(x)):
                    kept = False
                if multiplier > 0.0:
                    left -= multiplier * (x - top)
                elif multiplier < 0.0:
                    left -= multiplier * (x - bottom)
        excess = 0.0
        adjoint = np.zeros(nx)
        for k in range(horizon - 1, -1, -1):
            for i in range(nx):
                adjoint[i] += 2.0 * state_weights[env_index, k, i] * errors[k, i]
            for i in range(bounded):
                adjoint[i] += multipliers[env_index, k, i]
            for j in range(nu):
                u, weight = inputs[env_index, k, j], input_weights[env_index, k, j]
                slope = 2.0 * weight * u
                for i in range(nx):
                    slope += b[env_index, k, i, j] * adjoint[i]
                gradient[k, j] = slope
                step = min(max(slope / (2.0 * weight), u - high[j]), u - low[j])
                excess += step * (slope - weight * step)
            before = np.zeros(nx)
            for other in range(nx):
                for i in range(nx):
                    before[i] += a[env_index, k, other, i] * adjoint[other]
            adjoint = before
        left = abs(left)
        cost += ROUNDING * penalised
        proven = excess + left <= EXCESS_COST * cost < np.inf
        negligible = left <= max(EXCESS_COST * cost, REST * cost_units[env_index]) < np.inf
        most = EXCESS_INPUT * scales[env_index]
        optimal[env_index] = kept and (
            proven or (negligible and _stands(data, env_index, box, most, inputs, gradient))
        )
    return optimal


@compiled(error_model="numpy")
def _stands(
    data: tuple[np.ndarray, ...],
    env_index: int,
    box: tuple[np.ndarray, np.ndarray],
    most: np.ndarray,
    inputs: np.ndarray,
    gradient: np.ndarray,
) -> bool:
    """Tell whether no input moves by more than `most` (nu,) in a Newton step of its own."""
    _, _, a, b, _, state_weights, input_weights = data
    _, horizon, nx, nu = b.shape
    hessian = np.zeros((nx, nx))  # of the cost to go in the state
    for k in range(horizon - 1, -1, -1):
        for i in range(nx):
            hessian[i, i] += 2.0 * state_weights[env_index, k, i]
        a_k, b_k = a[env_index, k], b[env_index, k]
        response = b_k.T @ hessian @ b_k
        for j in range(nu):
            curvature = 2.0 * input_weights[env_index, k, j] + response[j, j]
            u = inputs[env_index, k, j]
            target = min(max(u - gradient[k, j] / curvature, box[0][j]), box[1][j])
            if not abs(u - target) <= most[j]:
                return False
        hessian = a_k.T @ hessian @ a_k
    return True
