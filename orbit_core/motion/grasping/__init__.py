"""Where a parallel gripper may take a thing, and how the arm gets there, holds it and goes."""

from orbit_core.motion.grasping.antipodal import GraspCandidates, GraspConfig, grasp_candidates
from orbit_core.motion.grasping.hand_boxes import HandBoxes
from orbit_core.motion.grasping.planner import GraspPlan, GraspPlanner
from orbit_core.motion.grasping.surface import Surface, surface_of, surface_of_cloud

__all__ = [
    "GraspCandidates",
    "GraspConfig",
    "GraspPlan",
    "GraspPlanner",
    "HandBoxes",
    "Surface",
    "grasp_candidates",
    "surface_of",
    "surface_of_cloud",
]
