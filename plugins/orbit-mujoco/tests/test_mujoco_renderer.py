"""What is MuJoCo's own about its renderer: settings, markers, contexts, and taking leave quietly."""

from __future__ import annotations

import ctypes.util
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.scene import (
    Box,
    CameraSpec,
    Channel,
    MarkerShape,
    MarkerSpec,
    Mesh,
    ObjectSpec,
    Plane,
    Scene,
    Shape,
    look_at,
    single_link,
)
from orbit_mujoco import MujocoConfig, renderer_context
from orbit_mujoco.renderer import MujocoRenderer

CAMERA = CameraSpec(name="camera", width=64, height=48, pose=look_at((0.8, 0, 0.8), (0, 0, 0)))
CAMERA_POSE = torch.tensor([(*CAMERA.pose.position, *CAMERA.pose.orientation)])
HERE = torch.tensor([[[0.0, 0, 0.1, 1, 0, 0, 0]]])


def scene(*markers: MarkerSpec, color: tuple[float, float, float, float] = (0.8, 0.2, 0.2, 1.0)) -> Scene:
    box = single_link("box", Shape(Box((0.1, 0.1, 0.1)), color=color), 1.0, np.eye(3) * 0.01)
    return Scene(objects=(ObjectSpec(name="box", articulation=box),), terrain=(Shape(Plane()),), markers=markers)


class Make:
    """Makes renderers and closes them."""

    def __init__(self) -> None:
        self.made: list[MujocoRenderer] = []

    def __call__(self, what: Scene, **settings: int) -> MujocoRenderer:
        self.made.append(MujocoRenderer(SceneLayout.of(what), (CAMERA,), MujocoConfig(**settings)))
        return self.made[-1]


@pytest.fixture
def make() -> Iterator[Make]:
    maker = Make()
    yield maker
    for renderer in maker.made:
        renderer.close()


def rgb(renderer: MujocoRenderer, markers: torch.Tensor | None = None) -> torch.Tensor:
    image = renderer.render(CAMERA, CAMERA_POSE, HERE, (Channel.RGB,), markers)
    assert image.rgb is not None
    return image.rgb[0].float()


def test_shadows_darken_and_can_be_left_out(make):
    lit, shaded = rgb(make(scene(), shadow_size=0)), rgb(make(scene()))
    # MuJoCo adds a shadowing light in a pass of its own, so where lights saturate the sum differs a little.
    assert (shaded - lit).max() < 10
    assert ((lit - shaded) > 20).any(-1).float().mean() > 0.005


def test_shadows_fall_whatever_the_range_of_the_camera():
    """A light's view of the scene must not end with that of a camera which sees but two metres."""
    pictures = []
    for far in (2.0, 20.0):
        camera = replace(CAMERA, far=far)
        renderer = MujocoRenderer(SceneLayout.of(scene()), (camera,), MujocoConfig())
        image = renderer.render(camera, CAMERA_POSE, HERE, (Channel.RGB, Channel.DEPTH))
        assert image.rgb is not None
        assert image.depth is not None
        pictures.append((image.rgb[0].float(), image.depth[0, ..., 0]))
        renderer.close()
    (near, depth), (far, _) = pictures
    seen = depth.isfinite()
    assert seen.float().mean() > 0.5
    assert ((near - far).abs().amax(-1)[seen] > 8).float().mean() < 0.003


def test_antialiasing_smooths_edges(make):
    hard, soft = rgb(make(scene(), shadow_size=0)), rgb(make(scene(), shadow_size=0, antialiasing=4))
    assert len(soft.reshape(-1, 3).unique(dim=0)) > len(hard.reshape(-1, 3).unique(dim=0))


@pytest.mark.parametrize("settings", [{}, {"antialiasing": 4}])
def test_depth_is_the_same_with_and_without_colour(make, settings):
    renderer = make(scene(), **settings)
    alone = renderer.render(CAMERA, CAMERA_POSE, HERE, (Channel.DEPTH,))
    together = renderer.render(CAMERA, CAMERA_POSE, HERE, (Channel.DEPTH, Channel.RGB))
    torch.testing.assert_close(alone.depth, together.depth)


def test_the_sky_hides_nothing_within_range_and_is_infinitely_far_with_colour_too(make):
    level = CameraSpec(name="level", width=64, height=48, pose=look_at((0.0, 0, 1.0), (1.0, 0, 1.0)), far=4.0)
    pose = torch.tensor([(*level.pose.position, *level.pose.orientation)])
    renderer = MujocoRenderer(SceneLayout.of(scene()), (level,), MujocoConfig())
    images = [renderer.render(level, pose, HERE, what) for what in ((Channel.DEPTH,), (Channel.DEPTH, Channel.RGB))]
    renderer.close()
    assert images[0].depth.isinf().any()
    assert images[0].depth[images[0].depth.isfinite()].max() > 3.5
    torch.testing.assert_close(images[1].depth, images[0].depth, atol=1e-3, rtol=1e-3)


