"""Mesh files as rigid bodies in USD."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from orbit_assets import load_articulation
from orbit_assets.usd.writer import MeshBody, mesh_articulation, mesh_to_usd
from orbit_core.interfaces.errors import ArgumentError, AssetError
from orbit_core.scene import Mesh, MeshCollision


def brick(folder: Path, suffix: str) -> Path:
    """A block of 1 x 2 x 3."""
    path = folder / f"brick.{suffix}"
    trimesh.creation.box((1.0, 2.0, 3.0)).export(path)
    return path


@pytest.mark.parametrize("suffix", ["obj", "stl", "glb"])
def test_a_mesh_becomes_a_body_with_mass_collider_and_friction(tmp_path: Path, suffix: str) -> None:
    body = MeshBody(friction=0.5, density=1000.0, scale=0.1, collision=MeshCollision.TRIANGLES)
    told = mesh_to_usd(brick(tmp_path, suffix), tmp_path / "brick.usda", body)
    assert told == ("mesh brick." + suffix + " is one rigid body of 6 kg",)
    got = load_articulation(tmp_path / "brick.usda")
    assert got.root.mass == pytest.approx(6.0, rel=1e-5)
    y, z = (0.3, 0.2) if suffix == "glb" else (0.2, 0.3)
    wanted = 0.5 * np.diag((y**2 + z**2, 0.1**2 + z**2, 0.1**2 + y**2))
    np.testing.assert_allclose(got.root.inertia, wanted, rtol=1e-5, atol=1e-9)
    (solid,) = got.root.collisions
    assert isinstance(solid.geometry, Mesh)
    assert solid.geometry.collision is MeshCollision.TRIANGLES
    assert (solid.material.static_friction, solid.material.dynamic_friction) == (0.5, 0.5)
    np.testing.assert_allclose(np.ptp(solid.geometry.vertices, axis=0), (0.1, y, z), atol=1e-6)
    assert len(got.root.visuals) == 1


def test_mass_wins_and_the_hull_is_the_collider_unless_asked(tmp_path: Path) -> None:
    got = mesh_articulation(brick(tmp_path, "stl"), MeshBody(mass=2.0, density=1.0, up="y"))
    assert got.root.mass == 2.0
    (solid,) = got.root.collisions
    assert isinstance(solid.geometry, Mesh)
    assert solid.geometry.collision is MeshCollision.CONVEX_HULL
    np.testing.assert_allclose(np.ptp(solid.geometry.vertices, axis=0), (1.0, 3.0, 2.0), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "value"), [("mass", 0.0), ("density", -1.0), ("friction", float("nan")), ("scale", 0.0)]
)
def test_numbers_that_cannot_be(tmp_path: Path, name: str, value: float) -> None:
    with pytest.raises((AssetError, ArgumentError), match=f"{name} is {value}"):
        mesh_articulation(brick(tmp_path, "stl"), MeshBody(**{name: value}))


def test_a_sheet_has_no_volume(tmp_path: Path) -> None:
    path = tmp_path / "sheet.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(AssetError, match="has no volume"):
        mesh_articulation(path)
