"""What a tuner tunes: an environment, a controller, and the space of its parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.core.controller import Controller
from zoac.core.measures import Constraint, Metric, Trace
from zoac.core.parameters import ParameterSpace
from zoac.core.segments import Segment
from zoac.envs.base import VecEnv
from zoac.rollout import probe
from zoac.specs.guides import signal_traces
from zoac.specs.judge import Judge
from zoac.specs.signals import Signal
from zoac.specs.spec import Spec

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Task(ABC):
    """Environment + controller + space + metrics."""

    space: ParameterSpace
    metrics: tuple[Metric, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    signals: Mapping[str, Signal] = {}
    """What specs and figures call the numbers of an episode, by name."""
    sample_time: float | None = None
    """Seconds of a step, if they are known."""
    specs: tuple[Spec, ...] = ()
    """Requirements on whole episodes; those without a limit replace the environment's cost."""
    fixed: Mapping[str, float] = {}
    """Parameters that the controller has beside those in `space`, by name."""
    failure_penalty: float | None = None
    """Cost of a step that fails, which ends its episode: the controller raises, or acts with what
    is not finite or of the wrong shape; or the environment raises, or returns an observation or a
    cost that is not finite. None: such a step ends the run, with a message."""
    step_timeout: float | None = None
    """Seconds after which a step or reset of an environment is ended and counts as failed."""
    objective: str = ""
    """Which signal is minimised, where the first line of a run is to say it."""
    baseline: Mapping[str, Any] | None = None
    """Present values of the parameters in `space`, to compare with, for tasks that have them."""
    strict: Judge | None = None
    """Tells a tuner how an episode breaks hard specs, more strictly than evaluation does. None: as
    evaluation does, and held-out episodes choose an answer, see `strategies.held_specs`."""
    preset: str | None = None
    """Folder of `conf/preset` with the tuners' options that suit this task."""

    def parts(self) -> dict[str, Any]:
        """Return what tells this task from others beyond its configuration, by name.

        Functions, classes and objects, or dicts of them; see `zoac.config.fingerprint`.
        """
        return {"task": self}

    @abstractmethod
    def make_env(self, n: int) -> VecEnv:
        """Return a vectorised environment with `num_envs=n`."""

    @abstractmethod
    def make_controller(self) -> Controller:
        """Return the controller."""

    @cached_property
    def restore_fault(self) -> str | None:
        """Why an environment cannot be restored; None: a trial showed that it can."""
        return self._fault(pickled=False)

    @cached_property
    def save_fault(self) -> str | None:
        """Why an environment cannot be restored in another process; None: it can."""
        return self.restore_fault or self._fault(pickled=True)

    def _fault(self, pickled: bool) -> str | None:
        return probe.restore_fault(self.make_env, pickled) or probe.controller_fault(
            self.make_controller(), self.space, self.make_env, pickled
        )

    @cached_property
    def shortest_horizon(self) -> int:
        """Steps from the start of an episode that can tell good parameters from bad ones.

        A dead time and a rise time, say: successive halving looks no shorter. 0: not known.
        """
        return 0

    def tuning_costs(self, segment: Segment) -> np.ndarray:
        """Return the costs (T,) that a tuner sees; evaluation always reports the plain ones."""
        return segment.costs

    def env_action(self, action: np.ndarray) -> Any:
        """Return a controller's action (m,) as this task's environment takes it."""
        return action

    def traces(self, segment: Segment) -> list[Trace]:
        """Return what figures show of a segment: its signals, if they have names.

        By default every observation, action and cost. Every segment must give the same traces, in
        the same order.
        """
        if self.signals:
            return signal_traces(segment, self.signals, self.sample_time, self.specs)
        steps = np.arange(segment.length + 1)
        shown = [(f"Observation {i}", column) for i, column in enumerate(segment.observations.T)]
        shown += [(f"Action {i}", column) for i, column in enumerate(segment.actions.T)]
        shown += [("Cost", segment.costs)]
        return [Trace(title, steps[: len(column)], column) for title, column in shown]

    def draw(self, axes: Axes, segment: Segment, step: int) -> bool:
        """Draw the plant as it stands after `step` steps; return whether there is a picture."""
        return False
