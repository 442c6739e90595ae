"""The base class of everything that wraps a tuner."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zoac.core.segments import Proposal, Segment
from zoac.core.tuner import Tuner


class TunerStrategy(Tuner):
    """A tuner around another: a subclass changes some of what it does and forwards the rest."""

    def __init__(self, tuner: Tuner) -> None:
        self._tuner = tuner

    def ask(self) -> list[Proposal]:
        """See `Tuner.ask`."""
        return self._tuner.ask()

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """See `Tuner.tell`."""
        return self._tuner.tell(segments)

    def background_update(self) -> None:
        """See `Tuner.background_update`."""
        self._tuner.background_update()

    def recommend(self) -> np.ndarray:
        """See `Tuner.recommend`."""
        return self._tuner.recommend()

    def state(self) -> Any:
        """See `Tuner.state`."""
        return {"tuner": self._tuner.state()}

    def restore(self, state: Any) -> None:
        """See `Tuner.restore`."""
        self._tuner.restore(state["tuner"])

    def outcome(self) -> dict[str, Any]:
        """See `Tuner.outcome`."""
        return self._tuner.outcome()

    def describe(self) -> dict[str, Any]:
        """See `Tuner.describe`."""
        return self._tuner.describe()
