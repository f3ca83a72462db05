"""Settled scenes: objects that an engine leaves pressed together are moved apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orbit_assets.objects import box, cylinder, sphere
from orbit_core.scene import HeightField, Mesh, MeshCollision, ObjectSpec, Pose, Scene, Shape
from orbit_scenes.certify import overlaps, settled
from orbit_scenes.separate import separated
from orbit_scenes.things import thing

TABLE = box("table", (0.4, 0.4, 0.1), pose=Pose((0.0, 0.0, 0.35)), fixed_base=True)


def _cube(name: str, z: float, x: float = 0.0) -> ObjectSpec:
    return box(name, (0.05, 0.05, 0.05), pose=Pose((x, 0.0, z)))


def _heights(scene: Scene) -> list[float]:
    return [each.pose.position[2] for each in separated(scene).objects if not each.fixed_base]


def test_a_tower_is_raised_from_the_table_upwards():
    # Each is 1 mm deep in what is below it.
    cubes = tuple(_cube(f"cube{number}", 0.4 + 0.025 - 0.001 + number * 0.049) for number in range(3))
    assert _heights(Scene(objects=(*reversed(cubes), TABLE))) == pytest.approx([0.525, 0.475, 0.425], abs=1e-5)


def test_a_wheel_and_a_ball_are_raised_from_the_ground():
    wheel = cylinder("wheel", 0.03, 0.02, pose=Pose.from_euler(np.pi / 2, 0.0, 0.3, (0.0, 0.0, 0.029)))
    ball = sphere("ball", 0.02, pose=Pose((0.5, 0.0, 0.0185)))
    assert _heights(Scene(objects=(wheel, ball))) == pytest.approx([0.03, 0.02], abs=1e-5)


def test_what_is_pressed_against_a_wall_is_moved_aside():
    wall = box("wall", (0.1, 1.0, 1.0), pose=Pose((-0.05, 0.0, 0.5)), fixed_base=True)
    (cube, _) = separated(Scene(objects=(_cube("cube", 0.025, x=0.024), wall))).objects
    assert cube.pose.position == pytest.approx((0.025, 0.0, 0.025), abs=1e-5)


def test_what_is_free_of_contact_or_deep_in_a_thing_stays_where_it_is():
    above, within = _cube("above", 0.4255), _cube("within", 0.41, x=0.1)
    assert _heights(Scene(objects=(above, within, TABLE))) == [0.4255, 0.41]


@pytest.mark.parametrize("terrain", [False, True])
def test_surfaces_of_triangles_raise_what_is_on_them(terrain: bool):
    if terrain:
        field = HeightField(np.full((9, 9), 0.1), (2.0, 2.0))
        scene = Scene(objects=(_cube("cube", 0.124),), terrain=(Shape(field),))
        assert _heights(scene) == pytest.approx([0.125], abs=1e-5)
        return
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0.0, 0.5)])
    # The floor and one wall of a room whose hull would hold the cube.
    room = Mesh(corners, np.array([(0, 4, 6), (0, 6, 2), (0, 1, 4), (1, 5, 4)]), MeshCollision.TRIANGLES)
    scan = replace(TABLE, pose=Pose())
    link = replace(scan.articulation.root, collisions=(Shape(room),))
    scan = replace(scan, articulation=replace(scan.articulation, links=(link,)))
    assert _heights(Scene(objects=(_cube("cube", 0.0243), scan), terrain=())) == pytest.approx([0.025], abs=1e-5)


@pytest.mark.parametrize("backend", ["mujoco", "bullet", "sapien"])
def test_a_settled_scene_starts_with_nothing_pressed_in(backend: str):
    pytest.importorskip(f"orbit_{backend}")
    mug, bowl = thing("mug"), thing("bowl")
    scene = Scene(
        objects=(
            TABLE,
            mug.build("mug", Pose((-0.1, 0.0, 0.41 + mug.rest_height))),
            bowl.build("bowl", Pose((0.1, 0.0, 0.41 + bowl.rest_height))),
            _cube("cube", 0.44, x=0.0),
        )
    )
    rested = settled(scene, backend)
    # Exact to twice what a way out is found to, for shapes are drawn in by half of the depth.
    assert not list(overlaps(rested, depth=5e-6))
    moved = {each.name: each.pose.position for each in rested.objects}
    assert moved["cube"][2] == pytest.approx(0.425, abs=2e-4)
