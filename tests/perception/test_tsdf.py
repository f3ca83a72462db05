"""Distance fields of a ball, a box and a plane that cameras see from around: the surface, the signs, the gradients."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError, ShapeError
from orbit_core.scene import Box, CameraSpec, Plane, Pose, Sphere, look_at
from orbit_core.scene.shapes import Geometry
from orbit_core.sensors import intrinsic_matrix
from orbit_core.sensors.proprioception import pose_tensor
from orbit_motion.perception import TsdfConfig, TsdfVolume

CPU = torch.device("cpu")
VOXEL = 0.02
CONFIG = TsdfConfig(lower=(-0.48, -0.48, -0.48), voxel_size=VOXEL, shape=(48, 48, 48))
RADIUS = 0.3
HALF = torch.tensor((0.3, 0.2, 0.25))
BALL: tuple[Geometry, Pose] = (Sphere(RADIUS), Pose())
BOX: tuple[Geometry, Pose] = (Box((0.3, 0.2, 0.25)), Pose())
EYES = [
    eye for eye in itertools.product((-1.0, 0.15, 1.0), (-1.0, 0.1, 1.0), (-1.0, 0.2, 1.0)) if max(map(abs, eye)) == 1
]


def cameras() -> list[CameraSpec]:
    """From 26 sides, at 2 m."""
    found = []
    for eye in EYES:
        place = tuple(float(v) for v in 2.0 * np.array(eye) / np.linalg.norm(eye))
        found.append(CameraSpec(name="eye", width=120, height=120, vertical_fov=0.6, pose=look_at(place, (0, 0, 0))))
    return found


@pytest.fixture
def ball_and_box(picture) -> TsdfVolume:
    """A ball in environment 0, and a box in environment 1."""
    volume = TsdfVolume(CONFIG, 2, CPU)
    for camera in cameras():
        depth = torch.cat((picture([BALL], camera), picture([BOX], camera)))
        volume.integrate(depth, intrinsic_matrix(camera), pose_tensor(camera.pose, CPU).repeat(2, 1))
    return volume


def box_distance(points: Tensor) -> Tensor:
    """Signed distance (...,) of points (..., 3) to the box."""
    beyond = points.abs() - HALF
    return beyond.clamp_min(0.0).norm(dim=-1) + beyond.amax(-1).clamp_max(0.0)


def box_surface(count: int, margin: float) -> Tensor:
    """Points on the box's faces, kept from its edges."""
    random = torch.Generator().manual_seed(0)
    points = (torch.rand(count, 3, generator=random) * 2 - 1) * (HALF - margin)
    face = torch.arange(count) % 3
    points[torch.arange(count), face] = HALF[face] * (torch.arange(count) % 2 * 2 - 1)
    return points


def ball_surface(count: int) -> Tensor:
    normals = torch.nn.functional.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    return RADIUS * normals


def crossings(volume: TsdfVolume, env: int, surface: Tensor, normals: Tensor) -> Tensor:
    """How far (P,) along the normal the field of an environment turns positive, from 1.5 voxels behind the surface."""
    steps = torch.linspace(-1.5 * VOXEL, 1.5 * VOXEL, 61)
    points = surface[:, None] + steps[:, None] * normals[:, None]
    found = volume.sample(points.flatten(0, 1).expand(2, -1, -1))
    assert found.known[env].all()
    positive = found.distances[env].view(-1, 61) > 0.0
    assert positive[:, -1].all()
    return steps[positive.float().argmax(1)]


def test_the_zero_level_lies_within_a_voxel_of_the_surface_and_a_fifth_on_average(ball_and_box):
    ball, box = ball_surface(600), box_surface(600, margin=0.04)
    faces = torch.where(box.abs() == HALF, box.sign(), 0.0)
    for env, (surface, normals) in enumerate(((ball, ball / RADIUS), (box, faces))):
        aside = crossings(ball_and_box, env, surface, normals).abs()
        assert aside.max() < 0.8 * VOXEL
        assert aside.mean() < 0.2 * VOXEL


def test_distances_have_the_right_sign_a_voxel_from_the_surface(ball_and_box):
    centres = ball_and_box.centres
    for env, truth in enumerate((centres.norm(dim=-1) - RADIUS, box_distance(centres))):
        known = ball_and_box.weights[env] > 0
        sure = known & (truth.abs() > VOXEL)
        assert (ball_and_box.distances[env][sure].sign() == truth[sure].sign()).all()
        assert not known[truth < -2 * CONFIG.band].any()  # what lies deep inside was never seen
        assert known[truth > 0].all()


def test_gradients_stand_on_the_surface(ball_and_box):
    surface = ball_surface(600)
    found = ball_and_box.sample(surface.expand(2, -1, -1))
    cosine = torch.nn.functional.cosine_similarity(found.gradients[0], surface, dim=-1)
    assert cosine.min() > math.cos(math.radians(40))  # where a line of sight touches the ball, free space begins
    assert cosine.mean() > math.cos(math.radians(15))


def test_a_plane_seen_straight_is_exact_to_rounding(picture):
    camera = CameraSpec(name="eye", width=120, height=120, vertical_fov=0.8, pose=look_at((0, 0, 2.0), (0, 0, 0)))
    volume = TsdfVolume(CONFIG, 1, CPU)
    volume.integrate(
        picture([(Plane(), Pose())], camera), intrinsic_matrix(camera), pose_tensor(camera.pose, CPU)[None]
    )
    heights = torch.linspace(-0.05, 0.05, 11)
    points = torch.stack((heights * 3, -heights * 2, heights), -1)[None]
    found = volume.sample(points)
    assert found.known.all()
    torch.testing.assert_close(found.distances, points[..., 2], atol=1e-5, rtol=0)
    torch.testing.assert_close(found.gradients, torch.tensor((0.0, 0.0, 1.0)).expand(1, 11, 3), atol=1e-3, rtol=0)


