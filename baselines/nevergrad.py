"""Any optimiser of Nevergrad by its name, on whole episodes."""

from __future__ import annotations

import queue
import time
import warnings
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, ClassVar, Literal

import numpy as np

from zoac.baselines.episodes import EpisodeTuner
from zoac.core.errors import ConfigError, suggest
from zoac.core.seeding import global_random_kept
from zoac.core.tuner import Problem
from zoac.core.types import Count, Fraction, Positive
from zoac.rollout.outcomes import Outcomes

with global_random_kept():  # the library draws while it is imported
    import nevergrad as ng
    from nevergrad.common.errors import InefficientSettingsWarning, TellNotAskedNotSupportedError
    from nevergrad.optimization import recaster

Optimizer = Any
Factory = Callable[[Any, int, int], Optimizer]
"""Parametrization, number of evaluations, number of workers -> optimiser."""

LIBRARY_SIGMA = 1.0 / 3.0
"""Nevergrad's mutation standard deviation for bounds [-1, 1]: a sixth of their distance."""


class _Counting(queue.Queue[Any]):
    """A queue that knows how many items were put into it."""

    count = 0

    def put(self, item: Any, block: bool = True, timeout: float | None = None) -> None:
        super().put(item, block, timeout)
        self.count += 1


class _Thread(recaster._MessagingThread):
    """Optimisers without ask and tell run in a thread; the library's own has two faults.

    It keeps Python from exiting, and it goes on computing, and drawing random numbers, after
    `tell` has returned.
    """

    daemon = True
    alive: ClassVar[weakref.WeakSet[_Thread]] = weakref.WeakSet()

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.messages_tell = _Counting()
        self.alive.add(self)

    @classmethod
    def settle(cls) -> None:
        """Wait until each thread has asked for as many values as it was told, and one more."""
        for thread in list(cls.alive):
            while thread.is_alive() and thread.call_count <= thread.messages_tell.count:
                time.sleep(1e-4)


recaster._MessagingThread = _Thread


class NevergradTuner(EpisodeTuner):
    """An optimiser of Nevergrad, by ask and tell.

    Its state is the history of costs: `restore` builds the optimiser anew from the same seed, asks
    and tells it the same again. That needs nothing of an optimiser but to be deterministic, and
    takes as long as the optimiser's own computations did.
    """

    def __init__(
        self,
        problem: Problem,
        factory: Factory,
        *,
        start: str,
        initial_sigma: float | None = None,
        workers: int | None = None,
        recommendation: str,
        reevaluate_top: int,
        reevaluate_fraction: float,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            factory: Makes the optimiser.
            start: "random", "baseline" or "middle": the parametrization's initial value.
            spread: Standard deviation of Nevergrad's mutations, in the mapped box; None: the
                library's.
            workers: How many evaluations the library plans for at a time; None: the number of
                environments, or 1 for an optimiser that allows no more.
            recommendation: "library": the optimiser's own; or see `EpisodeTuner`.
            reevaluate_top: See `EpisodeTuner`.
            reevaluate_fraction: See `EpisodeTuner`.

        Raises:
            ConfigError: If the optimiser needs a package that is not installed, or `start` is
                "baseline" and the task has no baseline parameters.
        """
        super().__init__(
            problem,
            recommendation=recommendation,
            reevaluate_top=reevaluate_top,
            reevaluate_fraction=reevaluate_fraction,
        )
        self._factory = factory
        self._start = start
        self._initial_sigma = LIBRARY_SIGMA if initial_sigma is None else initial_sigma
        one_by_one = getattr(factory, "no_parallelization", False)
        self._workers = workers or (1 if one_by_one else problem.num_envs)
        self._first = self._starting_point(start)
        self._seed = int(self._rng.integers(2**32))
        self._begin()

    def _begin(self) -> None:
        """Make the optimiser as it is before the first ask."""
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
        """Run the library's code in a house of its own.

        Some optimisers draw from numpy's global random state: here they find one seeded from the
        tuner's stream. Warnings about settings that are meant are silenced.

        Raises:
            ConfigError: If the library's code fails; some optimisers need packages that are not
                installed, and some do not work with this version of numpy.
        """
        outside = np.random.get_state()  # noqa: NPY002
        np.random.set_state(self._global_random)  # noqa: NPY002
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", InefficientSettingsWarning)
                yield
                _Thread.settle()
        except Exception as error:
            raise ConfigError(
                f"Nevergrad's optimiser failed: {type(error).__name__}: {error}. "
                "Choose another; TwoPointsDE, DiagonalCMA and PSO need nothing else"
            ) from error
        finally:
            self._global_random = np.random.get_state()  # noqa: NPY002
            np.random.set_state(outside)  # noqa: NPY002

    @contextmanager
    def _only_looking(self) -> Iterator[None]:
        """Run library code that draws nothing which counts: some parts are made when looked at."""
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
                # Some optimisers learn from no point but their own: then not from a start.
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
        return [item if isinstance(item, int) else item.copy() for item in self._history]

    def _own_restore(self, state: Any) -> None:
        self._begin()
        for item in state:
            if isinstance(item, int):
                self._ask_library(item)
            else:
                self._tell_library(item.copy())

    def describe(self) -> dict[str, Any]:
        """Return the choices that a fair comparison must show."""
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

    Some optimisers ignore an initial value, so baseline parameters are its first point as well.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        name: str = "TwoPointsDE",
        start: Literal["random", "baseline", "middle"] = "random",
        initial_sigma: Positive | None = None,
        recommendation: Literal["library", "best_seen", "reevaluated"] = "library",
        reevaluate_top: Count = 10,
        reevaluate_fraction: Fraction = 0.1,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            name: A name in `nevergrad.optimizers.registry`.
            start: The value that the optimiser starts from; some ignore it, but baseline parameters
                are then evaluated first.
            spread: Standard deviation of Nevergrad's mutations in the mapped box; None: the
                library's.
            recommendation: "library": the optimiser's own; or see `EpisodeTuner`.
            reevaluate_top: See `EpisodeTuner`.
            reevaluate_fraction: See `EpisodeTuner`.

        Raises:
            ConfigError: If there is no optimiser of that name, or see `NevergradTuner`.
        """
        registry = ng.optimizers.registry
        if name not in registry:
            raise ConfigError(f"unknown Nevergrad optimiser {name!r}; {suggest(name, registry)}")
        super().__init__(
            problem,
            registry[name],
            start=start,
            initial_sigma=initial_sigma,
            recommendation=recommendation,
            reevaluate_top=reevaluate_top,
            reevaluate_fraction=reevaluate_fraction,
        )

    def _make(self) -> Optimizer:
        optimizer = super()._make()
        if self._start == "baseline":
            optimizer.suggest(self._first)
        return optimizer

    def describe(self) -> dict[str, Any]:
        """Return the choices that a fair comparison must show."""
        return {**super().describe(), "initial_sigma": self._initial_sigma}
