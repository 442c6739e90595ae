"""CMA-ES by Nevergrad, as the library has it or as it is told."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from zoac.baselines.nevergrad import NevergradTuner, ng
from zoac.core.errors import ConfigError
from zoac.core.tuner import Problem
from zoac.core.types import Count, Fraction, Positive
from zoac.rollout.outcomes import Outcomes


class CmaEs(NevergradTuner):
    """Nevergrad's `CMA`, or its `ParametrizedCMA` where an option says otherwise.

    On a bounded box `CMA` is not textbook CMA-ES: the library chooses a diagonal, elitist
    variant of small population and small initial spread, and recommends the point of the
    cheapest single episode since its last restart. `describe` shows what was chosen.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        start: Literal["random", "baseline", "middle"] = "random",
        initial_sigma: Positive | None = None,
        population: Annotated[int, Field(ge=2)] | None = None,
        covariance: Literal["full", "diagonal"] | None = None,
        elitist: bool | None = None,
        recommendation: Literal["library", "mean", "best_seen", "reevaluated"] = "library",
        reevaluate_top: Count = 10,
        reevaluate_fraction: Fraction = 0.1,
    ) -> None:
        """
        Four options are the library's choice where they are None. With any of them given, the
        others become those of textbook CMA-ES: spread 0.5, population 4 + 3 ln d, full
        covariance, not elitist.

        Args:
            problem: What is tuned.
            start: The initial mean.
            spread: Initial standard deviation in the mapped box.
            population: Points per generation; a batch is then one generation.
            covariance: "full" or "diagonal".
            elitist: The best point so far stays in the population.
            recommendation: "library"; "mean" of the search distribution; or see `EpisodeTuner`.
            reevaluate_top: See `EpisodeTuner`.
            reevaluate_fraction: See `EpisodeTuner`.

        Raises:
            ConfigError: If there is a single parameter, or `start` is "baseline" and the task has
                no baseline parameters.
        """
        if problem.space.dimension == 1:
            raise ConfigError(
                "CMA-ES needs two parameters or more; for one use tuner=zoac_plus, bo or optuna"
            )
        chosen = (initial_sigma, population, covariance, elitist)
        self._by_library = all(option is None for option in chosen)
        textbook = ng.families.ParametrizedCMA(
            scale=1.0,
            popsize=population or 4 + int(3 * np.log(problem.space.dimension)),
            diagonal=covariance == "diagonal",
            elitist=bool(elitist),
        )
        super().__init__(
            problem,
            ng.optimizers.registry["CMA"] if self._by_library else textbook,
            start=start,
            initial_sigma=None
            if self._by_library
            else self._mutation(problem, initial_sigma or 0.5),
            # With more workers the library would enlarge the population to their number.
            workers=None if self._by_library else 1,
            recommendation=recommendation,
            reevaluate_top=reevaluate_top,
            reevaluate_fraction=reevaluate_fraction,
        )

    @staticmethod
    def _mutation(problem: Problem, initial_sigma: float) -> float:
        """Return Nevergrad's mutation standard deviation that gives CMA-ES this spread."""
        factor = 0.3 if problem.space.dimension < 18 else 0.15  # the library's, for a bounded box
        return initial_sigma / factor

    @property
    def _strategy(self) -> Any:
        """The `cma.CMAEvolutionStrategy` within."""
        optimizer = self._part("optim") if self._by_library else self._optimizer
        with self._library():
            # The property `es` restarts a strategy that has converged: not for looking at it.
            return optimizer.es if optimizer._es is None else optimizer._es

    def _batch(self) -> int:
        return super()._batch() if self._by_library else int(self._strategy.popsize)

    def _learn(self, outcomes: Outcomes) -> dict[str, float]:
        metrics = super()._learn(outcomes)
        return {**metrics, "initial_sigma": float(self._strategy.sigma) * self._initial_sigma}

    def _own_recommendation(self) -> np.ndarray | None:
        if self._recommendation != "mean":
            return super()._own_recommendation()
        with self._library():
            box = self._optimizer.parametrization.spawn_child()
            return np.array(box.set_standardized_data(self._strategy.mean).value)

    def describe(self) -> dict[str, Any]:
        """Return the choices, those of the library as it made them."""
        strategy = self._strategy
        return {
            **super().describe(),
            "initial_sigma": float(strategy.sigma0) * self._initial_sigma,
            "population": int(strategy.popsize),
            "covariance": "diagonal" if strategy.opts["CMA_diagonal"] else "full",
            "elitist": bool(strategy.opts["CMA_elitist"]),
        }
