"""Basic action terms: nodes that turn normalised commands into joint targets, and the registry of motion generators."""

from orbit_core.actions.actuate import Actuate
from orbit_core.actions.base import JointTarget, MotionGenerator
from orbit_core.actions.base_velocity import BaseVelocity, BaseVelocityConfig
from orbit_core.actions.binary_gripper import BinaryGripper, BinaryGripperConfig
from orbit_core.actions.differential_drive import DifferentialDrive, DifferentialDriveConfig
from orbit_core.actions.differential_ik import DifferentialIk, DifferentialIkConfig
from orbit_core.actions.drives import with_drives_for
from orbit_core.actions.embodiment import driven_joints, end_effector_of, joint_commands
from orbit_core.actions.full_ik_term import FullIkTerm, FullIkTermConfig
from orbit_core.actions.grasp_synergies import GraspSynergies, GraspSynergiesConfig
from orbit_core.actions.ik import IkMethod, joint_delta
from orbit_core.actions.joint_effort import JointEffort, JointEffortConfig
from orbit_core.actions.joint_position import JointPosition, JointPositionConfig
from orbit_core.actions.joint_velocity import JointVelocity, JointVelocityConfig
from orbit_core.actions.modes import CommandMode
from orbit_core.actions.presets import ACTION_PRESETS, ActionPreset, action_words, preset_terms
from orbit_core.actions.registry import generator_descriptions, motion_generators
from orbit_core.actions.term import ActionTerm, ActionTerms

__all__ = [
    "ACTION_PRESETS", "ActionPreset", "ActionTerm", "ActionTerms", "Actuate", "BaseVelocity", "BaseVelocityConfig",
    "BinaryGripper", "BinaryGripperConfig", "CommandMode", "DifferentialDrive", "DifferentialDriveConfig",
    "DifferentialIk", "DifferentialIkConfig", "FullIkTerm", "FullIkTermConfig", "GraspSynergies",
    "GraspSynergiesConfig", "IkMethod", "JointEffort", "JointEffortConfig", "JointPosition", "JointPositionConfig",
    "JointTarget", "JointVelocity", "JointVelocityConfig", "MotionGenerator", "action_words", "driven_joints",
    "end_effector_of", "generator_descriptions", "joint_commands", "joint_delta", "motion_generators", "preset_terms",
    "with_drives_for",
]  # fmt: skip
