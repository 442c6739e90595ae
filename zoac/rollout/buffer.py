"""What environments did, row by row, while their segments are not yet cut."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


class Recording:
    """Arrays (rows, n, ...) by name, which grow as needed."""

    def __init__(self) -> None:
        self.rows, self._capacity = 0, 64
        self._kept: dict[str, np.ndarray] = {}

    def append(self, values: Mapping[str, np.ndarray]) -> None:
        """Take one row, everything (n, ...); a name that is missing has zeros there."""
        if self.rows == self._capacity:
            self._kept = {k: np.concatenate([v, np.zeros_like(v)]) for k, v in self._kept.items()}
            self._capacity *= 2
        for name, value in values.items():
            value, kept = np.asarray(value), self._kept.get(name)
            if kept is None:
                kept = self._kept[name] = np.zeros((self._capacity, *value.shape), value.dtype)
            elif kept.dtype != value.dtype:  # whole numbers before
                kept = self._kept[name] = kept.astype(np.result_type(kept, value), copy=False)
            kept[self.rows] = value
        self.rows += 1

    def cut(self, first_row: int, env_index: int) -> dict[str, np.ndarray]:
        """Return copies of an environment's rows since `first_row`, by name."""
        rows = slice(first_row, self.rows)
        return {name: kept[rows, env_index].copy() for name, kept in self._kept.items()}
