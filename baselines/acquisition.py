"""The upper confidence bound of a Gaussian process, with its gradient, and its maximum.

The values are those of `bayes_opt.util.UtilityFunction`. The library maximises them by finite
differences through scikit-learn, which takes most of the time of an ask. This module has the exact
gradient for the library's kernel, a Matern of smoothness 5/2 with one length scale.
"""

import math
from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize
from sklearn.gaussian_process import GaussianProcessRegressor

Rounding = Callable[[np.ndarray], np.ndarray]

KAPPA = 2.576
"""Standard deviations in the bound; the library's."""

_MIN_VARIANCE = 1e-12  # relative to the prior's; rounding makes it negative at known points
_PIECE = 500  # points at a time, for matrices that stay in the processor's cache


class Acquisition:
    """The upper confidence bound of a fitted process, to be maximised."""

    def __init__(self, process: GaussianProcessRegressor, seen: np.ndarray) -> None:
        """
        Args:
            process: Fitted, with the kernel Matern(nu=2.5) and normalised values.
            seen: The values (n,) that it was fitted to.
        """
        self._points = process.X_train_ / process.kernel_.length_scale
        self._scale = float(process.kernel_.length_scale)
        self._alpha = process.alpha_
        self._mean, self._std = float(seen.mean()), float(seen.std()) or 1.0
        eye = np.eye(len(self._points))
        self._whitening = solve_triangular(process.L_, eye, lower=True, check_finite=False)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Return the value (n,) of each of the points (n, d)."""
        pieces = range(0, len(points), _PIECE)
        return np.concatenate([self._values(points[i : i + _PIECE]) for i in pieces])

    def _values(self, points: np.ndarray) -> np.ndarray:
        points, seen = points / self._scale, self._points
        squares = (points * points).sum(1)[:, None] + (seen * seen).sum(1) - 2.0 * (points @ seen.T)
        distances = np.sqrt(np.maximum(squares, 0.0))
        covariance = _matern(distances)
        reduced = covariance @ self._whitening.T
        variance = 1.0 - np.einsum("ij,ij->i", reduced, reduced)
        std = self._std * np.sqrt(np.maximum(variance, _MIN_VARIANCE))
        mean = self._std * (covariance @ self._alpha) + self._mean
        return mean + KAPPA * std

    def value_and_gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the value at `x` (d,) and its gradient (d,)."""
        offsets = x / self._scale - self._points
        distances = np.sqrt(np.einsum("ij,ij->i", offsets, offsets))
        covariance = _matern(distances)
        # d covariance / d x = slope * offset / length scale
        decay = np.exp(-math.sqrt(5.0) * distances)
        slope = -5.0 / 3.0 * (1.0 + math.sqrt(5.0) * distances) * decay / self._scale
        reduced = self._whitening @ covariance
        variance = 1.0 - reduced @ reduced
        by_variance = -2.0 * ((self._whitening.T @ reduced) * slope) @ offsets
        if variance < _MIN_VARIANCE:
            variance, by_variance = _MIN_VARIANCE, np.zeros_like(x)
        mean = self._std * float(covariance @ self._alpha) + self._mean
        std = self._std * math.sqrt(variance)
        mean_gradient = self._std * ((self._alpha * slope) @ offsets)
        std_gradient = self._std * by_variance / (2.0 * math.sqrt(variance))
        return mean + KAPPA * std, mean_gradient + KAPPA * std_gradient


def maximise(
    acquisition: Acquisition,
    bounds: np.ndarray,
    random_state: np.random.RandomState,
    rounded: Rounding = np.asarray,
    samples: int = 10_000,
    starts: int = 10,
) -> np.ndarray:
    """Return the best point (d,) of a random search and of L-BFGS-B from random starts.

    The algorithm and its random numbers are those of `bayes_opt.util.acq_max`; the gradients are
    exact.

    Args:
        acquisition: What to maximise.
        bounds: Lower and upper bounds (d, 2).
        random_state: Gives the random points.
        rounded: Rounds points (..., d) to allowed values. Coordinates that it changes stay at the
            start.
        samples: Points of the random search.
        starts: Starts of L-BFGS-B.
    """
    low, high = bounds.T
    points = rounded(random_state.uniform(low, high, (samples, len(low))))
    values = acquisition.values(points)
    best, best_value = points[values.argmax()], values.max()

    def descend(x: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = acquisition.value_and_gradient(x)
        return -value, -gradient

    for drawn in random_state.uniform(low, high, (starts, len(low))):
        start = rounded(drawn)
        free = start == drawn
        box = np.stack([np.where(free, low, start), np.where(free, high, start)], axis=1)
        result = minimize(descend, start, jac=True, bounds=box, method="L-BFGS-B")
        if result.success and -result.fun >= best_value:
            best, best_value = result.x, -result.fun
    return np.clip(best, low, high)


def _matern(distances: np.ndarray) -> np.ndarray:
    r = math.sqrt(5.0) * distances
    return (1.0 + r + r * r / 3.0) * np.exp(-r)
