"""Motion generators by name. Any installed package may add its own through the entry-point group ``orbit.motion``.

An entry point names the generator's configuration, a dataclass that is an
:class:`~orbit_core.actions.ActionTerm` and says its own ``name``.
"""

from __future__ import annotations

from functools import cache

from orbit_core.actions.base_velocity import BaseVelocityConfig
from orbit_core.actions.binary_gripper import BinaryGripperConfig
from orbit_core.actions.differential_drive import DifferentialDriveConfig
from orbit_core.actions.differential_ik import DifferentialIkConfig
from orbit_core.actions.full_ik_term import FullIkTermConfig
from orbit_core.actions.grasp_synergies import GraspSynergiesConfig
from orbit_core.actions.joint_effort import JointEffortConfig
from orbit_core.actions.joint_position import JointPositionConfig
from orbit_core.actions.joint_velocity import JointVelocityConfig
from orbit_core.actions.term import ActionTerm
from orbit_core.registry import ClassRegistry

GROUP = "orbit.motion"
_OWN = (
    DifferentialIkConfig,
    FullIkTermConfig,
    JointPositionConfig,
    JointVelocityConfig,
    JointEffortConfig,
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
