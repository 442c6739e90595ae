"""What a tuner tunes: an environment, a controller, and the space of its parameters."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from zoac.core.errors import ConfigError, ZoacError, suggest
from zoac.core.parameters import ParameterSpace
from zoac.core.types import is_number
from zoac.envs.base import VecEnv
from zoac.rollout import probe
from zoac.runs.schema import CLOCKS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from zoac.core.segments import Segment

Parameters = Mapping[str, np.ndarray]
Memory = Mapping[str, np.ndarray]
Diagnostics = Mapping[str, np.ndarray]


class Controller(Protocol):
    """A pure function of (parameters, observation, memory), batched over n environments.

    Whatever lasts from step to step is `memory`: arrays with one row per environment, begun anew at
    every episode start and kept when the parameters change in mid-episode. `act` must not change
    its arguments, must not remember anything else, and must compute each environment from that
    environment's rows alone.
    """

    def init(self, n: int) -> Memory:
        """Return the memory of `n` environments at the start of an episode; `{}` if there is none."""
        ...

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return actions (n, m), the next memory, and diagnostics.

        Args:
            params: Physical values by name, each (n,): one value per environment.
            obs: Observations (n, o).
            memory: As returned by `init` or the call before.

        Returns:
            Actions (n, m); memory; diagnostics by name, arrays with n rows (the same names at
            every step), which are stored with the segment. `solver_seconds` (n,) and
            `solver_failed` (n,) bool are names that the accounting knows.
        """
        ...


