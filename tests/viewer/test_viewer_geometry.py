"""Shapes become triangles of the right size, place and colour."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
import torch
import trimesh

from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.meshes import marker_shapes, triangles
from orbit_core.scene import (
    Box,
    Capsule,
    Channel,
    Cylinder,
    Geometry,
    HeightField,
    MarkerShape,
    MarkerSpec,
    Mesh,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_viewer.scene_view import Drawing
from orbit_viewer.viewer import picture_of


@pytest.mark.parametrize(
    ("geometry", "half_extents", "volume"),
    [
        (Box((0.1, 0.2, 0.3)), (0.1, 0.2, 0.3), 0.048),
        (Sphere(0.5), (0.5, 0.5, 0.5), 4 / 3 * math.pi * 0.125),
        (Cylinder(0.2, 0.4), (0.2, 0.2, 0.4), math.pi * 0.04 * 0.8),
        (Capsule(0.2, 0.4), (0.2, 0.2, 0.6), math.pi * 0.04 * 0.8 + 4 / 3 * math.pi * 0.008),
    ],
)
def test_solids_have_their_size(geometry: Geometry, half_extents: tuple[float, float, float], volume: float) -> None:
    mesh = triangles(geometry)
    assert np.allclose(mesh.bounds, [[-h for h in half_extents], half_extents], atol=2e-3)
    assert mesh.volume == pytest.approx(volume, rel=0.03)


def test_a_height_field_has_x_along_columns_and_faces_up() -> None:
    heights = np.zeros((3, 5))
    heights[0, 4] = 1.0
    mesh = triangles(HeightField(heights, (4.0, 2.0)))
    assert np.allclose(mesh.vertices[mesh.vertices[:, 2].argmax()], (2.0, -1.0, 1.0))
    assert (mesh.face_normals[:, 2] > 0).all()


def test_a_plane_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="plane"):
        triangles(Plane())


def test_a_drawing_keeps_places_and_colours() -> None:
    cube = trimesh.creation.box((0.2, 0.2, 0.2))
    shapes = (
        Shape(Mesh(cube.vertices, cube.faces), Pose((1.0, 0.0, 0.0)), color=(1.0, 0.0, 0.0, 1.0)),
        Shape(Box((0.1, 0.1, 0.1)), Pose((0.0, 2.0, 0.0)), color=(0.0, 0.5, 0.0, 0.5)),
        Shape(Sphere(0.1), Pose((0.0, 0.0, 3.0)), color=(1.0, 0.0, 0.0, 1.0)),
    )
    drawing = Drawing.of(shapes)
    assert np.allclose(drawing.corners.min(axis=0), (-0.1, -0.1, -0.1), atol=1e-3)
    assert np.allclose(drawing.corners.max(axis=0), (1.1, 2.1, 3.1), atol=1e-3)
    loaded = trimesh.load_scene(io.BytesIO(drawing.glb), file_type="glb")
    colors = sorted(tuple(g.visual.material.baseColorFactor) for g in loaded.geometry.values())
    # 0.5 on the screen's sRGB curve is 0.214 of the light, which is what glTF counts in.
    assert colors == [(0, 55, 0, 128), (255, 0, 0, 255)]


@pytest.mark.parametrize("shape", MarkerShape)
def test_markers_have_their_size(shape: MarkerShape) -> None:
    corners = Drawing.of(marker_shapes(MarkerSpec("goal", shape, size=0.4))).corners
    extent = np.ptp(corners, axis=0)
    if shape is MarkerShape.ARROW:
        assert corners[:, 0].min() == pytest.approx(0.0, abs=1e-3)
        assert extent[0] == pytest.approx(0.4, abs=2e-3)
        assert extent[1:].max() < 0.1
    elif shape is MarkerShape.FRAME:
        assert np.allclose(corners.max(axis=0), 0.4, atol=2e-3)
    else:
        assert np.allclose(extent, 0.4, atol=2e-3)


def test_depth_is_brighter_near_and_black_where_nothing_is() -> None:
    depth = torch.tensor([[1.0, 2.0, torch.inf]])[..., None]
    picture = picture_of(Channel.DEPTH, depth)
    assert picture.shape == (1, 3, 3)
    assert picture[0, 0, 0] > picture[0, 1, 0] > picture[0, 2, 0] == 0
    assert not picture_of(Channel.DEPTH, torch.full((2, 2, 1), torch.inf)).any()


def test_segments_have_colours_of_their_own() -> None:
    indices = torch.arange(-2, 6, dtype=torch.int32)[None, :, None]
    picture = picture_of(Channel.INSTANCE, indices)
    assert len({tuple(pixel) for pixel in picture[0, 2:].tolist()}) == 6


def test_normals_map_to_the_whole_range() -> None:
    picture = picture_of(Channel.NORMALS, torch.tensor([[[1.0, -1.0, 0.0]]]))
    assert picture[0, 0].tolist() == [255, 0, 127]
