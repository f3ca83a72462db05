"""Cameras of rays against a renderer, and event cameras against the closed form of a moving edge."""

from __future__ import annotations

import math
from typing import cast

import pytest
import torch
from torch import Tensor

from orbit_assets.objects import box, sphere
from orbit_core.interfaces import World, required_capabilities
from orbit_core.interfaces.capabilities import Capability
from orbit_core.scene import (
    AmbientLight,
    CameraSpec,
    Channel,
    EventCameraSpec,
    Noise,
    Plane,
    Pose,
    RayCameraSpec,
    Scene,
    Shape,
    look_at,
)
from orbit_core.sensors import CameraSensor, EventCamera, RayCamera
from orbit_core.world import simulate

EYE = look_at((1.2, -0.9, 0.8), (0.0, 0.0, 0.1))
CHANNELS = (Channel.DEPTH, Channel.POSITION, Channel.NORMALS, Channel.INSTANCE, Channel.SEMANTIC)


def pictures(world: World, name: str) -> CameraSensor:
    """Return a camera of the world."""
    return cast(CameraSensor, world.sensors[name])


def test_a_ray_camera_sees_what_is_drawn():
    drawn = CameraSpec(name="drawn", width=40, height=30, channels=CHANNELS, pose=EYE)
    rays = RayCameraSpec(name="rays", width=40, height=30, channels=CHANNELS, pose=EYE)
    things = (
        box("crate", (0.3, 0.2, 0.25), pose=Pose((0.0, 0.0, 0.125)), fixed_base=True),
        sphere("ball", 0.1, pose=Pose((0.3, -0.2, 0.1)), fixed_base=True),
    )
    world = simulate(Scene(objects=things, terrain=(Shape(Plane()),), sensors=(drawn, rays)), 2, "mujoco")
    one, other = pictures(world, "drawn"), pictures(world, "rays")
    assert isinstance(other, RayCamera)
    # Along outlines a pixel's middle may fall on either side.
    same = one.image(Channel.INSTANCE) == other.image(Channel.INSTANCE)
    assert same.float().mean() > 0.99
    same &= (one.image(Channel.NORMALS) * other.image(Channel.NORMALS)).sum(-1, keepdim=True) > 0.98
    assert same.float().mean() > 0.95
    depths = one.image(Channel.DEPTH)[same], other.image(Channel.DEPTH)[same]
    assert torch.allclose(*depths, atol=4e-3)
    assert torch.equal(one.image(Channel.SEMANTIC)[same], other.image(Channel.SEMANTIC)[same])
    assert torch.allclose(other.point_cloud()[0, 15, 20], one.point_cloud()[0, 15, 20], atol=4e-3)
    world.close()


def test_a_ray_camera_keeps_its_planes_and_looks_through_what_carries_it():
    near = RayCameraSpec(name="near", width=4, height=4, near=0.3, entity="head", frame="head")
    far = RayCameraSpec(name="far", width=4, height=4, far=0.5, entity="head", frame="head")
    # The head looks down (-z) from 0.6 m upon the ground, with a plate 0.2 m below itself.
    head = box("head", (0.2, 0.2, 0.2), pose=Pose((0.0, 0.0, 0.6)), fixed_base=True)
    plate = box("plate", (1.0, 1.0, 0.02), pose=Pose((0.0, 0.0, 0.39)), fixed_base=True)
    world = simulate(Scene(objects=(head, plate), terrain=(Shape(Plane()),), sensors=(near, far)), 1, "mujoco")
    assert torch.allclose(pictures(world, "near").image(Channel.DEPTH), torch.tensor(0.6), atol=1e-4)
    assert torch.allclose(pictures(world, "far").image(Channel.DEPTH), torch.tensor(0.2), atol=1e-4)
    world.objects["plate"].set_root_pose(torch.tensor([[5.0, 0.0, 0.39, 1.0, 0.0, 0.0, 0.0]]))
    world.step()
    assert pictures(world, "far").image(Channel.DEPTH).isinf().all()
    world.close()


def test_a_ray_camera_needs_rays_and_no_renderer():
    spec = RayCameraSpec(name="rays", channels=(Channel.DEPTH, Channel.INSTANCE))
    assert set(required_capabilities(Scene(sensors=(spec,)))) == {Capability.RAY_CASTS}
    with pytest.raises(ValueError, match="ray camera 'rays' sees no colours"):
        RayCameraSpec(name="rays", channels=(Channel.RGB,))


