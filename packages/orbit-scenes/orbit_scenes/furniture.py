"""Furniture of boxes, with drawers and doors that move, and the places on and in it where things may stand.

Each piece stands on the floor with its frame in the middle of its footprint and its front towards -x. A link that moves
has the frame of the whole piece where it is shut.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.resources import as_file, files
from itertools import pairwise
from typing import ClassVar

from orbit_assets.objects import WOOD, box_between, solid_part
from orbit_core.configuration import from_plain, read_toml
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.objects import ObjectConfig
from orbit_core.scene import (
    Articulation,
    Color,
    Cylinder,
    Frame,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    Shape,
)
from orbit_core.scene.pose import Vector3

# Metres: thickness of panels and of worktops, gap around fronts, of a bar's distance from its front.
_PANEL, _TOP, _GAP, _BAR = 0.018, 0.038, 0.003, 0.035
# kg/m^3 of chipboard; of upholstery; of steel sheets with the air between.
_BOARD, _SOFT, _METAL = 650.0, 90.0, 400.0
_SURFACE = PhysicsMaterial(0.6, 0.6)
_CLOTH = PhysicsMaterial(0.9, 0.9)

WHITE: Color = (0.90, 0.90, 0.88, 1.0)
STEEL: Color = (0.66, 0.67, 0.69, 1.0)
DARK: Color = (0.20, 0.21, 0.23, 1.0)
STONE: Color = (0.42, 0.42, 0.44, 1.0)
OAK: Color = (0.76, 0.60, 0.42, 1.0)
WALNUT: Color = (0.42, 0.29, 0.19, 1.0)
CERAMIC: Color = (0.93, 0.94, 0.95, 1.0)
FRONTS: tuple[Color, ...] = ((0.88, 0.88, 0.85, 1.0), (0.62, 0.70, 0.66, 1.0), (0.55, 0.63, 0.72, 1.0), OAK)
"""Colours of kitchen fronts, of which a seed picks one."""
FABRICS: tuple[Color, ...] = ((0.36, 0.42, 0.50, 1.0), (0.55, 0.47, 0.38, 1.0), (0.44, 0.50, 0.40, 1.0))
"""Colours of upholstery."""


@dataclass(frozen=True, kw_only=True)
class Support:
    """A level rectangle where things may stand; its frame is its middle, z up."""

    name: str
    """Name by which rules choose it, such as ``drawer_1``."""
    link: str
    """Link that it moves with: a drawer, or the root of the furniture."""
    pose: Pose
    """In the frame of the link."""
    size: tuple[float, float]
    """Full extent along x and y, m."""
    clearance: float = 0.6
    """Free height above it, m."""
    joint: str = ""
    """The joint that has to be opened to reach it; empty for one that is open."""
    walled: bool = False
    """Whether walls around it hold things in, so that they may be poured into it."""


@dataclass(frozen=True, kw_only=True)
class FurnitureData:
    """One entry of the table ``data/furniture.toml``."""

    size: tuple[float, ...]
    """Depth, width and height, m."""
    source: str
    """Source of the size; see the head of the table."""
    height: float | None = None
    """A further height: of a seat, or of the underside of what hangs on a wall, m."""


@dataclass(frozen=True, eq=False)
class Furniture:
    """A piece of furniture."""

    kind: str
    """Name in the table of furniture, and the semantic label."""
    articulation: Articulation
    """Links, and the joints of doors and drawers; the frame is the middle of its box on the floor, its front towards
    -x."""
    size: Vector3
    """Depth, width and height of its box; a cabinet on a wall has its height above the floor added."""
    supports: tuple[Support, ...] = ()
    """Places on and in it where things may stand."""
    front: float = 0.0
    """Metres in front of it that stay free, for people and for what opens."""
    wall: bool = True
    """Whether its back stands against a wall."""
    bottom: float = 0.0
    """Height of its underside, m."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        """Build the object, fixed to the floor."""
        return ObjectSpec(
            name=name,
            articulation=self.articulation,
            pose=pose or Pose(),
            fixed_base=True,
            semantic_label=self.kind,
        )


@functools.cache
def furniture_table() -> dict[str, FurnitureData]:
    """Return the table of sizes by kind, as the file states it."""
    with as_file(files("orbit_scenes") / "data" / "furniture.toml") as path:
        values = read_toml(path, "table of furniture")
    return {name: from_plain(FurnitureData, entry, f"furniture '{name}'") for name, entry in values.items()}


def measured(kind: str) -> Vector3:
    """Return depth, width and height of a kind from the table, m."""
    x, y, z = furniture_table()[kind].size
    return (x, y, z)


def furniture(kind: str, *, color: Color | None = None, size: Vector3 | None = None) -> Furniture:
    """Build a piece of furniture.

    Args:
        kind: name of the kind.
        color: of its fronts or its cover; None takes the kind's own.
        size: depth, width and height in metres; None takes the table's.

    Raises:
        UnknownNameError: there is no such kind.
        ConfigurationError: a length is not above zero.
    """
    if kind not in _KINDS:
        raise UnknownNameError("furniture", kind, _KINDS, "the kinds of furniture")
    extent = size or measured(kind)
    if len(extent) != 3 or not all(0.01 <= length < 20.0 for length in extent):
        raise ConfigurationError(f"the size of furniture '{kind}' is {extent}: give three lengths of 0.01 to 20 m")
    return _KINDS[kind](kind, extent, color)


@dataclass
class _Body:
    """Parts of a piece of furniture while it is built."""

    kind: str
    size: Vector3
    color: Color
    shapes: list[Shape] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    supports: list[Support] = field(default_factory=list)
    bottom: float = 0.0

    def box(self, name: str, low: Vector3, high: Vector3, color: Color, surface: PhysicsMaterial = _SURFACE) -> None:
        """Add a box of the fixed body."""
        self.shapes.append(box_between(name, low, high, color, surface))

    def support(self, name: str, low: tuple[float, float], high: tuple[float, float], z: float, **more: object) -> None:
        """Add a support of the fixed body between two corners at height ``z``."""
        middle = Pose(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, z))
        size = (high[0] - low[0], high[1] - low[1])
        self.supports.append(Support(name=name, link=self.kind, pose=middle, size=size, **more))  # pyright: ignore[reportArgumentType]

    def finish(self, density: float = _BOARD, *, front: float = 0.0, wall: bool = True) -> Furniture:
        """Return the piece; its mass is that of its boxes at one density (kg/m^3)."""
        root = solid_part(self.kind, tuple(self.shapes), density, self.kind)
        body = Articulation(self.kind, (root, *self.links), tuple(self.joints), tuple(self.frames))
        return Furniture(self.kind, body, self.size, tuple(self.supports), front, wall, self.bottom)

    def drawer(self, name: str, low: Vector3, high: Vector3) -> None:
        """Add a drawer whose front fills a rectangle of the front plane; ``low`` and ``high`` bound its box."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        # Free at the back, so that the shut drawer does not press on the carcass.
        depth = x1 - x0 - 0.03
        side, floor, wall = 0.012, z0 + 0.02, z0 + 0.7 * (z1 - z0)
        # Room for runners on both sides.
        inner0, inner1 = y0 + 0.02, y1 - 0.02
        back = x0 + depth
        parts = [
            self._front(name, x0, (y0, z0), (y1, z1)),
            box_between("floor", (x0, inner0, floor - 0.012), (back, inner1, floor), OAK, _SURFACE),
            box_between("left", (x0, inner1 - side, floor), (back, inner1, wall), OAK, _SURFACE),
            box_between("right", (x0, inner0, floor), (back, inner0 + side, wall), OAK, _SURFACE),
            box_between("back", (back - side, inner0 + side, floor), (back, inner1 - side, wall), OAK, _SURFACE),
        ]
        place = (x0 - _PANEL, (y0 + y1) / 2, z0 + 0.75 * (z1 - z0))
        parts += self._handle(name, place, 0.4 * (y1 - y0), upright=False)
        self.links.append(solid_part(name, tuple(parts), _BOARD, "drawer"))
        joint = Joint(
            f"{name}_joint",
            JointType.PRISMATIC,
            self.kind,
            name,
            axis=(-1.0, 0.0, 0.0),
            lower_limit=0.0,
            # Runners hold the last part of a drawer; friction keeps it where it is left.
            upper_limit=round(0.85 * depth, 3),
            damping=4.0,
            friction=1.0,
        )
        self.joints.append(joint)
        middle = Pose(((x0 + back - side) / 2, (y0 + y1) / 2, floor))
        size = (back - side - x0, inner1 - inner0 - 2 * side)
        clearance = z1 - floor - 0.03
        self.supports.append(
            Support(name=name, link=name, pose=middle, size=size, clearance=clearance, joint=joint.name, walled=True)
        )

    def door(self, name: str, x: float, low: tuple[float, float], high: tuple[float, float], hinge: str) -> str:
        """Add a door that fills a rectangle (y, z) of the front plane at ``x``.

        Args:
            name: of its link.
            x: of the plane behind the door.
            low: corner of least y and z.
            high: the opposite corner.
            hinge: side of its hinge: "left" (+y), "right" (-y) or "bottom".

        Returns:
            The name of its joint.
        """
        (y0, z0), (y1, z1) = low, high
        origin, axis, handle, upright = {
            "left": ((x, y1, 0.0), (0.0, 0.0, -1.0), (x - _PANEL, y0 + 0.05, (z0 + z1) / 2), True),
            "right": ((x, y0, 0.0), (0.0, 0.0, 1.0), (x - _PANEL, y1 - 0.05, (z0 + z1) / 2), True),
            "bottom": ((x, 0.0, z0), (0.0, -1.0, 0.0), (x - _PANEL, (y0 + y1) / 2, z1 - 0.06), False),
        }[hinge]
        length = min(0.3, 0.4 * (z1 - z0)) if upright else 0.6 * (y1 - y0)
        parts = [self._front(name, x, low, high), *self._handle(name, handle, length, upright=upright)]
        self.links.append(solid_part(name, tuple(parts), _BOARD, "door"))
        joint = Joint(
            f"{name}_joint",
            JointType.REVOLUTE,
            self.kind,
            name,
            parent_pose=Pose(origin),
            child_pose=Pose(origin),
            axis=axis,
            lower_limit=0.0,
            upper_limit=1.57 if hinge == "bottom" else 1.9,
            damping=0.6,
            # An oven's door leans out by its handle: its springs, friction here, hold it where it is left ajar.
            friction=1.2 if hinge == "bottom" else 0.2,
        )
        self.joints.append(joint)
        return joint.name

    def _front(self, name: str, x: float, low: tuple[float, float], high: tuple[float, float]) -> Shape:
        # Fronts next to each other keep a gap, so that they pass when they open.
        gap = _GAP / 2
        corner0, corner1 = (x - _PANEL, low[0] + gap, low[1] + gap), (x, high[0] - gap, high[1] - gap)
        return box_between(f"{name}_front", corner0, corner1, self.color, _SURFACE)

    def _handle(self, link: str, place: Vector3, length: float, *, upright: bool) -> list[Shape]:
        """Return the bar of a handle and its two posts, and name the frame in the bar's middle."""
        x, y, z = place
        half = length / 2
        bar = x - _BAR
        # z into the piece, y across the bar: the frame of a gripper that grasps it.
        turn = Pose.from_matrix(
            ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
            if upright
            else ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        )
        self.frames.append(Frame(f"{link}_handle", link, Pose((bar, y, z)) @ turn))

        def post(name: str, along: float) -> Shape:
            dy, dz = (0.005, along) if upright else (along, 0.005)
            oy, oz = (0.0, dz) if upright else (dy, 0.0)
            return box_between(
                name, (bar, y + oy - 0.005, z + oz - 0.005), (x, y + oy + 0.005, z + oz + 0.005), STEEL, _SURFACE
            )

        low = (bar - 0.006, y - 0.006, z - half) if upright else (bar - 0.006, y - half, z - 0.006)
        high = (bar + 0.006, y + 0.006, z + half) if upright else (bar + 0.006, y + half, z + 0.006)
        whole = box_between(f"{link}_bar", low, high, STEEL, _SURFACE)
        return [whole, post(f"{link}_post_0", 0.02 - half), post(f"{link}_post_1", half - 0.02)]


