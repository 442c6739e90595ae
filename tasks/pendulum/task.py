"""Task `pendulum`: tune swing-up and PD gains."""

from __future__ import annotations

import numpy as np

from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.segments import Segment
from zoac.core.types import Count, Positive
from zoac.rollout.task import Task
from zoac.specs.signals import Signal, action, observation
from zoac.tasks.pendulum.controller import EnergyPd
from zoac.tasks.pendulum.plant import SAMPLE_TIME, PendulumVecEnv


def _angle(segment: Segment) -> np.ndarray:
    """Return the angle from upright, (T + 1,) [rad]."""
    cosine, sine, _ = segment.observations.T
    return np.arctan2(sine, cosine)


class Pendulum(Task):
    """Two PD gains, an energy gain, and the angle where one hands over to the other."""

    space = ParameterSpace(
        [
            Parameter("energy", 0.0, 1.0, unit="N m s^3/rad^3"),
            Parameter("kp", 0.0, 30.0, unit="N m/rad"),
            Parameter("kd", 0.0, 10.0, unit="N m s/rad"),
            Parameter("switch", 0.1, 1.5, unit="rad"),
        ]
    )
    baseline = {"energy": 0.1, "kp": 10.0, "kd": 2.0, "switch": 0.5}
    """Gains by hand, which swing up and hold."""
    sample_time = SAMPLE_TIME
    signals = {
        "angle": Signal("angle from upright", _angle, "rad"),
        "speed": observation(2, unit="rad/s"),
        "torque": action(0, unit="N m"),
    }

    def __init__(
        self,
        *,
        mass: Positive = 1.0,
        length: Positive = 1.0,
        max_episode_steps: Count = 200,
    ) -> None:
        """
        Args:
            mass: Of the rod [kg].
            length: Of the rod [m].
            max_episode_steps: Time limit, in steps of 0.05 s.
        """
        self._mass, self._length, self._steps = mass, length, max_episode_steps

    def make_env(self, n: int) -> PendulumVecEnv:
        """Return `n` pendulums."""
        return PendulumVecEnv(n, self._mass, self._length, self._steps)

    def make_controller(self) -> EnergyPd:
        """Return the controller."""
        return EnergyPd()
