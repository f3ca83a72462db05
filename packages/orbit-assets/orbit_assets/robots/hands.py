"""What dexterous hands share: how an arm carries them, and how they close."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from orbit_assets.compose import attach
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Gripper, Link, Pose
from orbit_core.scene.pose import Vector3


def on_bracket(
    hand: Articulation, name: str, origin: Vector3, fingers: Vector3, palm: Vector3, angle: float
) -> Articulation:
    """The hand on a bracket without mass, so that the flange that carries it points where the hand grasps.

    Args:
        hand: its root is the palm, or what carries the palm.
        name: of the result, whose root is ``<name>_mount``.
        origin: of the flange in the hand's root.
        fingers: along the stretched fingers, in the hand's root.
        palm: out of the palm, in the hand's root; perpendicular to ``fingers``.
        angle: between ``fingers`` and the direction of grasping, in degrees.
    """
    mount = bracket(origin, fingers, palm, angle).inverse()
    return merge_fixed_links(attach(Articulation(name, (Link(f"{name}_mount"),)), hand, f"{name}_mount", mount))


def bracket(origin: Vector3, fingers: Vector3, palm: Vector3, angle: float) -> Pose:
    """The pose of a flange in the root of the hand that it carries.

    The thumb meets the other fingers in front of the palm rather than beyond its end: a hand grasps along a direction
    ``angle`` degrees from ``fingers`` to ``palm``. That is z of the flange, and y points from the thumb to the fingers.

    Args:
        origin: of the flange in the hand's root.
        fingers: along the stretched fingers, in the hand's root.
        palm: out of the palm, in the hand's root; perpendicular to ``fingers``.
        angle: in degrees.
    """
    along, out = np.asarray(fingers), np.asarray(palm)
    cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    approach, opening = cosine * along + sine * out, sine * along - cosine * out
    turned = Pose.from_matrix(np.column_stack((np.cross(opening, approach), opening, approach)))
    return Pose(origin, turned.orientation)


def grasp(positions: Mapping[str, tuple[float, float]]) -> Gripper:
    """A gripper of these joints, by name: their positions (rad) where it is open, and where it is closed."""
    first, last = zip(*positions.values(), strict=True)
    return Gripper(tuple(map(re.escape, positions)), first, last)


def opened(positions: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """The open hand, as a part's home position."""
    return {re.escape(joint): position for joint, (position, _) in positions.items()}
