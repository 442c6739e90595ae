"""What a controller is: a function of parameters, observation and memory."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

Parameters = Mapping[str, np.ndarray]
Memory = Mapping[str, np.ndarray]
Diagnostics = Mapping[str, np.ndarray]


class Controller(Protocol):
    """A pure function of (parameters, observation, memory), batched over n environments.

    Whatever lasts from step to step is `memory`: arrays with one row per environment, begun anew at
    every episode start and kept when the parameters change in mid-episode. `act` must not change
    its arguments, must not remember anything else, and must compute each environment from that
    environment's rows alone.
    """

    def init(self, n: int) -> Memory:
        """Return the memory of `n` controllers at the start of an episode; by default none."""
        return {}

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return actions (n, m), the next memory, and diagnostics.

        Args:
            params: Physical values by name, each (n,): one value per environment.
            obs: Observations (n, o).
            memory: As returned by `init` or the call before.

        Returns:
            Actions (n, m); memory; diagnostics by name, arrays with n rows (the same names at
            every step), which are stored with the segment. `solver_seconds` (n,) and
            `solver_failed` (n,) bool are names that the accounting knows.
        """
