"""Furniture in rooms: against walls, next to and in front of each other, with free ways between all doors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from orbit_core.scene import Color, ObjectSpec, Pose
from orbit_scenes.furniture import FABRICS, FRONTS, OAK, WALNUT, Furniture, Support, furniture
from orbit_scenes.plan import Plan, Rectangle, Room, RoomKind

_Array = npt.NDArray[np.float64]
# Metres: places along a wall that are tried, cells of the map of free floor, gap to the wall, and the depth of the
# floor that stays free on both sides of a door: its leaf swings there.
_STEP, _CELL, _BEHIND, _DOOR_ROOM = 0.05, 0.05, 0.01, 0.95
WALKER = 0.28
"""Radius (m) of the disc that can get from door to door, that of a slim person or a mobile robot."""
# Yaw of a piece with its back to each wall, and the direction from the room to that wall.
_WALLS = ((0.0, (1.0, 0.0)), (math.pi, (-1.0, 0.0)), (math.pi / 2, (0.0, 1.0)), (-math.pi / 2, (0.0, -1.0)))


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece of furniture in its place."""

    name: str
    """Room and kind, such as ``kitchen_chair_2``; in scenes without rooms the kind."""
    furniture: Furniture
    """Kind, links and supports, without a place."""
    x: float
    """Middle of its box, m."""
    y: float
    """Middle of its box, m."""
    yaw: float
    """rad; a multiple of a quarter turn where it stands against a wall."""
    room: int
    """Place of its room among those of the plan."""
    z: float = 0.0
    """Height of its frame, m; above 0 for what stands on another piece, as a television does."""

    @property
    def pose(self) -> Pose:
        """Pose of its frame."""
        return Pose.from_euler(0.0, 0.0, self.yaw, (self.x, self.y, self.z))

    @property
    def rectangle(self) -> Rectangle:
        """The floor that it covers."""
        return self._covered(-self.furniture.size[0] / 2)

    @property
    def with_front(self) -> Rectangle:
        """The floor that it covers, and that in front of it that is to stay free."""
        return self._covered(-self.furniture.size[0] / 2 - self.furniture.front)

    def _covered(self, front: float) -> Rectangle:
        depth, width, _ = self.furniture.size
        corners = self.pose.transform(((front, -width / 2, 0.0), (depth / 2, width / 2, 0.0)))
        low, high = corners.min(0), corners.max(0)
        return Rectangle(float(low[0]), float(low[1]), float(high[0]), float(high[1]))

    def support_pose(self, support: Support) -> Pose:
        """Return the pose of the middle of one of its supports, with all joints shut."""
        return self.pose @ support.pose

    def build(self) -> ObjectSpec:
        """Build the object."""
        return self.furniture.build(self.name, self.pose)


