"""Search for the place of a cylinder between the open fingers of a hand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orbit_assets.audit.robots.postures import all_shapes, frame_pose, gripper_posture
from orbit_assets.convex import Convex, convex_shape, within
from orbit_core.scene import Cylinder, EndEffector, Gripper, Pose, RobotSpec, Shape

RADIUS, LENGTH = 0.02, 0.1
"""Metres. The axis is along the x of the end effector's frame: across the fingers' opening and the approach."""
# Metres out of the hand, from the end effector's frame, within which a place is looked for.
_FARTHEST, _STRIDE = 0.08, 0.002
# Metres between shapes that count as touching.
_TOUCH = 2e-4
# Share of the radius to which closing fingers would get into the cylinder: less is no more than brushing its front.
_CORE = 0.5
_LYING = Pose.from_axis_angle((0.0, 1.0, 0.0), math.pi / 2.0)


@dataclass(frozen=True, eq=False)
class Place:
    """Pose of the cylinder, and the robot's joints with the hand open and closed."""

    pose: Pose
    """Of the cylinder, in the world."""
    opened: Mapping[str, float]
    """Positions of all movable joints by name."""
    closed: Mapping[str, float]


def place_of(spec: RobotSpec, effector: EndEffector, gripper: Gripper) -> Place | None:
    """Return the place nearest to the end effector's frame that the open hand leaves free and the closing one does not.

    None where there is none: the hand opens too little, or closes next to it.
    """
    opened = gripper_posture(spec, gripper, gripper.open_position)
    closed = gripper_posture(spec, gripper, gripper.closed_position)
    frame = frame_pose(spec, effector.frame, opened)
    around, within_reach = all_shapes(spec, opened), all_shapes(spec, closed)
    whole, core = (Shape(Cylinder(radius, LENGTH / 2.0)) for radius in (RADIUS, _CORE * RADIUS))
    for out in np.arange(0.0, _FARTHEST, _STRIDE):
        pose = frame @ Pose((0.0, 0.0, float(out))) @ _LYING
        if not _touches(whole, pose, around) and _touches(core, pose, within_reach):
            return Place(pose, opened, closed)
    return None


def _touches(shape: Shape, pose: Pose, others: list[Convex]) -> bool:
    thing = convex_shape(shape, pose)
    assert thing is not None
    return any(within(thing, other, _TOUCH) for other in others)
