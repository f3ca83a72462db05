"""Whole scenes written as USD and read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_assets.objects import box, cabinet
from orbit_assets.scene_files import load_scene
from orbit_assets.usd.scene_writer import write_usd_scene
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    AmbientLight,
    CameraSpec,
    DirectionalLight,
    Finish,
    HeightField,
    Plane,
    Pose,
    Scene,
    Shape,
)
from orbit_core.world import simulate


def _scene() -> Scene:
    turned = Pose.from_euler(0.0, 0.0, 0.6, (1.0, 0.5, 0.0))
    objects = (
        box("block", (0.1, 0.1, 0.1), mass=0.5, pose=Pose((0.0, 0.0, 0.05))),
        box("block_2", (0.1, 0.1, 0.2), mass=0.5, pose=Pose((0.4, 0.0, 0.1))),
        replace(cabinet("kitchen_cabinet", pose=turned), home={"drawer_joint": 0.2}),
        box("wall", (0.1, 2.0, 2.0), pose=Pose((-1.0, 0.0, 1.0)), fixed_base=True),
    )
    lights = (AmbientLight((0.3, 0.3, 0.3)), DirectionalLight((0.2, 0.1, -1.0), shadows=False))
    return Scene(objects=objects, lights=lights, gravity=(0.0, 0.0, -3.7), physics_dt=0.002)


def test_a_scene_reads_back_with_names_poses_joints_light_and_gravity(tmp_path: Path):
    scene, path = _scene(), tmp_path / "room.usda"
    assert write_usd_scene(scene, path) == ()
    read = load_scene(path)
    assert {each.name for each in read.objects} == {each.name for each in scene.objects}
    found = {each.name: each for each in read.objects}
    for asked in scene.objects:
        got = found[asked.name]
        assert got.fixed_base == asked.fixed_base
        assert np.allclose(got.pose.matrix(), asked.pose.matrix(), atol=1e-6)
        assert got.articulation.joint_names == asked.articulation.joint_names
        assert got.articulation.mass == pytest.approx(asked.articulation.mass, rel=1e-6)
        labels = [link.semantic_label for link in got.articulation.links]
        assert all(labels)
    assert found["kitchen_cabinet"].home["drawer_joint"] == pytest.approx(0.2)
    assert read.gravity == pytest.approx(scene.gravity)
    assert read.physics_dt == pytest.approx(0.002)
    assert [isinstance(shape.geometry, Plane) for shape in read.terrain] == [True]
    (sun,) = read.directional_lights
    assert sun.unit_direction == pytest.approx(scene.directional_lights[0].unit_direction, abs=1e-6)
    assert not sun.shadows
    assert read.ambient == pytest.approx((0.3, 0.3, 0.3), abs=1e-6)


def test_a_scene_simulates_the_same_after_it_was_written_and_read(tmp_path: Path):
    scene, path = _scene(), tmp_path / "room.usdc"
    write_usd_scene(scene, path)
    worlds = [simulate(each, 1, "mujoco") for each in (scene, load_scene(path))]
    for world in worlds:
        world.step(50)
    for name in ("block", "block_2"):
        first, second = (world.objects[name].root_pose[0] for world in worlds)
        assert first[:3].tolist() == pytest.approx(second[:3].tolist(), abs=1e-4)
    for world in worlds:
        world.close()


def test_a_robot_keeps_its_drives_and_home(tmp_path: Path):
    robot = catalogue_robot("franka_panda")
    write_usd_scene(Scene(robots=(robot,)), tmp_path / "arm.usda")
    (read,) = load_scene(tmp_path / "arm.usda").robots
    assert read.name == robot.name
    assert read.fixed_base
    assert read.articulation.joint_names == robot.articulation.joint_names
    asked = {name: group.stiffness for group in robot.actuators for name in group.joints}  # pyright: ignore[reportAttributeAccessIssue]
    got = {name: group.stiffness for group in read.actuators for name in group.joints}  # pyright: ignore[reportAttributeAccessIssue]
    assert sorted(set(got.values())) == pytest.approx(sorted(set(asked.values())))
    assert read.home


def test_what_a_file_cannot_hold_is_told(tmp_path: Path):
    field = Shape(HeightField(np.zeros((3, 3)), (1.0, 1.0)), name="hill")
    shiny = box("shiny", (0.1, 0.1, 0.1))
    shapes = tuple(replace(shape, finish=Finish(roughness=0.2)) for shape in shiny.articulation.root.visuals)
    links = (replace(shiny.articulation.root, visuals=shapes),)
    shiny = replace(shiny, articulation=replace(shiny.articulation, links=links))
    scene = Scene(objects=(cabinet(), shiny), terrain=(field,), sensors=(CameraSpec(name="eye"),))
    lost = " ".join(write_usd_scene(scene, tmp_path / "scene.usda"))
    assert "1 sensors are left out: eye" in lost
    assert "shiny" not in lost, "finishes are written as preview surfaces"
    assert "height fields are written as meshes" in lost
    with pytest.raises(AssetError, match="name it"):
        write_usd_scene(scene, tmp_path / "scene.toml")
