"""Motion generators beyond the basic ones: impedance, operational space, prioritised IK, RMPflow, planning, MPC."""

from orbit_core.moved import moved_name as _moved_name
from orbit_motion.admittance import Admittance, AdmittanceConfig
from orbit_motion.cartesian_impedance import CartesianImpedance, CartesianImpedanceConfig
from orbit_motion.gains import GainCommand, GainRange
from orbit_motion.hybrid_force_motion import HybridForceMotion, HybridForceMotionConfig
from orbit_motion.joint_impedance import JointImpedance, JointImpedanceConfig
from orbit_motion.operational_space import OperationalSpace, OperationalSpaceConfig
from orbit_motion.prioritized_ik import PrioritizedIk, PrioritizedIkConfig, Priority
from orbit_motion.rmpflow import RmpFlow, RmpFlowConfig
from orbit_motion.whole_body_ik import WholeBodyIk, WholeBodyIkConfig

__all__ = [
    "Admittance", "AdmittanceConfig", "CartesianImpedance", "CartesianImpedanceConfig", "GainCommand", "GainRange",
    "HybridForceMotion", "HybridForceMotionConfig", "JointImpedance", "JointImpedanceConfig", "OperationalSpace",
    "OperationalSpaceConfig", "PrioritizedIk", "PrioritizedIkConfig", "Priority", "RmpFlow", "RmpFlowConfig",
    "WholeBodyIk", "WholeBodyIkConfig",
]  # fmt: skip


def __getattr__(name: str) -> object:
    return _moved_name(__name__, name)