# Grey that a white face has under ambient light of this strength only, whatever its direction.
DARK, LIGHT = 0.2, 0.8
SPEED, WIDE, FAR, PIXELS = 0.6, 0.5, 1.0, 64


def moving_edge(threshold: float, rate: float = 50.0) -> tuple[World, EventCamera]:
    """Return a dark plate that moves along x over a bright one, seen from above, and its event camera."""
    camera = EventCameraSpec(
        name="eye", width=PIXELS, height=4, vertical_fov=2.0 * math.atan(0.5 * WIDE * 4 / PIXELS / FAR), rate=rate,
        pose=Pose((0.0, 0.0, FAR + 0.01)), threshold=threshold,
    )  # fmt: skip
    ground = box(
        "ground", (4.0, 4.0, 0.01), pose=Pose((0.0, 0.0, -0.025)), color=(LIGHT,) * 3 + (1.0,), fixed_base=True
    )
    plate = box("plate", (1.0, 1.0, 0.01), pose=Pose((-0.5, 0.0, 0.005)), color=(DARK,) * 3 + (1.0,), fixed_base=True)
    lights = (AmbientLight((1.0, 1.0, 1.0)),)
    world = simulate(Scene(objects=(ground, plate), lights=lights, sensors=(camera,), physics_dt=0.01), 2, "mujoco")
    return world, cast(EventCamera, world.sensors["eye"])


def brightness(world: World) -> Tensor:
    """Return the colours (N, W) of the picture's second row now."""
    return cast(CameraSensor, world.sensors["eye"]).image(Channel.RGB)[:, 1, :, 0].float()


@pytest.mark.parametrize("threshold", [0.1, 0.2, 0.5])
def test_a_dark_edge_makes_events_where_it_passes_as_many_as_thresholds_fit(threshold: float):
    world, camera = moving_edge(threshold)
    plate = world.objects["plate"]
    assert not camera.events.any()
    before, total, first, x = brightness(world), torch.zeros(2, PIXELS), -0.5, -0.5
    for _ in range(10):
        x += SPEED / 50.0
        plate.set_root_pose(torch.tensor([[x, 0.0, 0.005, 1.0, 0.0, 0.0, 0.0]]).expand(2, 7))
        world.step(2)
        # The edge, half a metre ahead of the plate's middle, has passed some columns; only they have events.
        passed = torch.nonzero(camera.events[0, 1]).flatten()
        edge = (x + 0.5) / WIDE * PIXELS + 0.5 * PIXELS
        assert len(passed)
        assert (passed.float() + 0.5 - edge).abs().max() < SPEED / 50.0 / WIDE * PIXELS + 1.5
        assert (camera.polarity[0, 1, passed] == -1).all()
        total += camera.events[:, 1]
    after = brightness(world)
    change = torch.log((after + 5.0) / (before + 5.0)) / threshold
    # Each event is a whole threshold: the sum is the logarithm's change, but for a rest below one.
    assert torch.equal(total, torch.trunc(change))
    swept = slice(round(0.5 * PIXELS) + 1, round(0.5 * PIXELS + (x - first) / WIDE * PIXELS) - 1)
    grey = before[0, -1], after[0, 0]
    assert (total[:, swept] == math.trunc(math.log(float(grey[1] + 5) / float(grey[0] + 5)) / threshold)).all()
    assert not total[:, : PIXELS // 2 - 2].any()
    assert not total[:, -8:].any()
    world.close()


def test_an_environment_that_begins_again_has_no_events():
    world, camera = moving_edge(0.2)
    plate = world.objects["plate"]
    world.step(2)
    plate.set_root_pose(torch.tensor([[-0.4, 0.0, 0.005, 1.0, 0.0, 0.0, 0.0]]).expand(2, 7))
    world.reset(torch.tensor([1]))
    plate.set_root_pose(torch.tensor([[-0.4, 0.0, 0.005, 1.0, 0.0, 0.0, 0.0]]).expand(2, 7))
    world.step(2)
    assert camera.events[0].any()
    assert not camera.events[1].any()
    world.step(2)
    assert not camera.events.any()
    world.close()


def test_what_no_event_camera_can_be_is_refused():
    for fields in ({"threshold": 0.0}, {"channels": (Channel.DEPTH,)}, {"noise": Noise(std=0.1)}):
        with pytest.raises(ValueError, match="event camera 'eye'"):
            EventCameraSpec(name="eye", **fields)  # pyright: ignore[reportArgumentType]
