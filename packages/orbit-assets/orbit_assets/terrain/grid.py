"""Grid of terrain: kinds side by side along y, levels of difficulty one after another along x."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.scene import Box, HeightField, Mesh, MeshCollision, PhysicsMaterial, Pose, RobotSpec, Shape
from orbit_core.scene.shapes import Color

# Kinds of ground. Each is a height as a function of position, which difficulty makes steeper, higher or sparser.
# A cell is a square around its own origin. Its height is zero all along its rim, so that any cell may be next to any
# other, and a robot starts in its middle. The kinds are those of Rudin et al., Learning to Walk in Minutes Using
# Massively Parallel Deep Reinforcement Learning (2021), and of Isaac Gym's terrains before it.

Array = npt.NDArray[np.floating[Any]]
Surface = Callable[[Array, Array], Array]
"""Height in metres at x and y in metres from the middle of a cell; arrays of one shape."""
# Metres: a place on an edge belongs to the side that is nearer to the middle.
_EDGE = 1e-9
# Most stones in a row across a cell.
_MOST_STONES = 1000


@dataclass(frozen=True)
class Span:
    """A quantity that goes from ``easy`` to ``hard`` in a straight line as difficulty goes from 0 to 1."""

    easy: float
    hard: float

    def at(self, difficulty: float) -> float:
        """Return the value at a difficulty."""
        return self.easy + difficulty * (self.hard - self.easy)


def is_number(value: object) -> bool:
    """Return True if the value is a finite number."""
    return isinstance(value, int | float) and bool(np.isfinite(value))


@dataclass(frozen=True, kw_only=True)
class TerrainKind(ABC):
    """One kind of ground."""

    platform: float = 2.0
    """Metres: side of the level square in the middle, where robots start."""

    def __post_init__(self) -> None:
        """Check what every kind must hold.

        Raises:
            ConfigurationError: a number is not finite, or a length is below zero; or a field is of another type.
        """
        for each in fields(self):
            value, usual = getattr(self, each.name), each.default
            what = f"terrain {type(self).__name__}: {each.name} is {value!r}"
            if isinstance(usual, Span) and not isinstance(value, Span):
                raise ConfigurationError(f"{what}: give Span(easy, hard)")
            if type(usual) is int and type(value) is not int:
                raise ConfigurationError(f"{what}: give a whole number")
            ends = (value.easy, value.hard) if isinstance(value, Span) else (value,)
            if not all(is_number(end) and end >= 0.0 for end in ends):
                raise ConfigurationError(f"{what}: give finite numbers, zero or above")

    @abstractmethod
    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        """Return the surface of a cell of side ``size`` (m) at a difficulty of 0 to 1; random values are drawn here,
        once.
        """


def _ring(x: Array, y: Array) -> Array:
    """Return the distance from the middle in the larger of both directions, whose level lines are squares."""
    return np.maximum(np.abs(x), np.abs(y))


def _square(place: Array, count: int, slack: float = 1e-6) -> npt.NDArray[np.int_]:
    """Return the square (of ``count`` in a row, side 1) of each place; an edge, within slack, belongs to the next."""
    return np.clip(np.floor(place + slack).astype(int), 0, count - 1)


def _inside(ring: Array, half: float) -> npt.NDArray[np.bool_]:
    return ring <= half + _EDGE


@dataclass(frozen=True, kw_only=True)
class Flat(TerrainKind):
    """Level ground."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        return lambda x, y: np.zeros_like(x)


