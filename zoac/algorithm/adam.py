"""Adam (Kingma and Ba, 2015) for a parameter vector."""

from __future__ import annotations

import numpy as np


class Adam:
    """First and second moments of a gradient, bias-corrected."""

    def __init__(self, size: int, betas: tuple[float, float] = (0.9, 0.999)) -> None:
        self._beta1, self._beta2 = betas
        self._first = np.zeros(size)
        self._second = np.zeros(size)
        self._steps = 0

    def step(self, gradient: np.ndarray, step_size: float) -> np.ndarray:
        """Return what to subtract from the parameters (d,) for `gradient` (d,)."""
        self._steps += 1
        self._first = self._beta1 * self._first + (1 - self._beta1) * gradient
        self._second = self._beta2 * self._second + (1 - self._beta2) * gradient**2
        first = self._first / (1 - self._beta1**self._steps)
        second = self._second / (1 - self._beta2**self._steps)
        return step_size * first / (np.sqrt(second) + 1e-8)

    def state(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Return a copy of the moments and the step count."""
        return self._first.copy(), self._second.copy(), self._steps

    def restore(self, state: tuple[np.ndarray, np.ndarray, int]) -> None:
        """Put back what `state` returned."""
        first, second, self._steps = state
        self._first, self._second = first.copy(), second.copy()
