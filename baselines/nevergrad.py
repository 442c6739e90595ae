"""Any optimiser of Nevergrad by its name."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from copy import deepcopy
from typing import Any, Literal

import numpy as np

from zoac.baselines.episode_tuner import EpisodeTuner
from zoac.core.errors import ConfigError, as_text, suggest
from zoac.core.seeding import global_random_kept
from zoac.core.tuner import Problem
from zoac.core.types import Positive
from zoac.rollout.outcomes import Outcomes

with global_random_kept():  # the library draws while it is imported
    import nevergrad as ng
    from nevergrad.common.errors import InefficientSettingsWarning, TellNotAskedNotSupportedError

Optimizer = Any
Factory = Callable[[Any, int, int], Optimizer]
"""Parametrization, number of evaluations, number of workers -> optimiser."""

LIBRARY_SIGMA = 1.0 / 3.0
"""Nevergrad's mutation standard deviation for bounds [-1, 1]: a sixth of their distance."""

OTHERS = "Choose another, such as TwoPointsDE, DiagonalCMA or PSO"


class NevergradTuner(EpisodeTuner):
    """An optimiser of Nevergrad, by ask and tell.

    The state is the history of costs. `restore` makes the optimiser again from the same seed and
    repeats every ask and tell. Any deterministic optimiser resumes exactly; the repetition takes as
    long as the optimiser's own computations did.

    A subclass sets `_factory`, and if necessary the two attributes below, before it calls the
    constructor of this class.
    """

    _factory: Factory
    _initial_sigma: float = LIBRARY_SIGMA
    """Standard deviation of Nevergrad's mutations, in normalised coordinates."""
    _workers: int = 0
    """Evaluations planned at a time; 0: `num_envs`, or 1 where the library allows no more."""

    def __init__(self, problem: Problem, **options: Any) -> None:
        """
        Args:
            problem: What is tuned.
            options: Of `EpisodeTuner`.

        Raises:
            ConfigError: If the optimiser needs a package that is not installed.
        """
        super().__init__(problem, **options)
        one_by_one = getattr(self._factory, "no_parallelization", False)
        self._workers = self._workers or (1 if one_by_one else problem.num_envs)
        self._seed = int(self._rng.integers(2**32))
        self._begin()

    def _begin(self) -> None:
        """Make the optimiser in its state before the first ask."""
        self._global_random = np.random.RandomState(self._seed).get_state()
        self._optimizer = self._make()
        self._asked: list[Any] = []
        self._history: list[int | np.ndarray] = []  # points asked; costs told

    def _make(self) -> Optimizer:
        with self._library():
            box = ng.p.Array(init=self._first, lower=-1.0, upper=1.0)
            box.set_mutation(sigma=self._initial_sigma)
            box.random_state.seed(self._seed)
            return self._factory(box, self.search_episodes, self._workers)

    @contextmanager
    def _library(self) -> Iterator[None]:
        """Run library code with its own global NumPy random state.

        Some optimisers draw from the global state; this one is seeded from the tuner's stream.
        Warnings about intended settings are silenced.

        Raises:
            ConfigError: If the library's code fails; some optimisers need packages that are not
                installed, and some do not work with this version of numpy.
        """
        outside = np.random.get_state()  # noqa: NPY002
        np.random.set_state(self._global_random)  # noqa: NPY002
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", InefficientSettingsWarning)
                warnings.filterwarnings("ignore", "orphanated injected")  # where it asks singly
                yield
        except Exception as error:
            raise ConfigError(
                f"Nevergrad's optimiser failed: {as_text(error)}. {OTHERS}"
            ) from error
        finally:
            self._global_random = np.random.get_state()  # noqa: NPY002
            np.random.set_state(outside)  # noqa: NPY002

    @contextmanager
    def _only_looking(self) -> Iterator[None]:
        """Run library code and discard its random draws: some properties draw when read."""
        globally = self._global_random
        with self._library():
            yield
        self._global_random = globally

    def _part(self, name: str) -> Any:
        """Return an attribute of the optimiser."""
        with self._only_looking():
            return getattr(self._optimizer, name)

    def _batch(self) -> int:
        """Return the number of points per ask."""
        return self._workers

    def _draw(self) -> list[np.ndarray]:
        return self._ask_library(self._batch())

    def _ask_library(self, n: int) -> list[np.ndarray]:
        with self._library():
            candidates = [self._optimizer.ask() for _ in range(n)]
        self._asked += candidates
        self._history.append(n)
        with self._only_looking():
            return [np.array(candidate.value) for candidate in candidates]

    def _learn(self, outcomes: Outcomes) -> dict[str, float]:
        return self._tell_library(outcomes.keys())

    def _tell_library(self, costs: np.ndarray) -> dict[str, float]:
        with self._library():
            for candidate, cost in zip(self._asked, costs, strict=True):
                # Some optimisers accept only points of their own, and so no start.
                with suppress(TellNotAskedNotSupportedError):
                    self._optimizer.tell(candidate, float(cost))
        self._asked = []
        self._history.append(costs)
        return {}

    def _own_recommendation(self) -> np.ndarray | None:
        if self._optimizer.num_tell == 0:
            return self._first
        with self._only_looking():
            own = self._optimizer.parametrization.random_state
            before = own.get_state()
            value = np.array(self._optimizer.provide_recommendation().value)
            own.set_state(before)
        return value

    def _own_state(self) -> Any:
        return deepcopy(self._history)

    def _own_restore(self, state: Any) -> None:
        self._begin()
        for item in deepcopy(state):
            if isinstance(item, int):
                self._ask_library(item)
            else:
                self._tell_library(item)

    def describe(self) -> dict[str, Any]:
        return {
            "optimizer": str(self._optimizer.name),
            "library": f"nevergrad {ng.__version__}",
            "start": self._start,
            "evaluations": self.search_episodes,
            "workers": self._workers,
            "batch": self._batch(),
            **super().describe(),
        }


