"""Rules for following and for changing lanes: thresholds and a choice, nothing to differentiate."""

from __future__ import annotations

import numpy as np

from zoac.core.controller import Diagnostics, Memory, Parameters

WANTED = 28.0
"""Speed that the driver wants [m/s]."""


class RuleBasedDriver:
    """Follows by gap and speed; changes lanes if all rules say so.

    A change needs: `patience` seconds since the last one; gaps of `ahead` and `behind` in the other
    lane, and a car behind that is not more than `closing` faster; and a lane that is better by
    `gain`, in what `better` compares: the speeds of the cars ahead [m/s], or the gaps [10 m].
    """

    def init(self, n: int) -> Memory:
        """Return the empty memory."""
        return {}

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return acceleration and wish to change, (n, 2), for observations (n, 8)."""
        v, gap, away, next_gap, next_away, behind, receding, waited = obs.T
        follow = params["k_gap"] * (gap - 2.0 - params["headway"] * v) + params["k_speed"] * away
        acceleration = np.minimum(follow, params["k_speed"] * (WANTED - v))
        by_gap = params["better"] == 1  # the second option
        gain = np.where(by_gap, (next_gap - gap) / 10.0, next_away - away)
        change = (
            (waited >= params["patience"])
            & (next_gap > params["ahead"])
            & (behind > params["behind"])
            & (receding > -params["closing"])
            & (gain > params["gain"])
        )
        return np.stack([acceleration, change.astype(np.float64)], axis=1), memory, {}
