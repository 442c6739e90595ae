"""Pendulum swing-up by energy and PD."""

from zoac.tasks.pendulum.plant import PendulumVecEnv
from zoac.tasks.pendulum.task import EnergyPd, Pendulum

__all__ = ["EnergyPd", "Pendulum", "PendulumVecEnv"]
