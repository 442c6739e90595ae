"""Where to look at a frequency response: a grid that misses no narrow peak, and what it shows."""

from collections.abc import Callable

import numpy as np

WEAK = 0.1
"""Damping ratio below which a root has a peak that may fall between two points of the grid."""

BESIDE = 150
"""Frequencies on each side of a weakly damped root."""

Figure = Callable[[np.ndarray], np.ndarray]
"""Function of frequencies (K,) [rad/s] that returns as many numbers."""


def beside(roots: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Return a grid of frequencies with further ones beside weakly damped roots.

    Args:
        roots: Poles and zeros in continuous time, complex.
        omega: The grid (K,) [rad/s], increasing.
    """
    weak = roots[(roots.imag > 0) & (np.abs(roots.real) < WEAK * np.abs(roots))]
    if not len(weak):
        return omega
    found = [omega]
    for root in weak:
        # A root on the axis has no width of its own.
        width = max(abs(root.real), 1e-9 * root.imag)
        offset = np.geomspace(0.01 * width, WEAK * root.imag, BESIDE)
        found += [root.imag - offset, root.imag + offset]
    every = np.unique(np.concatenate(found))
    return every[(every >= omega[0]) & (every <= omega[-1])]


def highest(figure: Figure, omega: np.ndarray) -> float:
    """Return the largest value of a figure: its largest on a grid, refined between the neighbours.

    Args:
        figure: What is looked at.
        omega: The grid (K,) [rad/s].
    """
    values = figure(omega)
    for _ in range(REFINEMENTS):
        k = int(np.nanargmax(values))
        omega = np.linspace(omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)], REFINED)
        values = figure(omega)
    return float(np.nanmax(values))


REFINEMENTS, REFINED = 3, 41
"""How often the neighbourhood of a peak is looked at more closely, and at how many points."""


def crossings(figure: Figure, omega: np.ndarray) -> np.ndarray:
    """Return the frequencies (N,) [rad/s] at which a figure changes its sign.

    Args:
        figure: What is looked at.
        omega: A grid (K,) [rad/s]; one change between two of its points is found.
    """
    values = figure(omega)
    omega, signs = omega[np.isfinite(values)], np.sign(values[np.isfinite(values)])
    at = np.flatnonzero(signs[:-1] != signs[1:])
    before, after, sign = omega[at], omega[at + 1], signs[at]
    for _ in range(HALVINGS if len(at) else 0):
        middle = 0.5 * (before + after)
        same = np.sign(figure(middle)) == sign
        before, after = np.where(same, middle, before), np.where(same, after, middle)
    return before


HALVINGS = 50
"""Of the interval around a crossing: as many as a double has bits."""
