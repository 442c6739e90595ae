"""Pendulum swing-up by energy and PD."""

from zoac.tasks.pendulum.controller import EnergyPd
from zoac.tasks.pendulum.plant import PendulumVecEnv
from zoac.tasks.pendulum.task import Pendulum

__all__ = ["EnergyPd", "Pendulum", "PendulumVecEnv"]
