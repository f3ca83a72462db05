"""What the viewer sends beside rigid links: cloth, and what cameras see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from viser import ViserServer

from orbit_assets.catalogue import robot
from orbit_assets.objects import box, sphere
from orbit_core.interfaces import SceneLayout
from orbit_core.scene import CameraSpec, Channel, Cloth, Fluid, Mesh, Scene
from orbit_core.sensors import CameraSensor
from orbit_viewer.scene_view import Frame, SceneView
from orbit_viewer.viewer import Viewer


class PaintedCamera(CameraSensor):
    """Sees a uniform grey, darker in each further environment."""

    def __init__(self) -> None:
        self.spec = CameraSpec(name="wrist", channels=(Channel.RGB, Channel.DEPTH))

    def image(self, channel: Channel) -> Tensor:
        value = torch.arange(4)[:, None, None, None].expand(4, 6, 8, 3)
        return (200 - 10 * value).to(torch.uint8)


@pytest.fixture
def server() -> Iterator[ViserServer]:
    server = ViserServer("127.0.0.1", 8170, verbose=False)
    yield server
    server.stop()


def test_the_panel_shows_what_the_chosen_environments_camera_sees(fakes: ModuleType) -> None:
    environment = fakes.FakeEnvironment(num_envs=4)
    environment.world.sensors = {"wrist": PaintedCamera()}
    with Viewer(environment, fakes.FakeAgent(), port=8170) as viewer:
        panel: Any = viewer._panel
        assert panel.pictures == ("wrist: rgb",)
        assert tuple(panel._picture_choice.options) == ("wrist: rgb", "wrist: depth", "all", "none")
        viewer.run(max_steps=1)
        assert (panel._pictures["wrist: rgb"].image == 200).all()
        viewer.controls.select(first=3)
        viewer.run(max_steps=1)
        assert panel._pictures["wrist: rgb"].image.shape == (6, 8, 3)
        assert (panel._pictures["wrist: rgb"].image == 170).all()


def test_the_panel_tells_of_the_chosen_environment(fakes: ModuleType) -> None:
    environment = fakes.FakeEnvironment(num_envs=4)
    agent, information = fakes.FakeAgent(), lambda index: {"height": f"{index} m"}
    with Viewer(environment, agent, port=8170, information=information) as viewer:
        viewer.controls.select(first=2)
        viewer.run(max_steps=3)
        panel: Any = viewer._panel
        assert "| height | 2 m |" in panel._status.content
        assert "| step | 3 |" in panel._status.content
        seconds, rewards = panel._plot.data
        assert np.allclose(seconds, [0.02, 0.04, 0.06])
        assert np.allclose(rewards, np.sin(np.array([1, 2, 3]) * 0.05))


def test_cloth_is_drawn_by_its_particles(server: ViserServer) -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
    cloth = Cloth("sheet", Mesh(vertices, np.array([[0, 1, 2]])), area_density=0.2)
    view = SceneView(server, SceneLayout.of(Scene(deformables=(cloth,))))
    links, markers = np.zeros((2, 0, 7), dtype=np.float32), np.zeros((2, 0, 7), dtype=np.float32)
    view.update(Frame(links, markers, (np.stack([vertices, vertices]),)))
    fallen = vertices - np.array([0, 0, 1], dtype=np.float32)
    view.update(Frame(links, markers, (np.stack([vertices, fallen]),)))
    first, second = view._particles_drawn[0]
    assert np.array_equal(first.vertices, vertices)
    assert np.array_equal(second.vertices, fallen)
    assert not np.array_equal(first.position, second.position), "environments stand apart"


def test_a_liquid_is_drawn_with_a_new_surface_in_each_frame(server: ViserServer) -> None:
    water = Fluid("water", (0.02, 0.02, 0.02), spacing=0.01)
    view = SceneView(server, SceneLayout.of(Scene(deformables=(water,))))
    links, markers = np.zeros((1, 0, 7), dtype=np.float32), np.zeros((1, 0, 7), dtype=np.float32)
    particles = water.rest_positions.astype(np.float32)
    view.update(Frame(links, markers, (particles[None],)))
    whole = view._particles_drawn[0][0].faces
    apart = particles.copy()
    apart[:32] += np.float32(0.5)
    view.update(Frame(links, markers, (apart[None],)))
    drawn = view._particles_drawn[0][0]
    assert len(drawn.faces) != len(whole)
    assert drawn.faces.max() == len(drawn.vertices) - 1
    assert (drawn.vertices > 0.4).all(axis=1).any()


def test_collision_shapes_replace_visual_ones(fakes: ModuleType, server: ViserServer) -> None:
    world = fakes.FakeEnvironment(num_envs=1).world
    view = SceneView(server, world.layout)
    frame = Frame(world.link_poses.numpy(), np.zeros((1, 2, 7), dtype=np.float32) + np.eye(7, dtype=np.float32)[3])
    view.update(frame)
    drawn = [handle for _, handle in view._bodies_drawn]
    view.show_collisions(True)
    view.show_markers(False)
    view.update(frame)
    assert len(view._bodies_drawn) == len(drawn)
    assert all(now is not before for (_, now), before in zip(view._bodies_drawn, drawn, strict=True))
    assert not any(handle.visible for handle in view._markers_drawn)


def test_axes_of_robots_are_drawn_by_one_switch(server: ViserServer) -> None:
    walker = robot("anymal_c")
    links = walker.articulation.link_names
    view = SceneView(server, SceneLayout.of(Scene(robots=(walker,))))
    poses = np.tile(np.array((0, 0, 0, 1, 0, 0, 0), dtype=np.float32), (2, len(links), 1))
    frame = Frame(poses, np.zeros((2, 0, 7), dtype=np.float32))
    view.update(frame)
    plain = len(view._bodies_drawn)
    view.show_frames(True)
    view.update(frame)
    marked = {links[body.link] for body, handle in view._bodies_drawn if "/frames/" in handle.name}
    assert marked == {"base", *(walker.articulation.frame(foot).link for foot in walker.feet)}
    view.show_frames(False)
    view.update(frame)
    assert len(view._bodies_drawn) == plain


def test_the_viewer_begins_with_axes_where_asked(fakes: ModuleType) -> None:
    with Viewer(fakes.FakeEnvironment(num_envs=1), fakes.FakeAgent(), port=8170, frames=True) as viewer:
        assert viewer.controls.selection.frames
        viewer.run(max_steps=1)


def test_each_environment_shows_its_own_variant(server: ViserServer) -> None:
    thing = replace(box("thing", (0.1, 0.1, 0.1)), variants=(sphere("thing", 0.1).articulation,))
    view = SceneView(server, SceneLayout.of(Scene(objects=(thing,))))
    links, markers = np.zeros((3, 1, 7), dtype=np.float32), np.zeros((3, 0, 7), dtype=np.float32)
    links[:, 0, 0] = (10, 20, 30)
    for first, shown in ((0, [[10, 30], [20]]), (1, [[20], [10, 30]])):
        view.update(Frame(links, markers, first=first))
        kinds = {body.kind: handle for body, handle in view._bodies_drawn}
        for kind, expected in enumerate(shown):
            offsets = view._offsets[[int(x / 10) - 1 for x in expected], 0]
            assert np.allclose(kinds[kind].batched_positions[:, 0] - offsets, expected)
