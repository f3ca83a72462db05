"""Dense meshes as fine as a picture shows."""

from __future__ import annotations

import numpy as np
import trimesh

from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.simplify import simplified, simplified_mesh
from orbit_core.plugin_kit.surfaces import bounded, textured_surface
from orbit_core.scene import Box, Mesh, Plane, Scene, Shape, Texture


def ball(subdivisions: int = 6) -> Mesh:
    surface = trimesh.creation.icosphere(subdivisions, 0.5)
    return Mesh(np.asarray(surface.vertices), np.asarray(surface.faces))


def test_a_dense_mesh_keeps_its_surface_within_a_fraction_of_a_cell() -> None:
    dense = ball()
    coarse = simplified_mesh(dense, 20)
    cell = np.sqrt(3.0) / 20
    assert len(coarse.faces) < len(dense.faces) / 10
    away = np.abs(np.linalg.norm(coarse.vertices, axis=1) - 0.5)
    assert away.max() < 0.25 * cell
    surface = trimesh.Trimesh(coarse.vertices, coarse.faces)
    outward = (surface.face_normals * surface.triangles_center).sum(1)
    assert (outward > 0.0).mean() > 0.99, "what is turned over would be culled"
    assert surface.volume > 0.95 * 4.0 / 3.0 * np.pi * 0.5**3


def test_sharp_edges_stay_where_they_are() -> None:
    block = trimesh.creation.box((1.0, 0.6, 0.4)).subdivide().subdivide().subdivide().subdivide()
    coarse = simplified_mesh(Mesh(np.asarray(block.vertices), np.asarray(block.faces)), 12)
    assert len(coarse.faces) < 0.5 * len(block.faces)
    np.testing.assert_allclose(np.abs(coarse.vertices).max(0), (0.5, 0.3, 0.2), atol=1e-3)


def test_few_triangles_and_textured_meshes_are_left_alone() -> None:
    few = ball(2)
    assert simplified_mesh(few, 400) is few
    layout = SceneLayout.of(Scene(terrain=(Shape(Box((1.0, 1.0, 1.0))),)))
    assert simplified(layout, 64) is layout


def test_a_texture_is_laid_by_metres_from_the_shapes_origin() -> None:
    texture = Texture(np.zeros((4, 8, 3), np.uint8), width=0.5)
    surface = textured_surface(bounded(Shape(Plane()), 2.0), texture)
    places = surface.vertices[:, :2] / (0.5, 0.25) + 0.5
    np.testing.assert_allclose(surface.coordinates, places, atol=1e-9)
    np.testing.assert_allclose(surface.normals, np.tile((0.0, 0.0, 1.0), (6, 1)), atol=1e-9)
    solid = textured_surface(Shape(Box((0.1, 0.2, 0.3))), texture)
    # Normals of a box's corners are those of its sides.
    corners = solid.vertices[solid.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(solid.normals[solid.faces], np.repeat(flat[:, None], 3, axis=1), atol=1e-9)


def test_own_coordinates_stay_with_their_corners() -> None:
    surface = trimesh.creation.box()
    own = np.random.default_rng(0).uniform(size=(8, 2))
    mesh = Mesh(np.asarray(surface.vertices), np.asarray(surface.faces), coordinates=own)
    laid = textured_surface(Shape(mesh), Texture(np.zeros((1, 1, 3), np.uint8)))
    np.testing.assert_allclose(laid.coordinates, own[np.asarray(surface.faces).ravel()])
    np.testing.assert_allclose(laid.vertices, np.asarray(surface.vertices)[np.asarray(surface.faces).ravel()])
    assert mesh != Mesh(mesh.vertices, mesh.faces)