def test_interpolation_gives_a_linear_field_and_its_gradient_exactly():
    volume = TsdfVolume(CONFIG, 2, CPU)
    slope = torch.tensor((0.3, -0.2, 0.1))
    volume.distances.copy_((volume.centres @ slope).expand(2, -1, -1, -1))
    volume.weights.fill_(1.0)
    points = torch.rand(2, 50, 3, generator=torch.Generator().manual_seed(0)) * 0.9 - 0.45
    found = volume.sample(points)
    torch.testing.assert_close(found.distances, points @ slope)
    torch.testing.assert_close(found.gradients, slope.expand(2, 50, 3), atol=1e-5, rtol=0)


def test_what_lies_outside_or_was_not_seen_is_not_known():
    volume = TsdfVolume(CONFIG, 1, CPU)
    found = volume.sample(torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.479], [5.0, 0.0, 0.0], [0.0, -0.479, 0.0]]]))
    assert not found.known.any()
    assert (found.distances == CONFIG.band).all()
    assert (found.gradients == 0).all()
    volume.weights.fill_(1.0)
    points = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.471], [0.469, 0.0, 0.0], [0.0, 0.0, -0.469]]])
    assert volume.sample(points).known.tolist() == [[True, False, True, True]]


def test_depth_that_tells_nothing_changes_nothing_and_infinite_depth_is_free():
    camera = CameraSpec(name="eye", width=30, height=20, vertical_fov=0.8, pose=look_at((2.0, 0, 0), (0, 0, 0)))
    rays, pose = intrinsic_matrix(camera), pose_tensor(camera.pose, CPU).repeat(3, 1)
    volume = TsdfVolume(CONFIG, 3, CPU)
    depth = torch.stack([torch.full((20, 30, 1), value) for value in (0.0, math.nan, math.inf)])
    volume.integrate(depth, rays, pose)
    assert (volume.weights[:2] == 0).all()
    assert 0.99 < volume.weights[2].max() <= 1.0
    torch.testing.assert_close(volume.distances, torch.full_like(volume.distances, CONFIG.band))
    behind = pose_tensor(look_at((-2.0, 0, 0), (-3.0, 0, 0)), CPU).repeat(3, 1)
    before = volume.weights.clone()
    volume.integrate(depth, rays, behind)
    assert torch.equal(volume.weights, before)


def test_distances_are_the_mean_of_what_was_seen_and_weights_have_a_limit():
    config = TsdfConfig(lower=(-0.1, -0.1, -0.1), voxel_size=0.05, shape=(4, 4, 4), truncation=0.5, max_weight=3.0)
    camera = CameraSpec(name="eye", width=10, height=10, pose=look_at((0, 0, 1.0), (0, 0, 0)))
    volume = TsdfVolume(config, 1, CPU)
    for depth in (1.0, 1.1, 1.2, 1.3, 1.4):
        volume.integrate(
            torch.full((1, 10, 10, 1), depth), intrinsic_matrix(camera), pose_tensor(camera.pose, CPU)[None]
        )
    middle = 0.025 + sum((0.0, 0.1, 0.2)) / 3  # of a voxel 0.025 m above the middle
    for late in (0.325, 0.425):
        middle = (3 * middle + late) / 4
    assert volume.distances[0, 2, 2, 2].item() == pytest.approx(middle, abs=1e-3)  # pixels aside weigh a little less
    assert volume.weights.max() == 3.0


def test_environments_are_reset_and_seen_apart_and_in_place(ball_and_box):
    kept = ball_and_box.distances
    before = kept.clone()
    ball_and_box.reset(torch.tensor([True, False]))
    assert ball_and_box.distances is kept
    assert (ball_and_box.weights[0] == 0).all()
    assert (kept[0] == CONFIG.band).all()
    assert torch.equal(kept[1], before[1])
    camera = cameras()[0]
    depth, pose = torch.full((2, 120, 120, 1), 2.0), pose_tensor(camera.pose, CPU).repeat(2, 1)
    ball_and_box.integrate(depth, intrinsic_matrix(camera), pose, seen=torch.tensor([True, False]))
    assert (ball_and_box.weights[0] > 0).any()
    assert torch.equal(kept[1], before[1])
    ball_and_box.reset(torch.tensor([1]))
    assert (ball_and_box.weights[1] == 0).all()
    assert (ball_and_box.weights[0] > 0).any()


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"voxel_size": 0.0}, "0.0 m wide"),
        ({"shape": (1, 8, 8)}, "two voxels or more"),
        ({"truncation": 0.01}, "at least two voxels, 0.04 m"),
        ({"max_weight": 0.5}, "at least 1, not 0.5"),
    ],
)
def test_grids_that_cannot_be_are_refused(settings, complaint):
    with pytest.raises(ConfigurationError, match=complaint):
        TsdfConfig(**{"lower": (0.0, 0.0, 0.0), "voxel_size": VOXEL, "shape": (8, 8, 8)} | settings)


def test_tensors_of_another_shape_are_refused():
    volume = TsdfVolume(CONFIG, 2, CPU)
    rays = torch.eye(3)
    with pytest.raises(ShapeError, match=r"must have shape \(2, H, W, 1\), not \(2, 4, 4\)"):
        volume.integrate(torch.ones(2, 4, 4), rays, torch.zeros(2, 7))
    with pytest.raises(ShapeError, match=r"must have shape \(2, 7\)"):
        volume.integrate(torch.ones(2, 4, 4, 1), rays, torch.zeros(1, 7))
    with pytest.raises(ShapeError, match=r"must have shape \(2, P, 3\)"):
        volume.sample(torch.zeros(3, 3))
