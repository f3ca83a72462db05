"""Flat faces of surfaces: the same surface, in as few convex polygons as a search finds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import trimesh

from orbit_core.plugin_kit.meshes import convex_faces, fans, few_faces, height_field_mesh
from orbit_core.scene import HeightField

FloatArray = npt.NDArray[np.float64]


def level(rows: int = 11, columns: int = 21) -> FloatArray:
    return np.zeros((rows, columns))


def field(heights: FloatArray) -> HeightField:
    return HeightField(heights, (0.1 * (heights.shape[1] - 1), 0.1 * (heights.shape[0] - 1)))


def normal_areas(faces: list[FloatArray]) -> FloatArray:
    """(faces, 3) areas along their normals."""
    return np.array([0.5 * np.cross(face - face[0], np.roll(face, -1, 0) - face).sum(0) for face in faces])


def is_convex(face: FloatArray) -> bool:
    sides = np.roll(face, -1, axis=0) - face
    turns = np.cross(sides, np.roll(sides, -1, axis=0))
    return bool((turns @ turns.sum(0) > 0).all())


def test_a_level_floor_is_one_rectangle() -> None:
    (face,) = convex_faces(*height_field_mesh(field(level())))
    assert sorted(map(tuple, face.round(9).tolist())) == [(-1, -0.5, 0), (-1, 0.5, 0), (1, -0.5, 0), (1, 0.5, 0)]


def test_a_floor_and_a_ramp_are_two() -> None:
    heights = level()
    heights[:, 10:] = np.linspace(0.0, 0.3, 11)
    assert len(convex_faces(*height_field_mesh(field(heights)))) == 2


def test_a_box_of_many_triangles_has_six_faces_that_look_outwards() -> None:
    mesh = trimesh.creation.box((1.0, 2.0, 3.0)).subdivide().subdivide()
    faces = convex_faces(mesh.vertices, mesh.faces)
    assert len(faces) == 6
    for face, area in zip(faces, normal_areas(faces), strict=True):
        assert face.mean(0) @ area > 0


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_the_surface_stays_the_same_around_a_hole_and_a_pit(turn: float) -> None:
    heights = level(21, 21)
    heights[4:9, 5:16] = -0.2
    heights[12:18, 3:6] = np.random.default_rng(0).uniform(0.0, 0.1, (6, 3))
    vertices, triangles = height_field_mesh(field(heights))
    turned = vertices @ trimesh.transformations.rotation_matrix(turn, (1.0, 2.0, 0.5))[:3, :3].T
    faces = convex_faces(turned, triangles)
    assert len(faces) < len(triangles) / 4
    assert all(map(is_convex, faces))
    np.testing.assert_allclose(
        np.linalg.norm(normal_areas(faces), axis=-1).sum(), trimesh.Trimesh(turned, triangles).area, rtol=1e-9
    )
    joined = trimesh.Trimesh(*fans(faces), process=False)
    middles = turned[triangles[::7]].mean(1)
    assert np.abs(trimesh.proximity.closest_point_naive(joined, middles)[1]).max() < 1e-9


def test_a_curved_surface_keeps_its_triangles() -> None:
    ball = trimesh.creation.icosphere(2)
    assert len(convex_faces(ball.vertices, ball.faces)) == len(ball.faces)


def test_a_surface_that_bends_by_little_at_each_edge_keeps_its_triangles() -> None:
    x = np.linspace(-1.0, 1.0, 41)
    dome = field(np.tile(1000.0 - np.sqrt(1000.0**2 - x**2), (3, 1)))  # 5e-5 rad at each edge, 0.5 mm in all
    vertices, triangles = height_field_mesh(dome)
    assert len(convex_faces(vertices, triangles)) == len(triangles)


def test_vertices_in_single_precision_lie_in_one_plane() -> None:
    vertices, triangles = height_field_mesh(field(level()))
    tilt = trimesh.transformations.rotation_matrix(0.4, (1.0, 2.0, 3.0))[:3, :3]
    assert len(convex_faces((vertices @ tilt.T).astype(np.float32), triangles)) == 1


def test_triangles_without_an_area_are_left_out() -> None:
    corners = np.array(((0.0, 0, 0), (1.0, 0, 0), (2.0, 0, 0), (0.0, 1, 0)))
    (face,) = convex_faces(corners, np.array(((0, 1, 2), (0, 2, 3))))
    np.testing.assert_array_equal(face, corners[[0, 2, 3]])


def test_two_sides_of_a_sheet_stay_apart() -> None:
    corners = np.array(((0.0, 0, 0), (1.0, 0, 0), (0.0, 1, 0)))
    assert len(convex_faces(corners, np.array(((0, 1, 2), (2, 1, 0))))) == 2


def test_only_a_height_field_of_few_planes_is_made_of_its_faces() -> None:
    rough = level()
    rough[5:, 5:] = np.random.default_rng(0).uniform(0.0, 0.1, (6, 16))
    assert few_faces(field(rough)) is None
    assert len(few_faces(field(level())) or ()) == 1