@dataclass(frozen=True, kw_only=True)
class Rough(TerrainKind):
    """Heights drawn at knots of a square grid, level in the platform and plane in the triangles between the knots."""

    amplitude: Span = Span(0.01, 0.08)
    """Metres: heights are uniform between minus and plus this."""
    spacing: float = 0.2
    """Metres between knots, about; it is rounded so that knots lie on the rim."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        cells = max(round(size / self.spacing), 1) if self.spacing else 1
        step = size / cells
        knots = random.uniform(-1.0, 1.0, (cells + 1, cells + 1)) * self.amplitude.at(difficulty)
        place = np.linspace(-size / 2, size / 2, cells + 1)
        knots[_inside(_ring(*np.meshgrid(place, place)), self.platform / 2)] = 0.0
        knots[[0, -1]], knots[:, [0, -1]] = 0.0, 0.0

        def height(x: Array, y: Array) -> Array:
            column, row = (_square((v + size / 2) / step, cells, _EDGE) for v in (x, y))
            u, v = (x + size / 2) / step - column, (y + size / 2) / step - row
            start, across = knots[row, column], knots[row + 1, column + 1]
            # Each square is split along its rising diagonal, as height fields are.
            lower = start + u * (knots[row, column + 1] - start) + v * (across - knots[row, column + 1])
            upper = start + v * (knots[row + 1, column] - start) + u * (across - knots[row + 1, column])
            return np.where(u >= v, lower, upper)

        return height


@dataclass(frozen=True, kw_only=True)
class Slope(TerrainKind):
    """A pyramid with four slopes; upside down, a funnel."""

    grade: Span = Span(0.0, 0.4)
    """Rise over run: the tangent of the slope's angle."""
    down: bool = False
    """True for a funnel at whose bottom robots start, False for a pyramid on whose top they start."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        grade = self.grade.at(difficulty) * (-1.0 if self.down else 1.0)
        return lambda x, y: grade * (size / 2 - np.maximum(_ring(x, y), self.platform / 2))


@dataclass(frozen=True, kw_only=True)
class Stairs(TerrainKind):
    """A pyramid of steps; upside down, an amphitheatre."""

    rise: Span = Span(0.05, 0.23)
    """Metres: height of a step."""
    run: float = 0.3
    """Metres: depth of a step. A multiple of the grid's resolution, so that all steps are alike."""
    down: bool = False
    """True if robots start at the bottom and climb out."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        if not self.run:
            raise ConfigurationError("terrain Stairs: run is 0: give the steps a depth")
        # Down is the same surface upside down.
        rise = self.rise.at(difficulty) * (-1.0 if self.down else 1.0)
        most = np.floor((size - self.platform) / 2 / self.run + _EDGE)
        if most < 1.0:
            raise ConfigurationError(
                f"terrain Stairs: a step of {self.run:g} m does not fit between the rim of a {size:g} m cell and its "
                f"platform of {self.platform:g} m: give a shorter run"
            )
        return lambda x, y: rise * np.clip(np.floor((size / 2 - _ring(x, y)) / self.run + 1e-6), 0.0, most)


@dataclass(frozen=True, kw_only=True)
class SteppingStones(TerrainKind):
    """Square stones in a hole, level with the platform and the rim but for a little chance."""

    side: Span = Span(1.0, 0.3)
    """Metres: side of a stone."""
    apart: Span = Span(0.05, 0.2)
    """Metres between neighbouring stones."""
    unevenness: Span = Span(0.0, 0.05)
    """Metres: tops are uniform between minus and plus this."""
    depth: float = 1.0
    """Metres."""
    rim: float = 0.4
    """Metres: width of the level ground around the hole."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        apart = self.apart.at(difficulty)
        pitch = self.side.at(difficulty) + apart
        if pitch < size / _MOST_STONES:
            raise ConfigurationError(
                f"terrain SteppingStones: side and apart are {pitch:g} m together: in a cell of {size:g} m give "
                f"{size / _MOST_STONES:g} m or more"
            )
        count = int(np.ceil(size / pitch)) + 1
        tops = random.uniform(-1.0, 1.0, (count, count)) * self.unevenness.at(difficulty)

        def height(x: Array, y: Array) -> Array:
            across, along = (v + size / 2 for v in (x, y))
            column, row = (_square(v / pitch, count) for v in (across, along))
            # A slack of a micrometre keeps rounding from opening a gap one point wide at a stone's edge.
            wide = pitch - apart + 1e-6
            gap = (across - column * pitch > wide) | (along - row * pitch > wide)
            ring = _ring(x, y)
            level = _inside(ring, self.platform / 2) | ~(ring < size / 2 - self.rim - _EDGE)
            return np.where(level, 0.0, np.where(gap, -self.depth, tops[row, column]))

        return height


