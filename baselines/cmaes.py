"""CMA-ES by Nevergrad: the library's choices or one's own."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from zoac.baselines.nevergrad import NevergradTuner, ng
from zoac.core.errors import ConfigError
from zoac.core.tuner import Problem
from zoac.core.types import Positive
from zoac.rollout.outcomes import Outcomes

MAX_SIGMA = 2.0 / 3.0
"""Largest standard deviation in normalised coordinates: a third of the box.

pycma sets this limit itself where it knows the bounds, but Nevergrad reflects points at the bounds
and does not pass them on. The deviation of parameters that hardly matter would grow without end.
"""


class CmaEs(NevergradTuner):
    """Nevergrad's `CMA`, or its `ParametrizedCMA` where an option says otherwise.

    On a bounded box `CMA` is not textbook CMA-ES: the library chooses a diagonal, elitist
    variant with a small population and a small initial standard deviation. It recommends the
    point of the cheapest single episode since its last restart. `describe` shows the choices.
    """

    display_name = "CMA-ES"

    def __init__(
        self,
        problem: Problem,
        *,
        initial_sigma: Positive | None = None,
        population: Annotated[int, Field(ge=2)] | None = None,
        covariance: Literal["full", "diagonal"] | None = None,
        elitist: bool | None = None,
        recommendation: Literal["library", "mean", "best_seen", "reevaluated"] = "library",
        **options: Any,
    ) -> None:
        """
        If the first four options are None, the library chooses. If any of them is given, the
        others take the values of textbook CMA-ES: initial sigma 0.5, population 4 + 3 ln d, full
        covariance, not elitist.

        Args:
            problem: What is tuned.
            initial_sigma: Initial standard deviation in normalised coordinates.
            population: Points per generation; a batch is then one generation.
            covariance: "full" or "diagonal".
            elitist: The best point so far stays in the population.
            recommendation: "library"; "mean" of the search distribution; others: see
                `EpisodeTuner`.
            options: Of `EpisodeTuner`; the initial mean is `start`.

        Raises:
            ConfigError: If there is a single parameter.
        """
        if problem.space.dimension == 1:
            raise ConfigError(
                "CMA-ES needs two parameters or more; for one use tuner=zoac_plus, bo or optuna"
            )
        chosen = (initial_sigma, population, covariance, elitist)
        self._by_library = all(option is None for option in chosen)
        if covariance is not None:
            self.display_name = f"CMA-ES ({covariance}, {recommendation})"
        self._factory = ng.optimizers.registry["CMA"]
        if not self._by_library:
            d = problem.space.dimension
            first = initial_sigma or 0.5
            # The library scales its mutations by this factor on a bounded box.
            self._initial_sigma = first / (0.3 if d < 18 else 0.15)
            self._factory = ng.families.ParametrizedCMA(
                scale=1.0,
                popsize=population or 4 + int(3 * np.log(d)),
                diagonal=covariance == "diagonal",
                elitist=bool(elitist),
                inopts={"maxstd": max(MAX_SIGMA, first) / self._initial_sigma},
            )
            self._workers = 1  # with more workers the library would enlarge the population
        super().__init__(problem, recommendation=recommendation, **options)

    @property
    def _strategy(self) -> Any:
        """The `cma.CMAEvolutionStrategy` inside the optimiser."""
        optimizer = self._part("optim") if self._by_library else self._optimizer
        with self._library():
            # Reading the property `es` would restart a strategy that has converged.
            return optimizer.es if optimizer._es is None else optimizer._es

    def _batch(self) -> int:
        return super()._batch() if self._by_library else int(self._strategy.popsize)

    def _learn(self, outcomes: Outcomes) -> dict[str, float]:
        metrics = super()._learn(outcomes)
        return {**metrics, "sigma": float(self._strategy.sigma) * self._initial_sigma}

    def _own_recommendation(self) -> np.ndarray | None:
        if self._recommendation != "mean":
            return super()._own_recommendation()
        with self._library():
            box = self._optimizer.parametrization.spawn_child()
            return np.array(box.set_standardized_data(self._strategy.mean).value)

    def describe(self) -> dict[str, Any]:
        strategy = self._strategy
        return {
            **super().describe(),
            "initial_sigma": float(strategy.sigma0) * self._initial_sigma,
            "population": int(strategy.popsize),
            "covariance": "diagonal" if strategy.opts["CMA_diagonal"] else "full",
            "elitist": bool(strategy.opts["CMA_elitist"]),
        }
