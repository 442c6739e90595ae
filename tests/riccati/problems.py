"""Two more systems, written for these tests alone: a cart-pole and a quadrotor.

Every size and every pattern of zeros takes eleven seconds to compile. All tests have the same
three: the vehicle's, six states and two inputs with nothing known to be zero, and `gappy`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.mpc.problems import dense_problems
from zoac.mpc.problem import LinearisedProblem, Sparsity

Dynamics = Callable[[np.ndarray, np.ndarray], np.ndarray]

CART_POLE_HIGH = np.array([10.0, 3.0])
QUADROTOR_HIGH = np.array([15.0, 15.0])


def cart_pole(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Position, angle from upright, their rates, and a sled on a spring, seen from the cart.

    Forces on cart and sled. One Euler step of 0.02 s.
    """
    _, angle, speed, rate, away, drift = x
    sin, cos = np.sin(angle), np.cos(angle)
    total, pole, half = 1.1, 0.1, 0.5
    push = (u[0] + 4.0 * away + pole * half * rate**2 * sin) / total
    turn = (9.81 * sin - cos * push) / (half * (4.0 / 3.0 - pole * cos**2 / total))
    gain = push - pole * half * turn * cos / total
    return x + 0.02 * np.array([speed, rate, gain, turn, drift, u[1] - 4.0 * away - gain])


def quadrotor(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Position (2), roll, their rates; two thrusts. One Euler step of 0.02 s, 1 kg."""
    _, _, roll, _, _, rate = x
    thrust = u[0] + u[1]
    lift = np.array([-thrust * np.sin(roll), thrust * np.cos(roll) - 9.81])
    turn = 0.2 * (u[1] - u[0]) / 0.02
    return x + 0.02 * np.array([x[3], x[4], rate, lift[0], lift[1], turn])


def problems(
    dynamics: Dynamics, low: np.ndarray, high: np.ndarray, nx: int, horizon: int, n: int, seed: int
) -> LinearisedProblem:
    """Return n problems about rollouts of random inputs from random starts, weights 1e-4..1e2."""
    rng = np.random.default_rng(seed)
    nu = len(low)
    inputs = rng.uniform(low, high, (n, horizon, nu))
    states = np.empty((n, horizon + 1, nx))
    states[:, 0] = rng.normal(scale=0.5, size=(n, nx))
    a, b = np.empty((n, horizon, nx, nx)), np.empty((n, horizon, nx, nu))
    for lane in range(n):
        for k in range(horizon):
            x, u = states[lane, k], inputs[lane, k]
            states[lane, k + 1] = dynamics(x, u)
            # The complex step gives derivatives to rounding, without a line of calculus.
            for i, direction in enumerate(np.eye(nx + nu) * 1e-30j):
                moved = dynamics(x + direction[:nx], u + direction[nx:]).imag / 1e-30
                if i < nx:
                    a[lane, k, :, i] = moved
                else:
                    b[lane, k, :, i - nx] = moved
    return LinearisedProblem(
        states=states,
        inputs=inputs,
        a=a,
        b=b,
        reference=np.zeros((n, horizon, nx)),
        state_weights=np.repeat(10 ** rng.uniform(-4, 2, (n, 1, nx)), horizon, axis=1),
        input_weights=np.repeat(10 ** rng.uniform(-4, 1, (n, 1, nu)), horizon, axis=1),
        input_low=low,
        input_high=high,
    )


def cart_poles(horizon: int, n: int, seed: int) -> LinearisedProblem:
    """Return cart-pole problems, unstable: six states, two inputs."""
    return problems(cart_pole, -CART_POLE_HIGH, CART_POLE_HIGH, 6, horizon, n, seed)


def gappy(horizon: int, n: int, seed: int) -> LinearisedProblem:
    """Return problems with the zeros of an `Mpc` of a state, one that is always 0, and a rate.

    Their rows, five numbers, are no whole vectors.
    """
    problem = dense_problems(n, horizon, 4, 1, seed)
    can_be = Sparsity(np.zeros((4, 4), bool), np.array([[1], [0], [1], [1]], bool))
    can_be.a[0, 0] = can_be.a[3, 2] = True
    return replace(problem, a=problem.a * can_be.a, b=problem.b * can_be.b, sparsity=can_be)


def quadrotors(horizon: int, n: int, seed: int) -> LinearisedProblem:
    """Return quadrotor problems: six states, two inputs that cannot be negative."""
    return problems(quadrotor, np.zeros(2), QUADROTOR_HIGH, 6, horizon, n, seed)