@dataclass
class RoomLayout:
    """Furniture of one room while it is placed."""

    plan: Plan
    """Floor plan of the whole house."""
    index: int
    """Place of the room among those of the plan."""
    random: np.random.Generator
    """Generator that all choices are drawn from."""
    pieces: list[Piece] = field(default_factory=list)
    """Pieces on the floor, in the order in which they were placed."""
    hung: list[Piece] = field(default_factory=list)
    """Pieces on the walls, above the others."""

    def __post_init__(self) -> None:
        self.room: Room = self.plan.rooms[self.index]
        self.doors = [
            _around_door(wall.place(opening.along), wall.vertical, opening.width)
            for wall, opening in self.plan.doors()
            if self.index in opening.rooms
        ]
        self.windows = [
            Rectangle(x - 0.7, y - 0.7, x + 0.7, y + 0.7)
            for wall in self.plan.walls
            for opening in wall.openings
            if not opening.is_door and self.index in wall.rooms
            for x, y in (wall.place(opening.along),)
        ]

    def against_wall(
        self, kind: str, color: Color | None = None, prefer: Callable[[Piece], float] | None = None
    ) -> Piece | None:
        """Stand a piece with its back to a wall; return it, or None where there is no room.

        Args:
            kind: of the furniture.
            color: of its fronts or cover.
            prefer: cost of a place; the least is taken, and a random one without it.
        """
        made = furniture(kind, color=color)
        places = list(self._wall_places(kind, made))
        order = self.random.permutation(len(places))
        if prefer is not None:
            order = sorted(order, key=lambda number: prefer(places[number]))
        return self._first(places[number] for number in order)

    def next_to(self, kind: str, other: Piece, color: Color | None = None, gap: float = 0.0) -> Piece | None:
        """Stand a piece at one side of another, backs in line; return it, or None where there is no room."""
        made = furniture(kind, color=color)
        sides = self.random.permutation((1.0, -1.0))
        aside = (other.furniture.size[1] + made.size[1]) / 2 + gap
        # Backs in line, for both stand against one wall.
        back = (other.furniture.size[0] - made.size[0]) / 2
        return self._first(self._relative(kind, made, other, back, side * aside, 0.0) for side in sides)

    def in_front(self, kind: str, other: Piece, gap: float, turn: float = 0.0) -> Piece | None:
        """Stand a piece in front of another; return it, or None where there is no room."""
        made = furniture(kind)
        ahead = -(other.furniture.size[0] + made.size[0]) / 2 - gap
        return self._first([self._relative(kind, made, other, ahead, 0.0, turn)])

    def upon(self, kind: str, other: Piece) -> Piece:
        """Stand a piece on top of another."""
        x, y = other.x, other.y
        piece = Piece(self._name(kind), furniture(kind), x, y, other.yaw, self.index, other.furniture.size[2])
        self.hung.append(piece)
        return piece

    def in_the_middle(self, kind: str, color: Color | None = None) -> Piece | None:
        """Stand a piece free in the room, as near to its middle as it fits; return it, or None."""
        made, inside = furniture(kind, color=color), self.room.inside
        cx, cy = inside.middle
        # Along the longer side of the room, the other way only where that does not fit.
        turn = 0.0 if inside.depth >= inside.width else math.pi / 2
        xs, ys = np.arange(inside.x0, inside.x1, 0.15), np.arange(inside.y0, inside.y1, 0.15)
        spots = sorted(((x, y) for x in xs for y in ys), key=lambda spot: math.hypot(spot[0] - cx, spot[1] - cy))
        name = self._name(kind)
        return self._first(
            Piece(name, made, float(x), float(y), yaw, self.index)
            for x, y in spots[:200]
            for yaw in (turn, turn + math.pi / 2)
        )

    def around(self, kind: str, table: Piece, count: int) -> list[Piece]:
        """Stand up to ``count`` pieces around a table, their fronts to it."""
        made = furniture(kind)
        depth, width, _ = table.furniture.size
        # Pushed in by 12 cm, as chairs stand that nobody sits on.
        beyond = made.size[0] / 2 - 0.12
        spots = [
            (side * (depth / 2 + beyond), place * width / 4, 0.0 if side > 0 else math.pi)
            for side in (1.0, -1.0)
            for place in (1.0, -1.0)
        ]
        placed = []
        for x, y, turn in spots[:count]:
            piece = self._relative(kind, made, table, x, y, turn)
            # A chair stands partly under its table: the two may share floor.
            if self._fits(piece, apart=[table]):
                self.pieces.append(piece)
                placed.append(piece)
        return placed

    def hang(self, kind: str, below: Piece, color: Color | None = None) -> Piece | None:
        """Hang a piece on the wall above another, unless a window is there; return it, or None."""
        made = furniture(kind, color=color)
        back = (below.furniture.size[0] - made.size[0]) / 2
        piece = self._relative(kind, made, below, back, 0.0, 0.0)
        taken = any(piece.rectangle.grown(-0.005).meets(other.rectangle) for other in self.hung)
        # A fridge is as high as the cabinet hangs: the two would meet.
        tall = [other for other in self.pieces if other.furniture.size[2] > made.bottom]
        high = any(piece.rectangle.grown(-0.005).meets(other.rectangle) for other in tall)
        inside = self.room.inside.grown(1e-6).holds(piece.rectangle)
        blocked = any(piece.rectangle.meets(each) for each in (*self.windows, *self.doors))
        if taken or high or blocked or not inside:
            return None
        self.hung.append(piece)
        return piece

    def free_floor(self) -> tuple[_Array, npt.NDArray[np.bool_]]:
        """Return the middles (M, 2) of cells of the floor, and which of them a walker from a door can stand on (M,)."""
        return _free_floor(self.room.inside, [piece.rectangle for piece in self.pieces], self.doors)

    def _relative(self, kind: str, made: Furniture, other: Piece, x: float, y: float, turn: float) -> Piece:
        place = other.pose @ Pose((x, y, -other.z))
        return Piece(self._name(kind), made, place.position[0], place.position[1], other.yaw + turn, self.index)

    def _wall_places(self, kind: str, made: Furniture) -> Iterator[Piece]:
        inside, name = self.room.inside, self._name(kind)
        depth, width, _ = made.size
        for yaw, (dx, dy) in _WALLS:
            low, high = (inside.y0, inside.y1) if dx else (inside.x0, inside.x1)
            for along in np.arange(low + width / 2 + _BEHIND, high - width / 2 - _BEHIND + 1e-9, _STEP):
                wall = (inside.x1 if dx > 0 else inside.x0) if dx else (inside.y1 if dy > 0 else inside.y0)
                back = wall - (dx + dy) * (depth / 2 + _BEHIND)
                x, y = (back, float(along)) if dx else (float(along), back)
                yield Piece(name, made, x, y, yaw, self.index)

    def _first(self, places: Iterator[Piece] | Sequence[Piece]) -> Piece | None:
        for piece in places:
            if self._fits(piece):
                self.pieces.append(piece)
                return piece
        return None

    def _fits(self, piece: Piece, apart: Sequence[Piece] = ()) -> bool:
        """Return True if a piece covers free floor and leaves fronts, doors and windows free and all doors joined."""
        body = piece.rectangle.grown(-0.002)
        others = [other for other in self.pieces if other not in apart]
        if not self.room.inside.holds(body) or any(body.meets(door) for door in self.doors):
            return False
        if any(
            body.meets(other.with_front) or piece.with_front.grown(-0.002).meets(other.rectangle) for other in others
        ):
            return False
        # A front may reach to the opposite wall, but not beyond it.
        if not self.room.inside.holds(piece.with_front.grown(-0.05)):
            return False
        if piece.furniture.size[2] > 1.0 and any(body.meets(window) for window in self.windows):
            return False
        # The costly test comes last.
        rectangles = [other.rectangle for other in (*self.pieces, piece)]
        return _joined(self.room.inside, rectangles, self.doors)

    def _name(self, kind: str) -> str:
        base = f"{self.room.name}_{kind}"
        number = sum(piece.furniture.kind == kind for piece in (*self.pieces, *self.hung)) + 1
        return base if number == 1 else f"{base}_{number}"


