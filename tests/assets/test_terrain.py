"""Terrain: what it promises of its rims and origins, and what it refuses. Engines are held to it by the suite."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orbit_assets.catalogue import robot
from orbit_assets.terrain import (
    Boxes,
    Flat,
    Gap,
    Pit,
    Rough,
    Slope,
    Span,
    Stairs,
    SteppingStones,
    TerrainForm,
    TerrainGrid,
    TerrainKind,
    Waves,
)
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import HeightField, Mesh

KINDS: tuple[TerrainKind, ...] = (
    Flat(), Rough(), Slope(), Slope(down=True), Stairs(), Stairs(down=True), SteppingStones(), Boxes(), Gap(), Pit(),
    Waves(),
)  # fmt: skip
GRID = TerrainGrid(kinds=KINDS, levels=3, cell_size=6.0)


def test_every_cell_is_level_with_its_neighbours_along_its_rim() -> None:
    along = np.linspace(-3.0, 3.0, 241)
    for row in GRID.surfaces:
        for kind, surface in zip(KINDS, row, strict=True):
            for side in (-3.0, 3.0):
                for edge in ((along, np.full_like(along, side)), (np.full_like(along, side), along)):
                    assert np.abs(surface(*edge)).max() < 1e-9, kind


def test_difficulty_makes_ground_steeper_and_the_samples_are_the_function() -> None:
    slope = TerrainGrid(kinds=(Slope(),), levels=3)
    tops = slope.origins[:, 0, 2]
    np.testing.assert_allclose(tops, [0.0, 0.2 * 3.0, 0.4 * 3.0])
    rows, columns = np.meshgrid(np.arange(1, 660), np.arange(1, 180), indexing="ij")
    inner = (rows % 60 != 0) & (columns % 60 != 0)
    x, y = columns[inner] * 0.1 - 9.0, rows[inner] * 0.1 - 33.0
    np.testing.assert_allclose(GRID.heights[rows[inner], columns[inner]], GRID.height(x, y), atol=1e-9)


def test_a_seed_gives_the_same_ground_and_another_seed_another() -> None:
    np.testing.assert_array_equal(replace(GRID).heights, GRID.heights)
    assert not np.array_equal(replace(GRID, seed=1).heights, GRID.heights)


def test_a_robot_starts_above_all_that_is_near_its_cells_middle() -> None:
    near = np.linspace(-0.45, 0.45, 10)
    x, y = np.meshgrid(near, near)
    for origin in GRID.origins.reshape(-1, 3):
        assert GRID.height(origin[0] + x, origin[1] + y).max() <= origin[2] + 1e-9


def test_a_mesh_has_the_corners_of_the_height_field() -> None:
    field, mesh = (replace(GRID, form=form).shapes()[0].geometry for form in TerrainForm)
    assert isinstance(field, HeightField)
    assert isinstance(mesh, Mesh)
    np.testing.assert_array_equal(np.asarray(mesh.vertices)[:, 2], field.heights.ravel())
    assert len(replace(GRID, border=0.0).shapes()) == 1
    assert len(GRID.shapes()) == 5


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kinds": ()}, "has no kinds"),
        ({"kinds": Flat()}, r"give a tuple of kinds"),
        ({"kinds": ("Flat",)}, r"give a tuple of kinds"),
        ({"levels": 0}, "levels of a terrain grid is 0: give a whole number, 1 or more"),
        ({"levels": 1.5}, "levels of a terrain grid is 1.5: give a whole number"),
        ({"seed": -1}, "seed of a terrain grid is -1: give a whole number, 0 or more"),
        ({"form": "mesh"}, "form of a terrain grid is 'mesh': give a TerrainForm"),
        ({"difficulty": 0.5}, "difficulty is 0.5: give two numbers"),
        ({"difficulty": (0.0, float("nan"))}, "give two numbers"),
        ({"resolution": 1e-4}, "more than 33,554,432 points"),
        ({"difficulty": (0.2, 1.5)}, "0 <= first <= last <= 1"),
        ({"difficulty": (0.7, 0.1)}, "0 <= first <= last <= 1"),
        ({"resolution": 0.07}, "does not divide cell_size 8 m: 0.0701754 m does"),
        ({"resolution": 0.0}, "at least three points"),
        ({"cell_size": float("nan")}, "cell_size of a terrain grid is nan: give a finite number"),
        ({"border": -1.0}, "border is -1.0 m"),
        ({"cell_size": 1.0}, "platform is 2 m in a cell of 1 m"),
    ],
)
def test_a_grid_that_cannot_be_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        TerrainGrid(**fields)


def test_a_kind_that_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="Stairs: rise is Span"):
        Stairs(rise=Span(0.1, float("inf")))
    with pytest.raises(ConfigurationError, match=r"Stairs: rise is 0\.1: give Span"):
        Stairs(rise=0.1)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match=r"Waves: count is 1\.25: give a whole number"):
        Waves(count=1.25)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match="Boxes: side is 'wide': give finite numbers"):
        Boxes(side="wide")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match=r"in a cell of 8 m give 0\.008 m or more"):
        _ = TerrainGrid(kinds=(SteppingStones(side=Span(0.0, 0.0), apart=Span(0.0, 0.0)),)).heights
    with pytest.raises(ConfigurationError, match="run is 0"):
        _ = TerrainGrid(kinds=(Stairs(run=0.0),)).heights
    with pytest.raises(ConfigurationError, match="step of 100 m does not fit"):
        _ = TerrainGrid(kinds=(Stairs(run=100.0),)).heights
    with pytest.raises(ConfigurationError, match="not finite"):
        TerrainGrid(kinds=(Flat(),)).height(np.array([0.0, np.nan]), np.zeros(2))


def test_a_cell_smaller_than_the_robot_is_refused() -> None:
    small = TerrainGrid(kinds=(Flat(platform=0.1),), cell_size=0.6)
    with pytest.raises(ConfigurationError, match=r"smaller than robot .anymal_c., whose feet stand up to 0\.5 m"):
        small.check_fits(robot("anymal_c"), 0.5)
