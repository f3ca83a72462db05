"""Gains and armatures of joint drives, from the inertia that each joint moves over the workspace.

A drive of stiffness k and damping d on a joint that moves the inertia M (armature included) is a second-order system of
natural frequency ``sqrt(k / M)`` and damping ratio ``d / (2 sqrt(k M))``. :func:`designed_drives` chooses k and d for
the largest inertia that the joint meets: elsewhere the joint is faster and more damped, never less.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch

from orbit_core.dynamics.kinematics import mimic_matrix
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.interfaces.names import match_names
from orbit_core.scene import Articulation, ImplicitPd, Joint, JointType

MOTOR_TIME = 0.005
"""Seconds in which a motor without load reaches its joint's velocity limit at its effort limit. The reflected inertia
of a rotor is then ``MOTOR_TIME * effort / velocity``: 0.004 kg m^2 for Unitree's Go1 (23.7 N m, 30.1 rad/s) and 0.2 for
the Panda's shoulder (87 N m, 2.2 rad/s), where models that others tuned have 0.005 and 0.1."""
_SAMPLES = 256
_TURN = math.pi
"""Range in which joints without limits are sampled, to either side of zero."""


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
    effort_limit: float | None = None
    """N m or N; None keeps the joint's own."""


@dataclass(frozen=True)
class ReflectedInertia:
    """What each joint moves while all others stand still, kg m^2 or kg, armature included: (J,) over the workspace.

    Joints that mimic another have the value of the joint that they follow.
    """

    smallest: npt.NDArray[np.float64]
    mean: npt.NDArray[np.float64]
    largest: npt.NDArray[np.float64]


def reflected_inertia(articulation: Articulation, *, fixed_base: bool) -> ReflectedInertia:
    """The diagonal of the mass matrix over configurations drawn evenly within the joints' limits.

    A free base does not follow the joints' motion here, as that of a robot that stands does not.
    """
    diagonal = np.diagonal(_mass_matrices(articulation, fixed_base), axis1=1, axis2=2)
    leaders = _leaders(articulation)
    smallest, mean, largest = (reduce(diagonal, axis=0)[leaders] for reduce in (np.min, np.mean, np.max))
    return ReflectedInertia(smallest, mean, largest)


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


def designed_drives(
    articulation: Articulation, designs: Sequence[DriveDesign], *, fixed_base: bool
) -> tuple[tuple[ImplicitPd, ...], str]:
    """A drive for each joint that a design names, and the note that tells the gains for the build report.

    Raises:
        ConfigurationError: a frequency or damping ratio is not positive, or a joint has two designs.
        UnknownNameError: a pattern matches no movable joint.
    """
    largest = reflected_inertia(articulation, fixed_base=fixed_base).largest
    names = articulation.joint_names
    drives: dict[str, ImplicitPd] = {}
    for design in designs:
        for index in match_names(design.joints, names, "joint", f"'{articulation.name}'"):
            if names[index] in drives:
                raise ConfigurationError(f"'{articulation.name}': joint '{names[index]}' has two designs: give it one")
            drives[names[index]] = _drive(names[index], design, float(largest[index]))
    told = ", ".join(f"{name} {drive.stiffness:g}/{drive.damping:g}" for name, drive in drives.items())
    note = f"stiffness/damping for the inertia that each joint moves: {told} (N m/rad and N m s/rad, or N/m and N s/m)"
    return tuple(drives.values()), note


def _drive(joint: str, design: DriveDesign, inertia: float) -> ImplicitPd:
    for what, value in (("frequency", design.natural_frequency), ("damping ratio", design.damping_ratio)):
        if not (math.isfinite(value) and value > 0):
            raise ConfigurationError(f"drive design of joint '{joint}': its {what} is {value}, give a positive number")
    rate = 2 * math.pi * design.natural_frequency
    return ImplicitPd(
        joints=(re.escape(joint),),
        stiffness=_rounded(inertia * rate**2),
        damping=_rounded(2 * design.damping_ratio * inertia * rate),
        effort_limit=design.effort_limit,
    )


def _mass_matrices(articulation: Articulation, fixed_base: bool) -> npt.NDArray[np.float64]:
    """(S, J, J) of random configurations, followers folded into their leaders."""
    joints = articulation.movable_joints
    low, high = (np.array([_ends(joint)[end] for joint in joints]) for end in (0, 1))
    drawn = np.random.default_rng(0).uniform(low, high, (_SAMPLES, len(joints)))
    fold = mimic_matrix(articulation)
    offsets = np.array([joint.mimic.offset if joint.mimic else 0.0 for joint in joints])
    positions = torch.as_tensor(drawn @ fold.T + offsets, dtype=torch.float32)
    model = RigidBodyModel(articulation, fixed_base)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).repeat(_SAMPLES, 1)
    full = model.mass_matrix(model.kinematics.forward(root, positions))
    base = 0 if fixed_base else 6
    return fold.T @ full[:, base:, base:].double().numpy() @ fold


def _ends(joint: Joint) -> tuple[float, float]:
    if joint.type is JointType.CONTINUOUS:
        return -_TURN, _TURN
    low, high = (
        limit if math.isfinite(limit) else math.copysign(_TURN, limit)
        for limit in (joint.lower_limit, joint.upper_limit)
    )
    return low, high


def _leaders(articulation: Articulation) -> list[int]:
    """(J) the joint itself, or the one that it follows."""
    names = articulation.joint_names
    return [
        index if joint.mimic is None else names.index(joint.mimic.joint)
        for index, joint in enumerate(articulation.movable_joints)
    ]


def _rounded(value: float) -> float:
    """To three significant digits: gains are chosen, not measured."""
    return float(f"{value:.3g}")
