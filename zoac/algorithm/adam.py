"""Adam (Kingma and Ba, 2015) for a tuner's few parameters; the critic's many use PyTorch's."""

from __future__ import annotations

from typing import Any

import numpy as np

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8

Moments = tuple[Any, Any, int]
"""First and second moment of the gradient, each (d,), and the number of steps."""

START: Moments = 0.0, 0.0, 0


def descend(
    parameters: np.ndarray, moments: Moments, gradient: np.ndarray, step_size: float
) -> tuple[np.ndarray, Moments]:
    """Return `parameters` (d,) and the moments after a step against `gradient` (d,)."""
    first, second, steps = moments
    first = BETA_1 * first + (1 - BETA_1) * gradient
    second = BETA_2 * second + (1 - BETA_2) * gradient * gradient
    steps += 1
    scaled_step = step_size / (1 - BETA_1**steps)
    root_correction = 1 / np.sqrt(1 - BETA_2**steps)
    step = scaled_step * first / (np.sqrt(second) * root_correction + EPSILON)
    return parameters - step, (first, second, steps)
