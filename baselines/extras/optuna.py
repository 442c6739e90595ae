"""Optuna's samplers: Bayesian optimisation that takes noise and batches into account."""

import warnings
from copy import deepcopy
from typing import Any, Literal

import numpy as np

from zoac.baselines.extras.model_tuner import ModelTuner, params_of, point_of
from zoac.core.errors import ConfigError
from zoac.core.parameters import Parameter
from zoac.core.state import OwnObject
from zoac.core.tuner import Problem
from zoac.core.types import Count

try:
    import optuna
except ImportError as error:
    raise ConfigError("this tuner needs Optuna: pip install 'zoac[optuna]'") from error


class Optuna(ModelTuner):
    """A Gaussian process with a noise term, or a tree of Parzen estimators, in batches.

    Each batch comes from a new Optuna study, which holds the kept observations with transformed
    costs. The sampler lasts; it draws the initial design, too.
    """

    library = f"optuna {optuna.__version__}"
    draws_design = True

    def __init__(
        self,
        problem: Problem,
        *,
        sampler: Literal["gp", "tpe"] = "gp",
        initial_design: Count = 20,
        recommendation: Literal["best_seen", "reevaluated"] = "best_seen",
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            sampler: "gp": Gaussian process, log expected improvement, points under evaluation
                taken into account; "tpe": multivariate tree-structured Parzen estimator.
            initial_design: Random points before the first model.
            recommendation: See `EpisodeTuner`; Optuna itself recommends "best_seen".
            options: Of `ModelTuner`.
        """
        super().__init__(
            problem, initial_design=initial_design, recommendation=recommendation, **options
        )
        self.display_name = f"Optuna {sampler.upper()}"
        self._kind = sampler
        self._sampler = _sampler(sampler, initial_design, int(self._rng.integers(1, 2**32)))
        self._distributions = {p.name: _distribution(p) for p in problem.space.parameters}

    def _suggest(self, points: np.ndarray, costs: np.ndarray, count: int, seed: int) -> np.ndarray:
        space = self._problem.space
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            study = optuna.create_study(sampler=self._sampler)
            study.add_trials(
                [
                    optuna.trial.create_trial(
                        params=params_of(point, space),
                        distributions=self._distributions,
                        value=float(cost),
                    )
                    for point, cost in zip(points, costs, strict=True)
                ]
            )
            trials = [study.ask(self._distributions) for _ in range(count)]
        return np.stack([point_of(trial.params, space) for trial in trials])

    def _own_state(self) -> Any:
        return OwnObject(deepcopy(self._sampler))

    def _own_restore(self, state: Any) -> None:
        self._sampler = deepcopy(state.value)

    def describe(self) -> dict[str, Any]:
        return {
            "library": self.library,
            "sampler": self._kind,
            "initial_design": self._initial_design,
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
