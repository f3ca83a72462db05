"""Pictures of deformables: surfaces of liquids, and shadows that matter casts and receives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_assets.deformables import open_box, sheet
from orbit_assets.objects import box
from orbit_core.scene import (
    AmbientLight,
    CameraSpec,
    Channel,
    Cloth,
    DirectionalLight,
    Fluid,
    Plane,
    Pose,
    Scene,
    Shape,
    look_at,
)
from orbit_core.world import simulate

CHANNELS = (Channel.RGB, Channel.DEPTH, Channel.NORMALS, Channel.INSTANCE)
ABOVE = look_at((0.0, -1.0, 1.0), (0.0, 0.0, 0.0))
CAMERA = CameraSpec(name="camera", width=64, height=64, vertical_fov=0.9, channels=CHANNELS, pose=ABOVE)
SUN = DirectionalLight(direction=(0.0, 0.0, -1.0), color=(1.0, 1.0, 1.0), intensity=0.5)
GROUND = Shape(Plane(), color=(0.6, 0.6, 0.6, 1.0))
BASE = Scene(sensors=(CAMERA,), terrain=(GROUND,), lights=(AmbientLight((0.4, 0.4, 0.4)), SUN))
CLOTH = Cloth("cloth", sheet((0.4, 0.4), (9, 9)), area_density=0.2, color=(0.8, 0.4, 0.4, 1.0))
SHADED, LIT = 0.6 * 0.4 * 255.0, 0.6 * 0.9 * 255.0


def _images(scene: Scene, camera: CameraSpec = CAMERA) -> dict[Channel, Tensor]:
    world = simulate(replace(scene, sensors=(camera,)), num_envs=1, backend="mujoco", matter="orbit-matter")
    images = {channel: image[0].clone() for channel, image in world.sensors["camera"].images.items()}
    world.close()
    return images


def _pixel(point: tuple[float, float, float], camera: CameraSpec = CAMERA) -> tuple[int, int]:
    """Return the row and column of a point in the picture."""
    x, y, z = np.asarray(camera.pose.inverse().transform(np.array([point])))[0]
    focal = 0.5 * camera.height / np.tan(0.5 * camera.vertical_fov)
    return int(0.5 * camera.height - focal * y / -z), int(0.5 * camera.width + focal * x / -z)


def test_cloth_casts_a_shadow_of_its_size_on_the_ground() -> None:
    # The camera sees the ground below the cloth from the side.
    rgb = _images(replace(BASE, deformables=(replace(CLOTH, pose=Pose((0.0, 0.0, 0.5))),)))[Channel.RGB].float()
    for x in (-0.15, 0.0, 0.15):
        assert rgb[_pixel((x, -0.1, 0.0))].mean().item() == pytest.approx(SHADED, abs=1.5)
    for x in (-0.28, 0.28):
        assert rgb[_pixel((x, -0.1, 0.0))].mean().item() == pytest.approx(LIT, abs=1.5)


def test_a_mesh_whose_triangles_are_turned_over_by_a_slice_is_drawn_and_measured() -> None:
    # A reversed view has negative strides, which tensors do not take.
    turned = replace(CLOTH, mesh=replace(CLOTH.mesh, faces=np.asarray(CLOTH.mesh.faces)[:, ::-1]))
    world = simulate(replace(BASE, deformables=(turned,), sensors=(CAMERA,)), 1, "mujoco", matter="orbit-matter")
    assert world.sensors["camera"].images[Channel.RGB].float().std() > 0.0
    assert world.deformables["cloth"].covered_area[0].item() == pytest.approx(0.16, rel=0.05)
    world.close()


def test_a_light_without_shadows_passes_cloth() -> None:
    free = (*BASE.lights[:1], replace(SUN, shadows=False))
    hung = replace(CLOTH, pose=Pose((0.0, 0.0, 0.5)))
    rgb = _images(replace(BASE, lights=free, deformables=(hung,)))[Channel.RGB].float()
    assert rgb[_pixel((0.0, -0.1, 0.0))].mean().item() == pytest.approx(LIT, abs=1.5)


def test_shadows_follow_the_light_that_an_environment_is_given() -> None:
    hung = replace(CLOTH, pose=Pose((0.0, 0.0, 0.5)))
    world = simulate(replace(BASE, deformables=(hung,)), num_envs=2, backend="mujoco", matter="orbit-matter")
    lights = world.nominal_lights
    # Lower and from the side in the second environment: shadows move by 3 / 4 of the height.
    lights.directions[1, 0] = torch.tensor([0.6, 0.0, -0.8])
    world.set_lights(lights)
    images = world.sensors["camera"].images[Channel.RGB].float()
    world.close()
    below, beside = _pixel((0.0, -0.1, 0.0)), _pixel((0.375, -0.1, 0.0))
    assert images[0][below].mean().item() == pytest.approx(SHADED, abs=1.5)
    assert images[1][below].mean().item() == pytest.approx(0.6 * (0.4 + 0.5 * 0.8) * 255.0, abs=1.5)
    assert images[1][beside].mean().item() == pytest.approx(SHADED, abs=1.5)


def test_what_is_above_cloth_shades_it() -> None:
    lid = box("lid", size=(0.12, 0.12, 0.01), mass=0.1, pose=Pose((0.0, 0.0, 0.4)), fixed_base=True)
    rgb = _images(replace(BASE, objects=(lid,), deformables=(replace(CLOTH, pose=Pose((0.0, 0.0, 0.02))),)))
    red = rgb[Channel.RGB][..., 0].float()
    assert red[_pixel((0.0, 0.0, 0.02))].item() == pytest.approx(0.8 * 0.4 * 255.0, abs=1.5)
    assert red[_pixel((0.15, 0.1, 0.02))].item() == pytest.approx(0.8 * 0.9 * 255.0, abs=1.5)


def test_a_liquid_is_drawn_as_one_smooth_surface_without_holes() -> None:
    water = Fluid("water", (0.1, 0.1, 0.05), pose=Pose((0.0, 0.0, 0.05)), spacing=0.01)
    eye = replace(CAMERA, width=128, height=128, vertical_fov=0.3, pose=look_at((0.0, -0.01, 1.0), (0.0, 0.0, 0.1)))
    images = _images(replace(BASE, deformables=(water,)), eye)
    inner = slice(20, 108)
    top = images[Channel.DEPTH][inner, inner, 0]
    assert top.min() > 1.0 - 0.1 - 0.003
    assert top.max() < 1.0 - 0.1 + 0.006, "nothing is seen through it"
    assert images[Channel.NORMALS][inner, inner, 2].min() > 0.85
    assert images[Channel.INSTANCE][inner, inner].unique().numel() == 1


def test_a_lone_drop_far_from_its_light_casts_a_round_shadow() -> None:
    drop = Fluid("water", (0.02, 0.02, 0.02), pose=Pose((0.0, 0.0, 0.4)), spacing=0.04)
    eye = replace(CAMERA, vertical_fov=0.15, pose=look_at((0.0, -0.8, 0.8), (0.0, 0.0, 0.0)))
    rgb = _images(replace(BASE, deformables=(drop,)), eye)[Channel.RGB].float()[..., 0]
    inside, outside = _pixel((0.0, 0.0, 0.0), eye), _pixel((0.05, 0.0, 0.0), eye)
    assert rgb[inside].item() == pytest.approx(SHADED, abs=1.5)
    assert rgb[outside].item() == pytest.approx(LIT, abs=1.5)
    shaded = (rgb < 0.5 * (SHADED + LIT)).float().sum().item()
    across = 0.5 * 64 / np.tan(0.075) / (0.8 * 2.0**0.5)  # pixels of a metre
    assert shaded == pytest.approx(np.pi * (0.03 * across) ** 2 * 0.5**0.5, rel=0.15)
    assert torch.isfinite(rgb).all()


def test_a_liquid_that_leans_on_a_wall_is_not_drawn_through_it() -> None:
    """Smoothed from one side only, slanted surfaces once stood 19 mm off their particles, before a wall of 10 mm."""
    tank = open_box("tank", (0.1, 0.1, 0.08), Pose((0.0, 0.0, 0.01)))
    water = Fluid("water", (0.04, 0.04, 0.03), pose=Pose((0.0, 0.0, 0.045)), spacing=0.008, viscosity=0.05)
    pose = look_at((0.55, -0.45, 0.45), (0.02, 0.0, 0.04))
    camera = replace(CAMERA, width=240, height=180, vertical_fov=0.4, pose=pose, channels=(*CHANNELS, Channel.POSITION))
    scene = Scene(objects=(tank,), deformables=(water,), sensors=(camera,), terrain=(GROUND,), physics_dt=0.0025)
    world = simulate(scene, num_envs=1, backend="mujoco", matter="orbit-matter")
    world.step(60)
    images = {channel: image[0] for channel, image in world.sensors["camera"].images.items()}
    liquid = images[Channel.POSITION][images[Channel.INSTANCE][..., 0] == images[Channel.INSTANCE].max()]
    particles = world.deformables["water"].positions[0].clone()
    world.close()
    assert len(liquid) > 100
    # Spheres have a radius of 6 mm, and the wall's outer side is 60 mm from the middle.
    assert particles[:, :2].abs().max() < 0.05
    assert liquid[:, :2].abs().max() < 0.054
