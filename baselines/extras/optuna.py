"""Optuna's samplers: Bayesian optimisation that takes noise and batches into account."""

import warnings
from copy import deepcopy
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from zoac.baselines.bo import kept_observations
from zoac.baselines.episode_tuner import EpisodeTuner
from zoac.baselines.extras.model_tuner import normal_scores, params_of, point_of
from zoac.core.errors import ConfigError
from zoac.core.parameters import Parameter
from zoac.core.state import OwnObject
from zoac.core.tuner import Problem
from zoac.core.types import Count
from zoac.rollout.outcomes import Outcomes

try:
    import optuna
except ImportError as error:
    raise ConfigError("this tuner needs Optuna: pip install 'zoac[optuna]'") from error


class Optuna(EpisodeTuner):
    """A Gaussian process with a noise term, or a tree of Parzen estimators, in batches.

    This class keeps the history. Each batch comes from a new Optuna study, which holds the kept
    observations with transformed costs.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        sampler: Literal["gp", "tpe"] = "gp",
        initial_design: Count = 20,
        costs: Literal["normal_scores", "raw"] = "normal_scores",
        max_observations: Annotated[int, Field(ge=10)] | None = 500,
        recommendation: Literal["best_seen", "reevaluated"] = "best_seen",
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            sampler: "gp": Gaussian process, log expected improvement, points under evaluation
                taken into account; "tpe": multivariate tree-structured Parzen estimator.
            initial_design: Random points before the first model.
            costs: "normal_scores": the model sees the normal quantiles of the costs' ranks, so a
                few huge costs do not hide the differences of the others; or "raw" costs.
            max_observations: The model sees no more than these: the cheapest half and the most
                recent half. None: all.
            recommendation: See `EpisodeTuner`; Optuna itself recommends "best_seen".
            options: Of `EpisodeTuner`; the first point is `start`.
        """
        super().__init__(problem, recommendation=recommendation, **options)
        self.display_name = f"Optuna {sampler.upper()}"
        self._options: dict[str, Any] = {
            "sampler": sampler,
            "initial_design": initial_design,
            "costs": costs,
            "max_observations": max_observations,
            "start": self._start,
        }
        self._sampler = _sampler(sampler, initial_design, int(self._rng.integers(1, 2**32)))
        self._distributions = {p.name: _distribution(p) for p in problem.space.parameters}
        self._points = np.empty((0, problem.space.dimension))
        self._seen = Outcomes.none()
        self._asked: list[np.ndarray] = []

    def _draw(self) -> list[np.ndarray]:
        began = bool(len(self._seen) or self._asked)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            study = self._study()
            trials = [study.ask(self._distributions) for _ in range(self._problem.num_envs)]
        points = [point_of(trial.params, self._problem.space) for trial in trials]
        if not began:
            points[0] = self._first
        self._asked += points
        return points

    def _study(self) -> Any:
        """Return a study of the kept observations with transformed costs."""
        study = optuna.create_study(sampler=self._sampler)
        costs = self._costs.prices(self._seen)
        kept = kept_observations(-costs, self._options["max_observations"])
        costs = costs[kept]
        if self._options["costs"] == "normal_scores":
            costs = normal_scores(costs)
        study.add_trials(
            [
                optuna.trial.create_trial(
                    params=params_of(point, self._problem.space),
                    distributions=self._distributions,
                    value=float(cost),
                )
                for point, cost in zip(self._points[kept], costs, strict=True)
            ]
        )
        return study

    def _learn(self, outcomes: Outcomes) -> dict[str, float]:
        self._points = np.concatenate([self._points, np.stack(self._asked)])
        self._seen += outcomes
        self._asked = []
        return {}

    def _own_state(self) -> Any:
        asked = [point.copy() for point in self._asked]
        return OwnObject(deepcopy(self._sampler)), self._points.copy(), self._seen.state(), asked

    def _own_restore(self, state: Any) -> None:
        sampler, self._points, seen, asked = state
        self._sampler, self._asked = deepcopy(sampler.value), list(asked)
        self._seen = Outcomes(*seen)

    def describe(self) -> dict[str, Any]:
        """See `Tuner.describe`."""
        return {
            "library": f"optuna {optuna.__version__}",
            **self._options,
            "batch": self._problem.num_envs,
            **super().describe(),
        }


def _distribution(p: Parameter) -> Any:
    """Return Optuna's distribution: normalised for real parameters, physical for discrete ones."""
    if p.kind == "choice":
        return optuna.distributions.CategoricalDistribution(range(len(p.options)))
    if p.kind == "integer":
        return optuna.distributions.IntDistribution(int(p.low), int(p.high))
    return optuna.distributions.FloatDistribution(-1.0, 1.0)


def _sampler(kind: str, initial_design: int, seed: int) -> Any:
    if kind == "gp":
        return optuna.samplers.GPSampler(seed=seed, n_startup_trials=initial_design)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return optuna.samplers.TPESampler(
            seed=seed, n_startup_trials=initial_design, multivariate=True, constant_liar=True
        )


optuna.logging.set_verbosity(optuna.logging.WARNING)  # a study of its own for each batch
