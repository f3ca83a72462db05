"""Grasping by a parallel gripper: candidates on a surface, motions to them, and an interactive workflow."""

from orbit_motion.grasping.planner import (
    GraspCandidates,
    GraspConfig,
    GraspMotion,
    GraspPlan,
    GraspPlanner,
    GraspSearch,
    HandBoxes,
    Surface,
    grasp_candidates,
    surface_of,
    surface_of_cloud,
)
from orbit_motion.grasping.workflow import GraspWorkflow, Stage

__all__ = [
    "GraspCandidates",
    "GraspConfig",
    "GraspMotion",
    "GraspPlan",
    "GraspPlanner",
    "GraspSearch",
    "GraspWorkflow",
    "HandBoxes",
    "Stage",
    "Surface",
    "grasp_candidates",
    "surface_of",
    "surface_of_cloud",
]
