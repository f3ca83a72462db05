"""Basic action terms: nodes that turn normalised commands into joint targets, and the registry of motion generators."""

from orbit_core.actions.base import Actuate, CommandMode, JointTarget, MotionGenerator
from orbit_core.actions.differential_ik import DifferentialIk, DifferentialIkConfig
from orbit_core.actions.embodiment import driven_joints, end_effector_of, joint_commands
from orbit_core.actions.grippers import BinaryGripper, BinaryGripperConfig
from orbit_core.actions.ik import IkMethod, joint_delta
from orbit_core.actions.joints import (
    JointEffort,
    JointEffortConfig,
    JointPosition,
    JointPositionConfig,
    JointVelocity,
    JointVelocityConfig,
)
from orbit_core.actions.mobile_base import BaseVelocity, BaseVelocityConfig, DifferentialDrive, DifferentialDriveConfig
from orbit_core.actions.presets import (
    ACTION_PRESETS,
    ActionPreset,
    action_words,
    generator_descriptions,
    motion_generators,
    preset_terms,
    with_drives_for,
)
from orbit_core.actions.term import ActionTerm, ActionTerms

__all__ = [
    "ACTION_PRESETS", "ActionPreset", "ActionTerm", "ActionTerms", "Actuate", "BaseVelocity", "BaseVelocityConfig",
    "BinaryGripper", "BinaryGripperConfig", "CommandMode", "DifferentialDrive", "DifferentialDriveConfig",
    "DifferentialIk", "DifferentialIkConfig", "IkMethod", "JointEffort", "JointEffortConfig",
    "JointPosition", "JointPositionConfig", "JointTarget", "JointVelocity", "JointVelocityConfig", "MotionGenerator",
    "action_words", "driven_joints", "end_effector_of", "generator_descriptions", "joint_commands", "joint_delta",
    "motion_generators", "preset_terms", "with_drives_for",
]  # fmt: skip
