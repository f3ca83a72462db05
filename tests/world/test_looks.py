"""Textures, lights and cameras of environments in pictures, on every renderer that has them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.objects import box
from orbit_core.backends import backend as find_backend
from orbit_core.backends import backend_names
from orbit_core.envs import EventTerm, EventTime, make
from orbit_core.interfaces import (
    Capability,
    ConfigurationError,
    LightTable,
    UnknownNameError,
    UnsupportedCapabilityError,
    World,
)
from orbit_core.mdp import randomize
from orbit_core.mdp.randomize import Range
from orbit_core.scene import (
    STUDIO,
    AmbientLight,
    Box,
    CameraSpec,
    Channel,
    DirectionalLight,
    Finish,
    Plane,
    Pose,
    Scene,
    Shape,
    Texture,
    look_at,
)
from orbit_core.scene.patterns import concrete, grid, wood
from orbit_core.sensors import CameraSensor
from orbit_core.world import simulate
from orbit_core.world.studio import dressed
from orbit_tasks.lift import Lift

EYE = CameraSpec(
    name="eye", width=48, height=48, pose=look_at(eye=(0.0, -0.01, 2.0), target=(0.0, 0.0, 0.0)),
    channels=(Channel.RGB, Channel.DEPTH),
)  # fmt: skip
DRAWING = [name for name in backend_names() if find_backend(name).capabilities().has(Capability.TEXTURES)]
SUN = DirectionalLight((0.0, 0.0, -1.0), (1.0, 1.0, 1.0), 0.5, shadows=False)


def camera(world: World) -> CameraSensor:
    """The camera after a step."""
    world.step(1)
    sensor = world.sensors["eye"]
    assert isinstance(sensor, CameraSensor)
    return sensor


def quarters() -> Texture:
    """A picture of a metre: red, green above blue, black."""
    pixels = np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (0, 0, 0)]], np.uint8)
    return Texture(pixels.repeat(64, 0).repeat(64, 1), 1.0)


@pytest.mark.parametrize("backend", DRAWING)
def test_a_texture_lies_alike_on_ground_and_on_a_box(backend: str) -> None:
    finish = Finish(texture=quarters())
    ground = Shape(Plane(), color=(1.0, 1.0, 1.0, 1.0), finish=finish)
    slab = Shape(Box((0.45, 0.45, 0.05)), Pose((0.0, 0.0, 0.05)), color=(1.0, 1.0, 1.0, 1.0), finish=finish)
    for terrain in ((ground,), (ground, slab)):
        scene = Scene(terrain=terrain, sensors=(EYE,), lights=(AmbientLight((0.8, 0.8, 0.8)),))
        world = simulate(scene, 1, backend)
        seen = camera(world).image(Channel.RGB)[0]
        # Seen from above, x to the right and y up; the picture's middle is the origin.
        corners = seen[[16, 16, 31, 31], [16, 31, 16, 31]].float()
        wanted = 204.0 * torch.tensor([(1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0), (0, 0, 0)])
        torch.testing.assert_close(corners, wanted, atol=4.0, rtol=0.0)
        world.close()


@pytest.mark.parametrize("renderer", [*DRAWING, *(f"sapien-{tier}" for tier in ("pbr", "rt") if "sapien" in DRAWING)])
def test_a_texture_multiplies_the_colour_that_an_environment_gives_a_link(renderer: str) -> None:
    slab = box("slab", (0.9, 0.9, 0.1), color=(1.0, 1.0, 1.0, 1.0), fixed_base=True, pose=Pose((0.0, 0.0, 0.05)))
    (link,) = slab.articulation.links
    finish = Finish(texture=quarters())
    seen_as = tuple(replace(shape, finish=finish) for shape in link.visuals or link.collisions)
    textured = replace(slab, articulation=replace(slab.articulation, links=(replace(link, visuals=seen_as),)))
    eye = replace(EYE, channels=(Channel.RGB, Channel.ALBEDO))
    scene = Scene(objects=(textured,), sensors=(eye,), lights=(AmbientLight((0.8, 0.8, 0.8)),))
    backend = renderer if renderer in DRAWING else "mujoco"
    world = simulate(scene, 2, backend, renderer=None if renderer in DRAWING else renderer)
    world.objects["slab"].set_colors(torch.tensor([[[0.5, 0.25, 1.0]]]), env_ids=torch.tensor([1]))
    sensor = camera(world)
    # Two places on each side of the picture's middle: red, green above blue, black.
    rgb, albedo = (
        sensor.image(channel)[:, [16, 16, 31, 31], [16, 31, 16, 31]].float()
        for channel in (Channel.RGB, Channel.ALBEDO)
    )
    own = torch.tensor([(1.0, 1.0, 1.0), (0.5, 0.25, 1.0)])[:, None]
    torch.testing.assert_close(albedo, (255.0 * own).expand_as(albedo), atol=3.0, rtol=0.0)
    texture = torch.tensor([(1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0), (0, 0, 0)])
    if renderer in DRAWING:
        torch.testing.assert_close(rgb, 204.0 * own * texture, atol=4.0, rtol=0.0)
    else:  # the other tiers' light is their own
        red, green, blue = (rgb[:, place, channel] for place, channel in ((0, 0), (1, 1), (2, 2)))
        assert red[1] < 0.75 * red[0]
        assert green[1] < 0.6 * green[0]
        torch.testing.assert_close(blue[1], blue[0], atol=12.0, rtol=0.1)
    world.close()


@pytest.mark.parametrize("backend", DRAWING)
def test_each_environment_has_its_own_lights(backend: str) -> None:
    ground = Shape(Plane(), color=(1.0, 1.0, 1.0, 1.0))
    scene = Scene(terrain=(ground,), sensors=(EYE,), lights=(AmbientLight((0.2, 0.2, 0.2)), SUN))
    world = simulate(scene, 3, backend)
    before = camera(world).image(Channel.RGB).float()[:, 24, 24]
    own = world.nominal_lights
    slanted = torch.tensor([[[0.0, 0.8, -0.6]]])
    red = LightTable(torch.tensor([[0.1, 0.2, 0.3]]), slanted, torch.tensor([[[0.5, 0.0, 0.0]]]))
    world.set_lights(red, torch.tensor([1]))
    after = camera(world).image(Channel.RGB).float()[:, 24, 24]
    torch.testing.assert_close(after[[0, 2]], before[[0, 2]], atol=1.0, rtol=0.0)
    torch.testing.assert_close(after[1], 255.0 * torch.tensor([0.4, 0.2, 0.3]), atol=2.0, rtol=0.0)
    world.set_lights(own.rows(torch.tensor([1])), torch.tensor([1]))
    torch.testing.assert_close(camera(world).image(Channel.RGB).float()[:, 24, 24], before, atol=1.0, rtol=0.0)
    world.close()


def test_lights_of_environments_are_refused_where_a_renderer_lacks_them(monkeypatch: pytest.MonkeyPatch) -> None:
    world = simulate(Scene(sensors=(EYE,)), 1, "mujoco")
    declared = world._renderer_plugin.capabilities().declared  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.delitem(declared, Capability.LIGHTS_PER_ENVIRONMENT)
    with pytest.raises(UnsupportedCapabilityError, match="lights of environments"):
        world.set_lights(world.nominal_lights)
    world.close()


def test_a_camera_is_displaced_and_zoomed_in_each_environment() -> None:
    post = box("post", (0.5, 0.5, 0.2), fixed_base=True, pose=Pose((0.0, 0.0, 0.1)))
    world = simulate(Scene(objects=(post,), sensors=(EYE,)), 3, "mujoco")
    eye = camera(world)
    plain = (eye.image(Channel.DEPTH)[..., 0] < 1.9).sum((1, 2))
    eye.displace(torch.tensor([[0.0, 0.0, -0.5, 1.0, 0.0, 0.0, 0.0]]), torch.tensor([1]))
    eye.set_vertical_fov(torch.tensor([0.6]), 1.2, torch.tensor([2]))
    eye = camera(world)
    depth = eye.image(Channel.DEPTH)[..., 0]
    seen = (depth < depth[:, :1, :1] - 0.1).sum((1, 2)).float()
    torch.testing.assert_close(depth[:, 24, 24], torch.tensor([1.8, 1.3, 1.8]), atol=0.01, rtol=0.0)
    # Nearer by 0.5 m, or by a narrower view: the area of the post grows with the square.
    assert seen[0] == pytest.approx(float(plain[0]), rel=0.15)
    assert seen[1] == pytest.approx(float(plain[0]) * (1.8 / 1.3) ** 2, rel=0.2)
    assert seen[2] == pytest.approx(float(plain[0]) * (math.tan(0.45) / math.tan(0.3)) ** 2, rel=0.2)
    # Points are right with each environment's own intrinsics.
    points = eye.point_cloud()[2]
    corner = points[2, 2]
    assert corner[0] == pytest.approx(-(2.0 * math.tan(0.3)) * (43 / 48), abs=0.03)
    world.close()


def test_looks_and_physics_are_drawn_for_each_environment_by_events() -> None:
    task = Lift()
    scene = task.scene()
    extra = box("extra", (0.04, 0.04, 0.04), mass=0.1, pose=Pose((0.5, 0.3, 0.5)))

    class Crowded(Lift):
        def scene(self) -> Scene:
            return replace(scene, objects=(*scene.objects, extra), sensors=(*scene.sensors, EYE))

    task = Crowded()
    task.events.cube_mass = EventTerm(randomize.lights(tilt=0.4), EventTime.STARTUP)
    task.events.friction = EventTerm(randomize.camera_pose("eye", 0.05, 0.02), EventTime.STARTUP)
    task.events.gains = EventTerm(randomize.gravity(Range(0.9, 1.1), tilt=0.05), EventTime.STARTUP)
    environment = make(task, 4, "mujoco", seed=0)
    world = environment.world
    lights = world.renderer.lights
    assert lights is not None
    turns = (lights.directions * world.nominal_lights.directions).sum(-1).clamp(max=1.0).arccos()
    assert (turns < 0.4 + 1e-3).all()
    assert (turns > 1e-3).all()
    assert len({tuple(row) for row in lights.radiance[:, 0].tolist()}) == 4
    environment.reset()
    ids = torch.arange(4)
    before = world.objects["extra"].root_pose.clone()
    randomize.distractors(("extra",), (0.3, 0.2, 0.1), (0.5, 0.4, 0.1), shown=0.5)(environment, ids)
    placed = world.objects["extra"].root_pose
    there = placed[:, 0] < 1.0
    assert (placed != before).any(1).all()
    assert ((placed[there, 0] >= 0.3) & (placed[there, 0] <= 0.5)).all()
    randomize.centers_of_mass("cube", Range(-0.005, 0.005))(environment, ids)
    randomize.camera_field_of_view("eye", Range(0.7, 1.0))(environment, ids)
    eye = world.sensors["eye"]
    assert isinstance(eye, CameraSensor)
    assert eye.intrinsics.shape == (4, 3, 3)
    with pytest.raises(UnknownNameError, match="camera"):
        randomize.camera_pose("nose")(environment, ids)
    environment.close()


def test_gravity_and_lights_turn_by_the_tilt_at_most_and_as_likely_any_way(monkeypatch: pytest.MonkeyPatch) -> None:
    environment = make(Lift(), 8, "mujoco")
    given: list[torch.Tensor] = []
    world = type(environment.world)
    monkeypatch.setattr(world, "set_gravity", lambda _, gravity, env_ids: given.append(gravity))
    tilt = 0.3
    event = randomize.gravity(Range(1.0, 1.0), tilt=tilt)
    for _ in range(64):
        event(environment, torch.arange(8))
    pulled = torch.cat(given)
    torch.testing.assert_close(pulled.norm(dim=1), torch.full((512,), 9.81))
    turned = (-pulled[:, 2] / 9.81).clamp(-1.0, 1.0).arccos()
    assert turned.max() <= tilt + 1e-4
    assert turned.max() > 0.95 * tilt
    # Uniform over a disc: half of them beyond its area's half.
    assert float(turned.median()) == pytest.approx(tilt / math.sqrt(2.0), abs=0.03)
    environment.close()
    for term in (lambda: randomize.gravity(Range(1.0, 1.0), tilt=1.6), lambda: randomize.lights(tilt=-0.1)):
        with pytest.raises(ConfigurationError, match="tilt"):
            term()


def test_patterns_repeat_without_a_seam_and_stay_light() -> None:
    for texture in (grid(), wood(), concrete()):
        pixels = texture.pixels.astype(float).mean(-1)
        inner = np.abs(np.diff(pixels, axis=1)).mean()
        seam = np.abs(pixels[:, 0] - pixels[:, -1]).mean()
        assert seam < 3.0 * inner + 1.0
        assert pixels.mean() > 200.0


def test_a_studio_dresses_what_is_plain_and_leaves_the_scenes_own_cameras_alone() -> None:
    ground = Shape(Plane(), color=(0.4, 0.4, 0.4, 1.0))
    bench = box("bench", (0.4, 0.4, 0.1), fixed_base=True, color=(0.66, 0.49, 0.34, 1.0), pose=Pose((0, 0, 0.05)))
    finished = Shape(Box((0.1, 0.1, 0.1)), Pose((1.0, 0.0, 0.1)), finish=Finish(roughness=0.2))
    scene = Scene(objects=(bench,), terrain=(ground, finished), sensors=(EYE,))
    world = simulate(scene, 1, "mujoco")
    own = camera(world).image(Channel.RGB)
    seen = dressed(world.layout, STUDIO).scene
    assert seen.terrain[0].finish.texture is grid()
    assert seen.terrain[1] == finished
    assert seen.objects[0].articulation.root.visuals[0].finish.texture is wood()
    assert seen.lights == STUDIO.lights
    pose = torch.tensor([(*EYE.pose.position, *EYE.pose.orientation)])
    renderer = world.create_renderer((EYE,), studio=STUDIO)
    image = renderer.render(EYE, pose, world.link_poses, (Channel.RGB,)).rgb
    assert image is not None
    # The bench's edge falls within pixels: averaging shows part of each side.
    single = world.create_renderer((EYE,), studio=replace(STUDIO, samples=1))
    rough = single.render(EYE, pose, world.link_poses, (Channel.RGB,)).rgb
    assert rough is not None
    assert len(image.view(-1, 3).unique(dim=0)) > len(rough.view(-1, 3).unique(dim=0))
    torch.testing.assert_close(camera(world).image(Channel.RGB), own, atol=0, rtol=0)
    for each in (renderer, single):
        each.close()
    world.close()


def test_a_finish_takes_shares_only() -> None:
    with pytest.raises(ValueError, match="roughness"):
        Finish(roughness=1.5)
