"""Planning: paths around obstacles, their timing within limits, and nodes that follow them."""

from orbit_motion.planning.base_path import BasePlanner, BasePlannerConfig
from orbit_motion.planning.follower import BasePathFollower, TrajectoryFollower
from orbit_motion.planning.joint_planner import JointPlanner, PlannerConfig
from orbit_motion.planning.trajectory import JointTrajectory, jerk_limited, time_optimal
from orbit_motion.still import StillWorld

__all__ = [
    "BasePathFollower", "BasePlanner", "BasePlannerConfig", "JointPlanner", "JointTrajectory", "PlannerConfig",
    "StillWorld", "TrajectoryFollower", "jerk_limited", "time_optimal",
]  # fmt: skip
