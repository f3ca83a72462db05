"""Numbers and poses as URDF writes them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement

from orbit_core.scene import Pose
from orbit_core.scene.pose import Vector3

UNLIMITED = 1e30
"""Written for an infinite limit, and from there on read as one: most parsers ask for a number."""


def numbers(values: Iterable[float]) -> str:
    """Numbers in full precision, apart by spaces."""
    return " ".join(repr(float(value)) for value in values)


def origin(parent: Element, pose: Pose) -> None:
    """Add ``<origin>`` to an element, unless the pose is the identity."""
    if pose != Pose():
        SubElement(parent, "origin", xyz=numbers(pose.position), rpy=numbers(roll_pitch_yaw(pose)))


def roll_pitch_yaw(pose: Pose) -> Vector3:
    """Fixed-axis angles in radians, the inverse of :meth:`Pose.from_euler`.

    Where pitch is a quarter turn, any yaw will do; the roll that goes with the one chosen is computed from it, so that
    the rotation is exact near there as well.
    """
    r = pose.rotation_matrix()
    yaw = math.atan2(r[1, 0], r[0, 0])
    sine, cosine = math.sin(yaw), math.cos(yaw)
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    roll = math.atan2(sine * r[0, 2] - cosine * r[1, 2], cosine * r[1, 1] - sine * r[0, 1])
    return (roll, pitch, yaw)
