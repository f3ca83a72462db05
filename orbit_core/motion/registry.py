"""Motion generators by name. Any installed package may add its own through the entry-point group ``orbit.motion``.

An entry point names the generator's configuration, a dataclass that is an
:class:`~orbit_core.motion.ActionTerm` and says its own ``name``.
"""

from __future__ import annotations

from functools import cache

from orbit_core.motion.admittance import AdmittanceConfig
from orbit_core.motion.base_velocity import BaseVelocityConfig
from orbit_core.motion.binary_gripper import BinaryGripperConfig
from orbit_core.motion.cartesian_impedance import CartesianImpedanceConfig
from orbit_core.motion.differential_drive import DifferentialDriveConfig
from orbit_core.motion.differential_ik import DifferentialIkConfig
from orbit_core.motion.full_ik_term import FullIkTermConfig
from orbit_core.motion.grasp_synergies import GraspSynergiesConfig
from orbit_core.motion.hybrid_force_motion import HybridForceMotionConfig
from orbit_core.motion.joint_effort import JointEffortConfig
from orbit_core.motion.joint_impedance import JointImpedanceConfig
from orbit_core.motion.joint_position import JointPositionConfig
from orbit_core.motion.joint_velocity import JointVelocityConfig
from orbit_core.motion.mpc import HandMpcConfig, TrunkMpcConfig
from orbit_core.motion.operational_space import OperationalSpaceConfig
from orbit_core.motion.prioritized_ik import PrioritizedIkConfig
from orbit_core.motion.rmpflow import RmpFlowConfig
from orbit_core.motion.term import ActionTerm
from orbit_core.motion.whole_body_ik import WholeBodyIkConfig
from orbit_core.registry import ClassRegistry

GROUP = "orbit.motion"
_OWN = (
    DifferentialIkConfig,
    PrioritizedIkConfig,
    FullIkTermConfig,
    WholeBodyIkConfig,
    JointPositionConfig,
    JointVelocityConfig,
    JointEffortConfig,
    JointImpedanceConfig,
    OperationalSpaceConfig,
    CartesianImpedanceConfig,
    HybridForceMotionConfig,
    AdmittanceConfig,
    RmpFlowConfig,
    HandMpcConfig,
    TrunkMpcConfig,
    BinaryGripperConfig,
    GraspSynergiesConfig,
    BaseVelocityConfig,
    DifferentialDriveConfig,
)


@cache
def motion_generators() -> ClassRegistry[ActionTerm]:
    """The configurations of all installed motion generators, read once."""
    return ClassRegistry[ActionTerm]("motion generator", GROUP, _OWN, ActionTerm)


def generator_descriptions() -> dict[str, str]:
    """The first line that each configuration says of itself, by the generator's name."""
    return motion_generators().descriptions
