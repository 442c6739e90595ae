"""A rule-based driver on a road with two lanes."""

from zoac.tasks.lane_change.plant import LaneChangeVecEnv
from zoac.tasks.lane_change.task import LaneChange, RuleBasedDriver

__all__ = ["LaneChange", "LaneChangeVecEnv", "RuleBasedDriver"]