def _carcass(
    body: _Body, low: Vector3, high: Vector3, color: Color, *, top: bool = True, shelves: tuple[float, ...] = ()
) -> None:
    """Add the panels of a box that is open towards -x, and shelves at heights within it."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    t = _PANEL
    body.box("back", (x1 - 0.008, y0 + t, z0), (x1, y1 - t, z1), color)
    body.box("left", (x0, y1 - t, z0), (x1, y1, z1), color)
    body.box("right", (x0, y0, z0), (x1, y0 + t, z1), color)
    body.box("bottom", (x0, y0 + t, z0), (x1 - 0.008, y1 - t, z0 + t), color)
    if top:
        body.box("top", (x0, y0 + t, z1 - t), (x1 - 0.008, y1 - t, z1), color)
    for index, height in enumerate(shelves):
        body.box(f"shelf_{index}", (x0 + 0.01, y0 + t, height - t), (x1 - 0.008, y1 - t, height), color)


def _inside(
    body: _Body, low: Vector3, high: Vector3, floors: list[float], ceiling: float, joint: str = "", name: str = "shelf"
) -> None:
    """Add the supports of a carcass: its floors, from the lowest up, below each other and ``ceiling``."""
    for index, (floor, above) in enumerate(zip(floors, [*floors[1:], ceiling], strict=True)):
        clearance = above - floor - _PANEL - 0.01
        corner0, corner1 = (low[0] + 0.02, low[1] + _PANEL + 0.01), (high[0] - 0.02, high[1] - _PANEL - 0.01)
        body.support(f"{name}_{index}", corner0, corner1, floor, clearance=clearance, joint=joint, walled=False)


def _base(kind: str, size: Vector3, color: Color | None, worktop: bool = True) -> tuple[_Body, Vector3, Vector3]:
    """Return a floor cabinet with plinth, carcass and worktop, without fronts, and the corners of its front opening."""
    depth, width, height = size
    body = _Body(kind, size, color or FRONTS[0])
    x0, x1, half = -depth / 2 + _PANEL, depth / 2, width / 2
    # Toes fit under the front: the plinth stands back.
    plinth, under = 0.1, height - (_TOP if worktop else 0.0)
    body.box("plinth", (x0 + 0.05, -half, 0.0), (x1, half, plinth), DARK)
    _carcass(body, (x0, -half, plinth), (x1, half, under), WHITE, top=not worktop)
    return body, (x0, -half, plinth), (x1, half, under)


def _worktop(body: _Body, color: Color = STONE) -> None:
    depth, width, height = body.size
    # The top overhangs the fronts by a centimetre; cabinets side by side share one level.
    low, high = (-depth / 2 - 0.01, -width / 2, height - _TOP), (depth / 2, width / 2, height)
    body.box("worktop", low, high, color)
    body.support("top", (low[0] + 0.03, low[1]), (high[0] - 0.02, high[1]), height, clearance=0.5)


def _base_drawers(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body, low, high = _base(kind, size, color)
    _worktop(body)
    span = high[2] - low[2]
    heights = [low[2], low[2] + 0.38 * span, low[2] + 0.76 * span, high[2]]
    for index, (z0, z1) in enumerate(pairwise(heights)):
        body.drawer(f"drawer_{index}", (low[0], low[1], z0), (high[0], high[1], z1))
    return body.finish(front=0.9)


def _double_doors(body: _Body, low: Vector3, high: Vector3) -> tuple[str, str]:
    x = low[0]
    left = body.door("left_door", x, (0.0, low[2]), (high[1], high[2]), "left")
    right = body.door("right_door", x, (low[1], low[2]), (0.0, high[2]), "right")
    return left, right


def _base_doors(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body, low, high = _base(kind, size, color)
    _worktop(body)
    middle = (low[2] + high[2]) / 2
    body.box("shelf", (low[0] + 0.06, low[1] + _PANEL, middle - _PANEL), (high[0], high[1] - _PANEL, middle), WHITE)
    left, _ = _double_doors(body, low, high)
    _inside(body, low, high, [low[2] + _PANEL, middle], high[2], left)
    return body.finish(front=0.9)


def _sink(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body, low, high = _base(kind, size, color)
    _double_doors(body, low, high)
    _basin(body, (-0.20, -0.26), (0.16, 0.26), size[2], 0.17)
    return body.finish(front=0.9)


def _basin(body: _Body, low: tuple[float, float], high: tuple[float, float], height: float, deep: float) -> None:
    """Add a worktop around a basin, the basin and a tap behind it."""
    (x0, y0), (x1, y1) = low, high
    a0, a1, half = -body.size[0] / 2 - 0.01, body.size[0] / 2, body.size[1] / 2
    under, floor, wall = height - _TOP, height - deep, 0.01
    # The worktop is a frame of four boxes around the opening.
    body.box("worktop_front", (a0, -half, under), (x0, half, height), STONE)
    body.box("worktop_back", (x1, -half, under), (a1, half, height), STONE)
    body.box("worktop_left", (x0, y1, under), (x1, half, height), STONE)
    body.box("worktop_right", (x0, -half, under), (x1, y0, height), STONE)
    body.box("basin_floor", (x0, y0, floor - wall), (x1, y1, floor), STEEL)
    body.box("basin_front", (x0 - wall, y0, floor), (x0, y1, under), STEEL)
    body.box("basin_back", (x1, y0, floor), (x1 + wall, y1, under), STEEL)
    body.box("basin_left", (x0, y1, floor), (x1, y1 + wall, under), STEEL)
    body.box("basin_right", (x0, y0 - wall, floor), (x1, y0, under), STEEL)
    middle = (y0 + y1) / 2
    body.box("tap", (x1 + 0.03, middle - 0.012, height), (x1 + 0.054, middle + 0.012, height + 0.2), STEEL)
    body.box("spout", (x1 - 0.10, middle - 0.01, height + 0.18), (x1 + 0.03, middle + 0.01, height + 0.2), STEEL)
    body.support("basin", low, high, floor, clearance=deep + 0.05, walled=True)


def _stove(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body, low, high = _base(kind, size, color)
    # The door of an oven is dark in kitchens of all colours.
    body.color = DARK
    depth, width, height = size
    body.box("hob", (-depth / 2 - 0.01, -width / 2, height - _TOP), (depth / 2, width / 2, height), DARK)
    for index, (x, y) in enumerate(((-0.13, -0.14), (-0.13, 0.14), (0.14, -0.14), (0.14, 0.14))):
        plate = Cylinder(0.085, 0.001)
        ring = Shape(plate, Pose((x, y, height + 0.001)), _SURFACE, (0.10, 0.10, 0.11, 1.0), f"burner_{index}")
        body.shapes.append(ring)
    body.support("hob", (-0.26, -0.28), (0.27, 0.28), height + 0.002, clearance=0.5)
    band = high[2] - 0.11
    body.box("panel", (low[0] - _PANEL, low[1], band), (low[0], high[1], high[2]), STEEL)
    for index in range(4):
        y = -0.2 + 0.4 * index / 3
        body.box(
            f"knob_{index}", (low[0] - 0.04, y - 0.018, band + 0.035), (low[0] - _PANEL, y + 0.018, band + 0.071), DARK
        )
    rack = low[2] + 0.32
    body.box("rack", (low[0] + 0.03, low[1] + _PANEL, rack - 0.01), (high[0] - 0.03, high[1] - _PANEL, rack), STEEL)
    joint = body.door("oven_door", low[0], (low[1], low[2] + 0.1), (high[1], band), "bottom")
    body.box("drawer_panel", (low[0] - _PANEL, low[1], low[2]), (low[0], high[1], low[2] + 0.1), DARK)
    corner0, corner1 = (low[0] + 0.05, low[1] + 0.05), (high[0] - 0.05, high[1] - 0.05)
    body.support("oven", corner0, corner1, rack, clearance=band - rack - 0.03, joint=joint)
    return body.finish(_METAL, front=0.9)


def _fridge(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    body = _Body(kind, size, color or CERAMIC)
    low, high = (-depth / 2 + _PANEL, -width / 2, 0.08), (depth / 2, width / 2, height)
    body.box("foot", (low[0] + 0.05, low[1], 0.0), (high[0], high[1], low[2]), DARK)
    split = low[2] + 0.36 * (height - low[2])
    floors = [low[2] + _PANEL, split, split + 0.28, split + 0.55, split + 0.82]
    # A shelf right under the ceiling would hold nothing.
    floors = [each for each in floors if each < height - 0.2]
    _carcass(body, low, high, CERAMIC, shelves=tuple(floors[1:]))
    lower = body.door("freezer_door", low[0], (low[1], low[2]), (high[1], split), "left")
    upper = body.door("fridge_door", low[0], (low[1], split), (high[1], height), "left")
    _inside(body, low, high, floors[1:], height, upper)
    _inside(body, low, high, floors[:1], split, lower, "freezer")
    return body.finish(_METAL, front=0.9)


def _wall_cabinet(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    bottom = furniture_table()[kind].height or 1.45
    body = _Body(kind, (depth, width, bottom + height), color or FRONTS[0], bottom=bottom)
    low, high = (-depth / 2 + _PANEL, -width / 2, bottom), (depth / 2, width / 2, bottom + height)
    middle = bottom + height / 2
    _carcass(body, low, high, WHITE, shelves=(middle,))
    left, _ = _double_doors(body, low, high)
    _inside(body, low, high, [bottom + _PANEL, middle], high[2], left)
    return body.finish(front=0.0)


def _legged(body: _Body, thickness: float, leg: float, color: Color) -> None:
    """Add a top on four legs."""
    depth, width, height = body.size
    x, y = depth / 2, width / 2
    body.box("top", (-x, -y, height - thickness), (x, y, height), color)
    for index, (sx, sy) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        cx, cy = sx * (x - leg), sy * (y - leg)
        low = (cx - leg / 2, cy - leg / 2, 0.0)
        body.box(f"leg_{index}", low, (cx + leg / 2, cy + leg / 2, height - thickness), color)
    body.support("top", (-x + 0.02, -y + 0.02), (x - 0.02, y - 0.02), height, clearance=0.6)


def _table(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body = _Body(kind, size, color or OAK)
    _legged(body, 0.03, 0.06, body.color)
    return body.finish(wall=False)


def _coffee_table(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body = _Body(kind, size, color or WALNUT)
    _legged(body, 0.03, 0.05, body.color)
    return body.finish(wall=False)


def _desk(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body = _Body(kind, size, color or OAK)
    _legged(body, 0.03, 0.05, body.color)
    depth, width, height = size
    # A case with one drawer hangs below the top at its right.
    low, high = (
        (-depth / 2 + 0.12, -width / 2 + 0.09, height - 0.19),
        (depth / 2 - 0.09, -width / 2 + 0.54, height - 0.03),
    )
    _carcass(body, low, high, WHITE, top=False)
    body.drawer("drawer", low, high)
    return body.finish(front=0.8)


def _chair(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    seat = furniture_table()[kind].height or 0.46
    body = _Body(kind, size, color or WOOD)
    x, y, leg = depth / 2, width / 2, 0.035
    body.box("seat", (-x, -y, seat - 0.03), (x, y, seat), body.color)
    for index, (sx, sy) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        cx, cy = sx * (x - leg / 2), sy * (y - leg / 2)
        top = height if sx > 0 else seat - 0.03
        body.box(f"leg_{index}", (cx - leg / 2, cy - leg / 2, 0.0), (cx + leg / 2, cy + leg / 2, top), body.color)
    body.box("rest", (x - 0.025, -y + leg, height - 0.25), (x - 0.005, y - leg, height - 0.05), body.color)
    return body.finish(wall=False)


def _sofa(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    seat = furniture_table()[kind].height or 0.42
    body = _Body(kind, size, color or FABRICS[0])
    x, y, arm, back = depth / 2, width / 2, 0.16, 0.22
    # Arms and back a little darker than the cushions, so that pictures show edges.
    shade: Color = (*(0.85 * part for part in body.color[:3]), 1.0)  # pyright: ignore[reportAssignmentType]
    body.box("base", (-x + 0.03, -y + 0.02, 0.08), (x, y - 0.02, seat - 0.15), shade, _CLOTH)
    middle = x - back
    body.box("cushion_left", (-x, 0.002, seat - 0.15), (middle, y - arm, seat), body.color, _CLOTH)
    body.box("cushion_right", (-x, -y + arm, seat - 0.15), (middle, -0.002, seat), body.color, _CLOTH)
    body.box("arm_left", (-x, y - arm, 0.08), (x, y, seat + 0.18), shade, _CLOTH)
    body.box("arm_right", (-x, -y, 0.08), (x, -y + arm, seat + 0.18), shade, _CLOTH)
    body.box("back", (middle, -y + arm, seat - 0.15), (x, y - arm, height), shade, _CLOTH)
    for index, (sx, sy) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        cx, cy = sx * (x - 0.08), sy * (y - 0.08)
        body.box(f"foot_{index}", (cx - 0.025, cy - 0.025, 0.0), (cx + 0.025, cy + 0.025, 0.08), DARK)
    body.support("seat", (-x + 0.05, -y + arm + 0.02), (middle - 0.03, y - arm - 0.02), seat, clearance=0.5)
    return body.finish(_SOFT, front=0.5)


def _tv_stand(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    body = _Body(kind, size, color or WALNUT)
    low, high = (-depth / 2 + _PANEL, -width / 2, 0.08), (depth / 2, width / 2, height)
    body.box("plinth", (low[0] + 0.04, low[1] + 0.04, 0.0), (high[0], high[1] - 0.04, low[2]), DARK)
    _carcass(body, low, high, body.color)
    # Three drawers side by side, as wide as each other.
    third = width / 3
    for index, name in enumerate(("left_drawer", "middle_drawer", "right_drawer")):
        y1 = high[1] - index * third
        body.drawer(name, (low[0], y1 - third, low[2] + _PANEL), (high[0], y1, height - _PANEL))
    body.support("top", (low[0] + 0.02, low[1] + 0.02), (high[0] - 0.02, high[1] - 0.02), height, clearance=0.3)
    return body.finish(front=0.7)


def _television(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    body = _Body(kind, size, color or (0.05, 0.05, 0.06, 1.0))
    body.box("foot", (-depth / 2, -0.2, 0.0), (depth / 2, 0.2, 0.02), DARK)
    body.box("neck", (-0.02, -0.04, 0.02), (0.02, 0.04, 0.06), DARK)
    body.box("screen", (-0.02, -width / 2, 0.06), (0.02, width / 2, height), body.color)
    return body.finish(_METAL)


def _bookshelf(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    body = _Body(kind, size, color or OAK)
    low, high = (-depth / 2, -width / 2, 0.0), (depth / 2, width / 2, height)
    # Shelves for folders: 0.32 m of free height and more.
    count = max(2, round(height / 0.36))
    floors = [_PANEL + index * (height - _PANEL) / count for index in range(count)]
    _carcass(body, low, high, body.color, shelves=tuple(floors[1:]))
    _inside(body, low, high, floors, height)
    return body.finish(front=0.6)


def _bed(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    body = _Body(kind, size, color or FABRICS[0])
    x, y = depth / 2, width / 2
    body.box("frame", (-x, -y, 0.12), (x - 0.05, y, 0.28), WALNUT)
    body.box("mattress", (-x + 0.02, -y + 0.02, 0.28), (x - 0.05, y - 0.02, height), WHITE, _CLOTH)
    body.box("head", (x - 0.05, -y, 0.0), (x, y, height + 0.45), WALNUT)
    body.box("cover", (-x + 0.01, -y + 0.01, height), (x - 0.75, y - 0.01, height + 0.03), body.color, _CLOTH)
    for index, side in enumerate((-1, 1)):
        cy = side * width / 4
        pillow = (x - 0.55, cy - 0.28, height), (x - 0.12, cy + 0.28, height + 0.10)
        body.box(f"pillow_{index}", *pillow, WHITE, _CLOTH)
        body.box(
            f"leg_{index}",
            (-x + 0.05, side * (y - 0.12) - 0.03, 0.0),
            (-x + 0.11, side * (y - 0.12) + 0.03, 0.12),
            DARK,
        )
    body.support("cover", (-x + 0.1, -y + 0.1), (x - 0.85, y - 0.1), height + 0.03, clearance=0.6)
    return body.finish(_SOFT)


def _nightstand(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    body = _Body(kind, size, color or WALNUT)
    low, high = (-depth / 2 + _PANEL, -width / 2, 0.06), (depth / 2, width / 2, height)
    for index, (x, y) in enumerate(
        ((low[0] + 0.05, -1), (low[0] + 0.05, 1), (high[0] - 0.05, -1), (high[0] - 0.05, 1))
    ):
        cy = y * (width / 2 - 0.05)
        body.box(f"foot_{index}", (x - 0.015, cy - 0.015, 0.0), (x + 0.015, cy + 0.015, low[2]), DARK)
    middle = low[2] + 0.5 * (height - low[2])
    _carcass(body, low, high, body.color, shelves=(middle,))
    body.drawer("drawer", (low[0], low[1], middle), (high[0], high[1], height - _PANEL))
    _inside(body, low, high, [low[2] + _PANEL], middle)
    body.support("top", (low[0], low[1] + 0.02), (high[0] - 0.02, high[1] - 0.02), height, clearance=0.6)
    return body.finish(front=0.5)


def _wardrobe(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    body = _Body(kind, size, color or WHITE)
    low, high = (-depth / 2 + _PANEL, -width / 2, 0.0), (depth / 2, width / 2, height)
    _carcass(body, low, high, body.color, shelves=(0.45, height - 0.35))
    # A rail for hangers, between shelf and top.
    rail = Cylinder(0.014, width / 2 - _PANEL)
    place = Pose((0.0, 0.0, height - 0.45)) @ Pose.from_euler(math.pi / 2, 0.0, 0.0)
    body.shapes.append(Shape(rail, place, _SURFACE, STEEL, "rail"))
    left, _ = _double_doors(body, low, high)
    _inside(body, low, high, [_PANEL, 0.45], height - 0.55, left)
    return body.finish(front=0.8)


def _washbasin(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body, low, high = _base(kind, size, color)
    _double_doors(body, low, high)
    width = size[1] / 2 - 0.10
    _basin(body, (-0.15, -width), (0.11, width), size[2], 0.12)
    return body.finish(front=0.7)


def _toilet(kind: str, size: Vector3, color: Color | None) -> Furniture:
    depth, width, height = size
    seat = furniture_table()[kind].height or 0.42
    body = _Body(kind, size, color or CERAMIC)
    x, y = depth / 2, width / 2
    body.box("foot", (-x + 0.12, -0.11, 0.0), (x - 0.18, 0.11, seat - 0.15), body.color)
    body.box("bowl", (-x + 0.04, -y + 0.02, seat - 0.15), (x - 0.18, y - 0.02, seat - 0.02), body.color)
    body.box("lid", (-x, -y, seat - 0.02), (x - 0.18, y, seat), WHITE)
    body.box("cistern", (x - 0.18, -y, 0.0), (x, y, height), body.color)
    body.support("cistern", (x - 0.17, -y + 0.02), (x - 0.01, y - 0.02), height, clearance=0.4)
    return body.finish(1200.0, front=0.6)


def _tub(body: _Body, wall: float, floor: float, color: Color) -> None:
    """Add the five boxes of a container that is open at the top."""
    depth, width, height = body.size
    x, y = depth / 2, width / 2
    body.box("floor", (-x + wall, -y + wall, 0.0), (x - wall, y - wall, floor), color)
    body.box("front", (-x, -y, 0.0), (-x + wall, y, height), color)
    body.box("back", (x - wall, -y, 0.0), (x, y, height), color)
    body.box("left", (-x + wall, y - wall, 0.0), (x - wall, y, height), color)
    body.box("right", (-x + wall, -y, 0.0), (x - wall, -y + wall, height), color)
    low, high = (-x + wall, -y + wall), (x - wall, y - wall)
    body.support("inside", low, high, floor, clearance=height - floor + 0.2, walled=True)


def _bathtub(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body = _Body(kind, size, color or CERAMIC)
    _tub(body, 0.07, 0.12, body.color)
    return body.finish(front=0.6)


def _bin(kind: str, size: Vector3, color: Color | None) -> Furniture:
    body = _Body(kind, size, color or (0.25, 0.36, 0.52, 1.0))
    _tub(body, 0.008, 0.008, body.color)
    return body.finish(950.0, wall=False)


def _door(kind: str, size: Vector3, color: Color | None) -> Furniture:
    """Build a room's door: a jamb on either side and a leaf between, whose hinge is at +y."""
    thick, width, height = size
    body = _Body(kind, size, color or (0.84, 0.82, 0.78, 1.0))
    jamb = 0.04
    half = width / 2
    # Jambs on both sides of the wall, wider than it is thick.
    for name, y0, y1 in (("jamb_left", half, half + jamb), ("jamb_right", -half - jamb, -half)):
        body.box(name, (-0.06, y0, 0.0), (0.06, y1, height + jamb), WHITE)
    body.box("jamb_top", (-0.06, -half, height), (0.06, half, height + jamb), WHITE)
    # The leaf is flush with the jamb's front, so that it swings clear of the wall.
    x1 = -0.06 + thick
    leaf = box_between("leaf", (-0.06, -half + _GAP, 0.008), (x1, half - _GAP, height - _GAP), body.color, _SURFACE)
    lever = []
    for name, x, sign in (("outer", -0.06, -1.0), ("inner", x1, 1.0)):
        a, b = sorted((x, x + sign * 0.05))
        lever.append(
            box_between(f"{name}_spindle", (a, -half + 0.055, 1.045), (b, -half + 0.07, 1.06), STEEL, _SURFACE)
        )
        c, d = sorted((x + sign * 0.05, x + sign * 0.065))
        lever.append(
            box_between(f"{name}_lever", (c, -half + 0.055, 1.043), (d, -half + 0.185, 1.062), STEEL, _SURFACE)
        )
    body.links.append(solid_part("leaf", (leaf, *lever), 400.0, "door"))
    origin = (-0.06, half - _GAP, 0.0)
    body.joints.append(
        Joint(
            "leaf_joint",
            JointType.REVOLUTE,
            kind,
            "leaf",
            parent_pose=Pose(origin),
            child_pose=Pose(origin),
            axis=(0.0, 0.0, -1.0),
            lower_limit=0.0,
            upper_limit=1.57,
            damping=1.5,
            friction=0.5,
        )
    )
    turn = Pose.from_matrix(((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    body.frames.append(Frame("leaf_handle", "leaf", Pose((-0.118, -half + 0.12, 1.052)) @ turn))
    return body.finish()


_KINDS: dict[str, Callable[[str, Vector3, Color | None], Furniture]] = {
    "base_drawers": _base_drawers,
    "base_doors": _base_doors,
    "sink": _sink,
    "stove": _stove,
    "fridge": _fridge,
    "wall_cabinet": _wall_cabinet,
    "dining_table": _table,
    "work_table": _table,
    "chair": _chair,
    "sofa": _sofa,
    "coffee_table": _coffee_table,
    "tv_stand": _tv_stand,
    "television": _television,
    "bookshelf": _bookshelf,
    "bed": _bed,
    "nightstand": _nightstand,
    "wardrobe": _wardrobe,
    "desk": _desk,
    "washbasin": _washbasin,
    "toilet": _toilet,
    "bathtub": _bathtub,
    "bin": _bin,
    "door": _door,
}


def furniture_kinds() -> list[str]:
    """Return the names of all kinds of furniture."""
    return list(_KINDS)


@dataclass(frozen=True, kw_only=True)
class FurnitureConfig(ObjectConfig):
    """A static piece of furniture whose drawers and doors move.

    Its frame is on the floor in the middle of its footprint, its front towards -x.
    """

    name: ClassVar[str] = "furniture"
    furniture: str = "base_drawers"
    """Kind; ``orbit scene furniture`` lists all."""
    color: Color | None = None
    """Of its fronts or its cover; None takes the kind's own."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        built = furniture(self.furniture, color=self.color).build(name, pose)
        return replace(built, pose=pose or Pose((0.9, 0.0, 0.0)))

    @property
    def rest_height(self) -> float:
        return 0.0
