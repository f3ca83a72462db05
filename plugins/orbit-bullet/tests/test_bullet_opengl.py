"""Bullet's OpenGL next to other libraries that draw with EGL in the same process."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch

from orbit_bullet import BulletBackend, BulletConfig, opengl
from orbit_bullet.renderer import BulletRenderer
from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.scene import (
    Box,
    CameraSpec,
    Channel,
    Finish,
    ObjectSpec,
    Scene,
    Shape,
    Texture,
    look_at,
    single_link,
)

_ROUNDS = """
import threading
import torch
from mujoco.egl import GLContext
from OpenGL import EGL
from orbit_bullet import BulletBackend, BulletConfig
from orbit_core.interfaces import SceneLayout
from orbit_core.scene import Box, CameraSpec, Channel, ObjectSpec, Scene, Shape, look_at, single_link

camera = CameraSpec(name="eye", width=160, height=120, pose=look_at((0.6, 0.4, 0.5), (0, 0, 0)), near=0.1)
body = single_link("cube", Shape(Box((0.05, 0.05, 0.05))), 1.0, torch.eye(3).numpy())
layout = SceneLayout.of(Scene(objects=(ObjectSpec(name="cube", articulation=body),), sensors=(camera,)))
eye = torch.tensor([[*camera.pose.position, *camera.pose.orientation]])
poses = torch.tensor([[[0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]]])
pictures = []

def draw(renderer):
    pictures.append(renderer.render(camera, eye, poses, (Channel.RGB,)).rgb.float())

for number in range(12):
    other = GLContext(64, 64) if number % 2 else None
    renderer = BulletBackend().create_renderer(layout, (camera,), BulletConfig(renderer="egl"))
    other = other or GLContext(64, 64)
    other.make_current()
    current = EGL.eglGetCurrentContext().address
    draw(renderer)
    assert EGL.eglGetCurrentContext().address == current, "another library's context is no longer current"
    if number % 3:
        other.free()
        draw(renderer)
    if not number % 10:
        thread = threading.Thread(target=draw, args=(renderer,))
        thread.start()
        thread.join()
    renderer.close()
    if not number % 3:
        other.make_current()
        other.free()
assert all(((each - pictures[0]).abs() > 8.0).float().mean() < 0.01 for each in pictures)
print(len(pictures))
"""


@pytest.fixture(scope="module")
def _drawn() -> None:
    if not opengl.loads():
        pytest.skip("Bullet does not draw with OpenGL here")
    pytest.importorskip("mujoco.egl")


@pytest.mark.usefixtures("_drawn")
def test_opengl_renderers_draw_the_same_whichever_context_is_current() -> None:
    """Another library's context is made before or after, is current or gone, and threads without any draw too."""
    done = subprocess.run([sys.executable, "-c", _ROUNDS], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split(), done.stderr) == (0, ["22"], "")


def test_opengl_that_finds_no_device_is_an_error_and_not_the_end_of_the_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Bullet's plugin ends the process where EGL has no device."""
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nowhere.json")
    monkeypatch.setattr(opengl, "loads", opengl.loads.__wrapped__)
    monkeypatch.setattr(opengl, "_made", [])
    monkeypatch.setattr(opengl, "_free", [])
    with pytest.raises(ConfigurationError, match="its plugin does not load here"):
        BulletRenderer(SceneLayout.of(Scene()), (), BulletConfig(renderer="egl"))


@pytest.mark.usefixtures("_drawn")
@pytest.mark.parametrize("size", [(30, 21), (513, 700), (1024, 1024)])
def test_textures_of_any_size_keep_their_colours(size: tuple[int, int]) -> None:
    pixels = np.full((*size, 3), (200, 20, 20), np.uint8)
    camera = CameraSpec(name="eye", width=64, height=64, pose=look_at((0.4, 0.3, 0.3), (0, 0, 0)), near=0.1)
    shape = Shape(Box((0.1, 0.1, 0.1)), color=(1.0, 1.0, 1.0, 1.0), finish=Finish(texture=Texture(pixels)))
    body = ObjectSpec(name="cube", articulation=single_link("cube", shape, 1.0, np.eye(3)))
    layout = SceneLayout.of(Scene(objects=(body,), sensors=(camera,)))
    renderer = BulletBackend().create_renderer(layout, (camera,), BulletConfig(renderer="egl"))
    eye, poses = torch.tensor([[*camera.pose.position, *camera.pose.orientation]]), torch.eye(7)[None, 3:4]
    rgb = renderer.render(camera, eye, poses, (Channel.RGB,)).rgb
    renderer.close()
    assert rgb is not None
    red, green, blue = (rgb[0, 32, 32, axis].item() for axis in range(3))
    assert red > 4 * max(green, blue)
