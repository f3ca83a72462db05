"""A scan that is read with the wrong axis up is refused, with the axis that fits; right ones are taken."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import trimesh

from orbit_core.interfaces.errors import AssetError
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import Pose
from orbit_scenes.house import make_scene
from orbit_scenes.scan import read_scan
from orbit_scenes.scan.upright import better_up

Up = Literal["x", "y", "z"]
# Axes of a room that become those of a file with this axis up.
_FILES: dict[Up, tuple[int, int, int]] = {"x": (2, 0, 1), "y": (1, 2, 0), "z": (0, 1, 2)}


def _inside(x: float, y: float, z: float, ceiling: bool = True) -> trimesh.Trimesh:
    """The inside of an empty room, all surfaces facing in."""
    room = trimesh.creation.box(extents=(x, y, z), transform=Pose((0.0, 0.0, z / 2)).matrix())
    kept = np.ones(len(room.faces), dtype=bool) if ceiling else room.face_normals[:, 2] < 0.5
    return trimesh.Trimesh(room.vertices, room.faces[kept][:, ::-1], process=False)


@functools.cache
def _furnished(kind: str, seed: int, rooms: int, ceiling: bool) -> trimesh.Trimesh:
    """Procedural rooms on a floor, with noise and a tilt of three degrees, with their furniture's undersides."""
    parts = []
    for entity in make_scene(kind, seed, rooms).objects:
        for link in entity.articulation.links:
            for shape in link.visuals:
                part = triangles(shape.geometry)
                parts.append(part.apply_transform((entity.pose @ shape.pose).matrix()))
    walls = trimesh.util.concatenate(parts)
    (x0, y0, _), (x1, y1, top) = walls.bounds
    corners = np.array([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)])
    sides = [trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)]
    if ceiling:
        sides.append(trimesh.Trimesh(corners + np.array((0.0, 0.0, top)), [(0, 2, 1), (0, 3, 2)], process=False))
    room = trimesh.util.concatenate([walls, *sides])
    noise = np.random.default_rng(seed).normal(0.0, 0.003, room.vertices.shape)
    turned = Pose.from_euler(0.04, -0.03, 0.2).transform(room.vertices + noise)
    return trimesh.Trimesh(turned, room.faces, process=False)


_ROOMS = [("house", 0, 3), ("kitchen", 3, 1), ("living", 2, 1), ("bedroom", 1, 1)]


@pytest.mark.parametrize("ceiling", [True, False])
@pytest.mark.parametrize(("kind", "seed", "rooms"), _ROOMS)
def test_a_furnished_room_is_taken_upright_and_refused_on_its_side(
    kind: str, seed: int, rooms: int, ceiling: bool, tmp_path: Path
):
    room = _furnished(kind, seed, rooms, ceiling)
    file = tmp_path / "room.ply"
    for up, axes in _FILES.items():
        trimesh.Trimesh(room.vertices[:, axes], room.faces, process=False).export(file)
        assert read_scan(file, unit=1.0, up=up).size[2] < 4.0
        for wrong in _FILES:
            if wrong != up:
                with pytest.raises(AssetError, match=rf"read with {wrong} up, .*give up='{up}' \(--up {up}\)"):
                    read_scan(file, unit=1.0, up=wrong)


@pytest.mark.parametrize(("kind", "seed", "rooms"), _ROOMS)
def test_a_furnished_room_that_stands_on_its_ceiling_is_refused(kind: str, seed: int, rooms: int, tmp_path: Path):
    room = _furnished(kind, seed, rooms, ceiling=True)
    over = room.vertices * (1.0, -1.0, -1.0)
    trimesh.Trimesh(over, room.faces, process=False).export(tmp_path / "room.ply")
    with pytest.raises(AssetError, match="upside down: turn the file over, for its z axis points down"):
        read_scan(tmp_path / "room.ply", unit=1.0, up="z")
    assert read_scan(tmp_path / "room.ply", unit=1.0, up="z", check_up=False).size[2] < 4.0


@pytest.mark.parametrize("ceiling", [True, False])
@pytest.mark.parametrize(
    "size",
    [
        (4.0, 3.0, 2.4), (3.0, 3.0, 3.0), (3.0, 3.0, 3.5), (1.5, 10.0, 2.5), (2.0, 10.0, 2.5), (2.0, 1.6, 2.4),
        (2.2, 2.2, 3.5), (7.0, 6.5, 0.85), (20.0, 12.0, 7.0), (6.0, 5.0, 8.0), (1.2, 1.0, 2.1),
    ],
)  # fmt: skip
def test_an_empty_room_read_right_is_taken(size: tuple[float, float, float], ceiling: bool):
    room = _inside(*size, ceiling=ceiling)
    assert better_up(room.vertices, room.triangles) is None


@pytest.mark.parametrize("size", [(4.0, 3.6, 2.4), (7.0, 6.5, 2.5), (20.0, 12.0, 7.0)])
def test_an_empty_room_on_its_side_has_its_floor_found(size: tuple[float, float, float]):
    room = _inside(*size, ceiling=False)
    for axes, direction in (((2, 0, 1), (1, 0, 0)), ((1, 2, 0), (0, 1, 0))):
        found = better_up(room.vertices[:, axes], room.vertices[:, axes][room.faces])
        assert found is not None
        assert found[1].direction == direction
        assert found[1].floor == pytest.approx(size[0] * size[1])


def test_a_thing_that_is_no_room_is_taken():
    ball = trimesh.creation.icosphere(radius=0.1)
    assert better_up(ball.vertices, ball.triangles) is None
