"""Things placed by rules on, in and next to what is there, without overlap and within reach of the floor."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import PremiseError
from orbit_core.scene import ObjectSpec, Pose
from orbit_scenes.forms import Cavity
from orbit_scenes.furnish import Piece
from orbit_scenes.furniture import Support
from orbit_scenes.things import Thing, thing

_Array = npt.NDArray[np.float64]
# Metres between two things, of a thing above its support where it is put down, and from a support's edge.
_APART, _ABOVE, _EDGE = 0.012, 0.0005, 0.015
# Places of one support that are tried for one thing.
_TRIES = 60


@dataclass(frozen=True, kw_only=True)
class On:
    """Rule: on top of furniture of a kind, open to all sides: a worktop, a table, an open shelf."""

    furniture: str = ".*"
    """Regular expression over kinds (full match)."""
    support: str = ".*"
    """Regular expression over names of its supports (full match)."""
    reach: float | None = 0.85
    """Metres from the nearest place where a robot can stand; None is anywhere."""


@dataclass(frozen=True, kw_only=True)
class In:
    """Rule: inside of furniture: behind a door, in a drawer, in a bin, or in a vessel that is placed already."""

    furniture: str = ".*"
    """Regular expression over kinds of furniture, or names of vessels of the library (full match)."""
    support: str = ".*"
    """Regular expression over names of its supports (full match)."""
    reach: float | None = 0.95
    """Metres from the nearest place where a robot can stand; None is anywhere."""


@dataclass(frozen=True, kw_only=True)
class Beside:
    """Rule: on the same support as another thing, next to it."""

    thing: str
    """Regular expression over names of things of the library (full match)."""
    distance: float = 0.25
    """Most metres between the two outlines."""


Rule = On | In | Beside


@dataclass(frozen=True, eq=False)
class PlacedThing:
    """A thing of the library in its place."""

    name: str
    """Name in the scene: that of the library, numbered where there are several."""
    thing: Thing
    """Form, mass and surface, from the library."""
    pose: Pose
    """Of its frame."""
    support: str
    """What it stands on or in, as ``object.support``."""
    yaw: float = 0.0
    """Rotation about z in the frame of its support, rad."""

    def build(self) -> ObjectSpec:
        """Build the object."""
        return self.thing.build(self.name, self.pose)


@dataclass(frozen=True, eq=False)
class _Place:
    """A support in the house: its pose, its extent and what stands on it so far."""

    owner: str
    kind: str
    support: Support
    pose: Pose
    placed: list[PlacedThing] = field(default_factory=list)
    cavity: Cavity | None = None
    """The space of a vessel, whose walls may slant."""

    @property
    def name(self) -> str:
        return f"{self.owner}.{self.support.name}"

    @property
    def closed(self) -> bool:
        return bool(self.support.joint) or self.support.walled


class Placer:
    """Places things in a house one after another.

    Args:
        pieces: furniture, in place.
        floor: middles (M, 2) of the cells of the floor where a robot can stand, m.
        random: generator that all choices are drawn from.
    """

    def __init__(self, pieces: Sequence[Piece], floor: _Array, random: np.random.Generator) -> None:
        self._places = [
            _Place(piece.name, piece.furniture.kind, support, piece.support_pose(support))
            for piece in pieces
            for support in piece.furniture.supports
        ]
        # What stands on a piece of furniture, as a television does, takes its middle.
        self._blocked = [piece for piece in pieces if piece.z > 0.0]
        self._floor, self._random = floor, random
        self.placed: list[PlacedThing] = []
        """Things that have been placed, in that order."""

    def place(self, name: str, rule: Rule) -> PlacedThing:
        """Place a thing of the library by a rule.

        Raises:
            UnknownNameError: the library has no such thing.
            PremiseError: nothing in the house meets the rule, or it has no room left; names the thing and the rule.
        """
        made = thing(name)
        candidates = list(self._candidates(rule))
        if not candidates:
            raise PremiseError(f"'{name}' is to be placed {told(rule)}, and nothing in the scene meets that")
        # In random order: the first support of a kind would otherwise get everything.
        for index in self._random.permutation(len(candidates)):
            if (found := self._try(made, candidates[index], rule)) is not None:
                return found
        raise PremiseError(
            f"'{name}' is to be placed {told(rule)}, and none of {len(candidates)} places has room for its "
            f"{_size_told(made)} within reach: place fewer things, or allow other places"
        )

    def _candidates(self, rule: Rule) -> Iterator[_Place]:
        for place in self._places:
            match rule:
                case Beside(thing=pattern):
                    if any(re.fullmatch(pattern, other.thing.name) for other in place.placed):
                        yield place
                case On(furniture=kind, support=support):
                    if not place.closed and _matches(place, kind, support):
                        yield place
                case In(furniture=kind, support=support):
                    if place.closed and _matches(place, kind, support):
                        yield place

    def _try(self, made: Thing, place: _Place, rule: Rule) -> PlacedThing | None:
        if made.size[2] > place.support.clearance:
            return None
        for _ in range(_TRIES):
            drawn = self._draw_in(made, place.cavity) if place.cavity else self._draw(made, place, rule)
            if drawn is None:
                continue
            x, y, yaw, lift = drawn
            local = Pose.from_euler(0.0, 0.0, yaw, (x, y, made.rest_height + _ABOVE + lift))
            pose = place.pose @ local
            # The cheap test comes first; most draws fail by reach or by overlap.
            if not self._reached(pose, rule) or self._overlaps(made, place, x, y, yaw, pose):
                continue
            return self._put(made, place, pose, yaw)
        return None

    def _draw_in(self, made: Thing, cavity: Cavity) -> tuple[float, float, float, float] | None:
        """Draw a place (x, y, yaw, height above the floor) in a vessel; None where its walls leave no room."""
        angle, yaw = self._random.uniform(0.0, math.tau, 2)
        x, y, _ = made.size
        # What is as wide as deep is taken for round.
        radius = x / 2 if math.isclose(x, y, rel_tol=0.02) else math.hypot(x, y) / 2
        # Off the middle only where the floor is level: a slanted wall would slide it back.
        away = float(self._random.uniform(0.0, max(cavity.profile[0][1] - radius - 0.002, 0.0)))
        lift = cavity.lift(away + radius + 0.002)
        return None if lift is None else (away * math.cos(angle), away * math.sin(angle), float(yaw), lift)

    def _draw(self, made: Thing, place: _Place, rule: Rule) -> tuple[float, float, float, float] | None:
        """Draw a place (x, y, yaw, 0) in the support's frame; None where the thing would hang over its edge."""
        # Along the furniture's own axes, give or take: people put things down so.
        quarter = int(self._random.integers(4)) * math.pi / 2
        yaw = quarter + float(self._random.normal(0.0, 0.15))
        half = _extent(made, yaw) / 2
        room = np.array(place.support.size) / 2 - half - (0.003 if place.closed else _EDGE)
        if (room < 0.0).any():
            return None
        if isinstance(rule, Beside):
            others = [other for other in place.placed if re.fullmatch(rule.thing, other.thing.name)]
            other = others[int(self._random.integers(len(others)))]
            middle = place.pose.inverse().transform(other.pose.position)[:2]
            away = math.hypot(*other.thing.size[:2]) / 2 + math.hypot(*made.size[:2]) / 2
            angle, gap = self._random.uniform(0.0, math.tau), self._random.uniform(0.0, rule.distance)
            # Half of both diagonals overstates round and square outlines; what overlaps is drawn again.
            spot = middle + (0.75 * away + gap) * np.array((math.cos(angle), math.sin(angle)))
            if (np.abs(spot) > room).any():
                return None
        else:
            spot = self._random.uniform(-room, room)
        return float(spot[0]), float(spot[1]), yaw, 0.0

    def _reached(self, pose: Pose, rule: Rule) -> bool:
        reach = getattr(rule, "reach", None)
        return reach is None or self.distance_from_floor(pose) <= reach

    def distance_from_floor(self, pose: Pose) -> float:
        """Return the horizontal metres from a pose to the nearest place where a robot can stand; infinite without."""
        if not len(self._floor):
            return math.inf
        return float(np.linalg.norm(self._floor - np.asarray(pose.position[:2]), axis=1).min())

    def _overlaps(self, made: Thing, place: _Place, x: float, y: float, yaw: float, pose: Pose) -> bool:
        inverse = place.pose.inverse()
        own = _outline(made, (x, y), yaw, _APART / 2)
        for other in place.placed:
            local = inverse.transform(other.pose.position)
            if _share(own, _outline(other.thing, (local[0], local[1]), other.yaw, _APART / 2)):
                return True
        return any(
            piece.z > 0.0
            and abs(piece.z - (pose.position[2] - made.rest_height)) < 0.01
            and _share(_outline(made, pose.position[:2], _yaw(pose), 0.0), _corners_of(piece))
            for piece in self._blocked
        )

    def _put(self, made: Thing, place: _Place, pose: Pose, yaw: float) -> PlacedThing:
        number = sum(other.thing.name == made.name for other in self.placed) + 1
        name = made.name if number == 1 else f"{made.name}_{number}"
        found = PlacedThing(name, made, pose, place.name, yaw)
        place.placed.append(found)
        self.placed.append(found)
        if made.cavity is not None:
            radius = made.cavity.profile[-1][1]
            floor = Pose((*made.cavity.axis, made.cavity.floor - made.rest_height))
            # A vessel that stands is a place for other things from then on.
            inside = Support(
                name="inside",
                link=made.name,
                pose=floor,
                size=(2.0 * radius, 2.0 * radius),
                clearance=2.0 * made.cavity.rim,
                walled=True,
            )
            self._places.append(_Place(name, made.name, inside, pose @ floor, cavity=made.cavity))
        return found


