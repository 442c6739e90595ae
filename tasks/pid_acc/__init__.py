"""Adaptive cruise control with an incremental PID (section IV-A of the paper)."""

from zoac.tasks.pid_acc.plant import PidAccVecEnv
from zoac.tasks.pid_acc.task import IncrementalPid, PidAcc

__all__ = ["IncrementalPid", "PidAcc", "PidAccVecEnv"]
