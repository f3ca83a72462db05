"""Planning: paths around obstacles, their timing within limits, and nodes that follow them."""

from orbit_motion.compliant import StillWorld
from orbit_motion.planning.base_path import BasePlanner, BasePlannerConfig
from orbit_motion.planning.follower import (
    BasePathFollower,
    JointTrajectory,
    TrajectoryFollower,
    jerk_limited,
    time_optimal,
)
from orbit_motion.planning.joint_planner import JointPlanner, PlannerConfig
from orbit_motion.planning.transits import HandTransits, TransitCounts

__all__ = [
    "BasePathFollower", "BasePlanner", "BasePlannerConfig", "HandTransits", "JointPlanner", "JointTrajectory",
    "PlannerConfig", "StillWorld", "TrajectoryFollower", "TransitCounts", "jerk_limited", "time_optimal",
]  # fmt: skip
