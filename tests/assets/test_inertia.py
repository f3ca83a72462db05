"""Mass properties against integrals over fine meshes, and the laws of composition."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_assets.mass_properties import mass_properties, shapes_mass_properties
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.merge import MassProperties, combine
from orbit_core.scene import Box, Capsule, Cylinder, Geometry, Mesh, Plane, Pose, Shape, Sphere
from orbit_core.scene.articulation import principal_axes

SIZES = st.floats(0.05, 1.0)
POSES = st.builds(
    lambda p, r, q, y: Pose.from_euler(r, q, y, p),
    st.tuples(*(st.floats(-1.0, 1.0),) * 3),
    *(st.floats(-3.0, 3.0),) * 3,
)


def as_mesh(solid: trimesh.Trimesh, pose: Pose | None = None) -> Mesh:
    vertices = np.asarray(solid.vertices)
    return Mesh(pose.transform(vertices) if pose else vertices, np.asarray(solid.faces))


@pytest.mark.parametrize(
    ("geometry", "surface"),
    [
        (Box((0.1, 0.2, 0.35)), trimesh.creation.box((0.2, 0.4, 0.7))),
        (Sphere(0.3), trimesh.creation.icosphere(subdivisions=5, radius=0.3)),
        (Cylinder(0.2, 0.4), trimesh.creation.cylinder(0.2, 0.8, sections=500)),
        (Capsule(0.2, 0.3), trimesh.creation.capsule(height=0.6, radius=0.2, count=(200, 200))),
    ],
)
def test_closed_forms_agree_with_integrals(geometry: Geometry, surface: trimesh.Trimesh) -> None:
    surface.apply_translation(-surface.center_mass)
    exact = mass_properties(geometry, density=700.0)
    assert exact.mass == pytest.approx(700.0 * surface.volume, rel=2e-3)
    assert exact.center_of_mass == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(exact.inertia, 700.0 * surface.moment_inertia, atol=3e-3 * exact.inertia.max())


@settings(max_examples=30, deadline=None)
@given(st.tuples(SIZES, SIZES, SIZES), POSES)
def test_a_placed_box_agrees_with_its_mesh(half: tuple[float, float, float], pose: Pose) -> None:
    box = trimesh.creation.box(tuple(2 * value for value in half))
    placed = mass_properties(Box(half), density=500.0).placed(pose)
    meshed = mass_properties(as_mesh(box, pose), density=500.0)
    assert placed.mass == pytest.approx(meshed.mass, rel=1e-6)
    np.testing.assert_allclose(placed.center_of_mass, meshed.center_of_mass, atol=1e-6)
    np.testing.assert_allclose(placed.inertia, meshed.inertia, atol=1e-6 * meshed.inertia.max())


@settings(max_examples=30, deadline=None)
@given(st.tuples(SIZES, SIZES, SIZES), POSES, st.floats(0.1, 0.9))
def test_two_halves_of_a_box_make_the_box(half: tuple[float, float, float], pose: Pose, cut: float) -> None:
    x, y, z = half
    parts = [
        Shape(Box((x * cut, y, z)), pose @ Pose((-x * (1 - cut), 0.0, 0.0))),
        Shape(Box((x * (1 - cut), y, z)), pose @ Pose((x * cut, 0.0, 0.0))),
    ]
    whole = mass_properties(Box(half), density=300.0).placed(pose)
    joined = shapes_mass_properties(parts, 300.0)
    assert joined.mass == pytest.approx(whole.mass)
    np.testing.assert_allclose(joined.center_of_mass, whole.center_of_mass, atol=1e-9)
    np.testing.assert_allclose(joined.inertia, whole.inertia, atol=1e-9)


def test_inertia_about_a_point_adds_mass_times_squared_distance() -> None:
    rod = MassProperties(3.0, (0.5, 0.0, 0.0), np.diag((0.0, 0.25, 0.25)))  # 1 m long: m l^2 / 12
    np.testing.assert_allclose(rod.about((0.0, 0.0, 0.0)), np.diag((0.0, 1.0, 1.0)))  # about its end: m l^2 / 3


def test_mass_and_density_say_the_same() -> None:
    by_mass = mass_properties(Sphere(0.1), mass=2.0)
    by_density = mass_properties(Sphere(0.1), density=2.0 / (4 / 3 * math.pi * 0.1**3))
    assert by_density.mass == pytest.approx(2.0)
    np.testing.assert_allclose(by_mass.inertia, by_density.inertia)


def test_an_open_mesh_counts_as_its_convex_hull() -> None:
    box = trimesh.creation.box((0.2, 0.4, 0.6))
    lidless = Mesh(np.asarray(box.vertices), np.asarray(box.faces)[2:])
    np.testing.assert_allclose(
        mass_properties(lidless, mass=1.0).inertia, mass_properties(Box((0.1, 0.2, 0.3)), mass=1.0).inertia, atol=1e-9
    )


@settings(max_examples=30, deadline=None)
@given(st.tuples(SIZES, SIZES, SIZES), POSES)
def test_principal_axes_rebuild_the_inertia(half: tuple[float, float, float], pose: Pose) -> None:
    inertia = mass_properties(Box(half), mass=1.0).placed(pose).inertia
    moments, axes = principal_axes(inertia)
    np.testing.assert_allclose(axes @ np.diag(moments) @ axes.T, inertia, atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)


@pytest.mark.parametrize("keywords", [{}, {"mass": 1.0, "density": 1.0}, {"mass": -1.0}, {"density": math.inf}])
def test_a_body_needs_one_positive_mass_or_density(keywords: dict[str, float]) -> None:
    with pytest.raises(AssetError):
        mass_properties(Sphere(0.1), **keywords)


def test_what_has_no_volume_is_refused() -> None:
    with pytest.raises(AssetError, match="Plane encloses no volume"):
        mass_properties(Plane(), mass=1.0)
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(AssetError, match="no volume"):
        mass_properties(flat, mass=1.0)
    with pytest.raises(AssetError, match="without mass"):
        combine([])
