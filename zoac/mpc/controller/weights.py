"""Matrices of weights, and what they are as weights of single outputs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError
from zoac.mpc.controller.numbers import Numbers

Values = Mapping[str, np.ndarray]


class Matrix:
    """A symmetric matrix of weights: numbers on its diagonal, and some beside it."""

    def __init__(
        self, kind: str, given: Mapping[Any, float], names: tuple[str, ...], numbers: Numbers
    ) -> None:
        """
        Args:
            kind: What the numbers' names begin with.
            given: Weights by name, or by pairs of names.
            names: Of the rows.
            numbers: Gets them.

        Raises:
            ConfigError: If the matrix is not positive semidefinite, or an entry cannot be used.
        """
        self._size = len(names)
        self._entries: list[tuple[int, int, str]] = []
        for key, value in given.items():
            pair = key if isinstance(key, tuple) else (key, key)
            if len(pair) != 2 or (isinstance(key, tuple) and pair[0] == pair[1]):
                raise ConfigError(f"{kind} {key!r}: expected a name, or a pair of two names")
            i, j = (names.index(name) for name in pair)
            least = 0.0 if i == j else -math.inf
            label = f"{kind}_{pair[0]}" if i == j else f"{kind}_{pair[0]}_{pair[1]}"
            self._entries.append((i, j, numbers.add(kind, label, value, least)))
        self.full = any(i != j for i, j, _ in self._entries)
        """Whether there is an entry beside the diagonal."""
        matrix = self.matrices(
            {name: np.full(1, numbers.values[name]) for *_, name in self._entries}, 1
        )[0]
        least_size = np.linalg.eigvalsh(matrix)[0] if self.full else 0.0
        if least_size < -1e-9 * np.abs(matrix).max():
            raise ConfigError(
                f"{kind}: the matrix is not positive semidefinite, its least eigenvalue is "
                f"{least_size:.3g}; make entries beside the diagonal smaller"
            )

    def matrices(self, values: Values, n: int) -> np.ndarray:
        """Return the matrix for n environments (n, size, size)."""
        matrix = np.zeros((n, self._size, self._size))
        for i, j, name in self._entries:
            matrix[:, i, j] = matrix[:, j, i] = values[name]
        return matrix


def factors(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues (n, m), 0 where negative, and eigenvectors as rows (n, m, m)."""
    sizes, vectors = np.linalg.eigh(matrix)
    return np.maximum(sizes, 0.0), np.ascontiguousarray(vectors.swapaxes(1, 2))
