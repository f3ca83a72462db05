"""Axes stand where a robot's frames are, and change nothing but looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orbit_assets.catalogue import robot
from orbit_core.backends import default_backend
from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.meshes import AXIS_COLORS
from orbit_core.rollout.pictures import OverviewCamera
from orbit_core.scene import Frame, Pose, RobotSpec, Scene
from orbit_core.world import simulate
from orbit_core.world.drawing import frame_lengths, frame_shapes, with_frames


def test_base_end_effectors_finger_tips_feet_and_wheels_have_axes() -> None:
    arm = robot("ur5+robotiq_2f85")
    tips = ("robotiq_85_left_finger_tip_link", "robotiq_85_right_finger_tip_link")
    hand = replace(arm, end_effectors=(replace(arm.end_effector, finger_tips=tips),), wheels=("wrist_1_link",))
    assert set(frame_lengths(hand)) == {"base_link", "robotiq_85_tcp", *tips, "wrist_1_link"}
    walker = robot("unitree_go2")
    assert set(frame_lengths(walker)) == {walker.base_link, *walker.feet}


def test_axes_stand_in_their_frame_on_its_link() -> None:
    arm = robot("ur5")
    place = Pose.from_euler(0.3, -0.2, 1.0, (0.1, 0.2, 0.3))
    body = replace(arm.articulation, frames=(*arm.articulation.frames, Frame("tip", "forearm_link", place)))
    spec = replace(arm, articulation=body, end_effectors=(replace(arm.end_effector, frame="tip"),))
    shapes = frame_shapes(spec)["forearm_link"]
    ends = {shape.color[:3]: shape.pose.position for shape in shapes}  # of each axis, its arrow's head comes last
    for column, color in enumerate(AXIS_COLORS):
        along = np.asarray(ends[color]) - place.position
        along /= np.linalg.norm(along)
        assert along == pytest.approx(place.rotation_matrix()[:, column], abs=1e-9)


def test_only_looks_change_and_nothing_seen_is_lost() -> None:
    plain = SceneLayout.of(Scene(robots=(bare("unitree_go2"),)))
    marked = with_frames(plain)
    axes = frame_shapes(plain.scene.robots[0])
    for link, before in zip(marked.links, plain.links, strict=True):
        assert link.collisions == before.collisions
        assert link.mass == before.mass
        if link.name in axes:
            assert link.visuals == (*before.collisions, *axes[link.name])
        else:
            assert link is before


def bare(name: str) -> RobotSpec:
    """A robot without visual shapes, whose collision shapes are drawn in their place."""
    spec = robot(name)
    links = tuple(replace(link, visuals=()) for link in spec.articulation.links)
    return replace(spec, articulation=replace(spec.articulation, links=links))


def test_pictures_show_axes_where_asked() -> None:
    world = simulate(Scene(robots=(robot("unitree_go2"),)), 1, default_backend())
    pictures = []
    for frames in (False, True):
        camera = OverviewCamera(world, 64, 48, Pose.from_euler(1.2, 0.0, 0.0, (0.0, -1.0, 0.6)), frames)
        pictures.append(camera.pictures().int())
        camera.close()
    world.close()
    changed = (pictures[0] - pictures[1]).abs().amax(-1) > 40
    assert 10 < int(changed.sum()) < changed.numel() / 2
