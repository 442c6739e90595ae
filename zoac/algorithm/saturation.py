"""The gradient through a tanh layer that is saturated nearly everywhere.

On raw observations of many metres a critic's first layer is: in `mpc_tracking` tanh is exactly +-1
in float32, and its derivative exactly 0, at 99 of 100 places. Two of the five large products of a
step are then nearly all zeros. Here only the others are computed, each sum in the order of MKL's
dense product (one fused multiply-add after the other), so that the bits are the same.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_SHARE = 32
"""Pays where at most one place in so many is unsaturated."""


class Unsaturated:
    """The places of a layer's activations (B, width) at which tanh' is not 0, if few."""

    def __init__(self, minibatch: int, width: int) -> None:
        """
        Args:
            minibatch: Largest B.
            width: Of the layer.
        """
        # Eight flags are read at once, as one word.
        self._flags = np.zeros((minibatch, -(-width // 8) * 8), np.bool_)
        self._words = self._flags.view(np.uint64)
        self._rows = np.empty(minibatch * width // _SHARE, np.uint32)
        self._columns = np.empty_like(self._rows)
        self._count = -1

    def find(self, activation: np.ndarray) -> bool:
        """Look through the activations (B, width); return whether `flow` and `gradient` pay."""
        limit = activation.size // _SHARE
        self._count = _find(activation, self._flags, self._words, self._rows, self._columns, limit)
        return self._count >= 0

    def flow(
        self, above: np.ndarray, matrix: np.ndarray, activation: np.ndarray, out: np.ndarray
    ) -> None:
        """Write (above @ matrix) * tanh', the loss's gradient at what enters the layer.

        Args:
            above: The same at the layer above, (B, k).
            matrix: Weights from this layer to that one, (k, width).
            activation: Of this layer, (B, width), as given to `find`.
            out: (B, width).
        """
        _flow(above, matrix, activation, out, *self._places())

    def gradient(self, flow: np.ndarray, below: np.ndarray, out: np.ndarray) -> None:
        """Write flow.T @ below, the loss's gradient at the layer's weights.

        Args:
            flow: What `flow` wrote, (B, width).
            below: What the layer reads, (B, i).
            out: (width, i).
        """
        _gradient(flow, below, out, *self._places())

    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        return self._rows[: self._count], self._columns[: self._count]


@njit(cache=True)
def _find(
    activation: np.ndarray,
    flags: np.ndarray,
    words: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    limit: int,
) -> int:
    """List the places, for each eight columns row after row; return their number, or -1 if there
    are more than `limit`."""
    size, width = activation.shape
    for i in range(size):
        for j in range(width):
            flags[i, j] = abs(activation[i, j]) != np.float32(1.0)
    count = 0
    for word in range(words.shape[1]):
        for i in range(size):
            if words[i, word] == 0:
                continue
            for j in range(8 * word, min(8 * word + 8, width)):
                if flags[i, j]:
                    if count == limit:
                        return -1
                    rows[count], columns[count] = i, j
                    count += 1
    return count


# Products and sums may be contracted to fused ones, as the dense product's are.
@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _flow(
    above: np.ndarray,
    matrix: np.ndarray,
    activation: np.ndarray,
    out: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
) -> None:
    out[:] = 0.0
    one, last = np.float32(1.0), len(rows) - 1
    # Four sums beside each other, since each must wait for its own last addition.
    for first in range(0, len(rows), 4):
        a, b, c, d = first, min(first + 1, last), min(first + 2, last), min(first + 3, last)
        left_a, left_b = above[rows[a]], above[rows[b]]
        left_c, left_d = above[rows[c]], above[rows[d]]
        right_a, right_b = matrix[:, columns[a]], matrix[:, columns[b]]
        right_c, right_d = matrix[:, columns[c]], matrix[:, columns[d]]
        sum_a = sum_b = sum_c = sum_d = np.float32(0.0)
        for k in range(above.shape[1]):
            sum_a += left_a[k] * right_a[k]
            sum_b += left_b[k] * right_b[k]
            sum_c += left_c[k] * right_c[k]
            sum_d += left_d[k] * right_d[k]
        out[rows[a], columns[a]] = sum_a
        out[rows[b], columns[b]] = sum_b
        out[rows[c], columns[c]] = sum_c
        out[rows[d], columns[d]] = sum_d
    for place in range(len(rows)):
        i, j = rows[place], columns[place]
        y = activation[i, j]
        out[i, j] *= one - y * y


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _gradient(
    flow: np.ndarray, below: np.ndarray, out: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> None:
    out[:] = 0.0
    for place in range(len(rows)):
        i, j = rows[place], columns[place]
        for k in range(below.shape[1]):
            out[j, k] += flow[i, j] * below[i, k]
