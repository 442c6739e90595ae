"""Bayesian optimisation by Nevergrad, with bounded time per evaluation."""

import contextlib
import io
import warnings
from copy import deepcopy
from functools import partial
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern

from zoac.baselines.acquisition import Acquisition, maximise
from zoac.baselines.nevergrad import NevergradTuner, ng
from zoac.core.parameters import ParameterSpace
from zoac.core.seeding import global_random_kept
from zoac.core.state import OwnObject
from zoac.core.tuner import Problem
from zoac.core.types import Count, NonNegative, Positive
from zoac.rollout.outcomes import Outcomes


class BayesOpt(NevergradTuner):
    """Nevergrad's `BO`: a Gaussian process and an upper confidence bound, one point at a time.

    The library fits its Gaussian process anew before each point, to all observations: thousands
    of evaluations would take days. Two options bound that, both off (0 and None) in the library:
    `refit_growth` and `max_observations`.
    """

    display_name = "BO"
    kept = "_global_random _seen"

    def __init__(
        self,
        problem: Problem,
        *,
        start: Literal["random", "baseline", "middle", "library"] = "random",
        initial_design: Count | None = None,
        noise: Positive = 1e-6,
        refit_growth: NonNegative = 0.05,
        max_observations: Annotated[int, Field(ge=10)] | None = 300,
        recommendation: Literal["library", "mean", "best_seen", "reevaluated"] = "library",
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            start: First point, see `EpisodeTuner`; "library": none, as the library ignores it.
            initial_design: Random points before the first fit; None: the library's, the square
                root of the number of evaluations.
            noise: Variance of the noise over that of the costs; the default is the library's and
                means none.
            refit_growth: Fraction by which the observations must grow before the length scale of
                the kernel is estimated again. In between, the process is conditioned on all
                observations with the last estimate. 0: estimate at every point.
            max_observations: Largest number of observations that the process is conditioned on:
                the cheapest half and the most recent half. None: all.
            recommendation: "library": the cheapest single episode's point; "mean": the evaluated
                point of the lowest posterior mean at the last ask; others: see `EpisodeTuner`.
            options: Of `EpisodeTuner`.
        """
        self._seen = Outcomes.none()
        self._model: dict[str, Any] = {
            "initial_design": initial_design,
            "noise": noise,
            "refit_growth": refit_growth,
            "max_observations": max_observations,
        }
        with global_random_kept():  # the library tries it out
            self._factory = ng.families.ParametrizedBO(
                init_budget=initial_design,
                gp_parameters={"alpha": noise},
            )
        super().__init__(problem, start=start, recommendation=recommendation, **options)

    def _make(self) -> Any:
        optimizer = super()._make()
        with self._library():
            bo = optimizer.bo
            # The library refuses the same point twice; with noise, twice is information.
            bo._space._allow_duplicate_points = True
            self._process = BoundedRegressor(
                self._model["refit_growth"],
                self._model["max_observations"],
                # The library's settings.
                kernel=Matern(nu=2.5),
                alpha=self._model["noise"],
                normalize_y=True,
                n_restarts_optimizer=5,
                random_state=bo.space.random_state,
            )
            if self._start != "library":
                optimizer.suggest(self._first)
        return optimizer

    def _draw(self) -> list[np.ndarray]:
        bo = self._part("bo")
        bo.suggest = self._suggest
        try:
            return super()._draw()
        finally:
            del bo.suggest  # a copy of the library's objects shall not hold the tuner

    def _suggest(self, utility: Any) -> dict[str, float]:
        """Return the next point, as `bayes_opt.BayesianOptimization.suggest` does, but faster.

        The library was told keys, which only rank; the process needs meaningful differences. It is
        fitted to rounded points, so that its posterior is constant where the cost is constant
        (Garrido-Merchan and Hernandez-Lobato 2020).
        """
        bo, process = self._optimizer.bo, self._process
        if len(bo.space) == 0:
            return bo.space.array_to_params(bo.space.random_sample())
        rounded = partial(rounded_points, self._problem.space)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the fit's convergence, as in the library
            process.fit(rounded(bo.space.params), -self._costs.prices(self._seen))
        point = maximise(
            Acquisition(process, process.seen), bo.space.bounds, bo.space.random_state, rounded
        )
        return bo.space.array_to_params(point)

    def _learn(self, outcomes: Outcomes) -> dict[str, float]:
        self._seen += outcomes
        with contextlib.redirect_stdout(io.StringIO()):  # it prints each duplicate in red
            return super()._learn(outcomes)

    def _own_recommendation(self) -> np.ndarray | None:
        if self._recommendation != "mean" or not hasattr(self._process, "X_train_"):
            return super()._own_recommendation()
        points = self._part("bo").space.params
        means = self._process.predict(rounded_points(self._problem.space, points))
        return points[int(np.argmax(means))] * 2.0 - 1.0

    def _own_state(self) -> Any:
        # Repeating every ask would take hours, so the optimiser is copied.
        return OwnObject(deepcopy((self._optimizer, self._process, self._asked)))

    def _own_restore(self, state: Any) -> None:
        self._optimizer, self._process, self._asked = deepcopy(state.value)

    def describe(self) -> dict[str, Any]:
        design = self._model["initial_design"] or int(np.sqrt(self.search_episodes))
        return {**super().describe(), **self._model, "initial_design": max(2, design)}


class BoundedRegressor(GaussianProcessRegressor):
    """A Gaussian process with few kernel estimates and a bounded number of observations.

    Args:
        growth: `refit_growth` of `BayesOpt`.
        cap: `max_observations` of `BayesOpt`.
        settings: Of `GaussianProcessRegressor`.
    """

    kernel: Any
    optimizer: Any
    seen: np.ndarray
    """The values that it is conditioned on."""

    def __init__(self, growth: float, cap: int | None, **settings: Any) -> None:
        super().__init__(**settings)
        self.growth, self.cap = growth, cap
        self._due = 0

    def fit(self, points: np.ndarray, values: np.ndarray) -> Self:
        """Condition on `points` (n, d) and `values` (n,), to be maximised."""
        kept = kept_observations(values, self.cap)
        points, values_kept = points[kept], values[kept]
        self.seen = values_kept
        previous = getattr(self, "kernel_", None)
        if previous is not None and len(values) < self._due:
            return self._condition(points, values_kept, previous)
        self._due = max(len(values) + 1, int(len(values) * (1.0 + self.growth)))
        super().fit(points, values_kept)
        if previous is not None and self.growth > 0:
            # The library's estimate sometimes ends at a bound where the likelihood is flat. The
            # library estimates again at the next point; here a bad estimate would last longer.
            likelihood = self.log_marginal_likelihood(previous.theta)
            if likelihood > self.log_marginal_likelihood_value_:
                return self._condition(points, values_kept, previous)
        return self

    def _condition(self, points: np.ndarray, values: np.ndarray, kernel: Any) -> Self:
        prior, estimator = self.kernel, self.optimizer
        self.kernel, self.optimizer = kernel, None
        try:
            super().fit(points, values)
        finally:
            self.kernel, self.optimizer = prior, estimator
        return self


def kept_observations(values: np.ndarray, cap: int | None) -> np.ndarray:
    """Return the indices, ascending, of the best half and the latest half of `cap` values (n,)."""
    n = len(values)
    if cap is None or n <= cap:
        return np.arange(n)
    latest = np.arange(n - cap // 2, n)
    earlier = np.argsort(-values[: latest[0]], kind="stable")[: cap - len(latest)]
    return np.concatenate([np.sort(earlier), latest])


def rounded_points(space: ParameterSpace, points: np.ndarray) -> np.ndarray:
    """`ParameterSpace.rounded` of points (..., d) in the library's box [0, 1]^d."""
    x = points * 2.0 - 1.0
    rounded = space.rounded(x)
    return np.where(rounded == x, points, (rounded + 1.0) / 2.0)
