"""Adam (Kingma and Ba, 2015) for a tuner's few parameters; the critic's many use PyTorch's."""

from __future__ import annotations

import numpy as np

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8


class Adam:
    """Gradient steps scaled by bias-corrected moments of the gradient."""

    def __init__(self, dimension: int) -> None:
        self.moments = np.zeros(dimension), np.zeros(dimension), 0
        """First and second moment, number of steps: the whole state, replaced and never changed."""

    def descend(self, parameters: np.ndarray, gradient: np.ndarray, step_size: float) -> np.ndarray:
        """Return `parameters` (d,) after a step against `gradient` (d,)."""
        first, second, steps = self.moments
        first = BETA_1 * first + (1 - BETA_1) * gradient
        second = BETA_2 * second + (1 - BETA_2) * gradient * gradient
        steps += 1
        self.moments = first, second, steps
        scaled_step = step_size / (1 - BETA_1**steps)
        root_correction = 1 / np.sqrt(1 - BETA_2**steps)
        return parameters - scaled_step * first / (np.sqrt(second) * root_correction + EPSILON)
