"""Task `pendulum`: tune swing-up and PD gains."""

import numpy as np

from zoac.core.controller import Controller, Diagnostics, Memory, Parameters
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.types import Count, Positive
from zoac.rollout.task import Task
from zoac.specs.signals import Signal, action, observation
from zoac.tasks.pendulum.plant import SAMPLE_TIME, PendulumVecEnv

PULL = 15.0
"""3 g / (2 l) of the pendulum that the controller believes in [1/s^2]."""


class EnergyPd(Controller):
    """PD within `switch` of upright; elsewhere torque along the speed until the energy suffices.

    E = speed^2 / 2 + PULL cos(angle) is the energy over the moment of inertia; upright and at rest
    it is PULL.
    """

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """Return the torque (n, 1) [N m] for observations (n, 3)."""
        cosine, sine, speed = obs.T
        angle = np.arctan2(sine, cosine)
        hold = -params["kp"] * angle - params["kd"] * speed
        swing = params["energy"] * (PULL - 0.5 * speed**2 - PULL * cosine) * speed
        torque = np.where(np.abs(angle) < params["switch"], hold, swing)
        return torque[:, None], memory, {}


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
        "angle": Signal(
            "angle from upright",
            lambda s: np.arctan2(s.observations[:, 1], s.observations[:, 0]),
            "rad",
        ),
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
        return PendulumVecEnv(n, self._mass, self._length, self._steps)

    def make_controller(self) -> EnergyPd:
        return EnergyPd()
