import numpy as np

from zoac.algorithm.gradient import standardised, zeroth_order_gradient


def test_gradient_is_the_weighted_mean_of_directions_over_sigma():
    directions = np.array([[1.0, 0.0], [0.0, 2.0]])
    gradient = zeroth_order_gradient(np.array([3.0, -1.0]), directions, sigma=0.5)
    np.testing.assert_allclose(gradient, [3.0, -2.0])


def test_gradient_of_whole_episodes_is_equation_2():
    """On a linear cost g.z with noise vectors that are orthonormal up to sqrt(n): exactly g."""
    g, sigma = np.array([2.0, -1.0, 0.5]), 0.1
    noise = np.sqrt(6) * np.concatenate([np.eye(3), -np.eye(3)]) / np.sqrt(2)
    costs = 7.0 + (sigma * noise) @ g
    assert np.allclose(zeroth_order_gradient(costs, noise, sigma), g)


def test_theorem_1_on_a_linear_quadratic_problem():
    """The estimator's mean is the gradient of the smoothed cost of x' = x + u, u = -theta x.

    One step of cost q x'^2 + r u^2 from x = 1 is quadratic in theta, so the Gaussian smoothing
    shifts it by a constant and its gradient is exact: 2 q (theta - 1) + 2 r theta.
    """
    q, r, theta, sigma = 2.0, 0.5, np.array([0.3]), 0.1
    epsilon = np.random.default_rng(0).standard_normal((400_000, 1))
    gain = theta + sigma * epsilon[:, 0]
    costs = q * (1.0 - gain) ** 2 + r * gain**2
    exact = 2 * q * (theta[0] - 1) + 2 * r * theta[0]
    baseline = q * (1 - theta[0]) ** 2 + r * theta[0] ** 2
    samples = (costs - baseline) * epsilon[:, 0] / sigma
    tolerance = 4 * samples.std() / np.sqrt(len(samples))
    estimate = zeroth_order_gradient(costs - baseline, epsilon, sigma)
    assert abs(estimate[0] - exact) < tolerance < 0.05 * abs(exact)


def test_standardised_advantages_have_mean_0_and_deviation_1():
    advantages = standardised(np.array([5.0, 7.0, 12.0]))
    np.testing.assert_allclose([advantages.mean(), advantages.std()], [0.0, 1.0], atol=1e-8)


def test_equal_advantages_give_no_direction():
    assert np.array_equal(standardised(np.full(4, 3.0)), np.zeros(4))