def _around_door(place: tuple[float, float], vertical: bool, width: float) -> Rectangle:
    x, y = place
    half = width / 2
    across, along = (_DOOR_ROOM, half) if vertical else (half, _DOOR_ROOM)
    return Rectangle(x - across, y - along, x + across, y + along)


def _free_floor(
    inside: Rectangle, taken: list[Rectangle], doors: list[Rectangle]
) -> tuple[_Array, npt.NDArray[np.bool_]]:
    labels, points, starts = _regions(inside, taken, doors)
    reached = np.isin(labels, [label for label in starts if label > 0]) if doors else labels > 0
    return points, reached.ravel()


def _joined(inside: Rectangle, taken: list[Rectangle], doors: list[Rectangle]) -> bool:
    """Return True if a walker gets from each door to every other."""
    _, _, starts = _regions(inside, taken, doors)
    return not starts or (min(starts) > 0 and len(set(starts)) == 1)


def _regions(
    inside: Rectangle, taken: list[Rectangle], doors: list[Rectangle]
) -> tuple[npt.NDArray[np.int32], _Array, list[int]]:
    """Return connected regions of cells that a walker can stand on, the cells' middles, and each door's region."""
    from scipy import ndimage

    xs = np.arange(inside.x0 + _CELL / 2, inside.x1, _CELL)
    ys = np.arange(inside.y0 + _CELL / 2, inside.y1, _CELL)
    x, y = np.meshgrid(xs, ys, indexing="ij")
    gap = np.minimum.reduce((x - inside.x0, inside.x1 - x, y - inside.y0, inside.y1 - y))
    # In a doorway the walls end: a walker stands there as it does within the room.
    for door in doors:
        within = (x > door.x0 + WALKER) & (x < door.x1 - WALKER) | (y > door.y0 + WALKER) & (y < door.y1 - WALKER)
        gap = np.where(within & (x > door.x0) & (x < door.x1) & (y > door.y0) & (y < door.y1), np.inf, gap)
    free = gap >= WALKER
    for each in taken:
        dx = np.maximum(np.maximum(each.x0 - x, x - each.x1), 0.0)
        dy = np.maximum(np.maximum(each.y0 - y, y - each.y1), 0.0)
        free &= np.hypot(dx, dy) >= WALKER
    # Four neighbours: a walker does not squeeze through corners.
    labels, _ = ndimage.label(free)  # pyright: ignore[reportGeneralTypeIssues]
    starts = []
    for door in doors:
        cx, cy = door.middle
        nearest = np.where(free & (np.hypot(x - cx, y - cy) < 0.6), np.hypot(x - cx, y - cy), np.inf)
        at = np.unravel_index(int(nearest.argmin()), free.shape)
        starts.append(int(labels[at]) if np.isfinite(nearest[at]) else 0)
    return np.asarray(labels, dtype=np.int32), np.stack((x.ravel(), y.ravel()), 1), starts


# Programmes of rooms --------------------------------------------------------------------------------------------------


def furnished(plan: Plan, index: int, random: np.random.Generator) -> RoomLayout:
    """Furnish a room of a plan as its use wants; what does not fit is left out."""
    layout = RoomLayout(plan, index, random)
    _PROGRAMMES[layout.room.kind](layout)
    return layout


