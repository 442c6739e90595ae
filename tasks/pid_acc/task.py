"""Task `pid_acc`: tune an incremental PID for adaptive cruise control."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zoac.core.controller import Controller, Diagnostics, Memory, Parameters
from zoac.core.measures import Trace
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.segments import Segment
from zoac.core.types import Count, NonNegative
from zoac.rollout.task import Task
from zoac.specs.signals import observation
from zoac.tasks.pid_acc.plant import SAMPLE_TIME, Jerk, PidAccVecEnv

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class IncrementalPid(Controller):
    """Eq. (13): du = Kp (e_t - e_{t-1}) + Ki e_t + Kd (e_t - 2 e_{t-1} + e_{t-2}), e = k dd + dv.

    Remembers nothing: the observation carries x_t, x_{t-1} and x_{t-2}.
    """

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return the increments du (n, 1) [m/s^2] for observations (n, 10)."""
        # (3, n): clearance and speed errors now, one and two steps ago.
        columns = obs.T
        e = params["k"] * columns[0:9:3] + columns[1:9:3]
        change = e[0] - e[1]
        du = params["Kp"] * change
        du += params["Ki"] * e[0]
        du += params["Kd"] * (change - (e[1] - e[2]))
        return du[:, None], memory, {}


class PidAcc(Task):
    """Four gains in [0, 10], linear."""

    space = ParameterSpace([Parameter(name, 0.0, 10.0) for name in ("k", "Kp", "Ki", "Kd")])
    baseline = {"k": 2.492, "Kp": 0.8307, "Ki": 0.0, "Kd": 3.1173}
    """The hand-tuned gains of the authors' first release."""
    sample_time = SAMPLE_TIME
    signals = {
        "clearance_error": observation(0, unit="m"),
        "speed_error": observation(1, unit="m/s"),
        "acceleration": observation(2, unit="m/s²"),
        "command": observation(9, unit="m/s²"),
    }

    def __init__(
        self,
        *,
        preceding_std: NonNegative = 0.05,
        jerk: Jerk = "rate",
        max_episode_steps: Count = 1000,
    ) -> None:
        """
        Args:
            preceding_std: Standard deviation of the preceding car's acceleration [m/s^2].
            jerk: Comfort term of the cost: 0.1 (du/T_s)^2 of the change applied ("rate", the
                paper's text), 0.1 du^2 of it ("increment"), or 0.1 du^2 of the increment commanded
                ("commanded_increment", the authors' code).
            max_episode_steps: Time limit, in steps of 0.1 s.
        """
        self._preceding_std, self._max_episode_steps = preceding_std, max_episode_steps
        self._jerk: Jerk = jerk

    def make_env(self, n: int) -> PidAccVecEnv:
        return PidAccVecEnv(
            n,
            preceding_std=self._preceding_std,
            jerk=self._jerk,
            max_episode_steps=self._max_episode_steps,
        )

    def make_controller(self) -> IncrementalPid:
        return IncrementalPid()

    def traces(self, segment: Segment) -> list[Trace]:
        """Return what Fig. 5 shows."""
        from zoac.tasks.pid_acc import figures

        return figures.traces(segment)

    def draw(self, axes: Axes, segment: Segment, step: int) -> bool:
        """Draw the two cars."""
        from zoac.tasks.pid_acc.figures import draw

        draw(axes, segment.observations[step])
        return True
