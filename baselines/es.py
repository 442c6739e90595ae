"""Evolution strategy: eq. (2) of the paper on whole episodes, with Adam."""

from typing import Any, Literal

import numpy as np

from zoac.algorithm.adam import START, descend
from zoac.algorithm.gradient import zeroth_order_gradient
from zoac.baselines.episode_tuner import EpisodeTuner
from zoac.core.tuner import Problem
from zoac.core.types import Count, Positive
from zoac.rollout.outcomes import Outcomes


class EvolutionStrategy(EpisodeTuner):
    """Gradient of the Gaussian-smoothed episode cost, estimated from `population` episodes."""

    display_name = "ES"
    kept = "_theta _adam _noise"

    def __init__(
        self,
        problem: Problem,
        *,
        population: Count = 20,
        sigma: Positive = 0.1,
        step_size: Positive = 0.05,
        recommendation: Literal["mean", "best_seen", "reevaluated"] = "mean",
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            population: Episodes per gradient step, n of eq. (2).
            sigma: Standard deviation of the search distribution, in normalised coordinates.
            step_size: Step size of Adam.
            recommendation: "mean" of the search distribution; others: see `EpisodeTuner`.
            options: Of `EpisodeTuner`; the first mean is `start`.
        """
        super().__init__(problem, recommendation=recommendation, **options)
        self._population = population
        self._sigma = sigma
        self._step_size = step_size
        self._theta = self._first
        self._adam = START
        self._noise = np.empty((0, len(self._theta)))

    def _draw(self) -> list[np.ndarray]:
        self._noise = self._rng.standard_normal((self._population, len(self._theta)))
        return list(self._theta + self._sigma * self._noise)

    def _learn(self, outcomes: Outcomes) -> dict[str, float]:
        costs = standardised_costs(self._costs.prices(outcomes))
        gradient = zeroth_order_gradient(costs, self._noise, self._sigma)
        # Outside the box the noise is clipped, so no gradient would return the mean to the box.
        theta, self._adam = descend(self._theta, self._adam, gradient, self._step_size)
        self._theta = self._problem.space.clip(theta)
        return {"gradient_norm": float(np.linalg.norm(gradient))}

    def _own_recommendation(self) -> np.ndarray | None:
        return self._theta

    def describe(self) -> dict[str, Any]:
        return {
            "start": self._start,
            "population": self._population,
            "initial_sigma": self._sigma,
            "step_size": self._step_size,
            **super().describe(),
        }


def standardised_costs(costs: np.ndarray) -> np.ndarray:
    """Return costs (n,) at mean 0 and standard deviation 1; zeros if all are equal."""
    centred = costs - costs.mean()
    deviation = centred.std()
    return centred / deviation if deviation > 0 else np.zeros_like(costs)
