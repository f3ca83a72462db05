"""Cached models: equal to what was built, rebuilt when out of date, and enough where the packages are missing."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orbit_assets import cache, sources
from orbit_assets.cache import Model, cache_folder, cached_articulation
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Box,
    Compliance,
    DriveGains,
    Finish,
    Frame,
    Joint,
    JointType,
    Link,
    LoopJoint,
    LoopType,
    Mesh,
    MeshCollision,
    Mimic,
    PhysicsMaterial,
    Pose,
    Shape,
    Texture,
)

PACKAGE = "numpy"  # any installed distribution will do


def make() -> Articulation:
    mesh = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], dtype=np.int32), MeshCollision.TRIANGLES)
    rubber = PhysicsMaterial(static_friction=1.5, compliance=Compliance(1e4, 10.0))
    shapes = (Shape(mesh, Pose((1.0, 0.1, 0.2))), Shape(Box((0.1, 0.2, 0.3)), material=rubber, name="pad"))
    links = tuple(Link(name, 1.0, (0.1, 0.0, 0.0), np.eye(3), shapes, shapes[:1], "label") for name in "abc")
    joints = (
        Joint("first", JointType.REVOLUTE, "a", "b", Pose.from_euler(0.1, 0.2, 0.3), lower_limit=-1.0, armature=0.1),
        Joint("second", JointType.PRISMATIC, "b", "c", mimic=Mimic("first", 2.0, 0.0, (0.5, 0.0, 0.1)), stiffness=3.0),
    )
    frames = (Frame("tip", "c", Pose((0.0, 0.0, 1 / 3))),)
    loops = (LoopJoint("weld", "a", "c", type=LoopType.WELD, orientation=(0.6, 0.8, 0.0, 0.0)),)
    drives = (DriveGains("first", 10.0, 1.0),)
    home = (("first", 0.3), ("second", 0.6 + 0.5 * 0.3**2 + 0.1 * 0.3**4))
    # Noise, so that its pixels are no default; links "a", "b" and "c" share it.
    picture = Texture(np.random.default_rng(0).integers(0, 256, (9, 7, 3), dtype=np.uint8), 0.5)
    skin = Mesh(np.eye(3, dtype=np.float32), mesh.faces, coordinates=np.array([[0.0, 0.1], [0.2, 1.0], [0.7, 0.5]]))
    pictured = Shape(skin, finish=Finish(texture=picture))
    links = tuple(replace(link, visuals=(*link.visuals, pictured)) for link in links)
    return Articulation("thing", links, joints, frames, True, (("a", "c"),), ("a note",), loops, drives, home)


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORBIT_CACHE_DIR", str(tmp_path / "cache"))


@pytest.fixture
def builds() -> list[str]:
    return []


@pytest.fixture
def model(builds: list[str]) -> Model:
    def build() -> Articulation:
        builds.append("built")
        return make()

    return Model("thing", build, (PACKAGE,), "BSD")


@pytest.fixture
def hide(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    return lambda: monkeypatch.setattr(sources, "installed_version", lambda package: None)


def assert_same(a: Articulation, b: Articulation) -> None:
    assert (a.name, a.joints, a.frames, a.notes) == (b.name, b.joints, b.frames, b.notes)
    assert (a.self_collisions, a.collision_exclusions) == (b.self_collisions, b.collision_exclusions)
    assert (a.loops, a.drives, a.home) == (b.loops, b.drives, b.home)
    for one, two in zip(a.links, b.links, strict=True):
        assert (one.name, one.mass, one.center_of_mass) == (two.name, two.mass, two.center_of_mass)
        assert (one.collisions, one.visuals, one.semantic_label) == (two.collisions, two.visuals, two.semantic_label)
        np.testing.assert_array_equal(one.inertia, two.inertia)


def entry() -> Path:
    return cache_folder() / "models" / "thing.json"


def test_round_trip_is_exact_and_meshes_cannot_be_written(model: Model, builds: list[str]) -> None:
    assert_same(cached_articulation(model), make())
    again = cached_articulation(model)
    assert builds == ["built"]
    assert_same(again, make())
    mesh = again.root.visuals[0].geometry
    assert isinstance(mesh, Mesh)
    assert not mesh.vertices.flags.writeable
    assert len(list((cache_folder() / "meshes").iterdir())) == 6, "equal arrays are stored once"
    picture = again.root.visuals[1].finish.texture
    assert picture is not None
    assert picture.pixels.dtype == np.uint8
    assert json.loads(entry().read_text())["licence"] == "BSD"


def test_rebuilt_for_another_version_or_recipe(
    model: Model, builds: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    cached_articulation(model)
    monkeypatch.setattr(sources, "installed_version", lambda package: "99.0")
    cached_articulation(model)
    monkeypatch.setattr(Model, "fingerprint", lambda self: "another")
    cached_articulation(model)
    cached_articulation(model)
    assert len(builds) == 3


def test_a_copied_folder_serves_without_the_package(
    model: Model, builds: list[str], hide: Callable[[], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cached_articulation(model)
    hide()
    cache_folder().rename(tmp_path / "elsewhere")
    monkeypatch.setenv("ORBIT_CACHE_DIR", str(tmp_path / "elsewhere"))
    assert_same(cached_articulation(model), make())
    assert builds == ["built"]


def test_an_outdated_copy_says_so(model: Model, hide: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
    cached_articulation(model)
    hide()
    monkeypatch.setattr(Model, "fingerprint", lambda self: "another")
    assert PACKAGE in cached_articulation(model).notes[-1]


def test_neither_copy_nor_package(hide: Callable[[], None]) -> None:
    hide()
    with pytest.raises(AssetError, match=r"pip install .*\[robots\]"):
        cached_articulation(Model("thing", make, ("example-robot-data",), ""))


def _truncate_mesh() -> None:
    path = next((cache_folder() / "meshes").glob("*.vertices.npy"))
    path.write_bytes(path.read_bytes()[:-8])


def _empty_mesh() -> None:
    next((cache_folder() / "meshes").glob("*.vertices.npy")).write_bytes(b"")


def _change_mesh() -> None:
    path = next((cache_folder() / "meshes").glob("*.vertices.npy"))
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    "damage",
    [
        lambda: entry().write_text('{"fingerprint": '),
        lambda: entry().write_text("[]"),
        lambda: entry().write_text(entry().read_text().replace('"Joint"', '"Hinge"')),
        lambda: entry().write_text(entry().read_text().replace('"parent"', '"father"')),
        lambda: [path.unlink() for path in (cache_folder() / "meshes").iterdir()],
        _truncate_mesh,
        _empty_mesh,
        _change_mesh,
    ],
)
def test_damage_is_mended_or_reported(
    model: Model, builds: list[str], hide: Callable[[], None], damage: Callable[[], object]
) -> None:
    cached_articulation(model)
    damage()
    assert_same(cached_articulation(model), make())
    assert len(builds) == 2
    damage()
    hide()
    with pytest.raises(AssetError, match="thing"):
        cached_articulation(model)


def test_many_writers_at_once(model: Model) -> None:
    with ThreadPoolExecutor(8) as pool:
        for articulation in pool.map(lambda _: cached_articulation(model), range(32)):
            assert_same(articulation, make())
    assert not list(cache_folder().rglob(".*")), "no temporary file is left"


def test_a_folder_that_cannot_be_written_only_warns(
    model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ORBIT_CACHE_DIR", str(tmp_path / "file" / "cache"))
    with pytest.warns(UserWarning, match="could not be cached"):
        assert_same(cached_articulation(model), make())


def test_default_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ORBIT_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert cache.cache_folder() == Path("/somewhere/orbit")
