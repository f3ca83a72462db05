"""Colours and textures of links per environment, in the pictures of every renderer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_assets.objects import box
from orbit_assets.textures import checker, stripes, texture_file
from orbit_core.backends import backend as find_backend
from orbit_core.backends import backend_names
from orbit_core.envs import EventTerm, EventTime, make
from orbit_core.interfaces import (
    ArgumentError,
    AssetError,
    Capability,
    ConfigurationError,
    UnsupportedCapabilityError,
    World,
)
from orbit_core.mdp import randomize
from orbit_core.scene import CameraSpec, Channel, Pose, Scene, Texture, look_at
from orbit_core.sensors import CameraSensor
from orbit_core.world import simulate
from orbit_tasks.lift import Lift

GREEN = (0.1, 0.9, 0.1, 1.0)
CAMERA = CameraSpec(
    name="eye",
    pose=look_at(eye=(0.0, -0.01, 2.0), target=(0.0, 0.0, 0.0)),
    width=48,
    height=48,
    channels=(Channel.RGB, Channel.ALBEDO),
)


def boxes(backend: str) -> World:
    """Two boxes side by side, seen from above, in three environments."""
    size = (0.4, 0.4, 0.1)
    left = box("left", size, fixed_base=True, pose=Pose((-0.4, 0.0, 0.05)))
    right = box("right", size, fixed_base=True, color=GREEN, pose=Pose((0.4, 0.0, 0.05)))
    return simulate(Scene(objects=(left, right), sensors=(CAMERA,)), 3, backend)


def seen(world: World) -> dict[Channel, Tensor]:
    """(3, 2, 3) of the middles of both boxes, left and right, in [0, 1]."""
    world.step(1)
    camera = world.sensors["eye"]
    assert isinstance(camera, CameraSensor)
    return {channel: middles(camera.image(channel).float() / 255.0) for channel in CAMERA.channels}


def middles(pictures: Tensor) -> Tensor:
    """(3, 2, 3) of pictures (3, H, W, 3)."""
    return pictures[:, 24][:, [14, 33]]


@pytest.mark.parametrize("backend", backend_names())
def test_a_link_has_its_own_colour_in_each_environment(backend: str) -> None:
    for needed in (Capability.RGB, Capability.ALBEDO, Capability.COLORS_PER_ENVIRONMENT):
        if not (support := find_backend(backend).capabilities()).has(needed):
            pytest.skip(f"{needed.value}: {support[needed].reason}")
    world = boxes(backend)
    own = seen(world)
    red, blue = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    world.objects["left"].set_colors(torch.tensor([[red], [blue]]), env_ids=torch.tensor([2, 0]))
    painted = seen(world)
    albedo = own[Channel.ALBEDO].clone()
    albedo[2, 0], albedo[0, 0] = torch.tensor(red), torch.tensor(blue)
    torch.testing.assert_close(painted[Channel.ALBEDO], albedo, atol=0.01, rtol=0.0)
    rgb = painted[Channel.RGB]
    assert rgb[2, 0].argmax() == 0
    assert rgb[0, 0].argmax() == 2
    assert (rgb[[2, 0], 0].amax(1) > rgb[[2, 0], 0].median(1).values + 0.2).all()
    # What was not painted looks as before.
    torch.testing.assert_close(rgb[1], own[Channel.RGB][1], atol=0.02, rtol=0.0)
    torch.testing.assert_close(rgb[:, 1], own[Channel.RGB][:, 1], atol=0.02, rtol=0.0)
    with pytest.raises(ArgumentError, match="colours of 'left'"):
        world.objects["left"].set_colors(torch.full((3, 1, 3), 1.5))
    check_textures(world, painted)
    world.close()


def check_textures(world: World, plain: dict[Channel, Tensor]) -> None:
    """A box of 0.4 m wears a picture of 0.4 m whose middle is the frame's origin: red on the left, black above."""
    if not find_backend(world.backend).capabilities().has(Capability.NORMALS):
        return
    pixels = np.full((2, 2, 3), 255, np.uint8)
    pixels[:, 0] = 255, 0, 0
    pixels[0] = 0
    picture, other = Texture(pixels, 0.4), checker()
    world.objects["left"].set_textures((other, picture), torch.tensor([[1]]), env_ids=torch.tensor([1]))
    world.step(1)
    camera = world.sensors["eye"]
    assert isinstance(camera, CameraSensor)
    albedo = camera.image(Channel.ALBEDO).float() / 255.0
    own = plain[Channel.ALBEDO][1, 0]
    # The left box spans columns 9 to 19 of 48 and rows 19 to 28, and its frame's origin is its middle.
    torch.testing.assert_close(albedo[1, 27, 10], torch.stack((own[0], own[0] * 0, own[0] * 0)), atol=0.02, rtol=0.0)
    torch.testing.assert_close(albedo[1, 27, 17], own, atol=0.02, rtol=0.0)
    assert albedo[1, 20:22, 10:18].max() < 0.02
    rgb = camera.image(Channel.RGB).float() / 255.0
    assert rgb[1, 27, 10, 0] > 0.2 > 0.02 > rgb[1, 27, 10, 1]
    for environment, side in ((0, 0), (2, 0), (1, 1)):
        same = middles(albedo)[environment, side]
        torch.testing.assert_close(same, plain[Channel.ALBEDO][environment, side], atol=0.01, rtol=0.0)
    with pytest.raises(ArgumentError, match="textures of 'left' are indices from -1 to 0, not"):
        world.objects["left"].set_textures((picture,), torch.ones(3, 1, dtype=torch.int64))


def test_colours_are_drawn_for_each_environment_and_refused_where_no_renderer_has_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task = Lift()
    task.events.cube_mass = EventTerm(randomize.colors(("cube",), low=(0.5, 0.0, 0.0)), EventTime.STARTUP)
    task.events.friction = EventTerm(randomize.textures(("cube",), (checker(), stripes())), EventTime.STARTUP)
    environment = make(task, 6, "mujoco", seed=0)
    textures = environment.world.painting.textures  # pyright: ignore[reportAttributeAccessIssue]
    assert textures is not None
    assert set(textures.chosen.flatten().tolist()) == {-1, 0, 1}
    colors = environment.world.renderer.link_colors
    assert colors is not None
    holding = colors[:, colors[0, :, 3] > 0.0]
    assert holding.shape == (6, 1, 4)
    assert len({tuple(color) for color in holding[:, 0].tolist()}) == 6
    assert (holding[..., 0] >= 0.5).all()
    declared = environment.world._renderer_plugin.capabilities().declared  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.delitem(declared, Capability.COLORS_PER_ENVIRONMENT)
    with pytest.raises(UnsupportedCapabilityError, match=r"colours of 'cube'.*choose renderer '"):
        environment.world.objects["cube"].set_colors(torch.zeros(6, 1, 3))
    monkeypatch.delitem(declared, Capability.NORMALS)
    with pytest.raises(UnsupportedCapabilityError, match=r"textures of 'cube'.*choose renderer '"):
        environment.world.objects["cube"].set_textures((checker(),), torch.zeros(6, 1, dtype=torch.int64))
    environment.close()


def test_a_file_that_is_no_texture_is_told_by_name(tmp_path: Path) -> None:
    (tmp_path / "cut.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(20))
    for name in ("cut.png", "missing.png"):
        with pytest.raises(AssetError, match=rf"texture '.*{name}' cannot be read"):
            texture_file(tmp_path / name)
    with pytest.raises(ValueError, match=r"uint8, not \(4, 4\) of float64"):
        Texture(np.zeros((4, 4)))  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match="needs one texture at least"):
        randomize.textures(("cube",), ())
