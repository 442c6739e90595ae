"""Matrices of weights, and what they are as weights of single outputs."""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, ControllerError
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
        self.full = self.full_within(self._size)
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

    def full_within(self, count: int) -> bool:
        """Return whether there is an entry beside the diagonal in the first `count` rows."""
        return any(i != j and max(i, j) < count for i, j, _ in self._entries)

    def matrices(self, values: Values, n: int) -> np.ndarray:
        """Return the matrix for n environments (n, size, size)."""
        matrix = np.zeros((n, self._size, self._size))
        for i, j, name in self._entries:
            matrix[:, i, j] = matrix[:, j, i] = values[name]
        return matrix


def cost_to_go(
    a: np.ndarray, b: np.ndarray, weight: np.ndarray, discount: np.ndarray
) -> np.ndarray:
    """Return P (n, nx, nx): the linear-quadratic regulator's weight of an infinite horizon.

    Args:
        a: (n, nx, nx), Jacobians of the model where it shall rest.
        b: (n, nx, nu).
        weight: (n, nx + nu, nx + nu), on states and inputs, cross terms included.
        discount: (n,), from step to step.

    Raises:
        ControllerError: If no input stabilises the linearised model.
    """
    rows = zip(a, b, weight, discount, strict=True)
    return np.stack([_regulator(a.shape[1], *(part.tobytes() for part in row)) for row in rows])


@lru_cache(maxsize=1000)  # parameters change far more rarely than states
def _regulator(nx: int, *parts: bytes) -> np.ndarray:
    """Return the cost to go (nx, nx) of one environment; the cache needs its arrays as bytes."""
    from scipy.linalg import LinAlgError, solve_discrete_are  # takes a tenth of a second

    a, b, weight, discount = map(np.frombuffer, parts)
    root, weight = np.sqrt(discount), weight.reshape(nx + len(b) // nx, -1)
    q, s, r = weight[:nx, :nx], weight[:nx, nx:], weight[nx:, nx:]
    try:
        found = solve_discrete_are(root * a.reshape(nx, -1), root * b.reshape(nx, -1), q, r, s=s)
    except (LinAlgError, ValueError) as error:
        raise ControllerError(
            f"terminal='riccati': no solution with these parameters ({error}); give "
            "terminal weights by name"
        ) from None
    return 0.5 * (found + found.T)


def factors(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues (n, m), 0 where negative, and eigenvectors as rows (n, m, m)."""
    sizes, vectors = np.linalg.eigh(matrix)
    return np.maximum(sizes, 0.0), np.ascontiguousarray(vectors.swapaxes(1, 2))
