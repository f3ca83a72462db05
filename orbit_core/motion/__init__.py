"""Motion generators: nodes that turn normalised commands into joint targets, and the action terms made of them."""

from orbit_core.motion.actuate import Actuate
from orbit_core.motion.admittance import Admittance, AdmittanceConfig
from orbit_core.motion.base import JointTarget, MotionGenerator
from orbit_core.motion.base_velocity import BaseVelocity, BaseVelocityConfig
from orbit_core.motion.binary_gripper import BinaryGripper, BinaryGripperConfig
from orbit_core.motion.cartesian_impedance import CartesianImpedance, CartesianImpedanceConfig
from orbit_core.motion.differential_drive import DifferentialDrive, DifferentialDriveConfig
from orbit_core.motion.differential_ik import DifferentialIk, DifferentialIkConfig
from orbit_core.motion.drives import with_drives_for
from orbit_core.motion.embodiment import driven_joints, end_effector_of, joint_commands
from orbit_core.motion.full_ik_term import FullIkTerm, FullIkTermConfig
from orbit_core.motion.gains import GainCommand, GainRange
from orbit_core.motion.grasp_synergies import GraspSynergies, GraspSynergiesConfig
from orbit_core.motion.hybrid_force_motion import HybridForceMotion, HybridForceMotionConfig
from orbit_core.motion.ik import IkMethod, joint_delta
from orbit_core.motion.joint_effort import JointEffort, JointEffortConfig
from orbit_core.motion.joint_impedance import JointImpedance, JointImpedanceConfig
from orbit_core.motion.joint_position import JointPosition, JointPositionConfig
from orbit_core.motion.joint_velocity import JointVelocity, JointVelocityConfig
from orbit_core.motion.modes import CommandMode
from orbit_core.motion.operational_space import OperationalSpace, OperationalSpaceConfig
from orbit_core.motion.presets import ACTION_PRESETS, ActionPreset, action_words, preset_terms
from orbit_core.motion.prioritized_ik import PrioritizedIk, PrioritizedIkConfig, Priority
from orbit_core.motion.registry import generator_descriptions, motion_generators
from orbit_core.motion.rmpflow import RmpFlow, RmpFlowConfig
from orbit_core.motion.term import ActionTerm, ActionTerms
from orbit_core.motion.whole_body_ik import WholeBodyIk, WholeBodyIkConfig

__all__ = [
    "ACTION_PRESETS", "ActionPreset", "ActionTerm", "ActionTerms", "Actuate", "Admittance", "AdmittanceConfig",
    "BaseVelocity", "BaseVelocityConfig", "BinaryGripper", "BinaryGripperConfig", "CartesianImpedance",
    "CartesianImpedanceConfig", "CommandMode", "DifferentialDrive", "DifferentialDriveConfig", "DifferentialIk",
    "DifferentialIkConfig", "FullIkTerm", "FullIkTermConfig", "GainCommand", "GainRange", "GraspSynergies",
    "GraspSynergiesConfig", "HybridForceMotion", "HybridForceMotionConfig", "IkMethod", "JointEffort",
    "JointEffortConfig", "JointImpedance", "JointImpedanceConfig", "JointPosition", "JointPositionConfig",
    "JointTarget", "JointVelocity", "JointVelocityConfig", "MotionGenerator", "OperationalSpace",
    "OperationalSpaceConfig", "PrioritizedIk", "PrioritizedIkConfig", "Priority", "RmpFlow", "RmpFlowConfig",
    "WholeBodyIk", "WholeBodyIkConfig", "action_words", "driven_joints", "end_effector_of",
    "generator_descriptions", "joint_commands", "joint_delta", "motion_generators", "preset_terms",
    "with_drives_for",
]  # fmt: skip
