"""Makes ``dishwasher.usda``: run ``python assets/make_dishwasher.py`` after a change here.

A small dishwasher as stands on a table. Its frame lies on the table in the middle of the footprint; the front faces -x.
The door is hinged at its bottom; its handle is a bar above its upper edge, free all around. The top ends a hand's
breadth behind the front, so that a hand reaches the rack's bar from above.
"""

from __future__ import annotations

import math
from pathlib import Path

from orbit_assets.objects import box_between, solid_part
from orbit_assets.usd import write_usd
from orbit_core.scene import Articulation, Capsule, Color, Frame, Joint, JointType, PhysicsMaterial, Pose, Shape
from orbit_core.scene.pose import Vector3

WIDTH, DEPTH = 0.44, 0.40
HINGE, HEIGHT = 0.14, 0.22
"""Height of the hinge above the table; of the door's panel, and of the tub's top, above the hinge."""
SHEET = 0.018
GAP = 0.003
FRONT = -DEPTH / 2
"""x of the door's outer face."""
INSIDE = FRONT + SHEET + GAP
"""x of the front edges of the tub: the door closes against them."""
SLOT = 0.13
"""From the front to where the top begins."""
BAR, REACH, BAR_LENGTH = 0.008, 0.05, 0.24
"""Radius of the bars; from the door's upper edge to its bar; length of the bars."""
RACK_BAR = 0.048
"""From the front to the rack's bar."""
RACK_LENGTH, RACK_TRAVEL = 0.26, 0.22

STEEL = 2700.0
"""kg/m^3, of sheets that are hollow, on average."""
WHITE: Color = (0.85, 0.87, 0.88, 1.0)
GRAY: Color = (0.55, 0.58, 0.60, 1.0)
BLUE: Color = (0.25, 0.40, 0.65, 1.0)
DARK: Color = (0.22, 0.24, 0.27, 1.0)
SMOOTH = PhysicsMaterial(static_friction=0.3, dynamic_friction=0.3)
GRIP = PhysicsMaterial(static_friction=0.8, dynamic_friction=0.8)


def tub() -> tuple[Shape, ...]:
    """Base, sides, back and a top that leaves a slot at the front."""
    side, back, top = WIDTH / 2, DEPTH / 2, HINGE + HEIGHT

    def sheet(name: str, low: Vector3, high: Vector3, color: Color = WHITE) -> Shape:
        return box_between(name, low, high, color, SMOOTH)

    return (
        sheet("base", (FRONT, -side, 0.0), (back, side, HINGE - GAP), GRAY),
        sheet("left", (INSIDE, side - SHEET, HINGE), (back, side, top)),
        sheet("right", (INSIDE, -side, HINGE), (back, SHEET - side, top)),
        sheet("back", (back - SHEET, SHEET - side, HINGE), (back, side - SHEET, top)),
        sheet("top", (FRONT + SLOT, SHEET - side, top - SHEET), (back - SHEET, side - SHEET, top)),
    )


def bar(name: str, x: float, z: float) -> Shape:
    """A round bar along y."""
    along_y = Pose.from_axis_angle((1.0, 0.0, 0.0), math.pi / 2)
    return Shape(Capsule(BAR, BAR_LENGTH / 2), Pose((x, 0.0, z)) @ along_y, GRIP, DARK, name)


def posts(x: float, low: float, high: float) -> tuple[Shape, ...]:
    """What carries a bar, at both of its ends."""
    half, end = 0.006, BAR_LENGTH / 2
    return tuple(
        box_between(name, (x - half, y - half, low), (x + half, y + half, high), DARK, GRIP)
        for name, y in (("post_left", end), ("post_right", -end))
    )


def door() -> tuple[Shape, ...]:
    """A panel with a bar above it."""
    side, middle, edge = WIDTH / 2, FRONT + SHEET / 2, HINGE + HEIGHT
    panel = box_between("panel", (FRONT, -side, HINGE), (FRONT + SHEET, side, edge), WHITE, SMOOTH)
    return (panel, bar("bar", middle, edge + REACH), *posts(middle, edge, edge + REACH))


def rack() -> tuple[Shape, ...]:
    """A tray of low sides behind a bar that stands as high as the tub's top."""
    half, floor, thin = WIDTH / 2 - SHEET - 0.012, HINGE + 0.07, 0.008
    start = FRONT + RACK_BAR
    end = start + RACK_LENGTH

    def part(name: str, low: Vector3, high: Vector3) -> Shape:
        return box_between(name, low, high, BLUE, SMOOTH)

    return (
        part("floor", (start - thin / 2, -half, floor), (end, half, floor + thin)),
        part("left", (start - thin / 2, half - thin, floor + thin), (end, half, floor + 0.05)),
        part("right", (start - thin / 2, -half, floor + thin), (end, thin - half, floor + 0.05)),
        part("back", (end - thin, thin - half, floor + thin), (end, half - thin, floor + 0.05)),
        bar("bar", start, HINGE + HEIGHT - 0.02),
        *posts(start, floor + thin, HINGE + HEIGHT - 0.02),
    )


def dishwasher() -> Articulation:
    """Tub, door and rack. Links collide with each other, for the shut door holds the rack back."""
    hinge = (FRONT, 0.0, HINGE)
    links = (
        solid_part("tub", tub(), STEEL, "dishwasher"),
        solid_part("door", door(), STEEL / 4, "door", hinge),
        solid_part("rack", rack(), STEEL / 3, "rack"),
    )
    joints = (
        # About the lower outer edge of the door, so that its panel swings clear of the base.
        Joint(
            "door_joint", JointType.REVOLUTE, "tub", "door", Pose(hinge), axis=(0.0, -1.0, 0.0),
            lower_limit=0.0, upper_limit=1.5, damping=0.8, friction=0.1,
        ),
        Joint(
            "rack_joint", JointType.PRISMATIC, "tub", "rack", axis=(-1.0, 0.0, 0.0),
            lower_limit=0.0, upper_limit=RACK_TRAVEL, damping=8.0, friction=2.0,
        ),
    )  # fmt: skip
    frames = (
        Frame("door_bar", "door", Pose((SHEET / 2, 0.0, HEIGHT + REACH))),
        Frame("rack_bar", "rack", Pose((FRONT + RACK_BAR, 0.0, HINGE + HEIGHT - 0.02))),
    )
    return Articulation("dishwasher", links, joints, frames, self_collisions=True)


if __name__ == "__main__":
    write_usd(dishwasher(), Path(__file__).with_name("dishwasher.usda"))
