"""Ray patterns and the geometry of pinhole cameras."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_core.dynamics.transforms import pose_inverse, quat_from_euler, transform_points
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import CameraSpec
from orbit_core.sensors import grid_pattern, intrinsic_matrix, lidar_pattern, point_cloud, project


def test_a_spinning_lidar_covers_the_turn_without_repeating_a_column():
    rays = np.array(lidar_pattern(3, (-0.2, 0.4), horizontal_resolution=math.radians(10)))
    assert rays.shape == (3 * 36, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
    assert len(np.unique(rays.round(6), axis=0)) == len(rays)
    np.testing.assert_allclose(np.arcsin(rays[::36, 2]), [-0.2, 0.1, 0.4])


def test_a_sector_has_a_ray_at_both_ends():
    rays = np.array(lidar_pattern(1, (0.0, 0.0), (-0.5, 0.5), 0.25))
    np.testing.assert_allclose(np.arctan2(rays[:, 1], rays[:, 0]), [-0.5, -0.25, 0.0, 0.25, 0.5])


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 6), st.floats(0.02, 0.5), st.floats(0.1, 2 * math.pi))
def test_neighbouring_lidar_columns_are_no_farther_apart_than_the_resolution(channels, resolution, span):
    rays = np.array(lidar_pattern(channels, (-0.3, 0.3), (0.0, span), resolution)).reshape(channels, -1, 3)
    azimuths = np.unwrap(np.arctan2(rays[0, :, 1], rays[0, :, 0]))
    assert np.all(np.diff(azimuths) <= resolution + 1e-6)


def test_a_grid_is_centred_with_rows_along_x():
    origins, directions = grid_pattern((1.6, 1.0), 0.1)
    assert len(origins) == len(directions) == 17 * 11
    np.testing.assert_allclose(np.mean(origins, axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(origins[0], (-0.8, -0.5, 0.0))
    np.testing.assert_allclose(origins[1], (-0.7, -0.5, 0.0))
    assert set(directions) == {(0.0, 0.0, -1.0)}


def test_impossible_patterns_are_refused():
    with pytest.raises(ConfigurationError, match="resolution"):
        grid_pattern((1.0, 1.0), 0.0)
    with pytest.raises(ConfigurationError, match="channel"):
        lidar_pattern(0, (0.0, 0.1))


@settings(max_examples=30, deadline=None)
@given(
    st.integers(2, 40), st.integers(2, 40), st.floats(0.2, 2.5),
    st.tuples(*[st.floats(-3, 3)] * 6), st.integers(0, 2**31),
)  # fmt: skip
def test_points_of_a_depth_image_project_back_to_their_pixels(width, height, fov, pose, seed):
    intrinsics = intrinsic_matrix(CameraSpec(name="camera", width=width, height=height, vertical_fov=fov))
    depth = 0.5 + 3 * torch.rand(1, height, width, 1, generator=torch.Generator().manual_seed(seed))
    angles = [torch.tensor([angle]) for angle in pose[3:]]
    camera = torch.cat((torch.tensor([pose[:3]]), quat_from_euler(*angles)), -1)
    points = transform_points(pose_inverse(camera)[:, None, None], point_cloud(depth, intrinsics, camera))
    torch.testing.assert_close(-points[..., 2:], depth, atol=1e-4, rtol=1e-4)
    pixels = project(points, intrinsics)[0]
    column, row = torch.arange(width) + 0.5, torch.arange(height) + 0.5
    torch.testing.assert_close(pixels[..., 0], column.expand(height, width), atol=2e-2, rtol=0)
    torch.testing.assert_close(pixels[..., 1], row[:, None].expand(height, width), atol=2e-2, rtol=0)


def test_a_pixel_that_sees_nothing_has_no_point():
    intrinsics = intrinsic_matrix(CameraSpec(name="camera", width=2, height=1))
    depth = torch.tensor([1.0, torch.inf]).view(1, 1, 2, 1)
    points = point_cloud(depth, intrinsics, torch.tensor([[0.0, 0, 0, 1, 0, 0, 0]]))
    assert points[0, 0, 0].isfinite().all()
    assert points[0, 0, 1].isinf().all()


def test_the_vertical_field_of_view_spans_the_height():
    camera = CameraSpec(name="camera", width=64, height=48, vertical_fov=0.9)
    top = torch.tensor([0.0, math.tan(0.45), -1.0])
    torch.testing.assert_close(project(top, intrinsic_matrix(camera)), torch.tensor([32.0, 0.0]), atol=1e-4, rtol=0)
