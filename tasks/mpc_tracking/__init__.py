"""Path tracking with a model predictive controller (section IV-B of the paper)."""

from zoac.tasks.mpc_tracking.controller import TrackingMpc
from zoac.tasks.mpc_tracking.plant import MpcTrackingVecEnv
from zoac.tasks.mpc_tracking.task import MpcTracking

__all__ = ["MpcTracking", "MpcTrackingVecEnv", "TrackingMpc"]