@dataclass(frozen=True, kw_only=True)
class Boxes(TerrainKind):
    """Square blocks side by side, each with an independent height."""

    amplitude: Span = Span(0.025, 0.15)
    """Metres: heights are uniform between minus and plus this."""
    side: float = 0.5
    """Metres: side of a block, about; it is rounded so that blocks fill the cell. The outermost ring is level."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        cells = max(round(size / self.side), 1) if self.side else 1
        heights = random.uniform(-1.0, 1.0, (cells, cells)) * self.amplitude.at(difficulty)
        heights[[0, -1]], heights[:, [0, -1]] = 0.0, 0.0

        def height(x: Array, y: Array) -> Array:
            column, row = (_square((v / size + 0.5) * cells, cells) for v in (x, y))
            return np.where(_inside(_ring(x, y), self.platform / 2), 0.0, heights[row, column])

        return height


@dataclass(frozen=True, kw_only=True)
class Gap(TerrainKind):
    """A trench around the platform, to be crossed."""

    width: Span = Span(0.1, 1.0)
    """Metres."""
    depth: float = 1.0
    """Metres."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        inner, width = self.platform / 2, self.width.at(difficulty)

        def height(x: Array, y: Array) -> Array:
            ring = _ring(x, y)
            trench = ~_inside(ring, inner) & (ring < inner + width - _EDGE) & (ring < size / 2 - _EDGE)
            return np.where(trench, -self.depth, 0.0)

        return height


@dataclass(frozen=True, kw_only=True)
class Pit(TerrainKind):
    """The platform is at the bottom of a pit with upright walls, which robots climb out of."""

    depth: Span = Span(0.05, 0.35)
    """Metres."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        depth = self.depth.at(difficulty)
        return lambda x, y: np.where(_inside(_ring(x, y), self.platform / 2), -depth, 0.0)


@dataclass(frozen=True, kw_only=True)
class Waves(TerrainKind):
    """``amplitude sin(k x) sin(k y)``: hills and hollows like those of a tray for eggs."""

    amplitude: Span = Span(0.02, 0.2)
    """Metres."""
    count: int = 3
    """Whole waves along each side of the cell, so that the rim is level."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        amplitude, k = self.amplitude.at(difficulty), 2.0 * np.pi * self.count / size
        return lambda x, y: amplitude * np.sin(k * (x + size / 2)) * np.sin(k * (y + size / 2))


# Metres: thickness of the level ground around the grid.
_BORDER_DEPTH = 1.0
# Most points at which heights are sampled: 256 MiB as 8-byte numbers, and as much again in each engine.
_MOST_POINTS = 2**25
# Metres: a robot starts above the highest point within this distance, in x and in y, of its cell's middle.
_START = 0.5


class TerrainForm(Enum):
    """Form of the terrain in engines. Both are the same surface; a mesh is for engines without height fields."""

    HEIGHT_FIELD = "height_field"
    """Heights on a grid: small, and fast to collide with."""
    MESH = "mesh"
    """Triangles of the same surface."""


