"""How a robot is put on the bench, and which of its joints are moved there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from orbit_core.assets.convex import Convex, convex_shape
from orbit_core.assets.posture import link_poses
from orbit_core.interfaces import match_names, match_values
from orbit_core.interfaces.layout import home_positions
from orbit_core.scene import Articulation, Gripper, Joint, JointType, RobotSpec

FloatArray = npt.NDArray[np.float64]
_TURN = math.pi
"""Radians to either side of zero, for joints without limits."""


def clamped(spec: RobotSpec) -> RobotSpec:
    """The robot with its root held, and links that do not collide with each other."""
    return replace(spec, fixed_base=True, articulation=replace(spec.articulation, self_collisions=False))


def frictionless(spec: RobotSpec) -> RobotSpec:
    """The robot without Coulomb friction in its joints, which no linear law describes."""
    joints = tuple(replace(joint, friction=0.0) for joint in spec.articulation.joints)
    groups = tuple(replace(group, friction=None) for group in spec.actuators)
    return replace(spec, articulation=replace(spec.articulation, joints=joints), actuators=groups)


def travel(joint: Joint) -> tuple[float, float]:
    """The limits of a joint, in rad or m; half a turn, or as many metres, where it has none."""
    if joint.type is JointType.CONTINUOUS:
        return -_TURN, _TURN
    low, high = joint.lower_limit, joint.upper_limit
    return (low if math.isfinite(low) else -_TURN), (high if math.isfinite(high) else _TURN)


def with_followers(articulation: Articulation, positions: FloatArray) -> FloatArray:
    """The positions (..., J) with each follower where its leader puts it."""
    placed = positions.copy()
    for index, joint in enumerate(articulation.movable_joints):
        if joint.mimic is not None:
            leader = articulation.joint_names.index(joint.mimic.joint)
            placed[..., index] = joint.mimic.position(placed[..., leader])
    return placed


def lowest_point(spec: RobotSpec) -> float:
    """Height (m) of the lowest point of all collision shapes at home, in the world."""
    positions = dict(zip(spec.articulation.joint_names, home_positions(spec).tolist(), strict=True))
    shapes = (shape for shapes in placed_shapes(spec, positions).values() for shape in shapes)
    return min(float(shape.bounds()[0][2]) for shape in shapes)


def placed_shapes(spec: RobotSpec, positions: Mapping[str, float]) -> dict[str, list[Convex]]:
    """Collision shapes of each link, in the world, at joint positions (rad, m) by name."""
    poses = link_poses(spec.articulation, positions)
    placed = {
        link.name: [convex_shape(shape, spec.pose @ poses[link.name]) for shape in link.collisions]
        for link in spec.articulation.links
    }
    return {name: [shape for shape in shapes if shape is not None] for name, shapes in placed.items()}


def drive_gains(spec: RobotSpec) -> tuple[FloatArray, FloatArray]:
    """Stiffness and damping (J,) of the joints' drives, whoever computes them; zero where there is none."""
    gains = np.zeros((2, len(spec.articulation.joint_names)))
    for group in spec.actuators:
        joints = match_names(group.joints, spec.articulation.joint_names, "joint", f"'{spec.name}'")
        gains[:, joints] = [[group.stiffness], [group.damping]]
    return gains[0], gains[1]


def held_joints(spec: RobotSpec) -> list[int]:
    """Indices of the joints that a drive with stiffness holds in place."""
    stiffness, _ = drive_gains(spec)
    joints = enumerate(spec.articulation.movable_joints)
    return [index for index, joint in joints if joint.mimic is None and stiffness[index] > 0.0]


def gripper_positions(spec: RobotSpec, gripper: Gripper, value: float | tuple[float, ...]) -> Mapping[int, float]:
    """Positions by joint index, of a gripper's ``open_position`` or ``closed_position``."""
    values = value if isinstance(value, tuple) else (value,) * len(gripper.joints)
    names = spec.articulation.joint_names
    return match_values(dict(zip(gripper.joints, values, strict=True)), names, "joint", f"the gripper of '{spec.name}'")
