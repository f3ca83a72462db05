"""What a file says of motors and of its home pose, as a robot's specification takes it; only where it is asked for."""

from __future__ import annotations

import math
import re
from dataclasses import replace

from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.scene import Articulation, DriveGains, ImplicitPd


def drives_from_model(articulation: Articulation) -> tuple[ImplicitPd, ...]:
    """Actuator groups with the gains and effort limits of the articulation's ``drives``, for ``RobotSpec.actuators``.

    Joints of one gain share a group. A drive without an effort limit keeps the joint's own.

    Raises:
        ConfigurationError: the file says of no drive.
    """
    if not articulation.drives:
        raise ConfigurationError(f"the file of '{articulation.name}' says of no drive: give actuator groups yourself")
    groups: dict[DriveGains, list[str]] = {}
    for drive in articulation.drives:
        groups.setdefault(replace(drive, joint=""), []).append(drive.joint)
    return tuple(
        ImplicitPd(
            joints=tuple(re.escape(joint) for joint in joints),
            stiffness=gains.stiffness,
            damping=gains.damping,
            effort_limit=gains.effort_limit if math.isfinite(gains.effort_limit) else None,
        )
        for gains, joints in groups.items()
    )


def home_from_model(articulation: Articulation) -> dict[str, float]:
    """The articulation's ``home``, for ``RobotSpec.home``.

    Raises:
        ConfigurationError: the file says of no home pose.
    """
    if not articulation.home:
        raise ConfigurationError(f"the file of '{articulation.name}' names no home pose: give home positions yourself")
    return {re.escape(joint): position for joint, position in articulation.home}