@dataclass(frozen=True, kw_only=True)
class TerrainGrid:
    """``len(kinds)`` times ``levels`` square cells around the environment's origin, with level ground around them.

    The surface is sampled at a square grid of points and plane between them, along the rising diagonal of each square:
    an upright wall is as wide as the distance between two points. A robot of any environment may walk on any cell, so
    that a curriculum moves it by a reset alone.
    """

    kinds: tuple[TerrainKind, ...] = (
        Slope(), Slope(down=True), Stairs(), Stairs(down=True), Rough(), Boxes(), Waves(),
    )  # fmt: skip
    """One row of cells each, in the order of y; name one twice to have it twice as often."""
    levels: int = 10
    """Cells of each kind."""
    difficulty: tuple[float, float] = (0.0, 1.0)
    """Difficulties of the first and of the last level; the others are evenly spaced between."""
    cell_size: float = 8.0
    """Metres: side of a cell."""
    resolution: float = 0.1
    """Metres between points of the surface; it divides the side of a cell."""
    border: float = 10.0
    """Metres: width of the level ground around the cells."""
    form: TerrainForm = TerrainForm.HEIGHT_FIELD
    """Form in engines."""
    seed: int = 0
    """Seed of the random kinds of terrain."""
    material: PhysicsMaterial = field(default_factory=PhysicsMaterial)
    """Friction and restitution of the ground."""
    color: Color = (0.42, 0.4, 0.36, 1.0)
    """RGBA in [0, 1]."""

    def __post_init__(self) -> None:
        """Check that the fields describe a possible grid.

        Raises:
            ConfigurationError: it cannot; names the field and what would do.
        """
        self._check_types()
        if not 0.0 < self.resolution <= self.cell_size / 2:
            raise ConfigurationError(
                f"cell_size is {self.cell_size:g} m and resolution {self.resolution:g} m: a cell must hold at least "
                "three points a side"
            )
        # Rounding of decimal fractions such as 8.0 / 0.1 must pass.
        if abs(self.cell_size / self.resolution - self._points) > 1e-6:
            raise ConfigurationError(
                f"resolution {self.resolution:g} m does not divide cell_size {self.cell_size:g} m: "
                f"{self.cell_size / self._points:g} m does"
            )
        if len(self.kinds) * self.levels * (self.cell_size / self.resolution) ** 2 > _MOST_POINTS:
            raise ConfigurationError(
                f"a terrain grid of {len(self.kinds)} times {self.levels} cells of {self.cell_size:g} m has more than "
                f"{_MOST_POINTS:,} points at resolution {self.resolution:g} m: give fewer cells, or a coarser one"
            )
        if self.border < 0.0:
            raise ConfigurationError(f"border is {self.border} m: give a width of zero or more")
        for kind in self.kinds:
            if kind.platform >= self.cell_size:
                raise ConfigurationError(
                    f"terrain {type(kind).__name__}: platform is {kind.platform:g} m in a cell of {self.cell_size:g} "
                    "m: make the cell larger than its platform"
                )

    def _check_types(self) -> None:
        if not (isinstance(self.kinds, tuple) and all(isinstance(kind, TerrainKind) for kind in self.kinds)):
            raise ConfigurationError(f"kinds of a terrain grid are {self.kinds!r}: give a tuple of kinds, as (Flat(),)")
        if not self.kinds:
            raise ConfigurationError("a terrain grid has no kinds: give at least one, such as Flat()")
        if not isinstance(self.form, TerrainForm):
            raise ConfigurationError(f"form of a terrain grid is {self.form!r}: give a TerrainForm")
        for name, least in (("levels", 1), ("seed", 0)):
            # ``type`` rather than isinstance: True is an int.
            value = getattr(self, name)
            if type(value) is not int or value < least:
                raise ConfigurationError(f"{name} of a terrain grid is {value!r}: give a whole number, {least} or more")
        if not (isinstance(self.difficulty, tuple) and [*map(is_number, self.difficulty)] == [True, True]):
            raise ConfigurationError(f"difficulty is {self.difficulty!r}: give two numbers, of first and last level")
        low, high = self.difficulty
        if not 0.0 <= low <= high <= 1.0:
            raise ConfigurationError(f"difficulty is {self.difficulty}: give 0 <= first <= last <= 1")
        for name in ("cell_size", "resolution", "border"):
            if not is_number(getattr(self, name)):
                raise ConfigurationError(f"{name} of a terrain grid is {getattr(self, name)!r}: give a finite number")

    @property
    def _points(self) -> int:
        """Squares between points along a cell's side."""
        return round(self.cell_size / self.resolution)

    @property
    def size(self) -> tuple[float, float]:
        """Extent (x, y) of all cells in metres, without the border."""
        return self.levels * self.cell_size, len(self.kinds) * self.cell_size

    @cached_property
    def surfaces(self) -> tuple[tuple[Surface, ...], ...]:
        """Surface of each level's cells, by kind; each cell has an independent random stream."""
        difficulties = np.linspace(*self.difficulty, self.levels)
        return tuple(
            tuple(
                # Seeded by place: adding a kind or a level leaves all other cells as they are.
                kind.surface(self.cell_size, float(difficulty), np.random.default_rng((self.seed, level, column)))
                for column, kind in enumerate(self.kinds)
            )
            for level, difficulty in enumerate(difficulties)
        )

    @cached_property
    def heights(self) -> Array:
        """Heights (rows along y, columns along x) of the sampled surface, in metres."""
        count = self._points
        place = np.linspace(-self.cell_size / 2, self.cell_size / 2, count + 1)
        x, y = np.meshgrid(place, place)
        heights = np.zeros((len(self.kinds) * count + 1, self.levels * count + 1))
        for level, row in enumerate(self.surfaces):
            for kind, surface in enumerate(row):
                cell = surface(x, y)
                # Rims stay exactly zero, so that neighbours meet without a step.
                inner = (slice(kind * count + 1, (kind + 1) * count), slice(level * count + 1, (level + 1) * count))
                heights[inner] = cell[1:-1, 1:-1]
        return heights

    def height(self, x: Array, y: Array) -> Array:
        """Compute the exact height (m) at places in the environment's frame; zero outside the grid.

        Raises:
            ConfigurationError: a place is not finite.
        """
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise ConfigurationError("a terrain has no height where x or y is not finite: give places in metres")
        size = self.cell_size
        level, kind = (np.floor(v / size + n / 2).astype(int) for v, n in ((x, self.levels), (y, len(self.kinds))))
        heights = np.zeros(x.shape)
        for i, row in enumerate(self.surfaces):
            for j, surface in enumerate(row):
                here = (level == i) & (kind == j)
                if here.any():
                    center = self.centers[i, j]
                    heights[here] = surface(x[here] - center[0], y[here] - center[1])
        return heights

    @cached_property
    def centers(self) -> Array:
        """x and y of the cells' middles (levels, kinds, 2), in the environment's frame."""
        x, y = ((np.arange(n) - (n - 1) / 2) * self.cell_size for n in (self.levels, len(self.kinds)))
        return np.stack(np.meshgrid(x, y, indexing="ij"), -1)

    @cached_property
    def origins(self) -> Array:
        """Start positions of robots (levels, kinds, 3): the cells' middles, as high as the highest point near them."""
        near = np.linspace(-_START, _START, 2 * max(round(_START / self.resolution), 1) + 1)
        x, y = np.meshgrid(near, near)
        top = [[surface(x, y).max() for surface in row] for row in self.surfaces]
        return np.concatenate((self.centers, np.array(top)[..., None]), -1)

    def shapes(self) -> tuple[Shape, ...]:
        """Build the terrain of a scene: the cells as one shape, and four level slabs around them."""
        own = HeightField(self.heights, self.size)
        geometry = own
        if self.form is TerrainForm.MESH:
            geometry = Mesh(*height_field_mesh(own), MeshCollision.TRIANGLES)
        cells = Shape(geometry, Pose(), self.material, self.color, "terrain")
        return (cells, *self._border()) if self.border else (cells,)

    def _border(self) -> tuple[Shape, ...]:
        x, y = (0.5 * extent for extent in self.size)
        half, deep = 0.5 * self.border, 0.5 * _BORDER_DEPTH
        along = [((x + self.border, half, deep), (0.0, side * (y + half), -deep)) for side in (1, -1)]
        across = [((half, y, deep), (side * (x + half), 0.0, -deep)) for side in (1, -1)]
        return tuple(
            Shape(Box(extents), Pose(place), self.material, self.color, f"border{number}")
            for number, (extents, place) in enumerate((*along, *across))
        )

    def check_fits(self, robot: RobotSpec, reach: float) -> None:
        """Reject cells that a robot does not fit in.

        Args:
            robot: that stands on them.
            reach: metres from the robot's root to its farthest foot, on the ground.

        Raises:
            ConfigurationError: a cell is smaller than the robot.
        """
        if self.cell_size < 2.0 * reach:
            raise ConfigurationError(
                f"terrain cells of {self.cell_size:g} m are smaller than robot '{robot.name}', whose feet stand up to "
                f"{reach:.2g} m from its middle: give cell_size of {4.0 * reach:.2g} m or more"
            )