class Nevergrad(NevergradTuner):
    """The optimiser called `name` in Nevergrad's registry.

    Some optimisers ignore an initial value, so the baseline is also the first point evaluated.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        name: str = "TwoPointsDE",
        initial_sigma: Positive | None = None,
        recommendation: Literal["library", "best_seen", "reevaluated"] = "library",
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            name: A name in `nevergrad.optimizers.registry`, of an optimiser with ask and tell.
            initial_sigma: Standard deviation of Nevergrad's mutations in normalised coordinates;
                None: the library's.
            recommendation: "library": the optimiser's own; others: see `EpisodeTuner`.
            options: Of `EpisodeTuner`; the optimiser's initial value is `start`.

        Raises:
            ConfigError: If there is no optimiser of that name, it has no ask and tell, or see
                `NevergradTuner`.
        """
        registry = ng.optimizers.registry
        if name not in registry:
            raise ConfigError(f"unknown Nevergrad optimiser {name!r}; {suggest(name, registry)}")
        self._factory = registry[name]
        self.display_name = f"Nevergrad {name}"
        self._initial_sigma = LIBRARY_SIGMA if initial_sigma is None else initial_sigma
        super().__init__(problem, recommendation=recommendation, **options)

    def _make(self) -> Optimizer:
        optimizer = super()._make()
        with self._library():
            threaded = _runs_in_a_thread(optimizer)
        if threaded:
            raise ConfigError(
                f"name={optimizer.name!r}: an optimiser without ask and tell, or made of one, "
                f"would run in a thread. {OTHERS}"
            )
        if self._start == "baseline":
            optimizer.suggest(self._first)
        return optimizer

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "initial_sigma": self._initial_sigma}


def _runs_in_a_thread(optimizer: Optimizer) -> bool:
    """Return whether an optimiser, or one of those that it is made of, has no ask and tell."""
    if isinstance(optimizer, ng.optimizers.NGOptBase):
        _ = optimizer.optim  # chosen when it is read
    held = [v if isinstance(v, list) else [v] for v in vars(optimizer).values()]
    kind = ng.optimizers.base.Optimizer
    parts = [part for some in held for part in some if isinstance(part, kind)]
    return optimizer.recast or any(map(_runs_in_a_thread, parts))