def test_rays_and_rasteriser_agree(make):
    renderer = make(scene())
    cast = renderer.render(CAMERA, CAMERA_POSE, HERE, (Channel.DEPTH, Channel.INSTANCE, Channel.NORMALS))
    drawn = renderer.render(CAMERA, CAMERA_POSE, HERE, (Channel.DEPTH, Channel.INSTANCE))
    assert (cast.links == drawn.links).float().mean() > 0.998
    same = cast.links == drawn.links
    torch.testing.assert_close(cast.depth[same], drawn.depth[same], atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("shape", MarkerShape)
def test_markers_are_drawn_in_colour_alone(make, shape):
    renderer = make(scene(MarkerSpec("goal", shape, 0.3, (0.1, 0.9, 0.1, 1.0))))
    marker = torch.tensor([[[0.2, 0.2, 0.2, 1.0, 0, 0, 0]]])
    without, with_marker = rgb(renderer), rgb(renderer, marker)
    assert ((with_marker - without).abs() > 30).any(-1).sum() > 10
    torch.testing.assert_close(rgb(renderer), without)
    channels = (Channel.RGB, Channel.DEPTH, Channel.INSTANCE)
    plain = renderer.render(CAMERA, CAMERA_POSE, HERE, channels)
    marked = renderer.render(CAMERA, CAMERA_POSE, HERE, channels, marker)
    torch.testing.assert_close(marked.depth, plain.depth)
    assert torch.equal(marked.links, plain.links)
    depth_alone = renderer.render(CAMERA, CAMERA_POSE, HERE, channels[:2], marker)
    torch.testing.assert_close(depth_alone.depth, plain.depth)


def test_markers_cast_no_shadow(make):
    goal = scene(MarkerSpec("goal", MarkerShape.BOX, 0.2, (0.1, 0.9, 0.1, 1.0)))
    place = torch.tensor([[[0.0, 0.3, 0.4, 1.0, 0, 0, 0]]])
    lit, shaded = (make(goal, shadow_size=size) for size in (0, 2048))
    seen, seen_in_shadow = (((rgb(drawn, place) - rgb(drawn)).abs() > 20).any(-1) for drawn in (lit, shaded))
    assert seen.sum() > 50
    assert (seen_in_shadow & ~seen).sum() < 5


def test_a_transparent_shape_is_solid_to_depth(make):
    glass = make(scene(color=(0.8, 0.2, 0.2, 0.3)))
    solid = make(scene())
    channels = (Channel.RGB, Channel.DEPTH)
    seen = [renderer.render(CAMERA, CAMERA_POSE, HERE, channels) for renderer in (glass, solid)]
    torch.testing.assert_close(seen[0].depth, seen[1].depth)
    assert not torch.equal(seen[0].rgb, seen[1].rgb)


def test_the_middle_grey_of_a_shape_is_kept(make):
    grey, near = (rgb(make(scene(color=(value, value, value, 1.0)))) for value in (0.5, 0.502))
    assert (grey - near).abs().max() < 4


def test_open_and_large_meshes_are_drawn(make):
    grid = np.linspace(-0.4, 0.4, 200)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    corner = np.arange(199 * 200).reshape(199, 200)[:, :-1].ravel()
    faces = np.concatenate(
        (np.stack((corner, corner + 1, corner + 201), 1), np.stack((corner, corner + 201, corner + 200), 1))
    )
    sheet = Mesh(np.stack((x, y, 0.05 * np.sin(9 * x)), 1), faces)
    body = single_link("sheet", Shape(sheet), 1.0, np.eye(3) * 0.01)
    renderer = make(Scene(objects=(ObjectSpec(name="sheet", articulation=body),), terrain=()))
    image = renderer.render(CAMERA, CAMERA_POSE, HERE, (Channel.INSTANCE,))
    assert (image.links == 0).float().mean() > 0.2


def test_a_camera_larger_than_the_buffers_is_refused(make):
    renderer = make(scene())
    large = CameraSpec(name="large", width=65, height=48)
    with pytest.raises(ConfigurationError, match=r"'large' is larger .*64x48"):
        renderer.render(large, CAMERA_POSE, HERE, (Channel.RGB,))


def test_closing_twice_is_fine_and_drawing_afterwards_is_not(make):
    renderer = make(scene())
    renderer.close()
    renderer.close()
    with pytest.raises(ConfigurationError, match="closed"):
        rgb(renderer)


def test_two_renderers_take_turns(make):
    first, second = make(scene()), make(scene(color=(0.1, 0.1, 0.9, 1.0)))
    alone = rgb(first)
    assert not torch.equal(alone, rgb(second))
    assert torch.equal(alone, rgb(first))


def test_without_any_opengl_the_error_names_the_packages(monkeypatch):
    def missing(platform: str) -> type:
        raise ImportError(f"no lib{platform}")

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(renderer_context, "_context_class", missing)
    with pytest.raises(ConfigurationError, match=r"egl \(no libegl\); osmesa.*libegl1 and libegl-mesa0, or libosmesa6"):
        renderer_context.create_context(8, 8)


PROGRAM = """
import sys; sys.path.insert(0, {folder!r})
import test_mujoco_renderer as t
renderer = t.MujocoRenderer(t.SceneLayout.of(t.scene()), (t.CAMERA,), t.MujocoConfig())
print(int(t.rgb(renderer).mean()))
"""


WITH_OSMESA = pytest.mark.skipif(
    ctypes.util.find_library("OSMesa") is None, reason="OpenGL without EGL: no libOSMesa, which Mesa 25 has no more"
)


@pytest.mark.parametrize(
    "environment",
    [
        pytest.param({}, id="unset"),
        pytest.param({"MUJOCO_GL": "egl"}, id="egl"),
        pytest.param({"MUJOCO_GL": "osmesa"}, id="osmesa", marks=WITH_OSMESA),
        pytest.param({"MUJOCO_EGL_DEVICE_ID": "99"}, id="egl fails", marks=WITH_OSMESA),
    ],
)
def test_an_open_renderer_ends_with_its_program_without_a_word(environment, request, monkeypatch):
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    program = PROGRAM.format(folder=str(request.path.parent))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert 20 < int(done.stdout) < 240
