"""Where a parallel gripper may take a thing, and how the arm gets there, holds it and goes."""

from orbit_motion.grasping.antipodal import GraspCandidates, GraspConfig, grasp_candidates
from orbit_motion.grasping.hand_boxes import HandBoxes
from orbit_motion.grasping.planner import GraspPlan, GraspPlanner
from orbit_motion.grasping.search import GraspMotion, GraspSearch
from orbit_motion.grasping.surface import Surface, surface_of, surface_of_cloud
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
