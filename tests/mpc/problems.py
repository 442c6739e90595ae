"""Random linearised problems, of the vehicle and of no particular model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zoac.mpc.problem import LinearisedProblem
from zoac.tasks.mpc_tracking import MpcTrackingVecEnv
from zoac.tasks.mpc_tracking.controller import SPACE
from zoac.tasks.mpc_tracking.vehicle import INPUT_HIGH, INPUT_LOW, BicycleModel


def box_points(n: int, seed: int) -> np.ndarray:
    """Return mapped parameters (n, 19): the first half uniform in the box, the rest corners."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(-1.0, 1.0, (n, SPACE.dimension))
    z[n // 2 :] = np.sign(z[n // 2 :])
    return z


def tracking_problems(z: np.ndarray, seed: int) -> LinearisedProblem:
    """Return the vehicle's problem for each row of `z`, about the rollout of random inputs."""
    rng = np.random.default_rng(seed)
    n, values = len(z), SPACE.values(z)
    observations, _ = MpcTrackingVecEnv(n).reset(seed=seed)
    observations[:, 1:6] += rng.uniform(-1.0, 1.0, (n, 5)) * (1.0, 0.3, 2.0, 1.0, 0.3)
    inputs = 0.3 * rng.uniform(INPUT_LOW, INPUT_HIGH, (n, 25, 2))
    states, a, b = BicycleModel().linearise(values[:, :6].copy(), observations[:, :6], inputs)
    reference = np.zeros((n, 25, 6))
    reference[:, :, :3] = observations[:, 6:].reshape(n, 25, 3)
    reference[:, :, 3] = 18.0
    stage = np.insert(values[:, 6:11], 3, 1e-2, axis=1)
    weights = np.repeat(stage[:, None], 25, axis=1)
    weights[:, -1] = values[:, 11:17]
    discount = 0.99 ** np.arange(26)[:, None]
    return LinearisedProblem(
        states=states,
        inputs=inputs,
        a=a,
        b=b,
        reference=reference,
        state_weights=weights * discount[1:],
        input_weights=np.repeat(values[:, None, 17:], 25, axis=1) * discount[:-1],
        input_low=INPUT_LOW,
        input_high=INPUT_HIGH,
        sparsity=BicycleModel.sparsity,
    )


def dense_problems(n: int, horizon: int, nx: int, nu: int, seed: int) -> LinearisedProblem:
    """Return problems with full Jacobians, an input box off centre, and `sparsity` unknown."""
    rng = np.random.default_rng(seed)
    low, high = -rng.uniform(0.1, 1.0, nu), rng.uniform(0.1, 1.0, nu)
    return LinearisedProblem(
        states=rng.normal(size=(n, horizon + 1, nx)),
        inputs=rng.uniform(low, high, (n, horizon, nu)),
        a=rng.normal(size=(n, horizon, nx, nx)) / nx,
        b=rng.normal(size=(n, horizon, nx, nu)),
        reference=rng.normal(size=(n, horizon, nx)),
        state_weights=rng.uniform(0.1, 1.0, (n, horizon, nx)),
        input_weights=rng.uniform(0.1, 1.0, (n, horizon, nu)),
        input_low=low,
        input_high=high,
    )


def integrator(input_weight: float) -> LinearisedProblem:
    """Return one state that adds up one input, for two steps from 0, with the reference 1."""
    return replace(
        dense_problems(1, 2, 1, 1, 0),
        states=np.zeros((1, 3, 1)), inputs=np.zeros((1, 2, 1)),
        a=np.ones((1, 2, 1, 1)), b=np.ones((1, 2, 1, 1)), reference=np.ones((1, 2, 1)),
        state_weights=np.ones((1, 2, 1)), input_weights=np.full((1, 2, 1), input_weight),
        input_low=np.array([-5.0]), input_high=np.array([5.0]),
    )  # fmt: skip


def states_along(problem: LinearisedProblem, inputs: np.ndarray) -> list[np.ndarray]:
    """Return the linearised states x_0 .. x_N, (n, nx) each, along plans `inputs` (n, N, nu)."""
    x = [problem.states[:, 0]]
    for k in range(inputs.shape[1]):
        x.append(
            problem.states[:, k + 1]
            + np.einsum("nij,nj->ni", problem.a[:, k], x[k] - problem.states[:, k])
            + np.einsum("nij,nj->ni", problem.b[:, k], inputs[:, k] - problem.inputs[:, k])
        )
    return x


def objective(problem: LinearisedProblem, inputs: np.ndarray) -> np.ndarray:
    """Return the objective (n,) of plans `inputs` (n, N, nu), by forward simulation alone."""
    x = np.stack(states_along(problem, inputs)[1:], axis=1)
    of_states = problem.state_weights * (x - problem.reference) ** 2
    return of_states.sum((1, 2)) + (problem.input_weights * inputs**2).sum((1, 2))


def gradient(problem: LinearisedProblem, inputs: np.ndarray) -> np.ndarray:
    """Return the objective's gradient (n, N, nu) at `inputs`, by the adjoint recursion."""
    x = states_along(problem, inputs)
    result = np.empty_like(inputs)
    adjoint = np.zeros_like(x[0])
    for k in reversed(range(inputs.shape[1])):
        adjoint += 2 * problem.state_weights[:, k] * (x[k + 1] - problem.reference[:, k])
        result[:, k] = 2 * problem.input_weights[:, k] * inputs[:, k]
        result[:, k] += np.einsum("nij,ni->nj", problem.b[:, k], adjoint)
        adjoint = np.einsum("nij,ni->nj", problem.a[:, k], adjoint)
    return result


def duality_gap(problem: LinearisedProblem, inputs: np.ndarray) -> np.ndarray:
    """Return (n,) an upper bound on how far the plans' objective is above the optimum.

    By convexity f(u) - f(v) <= f'(u) (u - v) for every v in the box; the worst v is a corner.
    The bound is zero exactly where the KKT conditions hold.
    """
    slope = gradient(problem, inputs)
    down, up = inputs - problem.input_low, inputs - problem.input_high
    return np.maximum(slope * down, slope * up).sum(axis=(1, 2))
