"""Gains and armatures of joint drives, from the inertia that each joint moves over the workspace.

A drive of stiffness k and damping d on a joint that moves the inertia M (armature included) is a second-order system of
natural frequency ``sqrt(k / M)`` and damping ratio ``d / (2 sqrt(k M))``. :func:`designed_drives` chooses k and d for
the largest inertia that the joint meets: elsewhere the joint is faster and more damped, never less. Where a joint has
dry friction F, k is no less than F over the error that the friction may leave.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.interfaces.names import match_names
from orbit_core.scene import Articulation, ImplicitPd, Joint

MOTOR_TIME = 0.005
"""Seconds in which a motor without load reaches its joint's velocity limit at its effort limit. The reflected inertia
of a rotor is then ``MOTOR_TIME * effort / velocity``: 0.004 kg m^2 for Unitree's Go1 (23.7 N m, 30.1 rad/s) and 0.2 for
the Panda's shoulder (87 N m, 2.2 rad/s), where models that others tuned have 0.005 and 0.1."""


@dataclass(frozen=True, kw_only=True)
class DriveDesign:
    """The response of a group of joints to a step of their position targets, from which gains are computed.

    ``joints`` are regular expressions over joint names (full match).
    """

    joints: tuple[str, ...]
    natural_frequency: float = 4.0
    """Hz, with the largest inertia that the joint meets."""
    damping_ratio: float = 1.0
    """1 is critical: the fastest response without overshoot."""
    friction_error: float = 0.01
    """How far from its target, in rad or m, dry friction may hold the joint at rest: stiffer and faster where that asks
    for it."""
    effort_limit: float | None = None
    """N m or N; None keeps the joint's own."""


def with_armature(articulation: Articulation) -> Articulation:
    """The articulation with a motor's reflected inertia on the joints that have none, noted.

    It follows from effort and velocity limits (:data:`MOTOR_TIME`). Joints without both limits, and those that mimic
    others, are left as they are.
    """
    values = {
        joint.name: _rounded(MOTOR_TIME * joint.effort_limit / joint.velocity_limit)
        for joint in articulation.movable_joints
        if not joint.armature and joint.mimic is None and joint.velocity_limit > 0
        if math.isfinite(joint.effort_limit) and math.isfinite(joint.velocity_limit)
    }
    if not values:
        return articulation
    edited = (replace(joint, armature=values.get(joint.name, joint.armature)) for joint in articulation.joints)
    told = ", ".join(f"{name} {value:g}" for name, value in values.items())
    note = f"armature where the model has none, from effort and velocity limits: {told} (kg m^2 or kg)"
    return replace(articulation, joints=tuple(edited), notes=(*articulation.notes, note))


def designed_drives(articulation: Articulation, designs: Sequence[DriveDesign]) -> tuple[tuple[ImplicitPd, ...], str]:
    """A drive for each joint that a design names, and the note that tells the gains for the build report.

    Raises:
        ConfigurationError: a frequency or damping ratio is not positive, or a joint has two designs.
        UnknownNameError: a pattern matches no movable joint.
    """
    from orbit_core.dynamics.rigid_body import reflected_inertia

    largest = reflected_inertia(articulation).largest
    names = articulation.joint_names
    drives: dict[str, ImplicitPd] = {}
    for design in designs:
        for index in match_names(design.joints, names, "joint", f"'{articulation.name}'"):
            if names[index] in drives:
                raise ConfigurationError(f"'{articulation.name}': joint '{names[index]}' has two designs: give it one")
            drives[names[index]] = _drive(articulation.movable_joints[index], design, float(largest[index]))
    told = ", ".join(f"{name} {drive.stiffness:g}/{drive.damping:g}" for name, drive in drives.items())
    note = f"stiffness/damping for the inertia that each joint moves: {told} (N m/rad and N m s/rad, or N/m and N s/m)"
    return tuple(drives.values()), note


def _drive(joint: Joint, design: DriveDesign, inertia: float) -> ImplicitPd:
    chosen = {
        "frequency": design.natural_frequency,
        "damping ratio": design.damping_ratio,
        "friction error": design.friction_error,
    }
    for what, value in chosen.items():
        if not (math.isfinite(value) and value > 0):
            raise ConfigurationError(
                f"drive design of joint '{joint.name}': its {what} is {value}, give a positive one"
            )
    stiffness = max(inertia * (2 * math.pi * design.natural_frequency) ** 2, joint.friction / design.friction_error)
    return ImplicitPd(
        joints=(re.escape(joint.name),),
        stiffness=_rounded(stiffness),
        damping=_rounded(2 * design.damping_ratio * math.sqrt(stiffness * inertia)),
        effort_limit=design.effort_limit,
    )


def _rounded(value: float) -> float:
    """Round to three significant digits: gains are chosen, not measured."""
    return float(f"{value:.3g}")
