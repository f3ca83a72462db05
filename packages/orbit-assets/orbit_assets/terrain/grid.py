"""Grid of terrain: kinds side by side along y, levels of difficulty one after another along x."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property

import numpy as np

from orbit_assets.terrain.kinds import Array, Boxes, Rough, Slope, Stairs, Surface, TerrainKind, Waves, is_number
from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.scene import Box, HeightField, Mesh, MeshCollision, PhysicsMaterial, Pose, RobotSpec, Shape
from orbit_core.scene.shapes import Color

# Metres: thickness of the level ground around the grid.
_BORDER_DEPTH = 1.0
# Most points at which heights are sampled: 256 MiB as 8-byte numbers, and as much again in each engine.
_MOST_POINTS = 2**25
# Metres: a robot starts above the highest point within this distance, in x and in y, of its cell's middle.
_START = 0.5


class TerrainForm(Enum):
    """Form of the terrain in engines. Both are the same surface; a mesh is for engines without height fields."""

    HEIGHT_FIELD = "height_field"
    MESH = "mesh"


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
    seed: int = 0
    material: PhysicsMaterial = field(default_factory=PhysicsMaterial)
    color: Color = (0.42, 0.4, 0.36, 1.0)

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
