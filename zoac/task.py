"""What a tuner tunes: an environment, a controller, and the space of its parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from zoac.environment import LaneEnv
from zoac.parameters import ParameterSpace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from zoac.segments import Segment

Parameters = Mapping[str, np.ndarray]
Memory = Mapping[str, np.ndarray]
Diagnostics = Mapping[str, np.ndarray]


class Controller(Protocol):
    """A pure function of (parameters, observation, memory), batched over n lanes.

    Whatever lasts from step to step is `memory`: arrays with one row per lane, begun anew at
    every episode start and kept when the parameters change in mid-episode. `act` must not change
    its arguments, must not remember anything else, and must compute each lane from that lane's
    rows alone.
    """

    def init(self, n: int) -> Memory:
        """Return the memory of `n` lanes at the start of an episode; `{}` if there is none."""
        ...

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return actions (n, m), the next memory, and diagnostics.

        Args:
            params: Physical values by name, each (n,): one value per lane.
            obs: Observations (n, o).
            memory: As returned by `init` or the call before.

        Returns:
            Actions (n, m); memory; diagnostics by name, arrays with n rows (the same names at
            every step), which are stored with the segment. `solver_seconds` (n,) and
            `solver_failed` (n,) bool are names that the accounting knows.
        """
        ...


@dataclass(frozen=True, slots=True)
class Metric:
    """A quantity reported beside the cost.

    Args:
        name: Name in logs and results.
        per_step: Function of a segment that returns one value per step, (T,).
        reduce: "mean" over all steps of all episodes, or "sum".
        unit: Unit for people to read.
    """

    name: str
    per_step: Callable[[Segment], np.ndarray]
    reduce: Literal["mean", "sum"] = "mean"
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Constraint:
    """A quantity that must not be above zero at any step; see `zoac.constraints`.

    Args:
        name: Name in logs and results.
        per_step: Function of a segment that returns one value per step, (T,); above zero is a
            violation, by so much.
        scale: What counts as a large violation, in the quantity's own unit.
    """

    name: str
    per_step: Callable[[Segment], np.ndarray]
    scale: float = 1.0


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
    """Cost of a step at which the controller raises, or acts with what is not finite or of the
    wrong shape; it ends the episode. None: such a controller ends the run, with a message."""
    nominal: Mapping[str, Any] | None = None
    """Reference parameters that are not tuned, for tasks that have them."""
    tuned_for: Mapping[str, Mapping[str, Any]] = {}
    """Tuner's name -> options that suit this task; where nothing else is said, they hold."""

    @abstractmethod
    def make_env(self, n: int) -> LaneEnv:
        """Return an environment of `n` lanes."""

    @abstractmethod
    def make_controller(self) -> Controller:
        """Return the controller."""

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
