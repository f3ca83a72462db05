"""Motion generators: nodes that turn normalised commands into joint targets, and the named action spaces of them."""

from orbit_core.motion.action_space import ACTION_SPACES, action_space, with_drives_for
from orbit_core.motion.actuate import Actuate
from orbit_core.motion.base import MotionGenerator
from orbit_core.motion.differential_ik import DifferentialIk, DifferentialIkConfig
from orbit_core.motion.gripper import GripperCommand, GripperConfig
from orbit_core.motion.ik import IkMethod, joint_delta
from orbit_core.motion.joint_effort import JointEffort, JointEffortConfig
from orbit_core.motion.joint_position import JointPosition, JointPositionConfig
from orbit_core.motion.joint_velocity import JointVelocity, JointVelocityConfig

__all__ = [
    "ACTION_SPACES", "Actuate", "DifferentialIk", "DifferentialIkConfig", "GripperCommand", "GripperConfig", "IkMethod",
    "JointEffort", "JointEffortConfig", "JointPosition", "JointPositionConfig", "JointVelocity", "JointVelocityConfig",
    "MotionGenerator", "action_space", "joint_delta", "with_drives_for",
]  # fmt: skip
