"""Optimality seen from outside: the condensed problem, a solver of it, and the KKT conditions."""

from __future__ import annotations

import numpy as np
import quadprog

from tests.mpc.problems import gradient
from zoac.mpc.problem import LinearisedProblem


def condense(
    problem: LinearisedProblem, lane: int, precision: type = np.float64
) -> tuple[np.ndarray, np.ndarray]:
    """Return H (N nu, N nu) and f (N nu,) of 1/2 w'Hw + f'w, w the inputs less the rollout's."""
    a, b = problem.a[lane].astype(precision), problem.b[lane].astype(precision)
    n, nx, nu = b.shape
    response = np.zeros((n, nx, n * nu), precision)
    after = np.zeros((nx, n * nu), precision)
    for k in range(n):
        after = a[k] @ after
        after[:, k * nu : (k + 1) * nu] += b[k]
        response[k] = after
    flat = response.reshape(n * nx, n * nu)
    weights = problem.state_weights[lane].ravel()
    error = (problem.states[lane, 1:].astype(precision) - problem.reference[lane]).ravel()
    inputs = problem.input_weights[lane].ravel()
    hessian = flat.T @ (weights[:, None] * flat) + np.diag(inputs)
    return hessian, flat.T @ (weights * error) + inputs * problem.inputs[lane].ravel()


def bounds(problem: LinearisedProblem, lane: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds (N nu,) of w."""
    low = (problem.input_low - problem.inputs[lane]).ravel()
    return low, (problem.input_high - problem.inputs[lane]).ravel()


def optimal_value(problem: LinearisedProblem, plans: np.ndarray) -> np.ndarray:
    """Return what plans (n, N, nu) cost under the linearised model, constants included, (n,)."""
    moved = np.zeros_like(problem.states[:, 0])
    total = np.zeros(len(plans))
    for k in range(plans.shape[1]):
        change = plans[:, k] - problem.inputs[:, k]
        moved = np.einsum("nij,nj->ni", problem.a[:, k], moved)
        moved += np.einsum("nij,nj->ni", problem.b[:, k], change)
        error = problem.states[:, k + 1] + moved - problem.reference[:, k]
        total += (problem.state_weights[:, k] * error**2).sum(1)
        total += (problem.input_weights[:, k] * plans[:, k] ** 2).sum(1)
    return total


def solve_condensed(problem: LinearisedProblem, lane: int) -> np.ndarray:
    """Return the plan (N, nu) that quadprog finds."""
    hessian, linear = condense(problem, lane)
    low, high = bounds(problem, lane)
    sides = np.concatenate([np.eye(len(low)), -np.eye(len(low))], axis=1)
    w = quadprog.solve_qp(hessian, -linear, sides, np.concatenate([low, -high]))[0]
    return problem.inputs[lane] + w.reshape(problem.inputs[lane].shape)


def solve_in_extended_precision(problem: LinearisedProblem, lane: int) -> np.ndarray:
    """Return the plan (N, nu) that fulfils the condensed problem's KKT conditions in 80 bits.

    Begins with quadprog's active set. Inputs found outside a bound are put there, those whose
    multiplier has the wrong sign are freed, until none is left; RuntimeError if that never is so.
    """
    hessian, linear = condense(problem, lane, np.longdouble)
    low, high = (side.astype(np.longdouble) for side in bounds(problem, lane))
    plan = solve_condensed(problem, lane)
    snap = 1e-9 * (problem.input_high - problem.input_low)
    at_low = (plan <= problem.input_low + snap).ravel()
    at_high = (plan >= problem.input_high - snap).ravel()
    for _ in range(20):
        w = np.where(at_low, low, np.where(at_high, high, 0))
        free = ~(at_low | at_high)
        slope = linear + hessian @ w
        w[free] -= _cholesky_solve(hessian[np.ix_(free, free)], slope[free])
        slope = linear + hessian @ w
        stay_low, stay_high = at_low & (slope >= 0), at_high & (slope <= 0)
        now_low, now_high = stay_low | (free & (w < low)), stay_high | (free & (w > high))
        if np.array_equal(now_low, at_low) and np.array_equal(now_high, at_high):
            if not np.isfinite(w).all():
                break
            return (problem.inputs[lane] + w.reshape(plan.shape)).astype(np.float64)
        at_low, at_high = now_low, now_high
    raise RuntimeError(f"lane {lane}: no plan; the active set goes in circles, or data overflow")


def _cholesky_solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a symmetric positive definite system in the precision of its data."""
    n = len(right)
    factor = np.zeros_like(matrix)
    for j in range(n):
        factor[j:, j] = matrix[j:, j] - factor[j:, :j] @ factor[j, :j]
        factor[j:, j] /= np.sqrt(factor[j, j])
    x = right.copy()
    for i in range(n):
        x[i] = (x[i] - factor[i, :i] @ x[:i]) / factor[i, i]
    for i in reversed(range(n)):
        x[i] = (x[i] - factor[i + 1 :, i] @ x[i + 1 :]) / factor[i, i]
    return x


def kkt_error(problem: LinearisedProblem, plans: np.ndarray) -> np.ndarray:
    """Return each lane's largest |u - clip(u - g / h)| over the input's range, (n,).

    g is the objective's gradient, h the diagonal of its Hessian in the inputs: zero exactly at
    the solution, whatever the units of inputs and objective.
    """
    slope = gradient(problem, plans)
    curvature = _hessian_diagonal(problem)
    step = np.clip(plans - slope / curvature, problem.input_low, problem.input_high) - plans
    spread = problem.input_high - problem.input_low
    return (np.abs(step) / np.where(np.isfinite(spread), spread, 1.0)).max(axis=(1, 2))


def _hessian_diagonal(problem: LinearisedProblem) -> np.ndarray:
    horizon = problem.a.shape[1]
    diagonal = 2 * problem.input_weights
    for k in range(horizon):
        response = problem.b[:, k]
        for after in range(k, horizon):
            if after > k:
                response = problem.a[:, after] @ response
            weights = problem.state_weights[:, after, :, None]
            diagonal[:, k] += 2 * (weights * response**2).sum(axis=1)
    return diagonal
