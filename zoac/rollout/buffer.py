"""What environments did, row by row, while their segments are not yet cut."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


class Recording:
    """Everything the environments did in one `rollout` call, row by row; grows as needed."""

    def __init__(self, n: int, observation: tuple[int, ...], action: tuple[int, ...]) -> None:
        """
        Args:
            n: Number of environments.
            observation: Shape of one environment's observation.
            action: Shape of one environment's action.
        """
        self.rows = 0
        self._observations = np.empty((64, n, *observation))
        self._actions = np.empty((64, n, *action))
        self._commands = np.empty((64, n, *action))
        self._costs = np.empty((64, n))
        self._diagnostics: dict[str, np.ndarray] = {}

    def append(
        self,
        observations: np.ndarray,
        actions: np.ndarray,
        commands: np.ndarray,
        costs: np.ndarray,
        diagnostics: Mapping[str, np.ndarray],
    ) -> None:
        """Take one row: everything (n, ...)."""
        row = self.rows
        if row == len(self._costs):
            self._grow()
        self._observations[row] = observations
        self._actions[row] = actions
        self._commands[row] = commands
        self._costs[row] = costs
        for name, value in diagnostics.items():
            if name not in self._diagnostics:  # the first row, or every controller failed before
                shape = (len(self._costs), *np.shape(value))
                self._diagnostics[name] = np.zeros(shape, np.asarray(value).dtype)
            kept = self._diagnostics[name]
            if (kind := np.result_type(kept, value)) != kept.dtype:  # whole numbers before
                kept = self._diagnostics[name] = kept.astype(kind)
            kept[row] = value
        for name in self._diagnostics.keys() - diagnostics.keys():  # every controller failed now
            self._diagnostics[name][row] = 0
        self.rows = row + 1

    def _grow(self) -> None:
        self._observations = _doubled(self._observations)
        self._actions = _doubled(self._actions)
        self._commands = _doubled(self._commands)
        self._costs = _doubled(self._costs)
        self._diagnostics = {name: _doubled(v) for name, v in self._diagnostics.items()}

    def cut(self, first_row: int, env_index: int, last_observation: np.ndarray) -> dict[str, Any]:
        """Return copies of an environment's rows since `first_row`: the arrays of a segment.

        Args:
            first_row: Where the segment began.
            env_index: Which environment.
            last_observation: Where it ended.
        """
        rows = slice(first_row, self.rows)
        return {
            "observations": np.concatenate(
                [self._observations[rows, env_index], last_observation[None]]
            ),
            "actions": self._actions[rows, env_index].copy(),
            "commands": self._commands[rows, env_index].copy(),
            "costs": self._costs[rows, env_index].copy(),
            "diagnostics": {
                name: v[rows, env_index].copy() for name, v in self._diagnostics.items()
            },
        }


def _doubled(array: np.ndarray) -> np.ndarray:
    return np.concatenate([array, np.empty_like(array)])