RESERVED = frozenset({
    "format", "task", "tuner", "seed", "variant", "config_hash", "kind", "final", "x", "parameters",
    "env_steps", "cost_mean", "cost_std", "cost_per_episode", "episode_lengths", "terminations",
    "violations", "violations_by_constraint", "env_restarts", "tuning_terminations",
    "baseline_cost_mean", "start", "acceptance_test", "select", "warnings", "failures", "first_failure", *CLOCKS,
})  # fmt: skip
"""Keys of evaluation rows and of `result.json`, which no metric may take. `solver_failures` is
free: a metric of that name counts an evaluation's, `result.json` those of the whole run."""


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A name, and a function of a segment that returns one value per step, (T,)."""

    name: str
    per_step: Callable[[Segment], np.ndarray]

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ConfigError(f"the name of a {self._what()} must be text, got {self.name!r}")
        if not callable(self.per_step):
            raise ConfigError(
                f"{self._what()} {self.name!r}: expected a function of a segment, got "
                f"{self.per_step!r}"
            )

    def _what(self) -> str:
        return type(self).__name__.lower()

    def values(self, segment: Segment) -> np.ndarray:
        """Return one number per step, (T,).

        Raises:
            ConfigError: If `per_step` raises, or returns anything else.
        """
        try:
            values = np.asarray(self.per_step(segment))
        except ZoacError:
            raise
        except Exception as error:  # whatever a user's function raises
            diagnostics = ", ".join(segment.diagnostics) or "none"
            raise ConfigError(
                f"{self._what()} {self.name!r} raised {type(error).__name__}: {error}; a segment "
                f"has observations {segment.observations.shape}, actions {segment.actions.shape}, "
                f"costs {segment.costs.shape}, and diagnostics: {diagnostics}"
            ) from error
        if values.shape != (segment.length,) or values.dtype.kind not in "biuf":
            raise ConfigError(
                f"{self._what()} {self.name!r} returned {values.dtype} of shape {values.shape}, "
                f"expected one number per step, ({segment.length},)"
            )
        return values


@dataclass(frozen=True, slots=True)
class Metric(_Quantity):
    """A quantity reported beside the cost.

    Args:
        name: Name in logs and results.
        per_step: Function of a segment that returns one value per step, (T,).
        reduce: "mean" over all steps of all episodes, or "sum".
        unit: Unit for people to read.

    Raises:
        ConfigError: If the name is one that results have already (`RESERVED`), or an argument
            cannot be used.
    """

    reduce: Literal["mean", "sum"] = "mean"
    unit: str = ""

    def __post_init__(self) -> None:
        _Quantity.__post_init__(self)
        if self.name in RESERVED:
            raise ConfigError(
                f"metric {self.name!r}: results have a number of that name already; call it "
                f"otherwise, such as {f'my_{self.name}'!r}"
            )
        if self.reduce not in ("mean", "sum"):
            raise ConfigError(
                f"metric {self.name!r}: unknown reduce {self.reduce!r}; "
                f"{suggest(self.reduce, ('mean', 'sum'))}"
            )


@dataclass(frozen=True, slots=True)
class Constraint(_Quantity):
    """A quantity that must not be above a limit at any step; see `zoac.rollout.constraints`.

    Args:
        name: Name in logs and results.
        per_step: Function of a segment that returns one value per step, (T,); above the limit is a
            violation, by so much.
        scale: What counts as a large excess over the limit, in the quantity's own unit; above
            zero. None: as much as the limit itself; where that is 0, the largest excess so far.
        limit: In the quantity's own unit.

    Raises:
        ConfigError: If limit or scale cannot be used, or another argument.
    """

    scale: float | None = None
    limit: float = 0.0

    def __post_init__(self) -> None:
        _Quantity.__post_init__(self)
        if not is_number(self.limit) or not math.isfinite(self.limit):
            raise ConfigError(
                f"constraint {self.name!r}: limit={self.limit!r}, expected a finite number, in the "
                "quantity's own unit"
            )
        scale = self.scale
        if scale is not None and not (is_number(scale) and math.isfinite(scale) and scale > 0):
            raise ConfigError(
                f"constraint {self.name!r}: scale={scale!r}, expected a number above zero, "
                "what counts as a large excess, in the quantity's own unit"
            )

    def excess(self, segment: Segment) -> np.ndarray:
        """Return by how much the limit is exceeded at each step, (T,); infinite if not finite.

        Raises:
            ConfigError: If `per_step` does not return one number per step.
        """
        over = self.values(segment).astype(np.float64) - self.limit
        return np.where(np.isfinite(over), np.maximum(over, 0.0), np.inf)


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """One line that figures show of a segment.

    Args:
        title: Quantity and unit.
        x: Abscissae (K,).
        y: Ordinates (K,).
        x_label: Quantity and unit of `x`.
        reference: Points (x, y) of a line to see it against, if any.
        limits: Ordinates that bound it.
    """

    title: str
    x: np.ndarray
    y: np.ndarray
    x_label: str = "Step"
    reference: tuple[np.ndarray, np.ndarray] | None = None
    limits: tuple[float, ...] = ()


class Task(ABC):
    """Environment + controller + space + metrics."""

    space: ParameterSpace
    metrics: tuple[Metric, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    fixed: Mapping[str, float] = {}
    """Parameters that the controller has beside those in `space`, by name."""
    failure_penalty: float | None = None
    """Cost of a step that fails, which ends its episode: the controller raises, or acts with what
    is not finite or of the wrong shape; or the environment raises, or returns an observation or a
    cost that is not finite. None: such a step ends the run, with a message."""
    objective: str = ""
    """Which signal is minimised, where the first line of a run is to say it."""
    baseline: Mapping[str, Any] | None = None
    """Reference parameters that are not tuned, for tasks that have them."""
    tuned_for: Mapping[str, Mapping[str, Any]] = {}
    """Tuner's name -> options that suit this task; where nothing else is said, they hold."""

    def parts(self) -> dict[str, Any]:
        """Return what tells this task from others beyond its configuration, by name.

        Functions, classes and objects, or dicts of them; see `zoac.runs.fingerprint`.
        """
        return {"task": self}

    @abstractmethod
    def make_env(self, n: int) -> VecEnv:
        """Return an environment of `n` environments."""

    @abstractmethod
    def make_controller(self) -> Controller:
        """Return the controller."""

    @cached_property
    def restore_fault(self) -> str | None:
        """Why an environment cannot be put back to where it stood; None: a trial showed that it can."""
        return probe.restore_fault(self.make_env) or probe.controller_fault(self)

    @cached_property
    def save_fault(self) -> str | None:
        """Why an environment cannot be saved and put back into another environment; None: it can."""
        return (
            self.restore_fault
            or probe.restore_fault(self.make_env, pickled=True)
            or probe.controller_fault(self, pickled=True)
        )

    @cached_property
    def horizon(self) -> probe.Horizon:
        """How long episodes are."""
        return probe.horizon(self)

    def tuning_costs(self, segment: Segment) -> np.ndarray:
        """Return the costs (T,) that a tuner sees; evaluation always reports the plain ones."""
        return segment.costs

    def env_action(self, action: np.ndarray) -> Any:
        """Return a controller's action (m,) as one environment of this task takes it."""
        return action

    def traces(self, segment: Segment) -> list[Trace]:
        """Return what figures show of a segment; by default every observation, action and cost.

        Every segment must give the same traces, in the same order.
        """
        steps = np.arange(segment.length + 1)
        shown = [(f"Observation {i}", column) for i, column in enumerate(segment.observations.T)]
        shown += [(f"Action {i}", column) for i, column in enumerate(segment.actions.T)]
        shown += [("Cost", segment.costs)]
        return [Trace(title, steps[: len(column)], column) for title, column in shown]

    def draw(self, axes: Axes, segment: Segment, step: int) -> bool:
        """Draw the plant as it stands after `step` steps; return whether there is a picture."""
        return False
