"""Base class of tuners whose library is given the whole history before each batch."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.special import ndtri
from scipy.stats import rankdata

from zoac.baselines.bo import kept_observations
from zoac.baselines.episode_tuner import EpisodeTuner
from zoac.core.parameters import ParameterSpace
from zoac.core.tuner import Problem
from zoac.core.types import Count
from zoac.rollout.outcomes import Outcomes


class ModelTuner(EpisodeTuner):
    """A library's model that is made anew for each batch, from all observations and a seed.

    The state is the history and the random stream. So a run continues bit for bit, and no object of
    the library is saved. A subclass says in `_suggest` which points its library evaluates next.
    """

    library: ClassVar[str]
    """Name and version of the library, for `describe`."""
    kept = "_points _seen _asked"
    draws_design: ClassVar[bool] = False
    """The library draws the random points before the first model, too."""

    def __init__(
        self,
        problem: Problem,
        *,
        initial_design: Count = 10,
        max_observations: Annotated[int, Field(ge=10)] | None = 500,
        recommendation: Literal["best_seen", "reevaluated"] = "best_seen",
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            initial_design: Random points before the first model.
            max_observations: The model sees no more than these: the cheapest half and the most
                recent half. None: all.
            recommendation: See `EpisodeTuner`.
            options: Of `EpisodeTuner`; the first point is `start`.
        """
        super().__init__(problem, recommendation=recommendation, **options)
        self._initial_design, self._max_observations = initial_design, max_observations
        self._points = np.empty((0, problem.space.dimension))
        self._seen = Outcomes.none()
        self._asked = self._points

    @abstractmethod
    def _suggest(self, points: np.ndarray, costs: np.ndarray, count: int, seed: int) -> np.ndarray:
        """Return the points to evaluate next, (count, d) or fewer.

        Args:
            points: Observed points (n, d), rounded as `ParameterSpace.rounded` does.
            costs: Normal quantiles (n,) of the ranks of their costs. So a few huge costs do not
                hide the differences of the others.
            count: Number of points.
            seed: For all random numbers of the library, below 2^31.
        """

    def _draw(self) -> list[np.ndarray]:
        count, space = self._problem.num_envs, self._problem.space
        points = self._rng.uniform(-1.0, 1.0, (count, space.dimension))
        if self.draws_design or len(self._seen) >= self._initial_design:
            costs = self._costs.prices(self._seen)
            kept = kept_observations(-costs, self._max_observations)
            seed = int(self._rng.integers(2**31))
            observed = space.rounded(self._points[kept])
            found = self._suggest(observed, normal_scores(costs[kept]), count, seed)
            points[: len(found)] = found
        points = space.rounded(points)
        if not len(self._seen) and not len(self._asked):
            points[0] = self._first
        self._asked = np.concatenate([self._asked, points])
        return list(points)

    def _learn(self, outcomes: Outcomes) -> dict[str, float]:
        self._points = np.concatenate([self._points, self._asked])
        self._seen += outcomes
        self._asked = self._asked[:0]
        return {}

    def describe(self) -> dict[str, Any]:
        return {
            "library": self.library,
            "initial_design": self._initial_design,
            "max_observations": self._max_observations,
            "start": self._start,
            "batch": self._problem.num_envs,
            **super().describe(),
        }


def normal_scores(values: np.ndarray) -> np.ndarray:
    """Return the standard normal quantiles (n,) of the ranks of `values` (n,); ties are equal."""
    return ndtri((rankdata(values) - 0.5) / max(len(values), 1))


def params_of(x: np.ndarray, space: ParameterSpace) -> dict[str, float | int]:
    """Return a normalised point (d,) as a library's parameters, choices as positions."""
    values = space.values(x)
    params: dict[str, float | int] = {}
    for p, columns, value in zip(space.parameters, space.columns, values, strict=True):
        if p.kind == "choice":
            params[p.name] = int(x[columns].argmax())
        else:
            params[p.name] = int(value) if p.kind == "integer" else float(x[columns][0])
    return params


def point_of(params: Mapping[str, float | int], space: ParameterSpace) -> np.ndarray:
    """Return the rounded normalised point (d,) of a library's parameters."""
    x = np.full(space.dimension, -1.0)
    for p, columns in zip(space.parameters, space.columns, strict=True):
        if p.kind == "choice":
            x[columns.start + int(params[p.name])] = 1.0
        else:
            x[columns] = p.centre(params[p.name]) if p.kind == "integer" else params[p.name]
    return x
