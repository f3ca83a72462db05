"""Scenes made by seed: houses of several rooms, single rooms, cluttered tables and bins."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import ConfigurationError, PremiseError, UnknownNameError
from orbit_core.scene import (
    AmbientLight,
    Articulation,
    Box,
    DirectionalLight,
    Link,
    ObjectSpec,
    Pose,
    Scene,
    Shape,
)
from orbit_scenes.furnish import Piece, RoomLayout, furnished
from orbit_scenes.furniture import furniture
from orbit_scenes.placing import Beside, In, On, PlacedThing, Placer, Rule
from orbit_scenes.plan import FLOORS, Plan, RoomKind, make_plan

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Usual:
    """A thing that is usual in rooms of a kind, and where it is put."""

    thing: str
    """Name in the library of things."""
    rule: Rule
    """Rule by which the thing is placed."""


_TABLES = "dining_table|coffee_table"
_COUNTER = "base_drawers|base_doors"
_BASE = r"drawer_\d"
# In the order in which a room gets them; what finds no place is left out, and a longer list starts over.
USUAL: Mapping[RoomKind, tuple[Usual, ...]] = {
    RoomKind.KITCHEN: (
        Usual(thing="plate", rule=On(furniture="dining_table")),
        Usual(thing="mug", rule=On(furniture=_COUNTER)),
        Usual(thing="bowl", rule=On(furniture="dining_table|" + _COUNTER)),
        Usual(thing="apple", rule=In(furniture="bowl")),
        Usual(thing="fork", rule=Beside(thing="plate")),
        Usual(thing="knife", rule=Beside(thing="plate")),
        Usual(thing="glass", rule=Beside(thing="plate")),
        Usual(thing="cooking_pot", rule=On(furniture="stove")),
        Usual(thing="spoon", rule=In(furniture="base_drawers", support=_BASE)),
        Usual(thing="spatula", rule=In(furniture="base_drawers", support=_BASE)),
        Usual(thing="milk_carton", rule=In(furniture="fridge", support=r"shelf_\d")),
        Usual(thing="mustard_bottle", rule=In(furniture="fridge", support=r"shelf_\d")),
        Usual(thing="cracker_box", rule=On(furniture=_COUNTER)),
        Usual(thing="sponge", rule=In(furniture="sink")),
        Usual(thing="saucer", rule=In(furniture="wall_cabinet", reach=1.1)),
        Usual(thing="soup_can", rule=In(furniture="base_doors")),
        Usual(thing="cutting_board", rule=On(furniture=_COUNTER)),
        Usual(thing="salt_shaker", rule=On(furniture="dining_table")),
        Usual(thing="water_bottle", rule=On(furniture=_COUNTER)),
        Usual(thing="banana", rule=On(furniture="dining_table|" + _COUNTER)),
        Usual(thing="skillet", rule=On(furniture="stove")),
        Usual(thing="jam_jar", rule=In(furniture="fridge", support=r"shelf_\d")),
    ),
    RoomKind.LIVING: (
        Usual(thing="remote_control", rule=On(furniture="coffee_table")),
        Usual(thing="mug", rule=On(furniture=_TABLES)),
        Usual(thing="book", rule=On(furniture="bookshelf")),
        Usual(thing="vase", rule=On(furniture="tv_stand|bookshelf|dining_table")),
        Usual(thing="tissue_box", rule=On(furniture="coffee_table|sofa")),
        Usual(thing="wine_glass", rule=On(furniture=_TABLES)),
        Usual(thing="wine_bottle", rule=Beside(thing="wine_glass", distance=0.3)),
        Usual(thing="candle", rule=On(furniture=_TABLES + "|bookshelf")),
        Usual(thing="flower_pot", rule=On(furniture="bookshelf|tv_stand")),
        Usual(thing="flashlight", rule=In(furniture="tv_stand", support=".*_drawer")),
        Usual(thing="tennis_ball", rule=On(furniture="bookshelf")),
    ),
    RoomKind.BEDROOM: (
        Usual(thing="alarm_clock", rule=On(furniture="nightstand", support="top")),
        Usual(thing="book", rule=On(furniture="nightstand|bookshelf")),
        Usual(thing="desk_lamp", rule=On(furniture="nightstand|bookshelf", support="top|shelf_[2345]")),
        Usual(thing="phone", rule=On(furniture="nightstand|bed")),
        Usual(thing="tissue_box", rule=In(furniture="wardrobe|nightstand")),
        Usual(thing="baseball", rule=On(furniture="bookshelf")),
        Usual(thing="glass", rule=On(furniture="nightstand|bookshelf")),
        Usual(thing="notebook", rule=On(furniture="bookshelf|bed")),
    ),
    RoomKind.BATHROOM: (
        Usual(thing="toilet_roll", rule=On(furniture="toilet")),
        Usual(thing="soap", rule=In(furniture="washbasin", support="basin")),
        Usual(thing="shampoo_bottle", rule=In(furniture="bathtub")),
        Usual(thing="toothbrush", rule=In(furniture="washbasin")),
        Usual(thing="bleach_bottle", rule=In(furniture="bathtub")),
    ),
    RoomKind.STUDY: (
        Usual(thing="laptop", rule=On(furniture="desk")),
        Usual(thing="mouse", rule=Beside(thing="laptop")),
        Usual(thing="pencil", rule=On(furniture="desk")),
        Usual(thing="mug", rule=On(furniture="desk")),
        Usual(thing="notebook", rule=On(furniture="desk|bookshelf")),
        Usual(thing="scissors", rule=In(furniture="desk")),
        Usual(thing="book", rule=On(furniture="bookshelf")),
        Usual(thing="screwdriver", rule=In(furniture="desk")),
        Usual(thing="rubiks_cube", rule=On(furniture="desk|bookshelf")),
        Usual(thing="cracker_box", rule=On(furniture="bookshelf")),
    ),
}
"""Things that are usual in each kind of room."""

CLUTTER = (
    "cracker_box", "sugar_box", "soup_can", "mustard_bottle", "tuna_can", "pudding_box", "gelatin_box",
    "potted_meat_can", "banana", "apple", "lemon", "peach", "pear", "orange", "plum", "mug", "bowl", "sponge",
    "foam_brick", "hammer", "screwdriver", "scissors", "wrench", "power_drill", "tennis_ball", "baseball", "soap",
    "remote_control", "flashlight", "egg", "butter", "rubiks_cube", "jam_jar", "soda_can", "salt_shaker", "toilet_roll",
)  # fmt: skip
"""Things of which clutter is made."""


@dataclass(frozen=True, eq=False)
class House:
    """Rooms, furniture and things of one seed."""

    plan: Plan
    """Rooms, and walls with doors and windows."""
    pieces: tuple[Piece, ...]
    """Furniture of all rooms, without doors."""
    things: tuple[PlacedThing, ...]
    """Things in their places, of unique names."""
    floor: _Array
    """Middles (M, 2) of cells of the floor where a robot that comes through the doors can stand, m."""
    left_out: tuple[str, ...] = ()
    """Things that found no place, a sentence each."""
    open_doors: bool = True
    """Whether doors between rooms stand open at home; the entrance is shut."""

    @property
    def scene(self) -> Scene:
        """The scene: the building, the furniture, doors and things; no robot."""
        objects = [building(self.plan), *(piece.build() for piece in self.pieces), *self._doors()]
        objects += [thing.build() for thing in self.things]
        # The sun from the south-west, and light from all around, as in a room with its ceiling taken off.
        lights = (AmbientLight((0.46, 0.46, 0.48)), DirectionalLight((-0.30, 0.42, -1.0)))
        return Scene(objects=tuple(objects), lights=lights)

    def _doors(self) -> Iterator[ObjectSpec]:
        made = furniture("door")
        for number, (wall, opening) in enumerate(self.plan.doors(), start=1):
            x, y = wall.place(opening.along)
            inner = self.plan.rooms[opening.rooms[0]].floor.middle
            # The leaf swings towards its first room, that is, along the door's own -x.
            into = inner[0] - x if wall.vertical else inner[1] - y
            yaw = (0.0 if into < 0.0 else math.pi) if wall.vertical else (math.pi / 2 if into < 0.0 else -math.pi / 2)
            name = "entrance" if len(opening.rooms) == 1 else f"door_{number}"
            spec = made.build(name, Pose.from_euler(0.0, 0.0, yaw, (x, y, 0.0)))
            swung = 1.45 if self.open_doors and len(opening.rooms) == 2 else 0.0
            body = replace(spec.articulation, home=(("leaf_joint", swung),))
            yield replace(spec, articulation=body, home={"leaf_joint": swung})


def building(plan: Plan) -> ObjectSpec:
    """Build the walls and floors of a plan as one fixed object; floors are drawn and the ground below carries."""
    walls = plan.shapes()
    floors = tuple(
        Shape(
            # Drawn 3 mm thick: less is lost in the ground from afar, where renderers resolve depth coarsely.
            Box((room.floor.width / 2, room.floor.depth / 2, 0.0015)),
            Pose((*room.floor.middle, 0.0015)),
            color=FLOORS[room.kind],
            name=f"floor_{room.name}",
        )
        for room in plan.rooms
    )
    link = Link("building", collisions=walls, visuals=(*walls, *floors), semantic_label="wall")
    return ObjectSpec(
        name="building", articulation=Articulation("building", (link,)), fixed_base=True, semantic_label="wall"
    )


def make_house(
    rooms: tuple[RoomKind, ...], seed: int = 0, things: int | None = None, *, open_doors: bool = True
) -> House:
    """Make a house of rooms of these kinds, furnished, with things in their usual places.

    Args:
        rooms: kinds of the rooms; the first has the entrance.
        seed: of all random choices.
        things: number of things; None takes 10 a room. What finds no place is named in :attr:`House.left_out`.
        open_doors: whether doors between rooms stand open at home.

    Raises:
        ConfigurationError: there is no room or more than 12, or the number of things is negative.
    """
    if things is not None and things < 0:
        raise ConfigurationError(f"{things} things: give a number of zero or more")
    # One stream for all choices, in a fixed order: a seed makes one house.
    random = np.random.default_rng(seed)
    plan = make_plan(rooms, random)
    layouts = [furnished(plan, index, random) for index in range(len(rooms))]
    pieces = tuple(piece for layout in layouts for piece in (*layout.pieces, *layout.hung))
    floors = [layout.free_floor() for layout in layouts]
    floor = np.concatenate([points[reached] for points, reached in floors])
    total = 10 * len(rooms) if things is None else things
    placed, left_out = _fill(layouts, floors, total, random)
    return House(plan, pieces, placed, floor, left_out, open_doors)


def _fill(
    layouts: list[RoomLayout],
    floors: list[tuple[_Array, npt.NDArray[np.bool_]]],
    total: int,
    random: np.random.Generator,
) -> tuple[tuple[PlacedThing, ...], tuple[str, ...]]:
    """Place things room by room in turns until there are ``total``, or no room takes any more."""
    placers = [
        Placer((*layout.pieces, *layout.hung), points[reached], random)
        for layout, (points, reached) in zip(layouts, floors, strict=True)
    ]
    found: list[PlacedThing] = []
    left_out: list[str] = []
    # Each room numbers its own things; in the scene names are unique.
    names: dict[str, int] = {}
    # Four rounds of the whole list are more than any room has space for.
    for turn in range(4 * max(len(each) for each in USUAL.values())):
        for layout, placer in zip(layouts, placers, strict=True):
            if len(found) == total:
                return tuple(found), tuple(left_out)
            usual = USUAL[layout.room.kind]
            wanted = usual[turn % len(usual)]
            try:
                placed = placer.place(wanted.thing, wanted.rule)
            except PremiseError as error:
                # Once only: later rounds ask for the same again.
                if turn < len(usual):
                    left_out.append(f"{layout.room.name}: {error}")
                continue
            names[wanted.thing] = names.get(wanted.thing, 0) + 1
            number = names[wanted.thing]
            found.append(replace(placed, name=wanted.thing if number == 1 else f"{wanted.thing}_{number}"))
    return tuple(found), tuple(left_out)


# Tables and bins ------------------------------------------------------------------------------------------------------


def cluttered_table(seed: int = 0, things: int = 12) -> Scene:
    """Make a table with things side by side on it, the table's middle 0.7 m in front of the origin.

    Args:
        seed: of all random choices.
        things: number of things.

    Raises:
        PremiseError: they do not fit.
    """
    random = np.random.default_rng(seed)
    piece = Piece("table", furniture("work_table"), 0.7, 0.0, 0.0, 0)
    # A robot works from the origin's side of the table: every place on the top is within its reach.
    placer = Placer([piece], np.array(((0.1, 0.0),)), random)
    names = [CLUTTER[index % len(CLUTTER)] for index in random.permutation(max(things, len(CLUTTER)))[:things]]
    placed = [placer.place(name, On(reach=None)) for name in names]
    return Scene(objects=(piece.build(), *(each.build() for each in placed)))


def heaped_bin(seed: int = 0, things: int = 12) -> Scene:
    """Make a bin on a table with things above it, in layers, from which they fall into it.

    :func:`orbit_scenes.certify.settled` lets them fall and returns the scene at rest.

    Args:
        seed: of all random choices.
        things: number of things.
    """
    from orbit_scenes.things import thing

    random = np.random.default_rng(seed)
    table = Piece("table", furniture("work_table"), 0.7, 0.0, 0.0, 0)
    height = table.furniture.size[2]
    bin_ = Piece("bin", furniture("bin"), 0.65, 0.0, 0.0, 0, height)
    small = [name for name in CLUTTER if max(thing(name).size) < 0.21]
    objects = [table.build(), bin_.build()]
    # Four cells over the bin's floor: a thing falls into its own, however it is turned.
    cells = [(-0.065, -0.10), (0.065, 0.09), (-0.065, 0.09), (0.065, -0.10)]
    level = height + 0.13
    for index in range(things):
        made = thing(small[int(random.integers(len(small)))])
        if index % 4 == 0:
            level += 0.23 if index else 0.0
        x, y = cells[index % 4]
        w, a, b, c = (float(value) for value in _random_quaternion(random))
        jitter = random.uniform(-0.01, 0.01, 2)
        pose = Pose((bin_.x + x + jitter[0], bin_.y + y + jitter[1], level), (w, a, b, c))
        number = sum(each.articulation.name == made.name for each in objects) + 1
        objects.append(made.build(made.name if number == 1 else f"{made.name}_{number}", pose))
    return Scene(objects=tuple(objects))


def _random_quaternion(random: np.random.Generator) -> _Array:
    values = random.normal(size=4)
    return values / np.linalg.norm(values)


# By name --------------------------------------------------------------------------------------------------------------

_HOUSE = (RoomKind.LIVING, RoomKind.KITCHEN, RoomKind.BEDROOM, RoomKind.BATHROOM, RoomKind.STUDY)
SCENES = ("house", *(kind.value for kind in RoomKind), "table", "bin")
"""Kinds of scenes."""


def make_scene(kind: str, seed: int = 0, rooms: int = 1, things: int | None = None) -> Scene:
    """Make a scene by name.

    Args:
        kind: "house", a kind of room, "table" or "bin". Further rooms of a house are of the other kinds in turn.
        seed: of all random choices; the same seed makes the same scene.
        rooms: number of rooms; a house has five of them where it is 1.
        things: number of things; None takes a usual number.

    Raises:
        UnknownNameError: there is no such kind.
        ConfigurationError: a number is out of its range, or a table or a bin is to have rooms.
    """
    if kind in ("table", "bin"):
        if rooms != 1:
            raise ConfigurationError(f"a {kind} has no rooms: leave the number of rooms out")
        make: Callable[[int, int], Scene] = cluttered_table if kind == "table" else heaped_bin
        return make(seed, 12 if things is None else things)
    return make_house(room_kinds(kind, rooms), seed, things).scene


def room_kinds(kind: str, rooms: int) -> tuple[RoomKind, ...]:
    """Return the kinds of the rooms of a house that is named by its first one.

    Raises:
        UnknownNameError: there is no such kind of scene.
        ConfigurationError: the number of rooms is not 1 to 12.
    """
    if kind not in SCENES:
        raise UnknownNameError("scene", kind, SCENES, "the kinds of scenes")
    if not 1 <= rooms <= 12:
        raise ConfigurationError(f"a house of {rooms} rooms: give 1 to 12")
    if kind == "house":
        count = 5 if rooms == 1 else rooms
        return tuple(_HOUSE[index % len(_HOUSE)] for index in range(count))
    first = RoomKind(kind)
    others = [each for each in _HOUSE if each is not first]
    return (first, *(others[index % len(others)] for index in range(rooms - 1)))
