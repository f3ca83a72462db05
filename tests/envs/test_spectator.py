"""Cameras of spectators: what they frame, how they follow, and the marks that tasks place for them."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import pytest
import torch

from orbit_assets.objects import box
from orbit_core.dynamics.transforms import quat_rotate, quat_rotate_inverse
from orbit_core.envs import make
from orbit_core.interfaces import SceneLayout, World
from orbit_core.mdp.common import ROBOT
from orbit_core.plugin_kit.meshes import marker_shapes
from orbit_core.rollout.framing import FIELD_OF_VIEW, FollowingCamera, framed
from orbit_core.scene import MarkerShape, MarkerSpec, Pose, Scene, ghost, look_at
from orbit_core.world import simulate
from orbit_tasks.velocity_flat import ARROW


def test_what_moves_fills_most_of_the_picture_and_what_is_fixed_does_not_count() -> None:
    table = box("table", (1.0, 1.0, 0.1), fixed_base=True, pose=Pose((0.0, 0.0, 0.05)))
    cube = box("cube", (0.3, 0.3, 0.3), pose=Pose((0.2, 0.1, 0.3)))
    world = simulate(Scene(objects=(table, cube)), 1, "mujoco")
    view = look_at(eye=(4.0, 3.0, 3.0), target=(0.0, 0.0, 0.0))
    for aspect in (4 / 3, 1.0):
        pose = framed(world, view, aspect)
        assert pose.orientation == view.orientation
        signs = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
        corners = torch.tensor((0.2, 0.1, 0.3)) + 0.15 * signs - torch.tensor(pose.position)
        local = quat_rotate_inverse(torch.tensor(pose.orientation).expand(8, 4), corners)
        up = math.tan(0.5 * FIELD_OF_VIEW)
        across = float((local[:, 0] / -local[:, 2]).abs().max()) / (up * aspect)
        height = float((local[:, 1] / -local[:, 2]).abs().max()) / up
        assert max(across, height) == pytest.approx(0.7, abs=1e-3)
    empty = simulate(Scene(objects=(table,)), 1, "mujoco")
    assert framed(empty, view, 1.0) == view
    for each in (world, empty):
        each.close()


def test_a_small_fixed_object_is_in_the_picture_too() -> None:
    cube = box("cube", (0.1, 0.1, 0.1), pose=Pose((0.0, 0.0, 0.05)))
    view = look_at(eye=(0.0, -3.0, 1.0), target=(0.0, 0.0, 0.0))
    places: list[float] = []
    for size in (0.3, 1.0):
        bin_ = box("bin", (size, size, 0.2), fixed_base=True, pose=Pose((1.0, 0.0, 0.1)))
        world = simulate(Scene(objects=(cube, bin_)), 1, "mujoco")
        places.append(framed(world, view, 1.0).position[0])
        world.close()
    assert places[0] > 0.4, "between the cube and the bin"
    assert abs(places[1]) < 1e-3, "a table is what things are on"


def test_a_drop_that_flew_off_does_not_widen_the_picture() -> None:
    spread = 0.1 * torch.rand(1, 500, 3, generator=torch.Generator().manual_seed(0))
    far = spread.clone()
    far[0, :3] += 5.0

    def distance(points: torch.Tensor) -> float:
        water = SimpleNamespace(positions=points)
        world = SimpleNamespace(
            layout=SceneLayout.of(Scene()),
            link_poses=torch.zeros(1, 0, 7),
            marker_poses=torch.zeros(1, 0, 7),
            deformables={"water": water},
        )
        return math.dist(
            framed(cast(World, world), look_at((0.0, -3.0, 1.0), (0.0, 0.0, 0.0)), 1.0).position, (0, 0, 0)
        )

    assert distance(far) == pytest.approx(distance(spread), rel=0.05)


def test_a_following_camera_lags_by_its_time_constant_and_jumps_when_an_episode_begins_again() -> None:
    cube = box("cube", (0.1, 0.1, 0.1), pose=Pose((0.0, 0.0, 0.05)))
    world = simulate(Scene(objects=(cube,)), 2, "mujoco")
    thing = world.objects["cube"]
    camera = FollowingCamera(world, "cube", Pose((-2.0, 0.0, 1.0)))
    pose = thing.root_pose.clone()
    for _ in range(200):
        pose[0, 0] += 0.02  # 1 m/s at 50 Hz
        thing.set_root_pose(pose)
        seen = camera.poses(0.02)
    # A critically damped spring trails a steady speed by twice its time constant.
    assert float(pose[0, 0] - 2.0 - seen[0, 0]) == pytest.approx(2 * 0.2 * 1.0, abs=0.03)
    torch.testing.assert_close(seen[1, :3], torch.tensor([-2.0, 0.0, 1.0]), atol=1e-4, rtol=0.0)
    assert (seen[:, 3:] == torch.tensor([1.0, 0.0, 0.0, 0.0])).all()
    pose[0, 0] = -3.0
    thing.set_root_pose(pose)
    assert float(camera.poses(0.02)[0, 0]) == pytest.approx(-5.0, abs=1e-4)
    world.close()


def test_the_arrow_of_a_commanded_velocity_points_along_it_and_is_gone_where_the_robot_shall_stand() -> None:
    environment = make("Velocity-Flat", 3, "mujoco", seed=0)
    environment.reset()
    wanted = torch.tensor([[0.5, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.3]])
    environment.commands["velocity"][:, :3] = wanted
    environment.task.mark(environment)
    arrow, root = environment.world.markers[ARROW].pose, environment.world.robots[ROBOT].root_pose
    ahead = quat_rotate(arrow[:2, 3:], torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3))
    own = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    along = quat_rotate(root[:2, 3:], own)
    assert ((ahead * along).sum(1) > 0.95).all()
    assert (arrow[:2, 2] > root[:2, 2]).all()
    assert arrow[2, 2] < -100.0
    environment.close()


def test_a_ghost_is_the_object_seen_through() -> None:
    thing = box("thing", (0.1, 0.2, 0.3), color=(0.9, 0.1, 0.1, 1.0))
    plain = marker_shapes(ghost("goal", thing, opacity=0.3))
    (seen,) = plain
    assert seen.geometry == thing.articulation.root.visuals[0].geometry
    assert seen.color == (0.9, 0.1, 0.1, 0.3)
    assert len(marker_shapes(ghost("goal", thing, axes=0.1))) == 1 + len(
        marker_shapes(MarkerSpec("axes", MarkerShape.FRAME, 0.1))
    )
