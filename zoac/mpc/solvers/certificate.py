"""Proof that a plan is optimal, from the problem's data alone, whatever its solver said of it."""

from __future__ import annotations

import numpy as np

from zoac.mpc.compiled import compiled
from zoac.mpc.problem import LinearisedProblem, Solution, Status
from zoac.mpc.solvers.scaling import units

EXCESS_COST = 1e-4
"""No plan is cheaper than a proven one by more than this part of its cost; or else"""

EXCESS_INPUT = 1e-6
"""no input of it moves by more than this part of its range, if each alone goes to its optimum."""


def certified(problem: LinearisedProblem, solution: Solution) -> Solution:
    """Return `solution`, with the status INACCURATE where a plan said to be solved has no proof."""
    proven = is_optimal(problem, solution.inputs)
    status = solution.status
    unproven = (status == Status.SOLVED) & ~proven
    if unproven.any():
        status = np.where(unproven, Status.INACCURATE, status).astype(np.int8)
    return Solution(solution.inputs, status, solution.iterations)


def is_optimal(problem: LinearisedProblem, inputs: np.ndarray) -> np.ndarray:
    """Tell for each problem (n,) whether `inputs` (n, N, nu), inside the box, is its optimum.

    With g the objective's gradient by the adjoint equation and r the input weights, no plan is
    cheaper by more than the sum of g d - r d^2, d = clip(g / 2r, u - high, u - low): the objective
    less that of r alone is convex. That is compared to the plan's cost. A plan that costs next to
    nothing may fail there for rounding. It is then judged by |u - clip(u - g / h)|, h being the
    curvature in that input alone.
    """
    scale = problem.input_high - problem.input_low
    scales = np.where(np.isfinite(scale), scale, units(problem).inputs)
    optimal = np.empty(len(inputs), dtype=np.bool_)
    _judge(
        problem.states,
        problem.inputs,
        problem.a,
        problem.b,
        problem.reference,
        problem.state_weights,
        problem.input_weights,
        problem.input_low,
        problem.input_high,
        scales,
        inputs,
        optimal,
    )
    return optimal


@compiled(error_model="numpy")
def _judge(
    states: np.ndarray,
    rollout: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    reference: np.ndarray,
    state_weights: np.ndarray,
    input_weights: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    scales: np.ndarray,
    inputs: np.ndarray,
    optimal: np.ndarray,
) -> None:
    n, horizon, nx, nu = b.shape
    errors = np.empty((horizon, nx))
    gradient = np.empty((horizon, nu))
    for env_index in range(n):
        moved = np.zeros(nx)
        cost = 0.0
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
        excess = 0.0
        adjoint = np.zeros(nx)
        for k in range(horizon - 1, -1, -1):
            for i in range(nx):
                adjoint[i] += 2.0 * state_weights[env_index, k, i] * errors[k, i]
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
        optimal[env_index] = excess <= EXCESS_COST * cost < np.inf or _stands(
            a[env_index],
            b[env_index],
            state_weights[env_index],
            input_weights[env_index],
            low,
            high,
            EXCESS_INPUT * scales[env_index],
            inputs[env_index],
            gradient,
        )


@compiled(error_model="numpy")
def _stands(
    a: np.ndarray,
    b: np.ndarray,
    state_weights: np.ndarray,
    input_weights: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    most: np.ndarray,
    inputs: np.ndarray,
    gradient: np.ndarray,
) -> bool:
    """Tell whether no input moves by more than `most` (nu,) in a Newton step of its own."""
    horizon, nx, nu = b.shape
    hessian = np.zeros((nx, nx))  # of the cost to go in the state
    for k in range(horizon - 1, -1, -1):
        for i in range(nx):
            hessian[i, i] += 2.0 * state_weights[k, i]
        response = b[k].T @ hessian @ b[k]
        for j in range(nu):
            curvature = 2.0 * input_weights[k, j] + response[j, j]
            u = inputs[k, j]
            target = min(max(u - gradient[k, j] / curvature, low[j]), high[j])
            if not abs(u - target) <= most[j]:
                return False
        hessian = a[k].T @ hessian @ a[k]
    return True
