"""Floor plans: a rectangle split into rooms, walls between them, doors that join all rooms, and windows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.scene import Box, Color, PhysicsMaterial, Pose, Shape
from orbit_scenes.furniture import measured

# Metres. The least side of a room lets a robot of 0.4 m radius pass a bed or a row of cupboards with a table in front.
_LEAST_SIDE, _THICKNESS, _HEIGHT = 2.7, 0.12, 2.5
# Metres from a door's leaf to the corner of its room, and jamb and air around its leaf.
_CORNER, _JAMB = 0.18, 0.045
# Metres: width, sill and head of windows.
_WINDOW, _SILL, _HEAD = 1.2, 1.05, 2.1
# Share of the pairs of neighbours beyond those needed that get a door.
_MORE_DOORS = 0.2
_PAINT: Color = (0.93, 0.92, 0.89, 1.0)
_GLASS: Color = (0.75, 0.87, 0.95, 0.25)


class RoomKind(Enum):
    """Use of a room."""

    KITCHEN = "kitchen"
    """A row of cupboards with fridge, sink and stove, and a table with chairs."""
    LIVING = "living"
    """A sofa opposite a television, bookshelves, and a table with chairs where there is space."""
    BEDROOM = "bedroom"
    """A bed between nightstands, a wardrobe and a bookshelf."""
    BATHROOM = "bathroom"
    """A bathtub, a washbasin and a toilet."""
    STUDY = "study"
    """A desk with a chair, and bookshelves."""


FLOORS: dict[RoomKind, Color] = {
    RoomKind.KITCHEN: (0.72, 0.70, 0.66, 1.0),
    RoomKind.LIVING: (0.66, 0.50, 0.34, 1.0),
    RoomKind.BEDROOM: (0.60, 0.47, 0.35, 1.0),
    RoomKind.BATHROOM: (0.62, 0.69, 0.72, 1.0),
    RoomKind.STUDY: (0.56, 0.43, 0.31, 1.0),
}
"""Colours of floors."""
# m^2 that a room of the kind has on average, by which the plan is made as large as its rooms need.
_AREA = {
    RoomKind.KITCHEN: 16.0,
    RoomKind.LIVING: 22.0,
    RoomKind.BEDROOM: 16.0,
    RoomKind.BATHROOM: 9.0,
    RoomKind.STUDY: 12.0,
}


@dataclass(frozen=True)
class Rectangle:
    """A rectangle along the axes, m."""

    x0: float
    """Least x."""
    y0: float
    """Least y."""
    x1: float
    """Largest x."""
    y1: float
    """Largest y."""

    @property
    def width(self) -> float:
        """Extent along x, m."""
        return self.x1 - self.x0

    @property
    def depth(self) -> float:
        """Extent along y, m."""
        return self.y1 - self.y0

    @property
    def middle(self) -> tuple[float, float]:
        """Middle, m."""
        return (self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2

    def grown(self, margin: float) -> Rectangle:
        """Return it with every side moved outwards by ``margin`` m; a negative one shrinks it."""
        return Rectangle(self.x0 - margin, self.y0 - margin, self.x1 + margin, self.y1 + margin)

    def meets(self, other: Rectangle) -> bool:
        """Return True if the two share an area."""
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def holds(self, other: Rectangle) -> bool:
        """Return True if the other is within it."""
        return self.x0 <= other.x0 and self.y0 <= other.y0 and self.x1 >= other.x1 and self.y1 >= other.y1


@dataclass(frozen=True)
class Opening:
    """A door or a window in a wall."""

    along: float
    """Middle, along the wall, m."""
    width: float
    """Full width, m; a door's includes its jambs."""
    sill: float
    """Height of the lower edge above the floor, m; 0 for a door."""
    head: float
    """Height of the upper edge above the floor, m."""
    rooms: tuple[int, ...]
    """Rooms that a door joins, one for the entrance; none for a window."""

    @property
    def is_door(self) -> bool:
        """True if one can walk through."""
        return bool(self.rooms)


@dataclass(frozen=True)
class Wall:
    """A straight wall along x or y."""

    vertical: bool
    """True if it runs along y."""
    at: float
    """Its x where it runs along y, else its y; of its middle, m."""
    start: float
    """Lower end of its middle line, along the wall, m."""
    end: float
    """Upper end of its middle line, along the wall, m."""
    rooms: tuple[int, ...]
    """Rooms on its sides, one for an outer wall."""
    openings: tuple[Opening, ...] = ()
    """Doors and windows, in order along the wall."""

    def place(self, along: float) -> tuple[float, float]:
        """Return x and y of a point of its middle line."""
        return (self.at, along) if self.vertical else (along, self.at)