def told(rule: Rule) -> str:
    """Return a rule in words."""
    match rule:
        case Beside(thing=other):
            return f"beside '{other}'"
        case On(furniture=kind, support=support):
            return f"on '{kind}.{support}'"
        case In(furniture=kind, support=support):
            return f"in '{kind}.{support}'"


def _matches(place: _Place, kind: str, support: str) -> bool:
    return re.fullmatch(kind, place.kind) is not None and re.fullmatch(support, place.support.name) is not None


def _size_told(made: Thing) -> str:
    return " x ".join(f"{length:.2f}" for length in made.size) + " m"


def _extent(made: Thing, yaw: float) -> _Array:
    """Return the extent (2,) along the axes of a thing that is turned by ``yaw``."""
    # The box around a turned rectangle: projections of both of its sides.
    c, s = abs(math.cos(yaw)), abs(math.sin(yaw))
    x, y, _ = made.size
    return np.array((c * x + s * y, s * x + c * y))


def _outline(made: Thing, middle: Sequence[float], yaw: float, margin: float) -> _Array:
    """Return the corners (4, 2) of a thing's footprint, grown by a margin."""
    x, y = made.size[0] / 2 + margin, made.size[1] / 2 + margin
    corners = np.array(((-x, -y), (x, -y), (x, y), (-x, y)))
    c, s = math.cos(yaw), math.sin(yaw)
    return corners @ np.array(((c, s), (-s, c))) + np.asarray(middle[:2])


def _corners_of(piece: Piece) -> _Array:
    r = piece.rectangle
    return np.array(((r.x0, r.y0), (r.x1, r.y0), (r.x1, r.y1), (r.x0, r.y1)))


def _share(first: _Array, second: _Array) -> bool:
    """Return True if two convex outlines (4, 2) share an area: no side of either separates them."""
    for outline in (first, second):
        sides = np.roll(outline, -1, axis=0) - outline
        normals = np.stack((sides[:, 1], -sides[:, 0]), 1)
        a, b = first @ normals.T, second @ normals.T
        if ((a.max(0) <= b.min(0)) | (b.max(0) <= a.min(0))).any():
            return False
    return True


def _yaw(pose: Pose) -> float:
    rotation = pose.rotation_matrix()
    return math.atan2(rotation[1, 0], rotation[0, 0])
