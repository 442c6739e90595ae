"""Terminal weights that stand for an infinite horizon."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from zoac.core.errors import ControllerError

MAX_KEPT = 1000


class RiccatiWeights:
    """The cost to go of the linear-quadratic problem without bounds, for the terminal weight.

    What was computed is kept: parameters change far more rarely than states.
    """

    full = True

    def __init__(self) -> None:
        self._kept: dict[bytes, np.ndarray] = {}

    def __call__(
        self, a: np.ndarray, b: np.ndarray, weight: np.ndarray, discount: np.ndarray
    ) -> np.ndarray:
        """Return P (n, nx, nx) for n environments.

        Args:
            a: (n, nx, nx), Jacobians of the model where it shall rest.
            b: (n, nx, nu).
            weight: (n, nx + nu, nx + nu), on states and inputs, cross terms included.
            discount: (n,), from step to step.

        Raises:
            ControllerError: If no input stabilises the linearised model.
        """
        return np.stack([self._one(*row) for row in zip(a, b, weight, discount, strict=True)])

    def _one(self, a: np.ndarray, b: np.ndarray, weight: np.ndarray, discount: float) -> np.ndarray:
        key = b"".join(part.tobytes() for part in (a, b, weight, np.float64(discount)))
        if key not in self._kept:
            if len(self._kept) >= MAX_KEPT:
                self._kept.clear()
            nx, root = len(a), np.sqrt(discount)
            q, s, r = weight[:nx, :nx], weight[:nx, nx:], weight[nx:, nx:]
            try:
                found = solve_discrete_are(root * a, root * b, q, r, s=s)
            except (LinAlgError, ValueError) as error:
                raise ControllerError(
                    f"terminal='riccati': no solution with these parameters ({error}); give "
                    "terminal weights by name"
                ) from None
            self._kept[key] = 0.5 * (found + found.T)
        return self._kept[key]
