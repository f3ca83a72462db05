"""Makes ``cabinet.usda``: run ``python assets/make_cabinet.py`` after a change here.

The frame lies on the floor in the middle of the footprint; the front faces -x. Panels are 18 mm boards.
"""

from __future__ import annotations

from pathlib import Path

from orbit_assets.objects import box_between, solid_part
from orbit_assets.usd import write_usd
from orbit_core.scene import Articulation, Color, Frame, Joint, JointType, PhysicsMaterial, Pose, Shape
from orbit_core.scene.pose import Vector3

WIDTH, DEPTH, HEIGHT = 0.50, 0.50, 0.62
BOARD = 0.018
GAP = 0.003
"""Between parts that move against each other."""
PLINTH = 0.04
FRONT = -DEPTH / 2
"""x of the fronts' outer faces."""
BODY_FRONT = FRONT + BOARD + GAP
"""x of the front edges of the body's boards: drawer front and door close against them."""
SHELF = 0.355
"""Height of the middle of the shelf between door and drawer."""
DRAWER_LENGTH = 0.42
BAR, BAR_LENGTH, CLEARANCE = 0.018, 0.16, 0.036
"""A handle's bar: its side, its length, and its distance from the front."""

WOOD = 650.0
STEEL = 7800.0
CARCASS_COLOR: Color = (0.62, 0.46, 0.31, 1.0)
FRONT_COLOR: Color = (0.86, 0.80, 0.70, 1.0)
DRAWER_COLOR: Color = (0.75, 0.62, 0.45, 1.0)
STEEL_COLOR: Color = (0.25, 0.27, 0.30, 1.0)
WOOD_SURFACE = PhysicsMaterial(static_friction=0.5, dynamic_friction=0.5)
HANDLE_SURFACE = PhysicsMaterial(static_friction=1.0, dynamic_friction=1.0)


def board(name: str, low: Vector3, high: Vector3, color: Color, surface: PhysicsMaterial = WOOD_SURFACE) -> Shape:
    """A board between two corners."""
    return box_between(name, low, high, color, surface)


def carcass() -> tuple[Shape, ...]:
    """The hollow body: sides, top, bottom, shelf, back and plinth."""
    side, back = WIDTH / 2, DEPTH / 2
    inner = side - BOARD
    across = {
        "bottom": PLINTH + BOARD / 2,
        "shelf": SHELF,
        "top": HEIGHT - BOARD / 2,
    }
    panels = [
        board(name, (BODY_FRONT, -inner, z - BOARD / 2), (back - BOARD, inner, z + BOARD / 2), CARCASS_COLOR)
        for name, z in across.items()
    ]
    return (
        board("left", (BODY_FRONT, inner, 0.0), (back, side, HEIGHT), CARCASS_COLOR),
        board("right", (BODY_FRONT, -side, 0.0), (back, -inner, HEIGHT), CARCASS_COLOR),
        board("back", (back - BOARD, -inner, 0.0), (back, inner, HEIGHT), CARCASS_COLOR),
        *panels,
        board("plinth", (FRONT + 0.05, -inner, 0.0), (FRONT + 0.05 + BOARD, inner, PLINTH), CARCASS_COLOR),
    )


def drawer() -> tuple[Shape, ...]:
    """A front and an open box behind it, clear of the body by the gap on every side."""
    half = WIDTH / 2 - BOARD - GAP
    low, high = SHELF + BOARD / 2 + GAP, HEIGHT - BOARD - 0.03
    start = FRONT + BOARD
    end = start + DRAWER_LENGTH
    thin = 0.012
    return (
        board("front", (FRONT, -WIDTH / 2, SHELF + GAP / 2), (start, WIDTH / 2, HEIGHT), FRONT_COLOR),
        board("floor", (start, -half, low), (end, half, low + thin), DRAWER_COLOR),
        board("left", (start, half - thin, low + thin), (end, half, high), DRAWER_COLOR),
        board("right", (start, -half, low + thin), (end, -half + thin, high), DRAWER_COLOR),
        board("back", (end - thin, -half + thin, low + thin), (end, half - thin, high), DRAWER_COLOR),
    )


def handle(middle: Vector3, horizontal: bool) -> tuple[Shape, ...]:
    """A square bar on two posts; ``middle`` is the middle of the bar."""
    x, y, z = middle
    half, end, post = BAR / 2, BAR_LENGTH / 2, 0.006

    def part(name: str, x_range: tuple[float, float], along: tuple[float, float], across: float) -> Shape:
        (x0, x1), (a0, a1) = x_range, along
        if horizontal:
            return board(name, (x0, y + a0, z - across), (x1, y + a1, z + across), STEEL_COLOR, HANDLE_SURFACE)
        return board(name, (x0, y - across, z + a0), (x1, y + across, z + a1), STEEL_COLOR, HANDLE_SURFACE)

    behind = (x + half, FRONT)
    return (
        part("bar", (x - half, x + half), (-end, end), half),
        part("post_0", behind, (-end, -end + 2 * post), post),
        part("post_1", behind, (end - 2 * post, end), post),
    )


def cabinet() -> Articulation:
    """Drawer above, door below, each with a handle that a parallel gripper can grasp from the front."""
    grip = FRONT - CLEARANCE - BAR / 2
    drawer_middle = (grip, 0.0, (SHELF + HEIGHT) / 2)
    door_middle = (grip, -WIDTH / 2 + 0.06, SHELF - 0.12)
    hinge = (FRONT, WIDTH / 2, 0.0)
    panel = board("panel", (FRONT, -WIDTH / 2, PLINTH), (FRONT + BOARD, WIDTH / 2, SHELF - GAP / 2), FRONT_COLOR)
    links = (
        solid_part("cabinet", carcass(), WOOD, "cabinet"),
        solid_part("drawer", drawer(), WOOD, "drawer"),
        solid_part("drawer_bar", handle(drawer_middle, horizontal=True), STEEL, "handle", drawer_middle),
        solid_part("door", (panel,), WOOD, "door", hinge),
        solid_part("door_bar", handle(door_middle, horizontal=False), STEEL, "handle", door_middle),
    )
    on_door = Pose(hinge).inverse() @ Pose(door_middle)
    joints = (
        Joint(
            "drawer_joint", JointType.PRISMATIC, "cabinet", "drawer", axis=(-1.0, 0.0, 0.0),
            lower_limit=0.0, upper_limit=0.4, damping=8.0, friction=3.0,
        ),
        Joint("drawer_bar_joint", JointType.FIXED, "drawer", "drawer_bar", Pose(drawer_middle)),
        # About the outer edge of the door, so that its board swings clear of the body.
        Joint(
            "door_joint", JointType.REVOLUTE, "cabinet", "door", Pose(hinge), axis=(0.0, 0.0, -1.0),
            lower_limit=0.0, upper_limit=1.57, damping=0.5, friction=0.2,
        ),
        Joint("door_bar_joint", JointType.FIXED, "door", "door_bar", on_door),
    )  # fmt: skip
    into_vertical_opening = Pose.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    into_horizontal_opening = Pose.from_matrix([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    frames = (
        Frame("drawer_handle", "drawer_bar", into_vertical_opening),
        Frame("door_handle", "door_bar", into_horizontal_opening),
    )
    return Articulation("cabinet", links, joints, frames)


if __name__ == "__main__":
    write_usd(cabinet(), Path(__file__).with_name("cabinet.usda"))