@dataclass(frozen=True)
class Room:
    """A room: its use and its floor between the middles of its walls."""

    kind: RoomKind
    """Use, by which it is furnished."""
    floor: Rectangle
    """Bounded by the middles of its walls, which neighbours share."""
    name: str
    """Kind, numbered where the plan has several of it."""

    @property
    def inside(self) -> Rectangle:
        """The floor between its walls' faces."""
        return self.floor.grown(-_THICKNESS / 2)


@dataclass(frozen=True)
class Plan:
    """A floor plan around the origin."""

    rooms: tuple[Room, ...]
    """In the order in which their kinds were given; the first has the entrance."""
    walls: tuple[Wall, ...]
    """Those between neighbours, and the outer ones, one for each room's side."""
    bounds: Rectangle
    """Bounded by the middles of the outer walls."""

    def doors(self) -> Iterator[tuple[Wall, Opening]]:
        """Yield all doors with the walls that they are in."""
        for wall in self.walls:
            for opening in wall.openings:
                if opening.is_door:
                    yield wall, opening

    def shapes(self) -> tuple[Shape, ...]:
        """Return boxes of all walls, with lintels over doors, and sills and panes of windows."""
        paint = PhysicsMaterial(0.7, 0.7)
        found: list[Shape] = []
        for index, wall in enumerate(self.walls):
            ends = (
                wall.start - _overhang(wall, wall.start, self.walls),
                wall.end + _overhang(wall, wall.end, self.walls),
            )
            for part, (a, b, z0, z1, color, thickness) in enumerate(_wall_parts(wall, *ends)):
                x, y = wall.place((a + b) / 2)
                half = (thickness / 2, (b - a) / 2) if wall.vertical else ((b - a) / 2, thickness / 2)
                place = Pose((x, y, (z0 + z1) / 2))
                box = Box((*half, (z1 - z0) / 2))
                found.append(Shape(box, place, paint, color, f"wall_{index}_{part}"))
        return tuple(found)


def make_plan(kinds: Sequence[RoomKind], random: np.random.Generator) -> Plan:
    """Split a rectangle into one room of each of the kinds, and join them by doors.

    Args:
        kinds: uses of the rooms; the first has the entrance.
        random: generator that all choices are drawn from.

    Raises:
        ConfigurationError: there is no room, or more than 12.
    """
    if not 1 <= len(kinds) <= 12:
        raise ConfigurationError(f"a house of {len(kinds)} rooms: give 1 to 12")
    # As large as its rooms need together, and a little longer than wide.
    area = sum(_AREA[kind] for kind in kinds)
    width = math.sqrt(area * float(random.uniform(1.0, 1.35)))
    outer = Rectangle(-width / 2, -area / width / 2, width / 2, area / width / 2)
    cells = _split(outer, [_AREA[kind] for kind in kinds], random)
    order = [kind.value for kind in kinds]
    names = [
        kind.value if order.count(kind.value) == 1 else f"{kind.value}_{order[: index + 1].count(kind.value)}"
        for index, kind in enumerate(kinds)
    ]
    rooms = tuple(Room(kind, cell, name) for kind, cell, name in zip(kinds, cells, names, strict=True))
    return Plan(rooms, tuple(_with_openings(_walls(cells, outer), len(cells), random)), outer)


def _split(outer: Rectangle, areas: list[float], random: np.random.Generator) -> list[Rectangle]:
    """Split a rectangle into parts of about these areas, each cut across the longer side."""
    if len(areas) == 1:
        return [outer]
    # The half with fewer square metres on either side is the most even cut, in the order of the rooms.
    sums = np.cumsum(areas) / sum(areas)
    cut = int(np.abs(sums[:-1] - 0.5).argmin()) + 1
    share = float(np.clip(sums[cut - 1] + random.uniform(-0.04, 0.04), 0.25, 0.75))
    length = max(outer.width, outer.depth)
    share = float(np.clip(share, _LEAST_SIDE / length, 1.0 - _LEAST_SIDE / length)) if length > 2 * _LEAST_SIDE else 0.5
    if outer.width >= outer.depth:
        x = outer.x0 + share * outer.width
        first, second = Rectangle(outer.x0, outer.y0, x, outer.y1), Rectangle(x, outer.y0, outer.x1, outer.y1)
    else:
        y = outer.y0 + share * outer.depth
        first, second = Rectangle(outer.x0, outer.y0, outer.x1, y), Rectangle(outer.x0, y, outer.x1, outer.y1)
    return [*_split(first, areas[:cut], random), *_split(second, areas[cut:], random)]


