"""Random search: points drawn uniformly, the best of them recommended."""

from typing import Literal

import numpy as np

from zoac.baselines.episode_tuner import EpisodeTuner
from zoac.core.tuner import Problem
from zoac.core.types import Count, Fraction


class RandomSearch(EpisodeTuner):
    """Points drawn uniformly from the normalised box, one episode each."""

    display_name = "Random search"

    def __init__(
        self,
        problem: Problem,
        *,
        recommendation: Literal["best_seen", "reevaluated"] = "best_seen",
        reevaluate_top: Count = 10,
        reevaluate_fraction: Fraction = 0.1,
    ) -> None:
        """See `EpisodeTuner` for the options."""
        super().__init__(
            problem,
            start="middle",  # recommended until a cost is known; draws no random number
            recommendation=recommendation,
            reevaluate_top=reevaluate_top,
            reevaluate_fraction=reevaluate_fraction,
        )

    def _draw(self) -> list[np.ndarray]:
        size = (self._problem.num_envs, self._problem.space.dimension)
        return list(self._rng.uniform(-1.0, 1.0, size))