def _kitchen(layout: RoomLayout) -> None:
    color = FRONTS[int(layout.random.integers(len(FRONTS)))]
    row: list[Piece] = []
    for kind in ("fridge", "base_drawers", "sink", "stove", "base_doors", "base_drawers"):
        own = None if kind in ("fridge", "stove") else color
        placed = next((piece for last in reversed(row) if (piece := layout.next_to(kind, last, own))), None)
        placed = placed or layout.against_wall(kind, own, prefer=_corner(layout.room.inside))
        row += [placed] if placed else []
    # Not over the fridge, which is too high, nor over the stove, which needs the air.
    for below in row:
        if below.furniture.kind in ("base_drawers", "base_doors", "sink"):
            layout.hang("wall_cabinet", below, color)
    table = layout.in_the_middle("dining_table", OAK)
    if table is not None:
        layout.around("chair", table, 4)
    layout.against_wall("bin")


def _living(layout: RoomLayout) -> None:
    fabric = FABRICS[int(layout.random.integers(len(FABRICS)))]
    inside = layout.room.inside
    sofa = layout.against_wall("sofa", fabric, prefer=_middle_of_wall(inside, layout.random))
    if sofa is not None:
        layout.in_front("coffee_table", sofa, 0.5)
    stand = layout.against_wall("tv_stand", WALNUT, prefer=None if sofa is None else _opposite(sofa))
    if stand is not None:
        layout.upon("television", stand)
    layout.against_wall("bookshelf", WALNUT, prefer=_corner(inside))
    layout.against_wall("bookshelf", WALNUT, prefer=_corner(inside))
    if inside.width * inside.depth > 20.0:
        table = layout.in_the_middle("dining_table", WALNUT)
        if table is not None:
            layout.around("chair", table, 4)


def _bedroom(layout: RoomLayout) -> None:
    fabric = FABRICS[int(layout.random.integers(len(FABRICS)))]
    bed = layout.against_wall("bed", fabric, prefer=_middle_of_wall(layout.room.inside, layout.random))
    if bed is not None:
        layout.next_to("nightstand", bed, gap=0.03)
        layout.next_to("nightstand", bed, gap=0.03)
    layout.against_wall("wardrobe", prefer=_corner(layout.room.inside))
    layout.against_wall("bookshelf", OAK, prefer=_corner(layout.room.inside))


def _bathroom(layout: RoomLayout) -> None:
    layout.against_wall("bathtub", prefer=_corner(layout.room.inside))
    layout.against_wall("washbasin")
    layout.against_wall("toilet")


def _study(layout: RoomLayout) -> None:
    desk = layout.against_wall("desk", OAK, prefer=_middle_of_wall(layout.room.inside, layout.random))
    if desk is not None:
        chair = layout._relative("chair", furniture("chair"), desk, -0.52, 0.15, math.pi)
        if layout._fits(chair, apart=[desk]):
            layout.pieces.append(chair)
    for _ in range(2):
        layout.against_wall("bookshelf", OAK, prefer=_corner(layout.room.inside))
    layout.against_wall("bin")


_PROGRAMMES: dict[RoomKind, Callable[[RoomLayout], None]] = {
    RoomKind.KITCHEN: _kitchen,
    RoomKind.LIVING: _living,
    RoomKind.BEDROOM: _bedroom,
    RoomKind.BATHROOM: _bathroom,
    RoomKind.STUDY: _study,
}


def _corner(inside: Rectangle) -> Callable[[Piece], float]:
    """Return the distance of a piece to the nearest corner of the room."""

    def cost(piece: Piece) -> float:
        r = piece.rectangle
        return min(r.x0 - inside.x0, inside.x1 - r.x1) + min(r.y0 - inside.y0, inside.y1 - r.y1)

    return cost


def _middle_of_wall(inside: Rectangle, random: np.random.Generator) -> Callable[[Piece], float]:
    """Return the distance of a piece from the middle of its wall, walls in a random order of preference."""
    bias = random.uniform(0.0, 0.8, 4)
    cx, cy = inside.middle

    def cost(piece: Piece) -> float:
        wall = int(np.argmin([abs(math.remainder(piece.yaw - yaw, math.tau)) for yaw, _ in _WALLS]))
        off = abs(piece.y - cy) if abs(math.cos(piece.yaw)) > 0.5 else abs(piece.x - cx)
        return off + float(bias[wall])

    return cost


def _opposite(other: Piece) -> Callable[[Piece], float]:
    """Return the cost of a place that does not face a piece."""
    ahead = np.array((-math.cos(other.yaw), -math.sin(other.yaw)))

    def cost(piece: Piece) -> float:
        facing = abs(math.remainder(piece.yaw - other.yaw - math.pi, math.tau))
        aside = np.array((piece.x - other.x, piece.y - other.y))
        return 3.0 * facing + float(np.linalg.norm(aside - (aside @ ahead) * ahead))

    return cost
