"""The bicycle model and its Jacobians against CasADi's, written apart."""

import casadi as ca
import numpy as np
import pytest

from tests.mpc_tracking.oracle import bicycle
from zoac.tasks.mpc_tracking.controller import SPACE
from zoac.tasks.mpc_tracking.vehicle import INPUT_HIGH, INPUT_LOW, BicycleModel

N = 50


@pytest.fixture(scope="module")
def points():
    rng = np.random.default_rng(0)
    theta = SPACE.values(rng.uniform(-1, 1, (N, 19)))[:, :6].copy()
    states = rng.uniform([0, -9, -1, 14, -2, -1], [400, 9, 1, 22, 2, 1], (N, 6))
    return theta, states, rng.uniform(INPUT_LOW, INPUT_HIGH, (N, 3, 2))


@pytest.fixture(scope="module")
def oracle() -> ca.Function:
    X, U, p = ca.SX.sym("X", 6), ca.SX.sym("U", 2), ca.SX.sym("p", 6)
    after = bicycle(X, U, dict(zip(SPACE.names[:6], ca.vertsplit(p), strict=True)))
    return ca.Function("F", [X, U, p], [after, ca.jacobian(after, X), ca.jacobian(after, U)])


def test_rollout_and_jacobians_agree_with_automatic_differentiation(points, oracle) -> None:
    theta, start, inputs = points
    states, a, b = BicycleModel().linearise(theta, start, inputs)
    np.testing.assert_array_equal(states[:, 0], start)
    for env_index in range(N):
        for k in range(inputs.shape[1]):
            expected = oracle(states[env_index, k], inputs[env_index, k], theta[env_index])
            after, by_state, by_input = (value.full() for value in expected)
            np.testing.assert_allclose(states[env_index, k + 1], after[:, 0], rtol=1e-12)
            np.testing.assert_allclose(a[env_index, k], by_state, rtol=1e-11, atol=1e-13)
            np.testing.assert_allclose(b[env_index, k], by_input, rtol=1e-11, atol=1e-13)


def test_prediction_is_the_first_step_of_the_rollout(points) -> None:
    theta, start, inputs = points
    states, _, _ = BicycleModel().linearise(theta, start, inputs)
    np.testing.assert_array_equal(
        BicycleModel().predict(theta, start, inputs[:, 0].copy()), states[:, 1]
    )


def test_sparsity_is_exactly_where_the_jacobians_can_differ_from_zero(points) -> None:
    _, a, b = BicycleModel().linearise(*points)
    np.testing.assert_array_equal((a != 0).any((0, 1)), BicycleModel.sparsity.a)
    np.testing.assert_array_equal((b != 0).any((0, 1)), BicycleModel.sparsity.b)


def test_an_environment_gives_the_same_bits_alone(points) -> None:
    together = BicycleModel().linearise(*points)
    for env_index in (0, 7, N - 1):
        alone = BicycleModel().linearise(*(array[env_index : env_index + 1] for array in points))
        for one, many in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], many[env_index])


def test_a_standstill_gives_infinities_and_no_exception() -> None:
    """With zero stiffness and speed the model divides by zero; the MPC must live to see it."""
    theta = np.array([[1.0, 0.0, 0.0, 1.0, 1.0, 1.0]])
    states, _, _ = BicycleModel().linearise(theta, np.zeros((1, 6)), np.zeros((1, 2, 2)))
    assert not np.isfinite(states).all()
