"""Adam (Kingma and Ba, 2015), for a tuner's few parameters and a critic's many weights alike."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8


class Adam:
    """First and second moments of a gradient, bias-corrected; float32 or float64."""

    def __init__(self, parameters: np.ndarray) -> None:
        """
        Args:
            parameters: (d,), of the length and the type of what will be moved.
        """
        self._first = np.zeros_like(parameters)
        self._second = np.zeros_like(parameters)
        self._steps = 0

    def descend(self, parameters: np.ndarray, gradient: np.ndarray, step_size: float) -> None:
        """Move `parameters` (d,), in place, against `gradient` (d,)."""
        self._steps += 1
        number = parameters.dtype.type
        _descend(
            parameters,
            gradient,
            self._first,
            self._second,
            number(step_size / (1 - BETA_1**self._steps)),
            number(1 / math.sqrt(1 - BETA_2**self._steps)),
            (number(BETA_1), number(1 - BETA_1), number(BETA_2), number(1 - BETA_2)),
            number(EPSILON),
            np.finfo(number).tiny,
        )

    def state(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Return a copy of the moments and the step count."""
        return self._first.copy(), self._second.copy(), self._steps

    def restore(self, state: tuple[np.ndarray, np.ndarray, int]) -> None:
        """Put back what `state` returned."""
        first, second, self._steps = state
        self._first, self._second = first.copy(), second.copy()


# One pass over memory. Division by zero cannot happen, and asking for it would stop the compiler
# from using vector instructions.
@njit(cache=True, error_model="numpy")
def _descend(
    parameters: np.ndarray,
    gradient: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    scaled_step: float,
    root_correction: float,
    betas: tuple[float, float, float, float],
    epsilon: float,
    tiny: float,
) -> None:
    keep_1, take_1, keep_2, take_2 = betas
    zero = tiny - tiny
    for i in range(len(parameters)):
        g = gradient[i]
        mean = keep_1 * first[i] + take_1 * g
        # Where the gradient stays 0 the mean would end as a subnormal number and stay one, at a
        # hundred times the price of any other; it moves nothing.
        first[i] = zero if abs(mean) < tiny else mean
        second[i] = keep_2 * second[i] + take_2 * g * g
        parameters[i] -= scaled_step * first[i] / (np.sqrt(second[i]) * root_correction + epsilon)
