"""A stick that a hand holds, and a net that slides on a rail, for a puck on ice."""

from __future__ import annotations

from orbit_assets.objects import WOOD, solid_link
from orbit_core.scene import (
    Articulation,
    Box,
    Color,
    Cylinder,
    Frame,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    PhysicsMaterial,
    Pose,
    RobotSpec,
    Shape,
)
from orbit_core.scene.pose import Vector3

LENGTH, WIDTH, DEPTH, BOARD = 0.14, 0.2, 0.12, 0.01
"""Metres: from the hand to the blade's middle; between the net's posts; from its line to its back; its boards."""
BLADE_HALF: Vector3 = (0.006, 0.05, 0.02)
"""Metres, half of the blade's sides."""
RED: Color = (0.75, 0.1, 0.1, 1.0)
WHITE: Color = (0.9, 0.93, 0.97, 1.0)
BLADE = PhysicsMaterial(0.3, 0.3)


def stick() -> Articulation:
    """A stick that hangs from its root along z; its frame ``blade`` is in the middle of its blade."""
    shaft = Shape(Cylinder(0.006, 0.5 * LENGTH), Pose((0.0, 0.0, 0.5 * LENGTH)), BLADE, WOOD, "shaft")
    blade = Shape(Box(BLADE_HALF), Pose((0.0, 0.0, LENGTH)), BLADE, RED, "blade")
    tip = Frame("blade", "stick", Pose((0.0, 0.0, LENGTH)))
    return Articulation("stick", (solid_link("stick", (shaft, blade), 600.0),), frames=(tip,))


def net(pose: Pose) -> RobotSpec:
    """A net of boards on a rail across the ice, along y, with a drive; its frame is in the middle of its line, on the
    ice."""  # fmt: skip
    half, up = 0.5 * WIDTH + BOARD, 0.03
    parts = {
        "left": ((0.5 * DEPTH, half - 0.5 * BOARD, up), (0.5 * DEPTH, 0.5 * BOARD, up - 0.002), RED),
        "right": ((0.5 * DEPTH, 0.5 * BOARD - half, up), (0.5 * DEPTH, 0.5 * BOARD, up - 0.002), RED),
        "back": ((DEPTH + 0.5 * BOARD, 0.0, up), (0.5 * BOARD, half, up - 0.002), WHITE),
    }
    boards = tuple(Shape(Box(size), Pose(at), BLADE, color, name) for name, (at, size, color) in parts.items())
    rail = Joint("rail", JointType.PRISMATIC, "mount", "net", axis=(0.0, 1.0, 0.0), lower_limit=-0.3, upper_limit=0.3)
    return RobotSpec(
        name="net",
        articulation=Articulation("net", (Link("mount"), solid_link("net", boards, 1000.0)), (rail,)),
        pose=pose,
        fixed_base=True,
        actuators=(ImplicitPd(joints=("rail",), stiffness=2000.0, damping=60.0),),
        gravity_compensation=True,
    )
