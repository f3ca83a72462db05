"""Meshes split into convex pieces: what they hold, where they are kept, and what falls through them."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from orbit_assets.cache import cache_folder
from orbit_assets.decomposition import ConvexDecomposition, convex_pieces
from orbit_assets.mass_properties import mass_properties
from orbit_assets.usd import read_usd, write_usd
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.scenes import decomposed_entity
from orbit_core.scene import Articulation, Link, Mesh, MeshCollision, ObjectSpec, Pose, Scene, Shape, Sphere
from orbit_core.world import simulate

FRAME = trimesh.creation.annulus(0.05, 0.08, 0.04, sections=4)
RING = Mesh(FRAME.vertices, FRAME.faces, MeshCollision.CONVEX_DECOMPOSITION)


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory):
    """A cache of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ORBIT_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


def body(mesh: Mesh) -> Articulation:
    mass = mass_properties(mesh, density=500.0)
    link = Link("ring", mass.mass, mass.center_of_mass, mass.inertia, (Shape(mesh, name="rim"),))
    return Articulation("ring", (link,))


def volume(mesh: Mesh) -> float:
    return float(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume)


def test_pieces_are_convex_and_fill_the_mesh_and_not_its_hole() -> None:
    pieces = convex_pieces(RING)
    assert len(pieces) >= 4
    assert sum(volume(piece) for piece in pieces) == pytest.approx(FRAME.volume, rel=0.02)
    for piece in pieces:
        hull = trimesh.convex.convex_hull(piece.vertices)
        assert volume(piece) == pytest.approx(hull.volume, rel=1e-3)
        assert piece.collision is MeshCollision.CONVEX_HULL


def test_a_split_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    first = convex_pieces(RING)
    monkeypatch.setitem(sys.modules, "coacd", None)
    assert convex_pieces(RING) == first
    with pytest.raises(AssetError, match=r"the lid asks for convex pieces.*\[decomposition\]"):
        convex_pieces(RING, ConvexDecomposition(concavity=0.2), where="the lid")


def test_a_split_that_fails_names_the_mesh_and_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flat = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    with pytest.raises(AssetError, match=r"lid\.obj could not be split .*it lies in a plane.*close its surface"):
        convex_pieces(flat, where="lid.obj")
    with pytest.raises(AssetError, match=r"concavity of 0\.01 to 1"):
        convex_pieces(RING, ConvexDecomposition(concavity=0.0))
    unseen = Mesh(1.1 * FRAME.vertices, FRAME.faces, MeshCollision.CONVEX_DECOMPOSITION)
    monkeypatch.syspath_prepend(tmp_path)
    for does, told in (("raise RuntimeError('not manifold')", "not manifold"), ("__import__('os')._exit(7)", "with 7")):
        code = f"Mesh = set_log_level = lambda *_: None\ndef run_coacd(*_, **__): {does}\n"
        (tmp_path / "coacd.py").write_text(code)
        with pytest.raises(AssetError, match=f"mesh 'rim' of link 'ring' of 'hoop' could not be split.*{told}"):
            decomposed_entity(ObjectSpec(name="hoop", articulation=body(unseen)))


def test_a_split_that_takes_too_long_is_ended_and_says_so() -> None:
    unseen = Mesh(1.2 * FRAME.vertices, FRAME.faces, MeshCollision.CONVEX_DECOMPOSITION)
    with pytest.raises(AssetError, match=r"the lid was not split .* within 0\.01 s: .*longer time_limit"):
        convex_pieces(unseen, ConvexDecomposition(time_limit=0.01), where="the lid")
    with pytest.raises(AssetError, match="time limit above zero"):
        convex_pieces(unseen, ConvexDecomposition(time_limit=0.0))


def test_what_is_no_mesh_is_refused_and_a_damaged_cache_made_anew() -> None:
    holed = RING.vertices.copy()
    holed[0, 0] = np.nan
    for vertices, faces, told in (
        (RING.vertices[:0], RING.faces[:0], "0 vertices and 0 triangles"),
        (holed, RING.faces, "not finite"),
        (RING.vertices, RING.faces - 1, "a triangle of vertex -1"),
    ):
        with pytest.raises(AssetError, match=f"the lid .*{told}"):
            convex_pieces(Mesh(vertices, faces), where="the lid")
    pieces = convex_pieces(RING)
    for path in (cache_folder() / "decompositions").iterdir():
        np.savez(path)
    assert convex_pieces(RING) == pieces


@pytest.mark.parametrize("backend", ["mujoco", "sapien"])
def test_a_ball_falls_through_a_ring_of_pieces_and_rests_on_its_hull(backend: str) -> None:
    heights = {}
    for collision in (MeshCollision.CONVEX_DECOMPOSITION, MeshCollision.CONVEX_HULL):
        model = body(replace(RING, collision=collision))
        ring = ObjectSpec(name="ring", articulation=model, fixed_base=True, pose=Pose((0.0, 0.0, 0.5)))
        inertia = np.eye(3) * 0.4 * 0.1 * 0.02**2
        link = Link("ball", 0.1, (0.0, 0.0, 0.0), inertia, (Shape(Sphere(0.02)),))
        ball = ObjectSpec(name="ball", articulation=Articulation("ball", (link,)), pose=Pose((0.0, 0.0, 0.56)))
        world = simulate(Scene(objects=(ring, ball)), num_envs=1, backend=backend)
        world.step(80)  # 0.4 s: to the ground through the hole
        heights[collision] = float(world.objects["ball"].root_pose[0, 2])
        world.close()
    assert heights[MeshCollision.CONVEX_DECOMPOSITION] < 0.1
    assert heights[MeshCollision.CONVEX_HULL] == pytest.approx(0.54, abs=0.002)


def test_usd_says_which_meshes_are_split(tmp_path: Path) -> None:
    path = tmp_path / "ring.usda"
    write_usd(body(RING), path)
    assert 'physics:approximation = "convexDecomposition"' in path.read_text()
    geometry = read_usd(path).root.collisions[0].geometry
    assert isinstance(geometry, Mesh)
    assert geometry.collision is MeshCollision.CONVEX_DECOMPOSITION
