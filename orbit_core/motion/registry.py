"""Motion generators by name. Any installed package may add its own through the entry-point group ``orbit.motion``.

An entry point names the generator's configuration, a dataclass that is an
:class:`~orbit_core.motion.ActionTerm` and says its own ``name``.
"""

from __future__ import annotations

import dataclasses
from functools import cache

from orbit_core.interfaces import ConfigurationError
from orbit_core.motion.base_velocity import BaseVelocityConfig
from orbit_core.motion.binary_gripper import BinaryGripperConfig
from orbit_core.motion.differential_ik import DifferentialIkConfig
from orbit_core.motion.joint_effort import JointEffortConfig
from orbit_core.motion.joint_position import JointPositionConfig
from orbit_core.motion.joint_velocity import JointVelocityConfig
from orbit_core.motion.term import ActionTerm
from orbit_core.registry import Registry

GROUP = "orbit.motion"
_OWN = (
    DifferentialIkConfig,
    JointPositionConfig,
    JointVelocityConfig,
    JointEffortConfig,
    BinaryGripperConfig,
    BaseVelocityConfig,
)


@cache
def motion_generators() -> Registry[type[ActionTerm]]:
    """The configurations of all installed motion generators, read once."""

    def read(kind: type[ActionTerm]) -> None:
        is_term = isinstance(kind, type) and issubclass(kind, ActionTerm) and dataclasses.is_dataclass(kind)
        if not is_term or not isinstance(getattr(kind, "name", None), str):
            raise ConfigurationError(f"{kind!r} is no dataclass of class ActionTerm with a class variable 'name'")
        registry.add(kind.name, kind)

    registry = Registry[type[ActionTerm]]("motion generator", GROUP, read)
    for kind in _OWN:
        read(kind)
    return registry


def generator_descriptions() -> dict[str, str]:
    """The first line that each configuration says of itself, by the generator's name."""
    kinds = motion_generators().values
    return {name: (kind.__doc__ or "").strip().partition("\n")[0] for name, kind in kinds.items()}