def _walls(cells: list[Rectangle], outer: Rectangle) -> list[Wall]:
    """Return the walls between neighbours, and the outer ones, one for each room's side."""
    found: list[Wall] = []
    # Cuts are computed once and shared, so that sides of neighbours agree to rounding.
    near = 1e-6
    for i, a in enumerate(cells):
        for j, b in enumerate(cells):
            if abs(a.x1 - b.x0) < near:
                low, high = max(a.y0, b.y0), min(a.y1, b.y1)
                if high - low > near:
                    found.append(Wall(True, a.x1, low, high, (i, j)))
            if abs(a.y1 - b.y0) < near:
                low, high = max(a.x0, b.x0), min(a.x1, b.x1)
                if high - low > near:
                    found.append(Wall(False, a.y1, low, high, (i, j)))
        for edge, bound in ((a.x0, outer.x0), (a.x1, outer.x1)):
            if abs(edge - bound) < near:
                found.append(Wall(True, edge, a.y0, a.y1, (i,)))
        for edge, bound in ((a.y0, outer.y0), (a.y1, outer.y1)):
            if abs(edge - bound) < near:
                found.append(Wall(False, edge, a.x0, a.x1, (i,)))
    return found


def _with_openings(walls: list[Wall], rooms: int, random: np.random.Generator) -> Iterator[Wall]:
    """Yield the walls with a door in those of a random spanning tree and in some others, an entrance and windows."""
    width, height = measured("door")[1] + 2 * _JAMB, measured("door")[2] + _JAMB
    wide = width + 2 * (_CORNER + _THICKNESS / 2)
    joinable = [wall for wall in walls if len(wall.rooms) == 2 and wall.end - wall.start >= wide]
    chosen: set[int] = set()
    group = list(range(rooms))
    # Kruskal's algorithm in random order: a wall joins two groups of rooms that no door has joined yet.
    for index in random.permutation(len(joinable)):
        a, b = (group[room] for room in joinable[index].rooms)
        if a != b or random.random() < _MORE_DOORS:
            chosen.add(id(joinable[index]))
            group = [a if each == b else each for each in group]
    if len(set(group)) > 1:
        raise ConfigurationError("two rooms of the plan share no wall that a door fits into: take another seed")
    entrance = next(wall for wall in walls if wall.rooms == (0,) and wall.end - wall.start >= wide)
    for wall in walls:
        low, high = wall.start + wide / 2, wall.end - wide / 2
        if id(wall) in chosen or wall is entrance:
            # Near an end and not in the middle: more of the wall is left for furniture.
            share = float(random.choice((random.uniform(0.0, 0.2), random.uniform(0.8, 1.0))))
            place = low + share * max(high - low, 0.0)
            yield _opened(wall, Opening(place, width, 0.0, height, wall.rooms))
        elif len(wall.rooms) == 1 and wall.end - wall.start >= _WINDOW + 1.0:
            yield _opened(wall, Opening((wall.start + wall.end) / 2, _WINDOW, _SILL, _HEAD, ()))
        else:
            yield wall


def _opened(wall: Wall, opening: Opening) -> Wall:
    return Wall(wall.vertical, wall.at, wall.start, wall.end, wall.rooms, (opening,))


def _overhang(wall: Wall, end: float, walls: Sequence[Wall]) -> float:
    """Return the metres by which a wall's box goes beyond the end of its middle line; negative where it stops short.

    No two boxes overlap, for renderers draw shared faces flickering: walls along y pass through where walls cross.
    """
    x, y = wall.place(end)
    through = {}
    for vertical in (True, False):
        along, across = (y, x) if vertical else (x, y)
        lines = [each for each in walls if each.vertical is vertical and abs(each.at - across) < 1e-6]
        touching = [each for each in lines if each.start - 1e-6 <= along <= each.end + 1e-6]
        inner = any(each.start + 1e-6 < along < each.end - 1e-6 for each in touching)
        through[vertical] = (bool(touching), inner or len(touching) > 1)
    (own_there, own_through), (other_there, other_through) = through[wall.vertical], through[not wall.vertical]
    assert own_there  # the wall itself
    half = _THICKNESS / 2
    if not other_there or (own_through and (wall.vertical or not other_through)):
        return 0.0
    return half if wall.vertical and not other_through else -half


def _wall_parts(wall: Wall, start: float, end: float) -> Iterator[tuple[float, float, float, float, Color, float]]:
    """Yield (start, end, lowest, highest, colour, thickness) of the boxes of a wall between two ends."""
    for opening in wall.openings:
        low, high = opening.along - opening.width / 2, opening.along + opening.width / 2
        yield start, low, 0.0, _HEIGHT, _PAINT, _THICKNESS
        yield low, high, opening.head, _HEIGHT, _PAINT, _THICKNESS
        if opening.sill > 0.0:
            yield low, high, 0.0, opening.sill, _PAINT, _THICKNESS
            yield low, high, opening.sill, opening.head, _GLASS, 0.02
        start = high
    yield start, end, 0.0, _HEIGHT, _PAINT, _THICKNESS
