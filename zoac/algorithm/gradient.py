"""The zeroth-order gradient (eq. 10)."""

from __future__ import annotations

import numpy as np


def zeroth_order_gradient(
    advantages: np.ndarray, directions: np.ndarray, sigma: float
) -> np.ndarray:
    """Return 1/(n sigma) sum_i A_i epsilon_i, shape (d,): eq. (10), and eq. (2) for returns.

    Args:
        advantages: (n,), one for each direction.
        directions: (n, d), the noise epsilon ~ N(0, I) before any clipping.
        sigma: Standard deviation of the perturbation.
    """
    return advantages @ directions / (len(advantages) * sigma)


def standardised(advantages: np.ndarray) -> np.ndarray:
    """Return the advantages shifted to mean 0 and scaled to standard deviation 1."""
    if not np.isfinite(np.square(advantages).sum()):  # their squares would overflow
        advantages = advantages / np.abs(advantages).max()
    return (advantages - advantages.mean()) / (advantages.std() + 1e-8)
