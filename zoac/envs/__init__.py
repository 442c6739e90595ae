"""Environments side by side, and a user's own environment as a task."""

from zoac.envs.fmu import FmuEnv as FmuEnv
