"""Models open files of their own folder and packages, and no others unless the caller says so."""

from __future__ import annotations

import json
import os
import struct
import zipfile
from pathlib import Path

import pytest

from orbit_core.assets import load_articulation
from orbit_core.assets.meshes import load_mesh
from orbit_core.assets.options import ReadLimits, ReadOptions
from orbit_core.assets.outside import model_folder, resolve_file
from orbit_core.interfaces.errors import AssetError

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
URDF = '<robot name="r"><link name="base"><visual><geometry><mesh filename="{}"/></geometry></visual></link></robot>'
MJCF = '<mujoco><asset><mesh name="m" file="{}"/></asset><worldbody><body><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'  # noqa: E501
LAYER = '#usda 1.0\ndef Cube "c" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"]) {}\n'


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A model's folder, with a mesh and a layer in it and others beside it."""
    folder = tmp_path / "robot"
    folder.mkdir()
    for place in (folder, tmp_path):
        (place / "mesh.obj").write_text(TETRAHEDRON)
        (place / "layer.usda").write_text(LAYER)
    return folder


OUTSIDE = ("../mesh.obj", "{above}/mesh.obj", "link.obj")


@pytest.mark.parametrize(
    ("suffix", "text", "form"),
    [
        *(("xml", MJCF, form) for form in OUTSIDE),
        *(("urdf", URDF, form) for form in (*OUTSIDE, "file://{above}/mesh.obj")),
    ],
)
def test_meshes_outside_are_refused_unless_allowed(model: Path, suffix: str, text: str, form: str) -> None:
    (model / "link.obj").symlink_to(model.parent / "mesh.obj")
    path = model / f"robot.{suffix}"
    path.write_text(text.format(form.format(above=model.parent)))
    with pytest.raises(AssetError, match="outside the model's folder"):
        load_articulation(path)
    for allowed in (True, (model.parent,)):
        assert load_articulation(path, options=ReadOptions(allow_outside=allowed)).root.visuals
    with pytest.raises(AssetError, match="outside the model's folder"):
        load_articulation(path, options=ReadOptions(allow_outside=(model / "elsewhere",)))


@pytest.mark.parametrize("suffix", ["urdf", "xml"])
def test_meshes_in_the_models_folder_are_read(model: Path, suffix: str) -> None:
    path = model / f"robot.{suffix}"
    path.write_text({"urdf": URDF, "xml": MJCF}[suffix].format("mesh.obj"))
    assert load_articulation(path).root.visuals


@pytest.mark.parametrize("arc", ["references", "payload", "subLayers"])
def test_usd_layers_outside_are_refused_and_missing_ones_are_errors(model: Path, arc: str) -> None:
    def stage(name: str, layer: str) -> Path:
        path = model / name
        if arc == "subLayers":
            path.write_text(f"#usda 1.0\n(subLayers = [@{layer}@])\n")
        else:
            path.write_text(f'#usda 1.0\ndef "a" (prepend {arc} = @{layer}@</c>) {{}}\n')
        return path

    assert len(load_articulation(stage("within.usda", "./layer.usda")).links) == 1
    outside = stage("outside.usda", "../layer.usda")
    with pytest.raises(AssetError, match="outside the model's folder"):
        load_articulation(outside)
    assert len(load_articulation(outside, options=ReadOptions(allow_outside=True)).links) == 1
    with pytest.raises(AssetError, match=r"gone\.usda"):
        load_articulation(stage("missing.usda", "./gone.usda"))


def test_includes_of_mjcf_outside_are_refused(model: Path) -> None:
    (model.parent / "part.xml").write_text('<mujoco><worldbody><body><geom size="1"/></body></worldbody></mujoco>')
    path = model / "robot.xml"
    path.write_text('<mujoco><include file="../part.xml"/></mujoco>')
    with pytest.raises(AssetError, match=r"<include>.*outside the model's folder"):
        load_articulation(path)
    assert len(load_articulation(path, options=ReadOptions(allow_outside=True)).links) == 1


def test_packages_named_or_above_the_model_are_open(model: Path, tmp_path: Path) -> None:
    options = ReadOptions(packages={"parts": tmp_path})
    path = model / "urdf" / "robot.urdf"
    path.parent.mkdir()
    for form in ("package://parts/mesh.obj", "package://robot/mesh.obj", "package:///mesh.obj"):
        assert resolve_file(form, path, options).read_text() == TETRAHEDRON
    with pytest.raises(AssetError, match="unknown package: give its folder"):
        resolve_file("package://others/mesh.obj", path, options)
    with pytest.raises(AssetError, match="outside the model's folder"):
        resolve_file("package://robot/../mesh.obj", path, ReadOptions())


def test_a_ros_package_and_an_installed_distribution_are_one_folder(tmp_path: Path) -> None:
    (tmp_path / "package.xml").write_text("<package/>")
    assert model_folder(tmp_path / "urdf" / "robot.urdf") == tmp_path
    installed = tmp_path / "site-packages" / "suite" / "assets" / "hand"
    assert model_folder(installed / "hand.xml") == tmp_path / "site-packages" / "suite"
    shared = tmp_path / "site-packages" / "cmeel.prefix" / "share"
    assert model_folder(shared / "robots" / "a" / "a.urdf") == shared / "robots"


@pytest.mark.parametrize("reference", ["https://example.org/mesh.obj", "a\0b", "", "mesh.obj/..", "pipe"])
def test_what_is_no_regular_file_is_refused(model: Path, reference: str) -> None:
    os.mkfifo(model / "pipe")
    with pytest.raises(AssetError):
        resolve_file(reference, model / "robot.urdf", ReadOptions())


def test_files_over_the_limit_are_refused_before_they_are_read(model: Path) -> None:
    options = ReadOptions(limits=ReadLimits(file_bytes=10))
    with pytest.raises(AssetError, match=r"mesh\.obj.*raise ReadLimits\.file_bytes"):
        resolve_file("mesh.obj", model / "robot.urdf", options)


def test_meshes_of_more_triangles_than_the_limit_are_refused(model: Path) -> None:
    with pytest.raises(AssetError, match="holds 4 triangles: make it smaller"):
        load_mesh(model / "mesh.obj", options=ReadOptions(limits=ReadLimits(vertices=3)))
    assert len(load_mesh(model / "mesh.obj", options=ReadOptions(limits=ReadLimits(vertices=4))).faces) == 4


def test_archives_and_pictures_are_measured_before_they_are_unpacked(model: Path) -> None:
    with zipfile.ZipFile(model / "bomb.zae", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb.dae", b"0" * 10_000_000)
    assert (model / "bomb.zae").stat().st_size < 20_000
    with pytest.raises(AssetError, match="unpacks to 10000000 bytes"):
        load_mesh(model / "bomb.zae", options=ReadOptions(limits=ReadLimits(expanded_bytes=1_000_000)))
    (model / "huge.png").write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 100_000, 100_000))
    path = model / "robot.xml"
    path.write_text('<mujoco><asset><texture type="2d" name="t" file="huge.png"/></asset></mujoco>')
    with pytest.raises(AssetError, match=r"huge\.png has 100000 x 100000 pixels"):
        load_articulation(path)


@pytest.mark.parametrize(
    "body",
    [
        '<worldbody><replicate count="2000000000"><geom size="1"/></replicate></worldbody>',
        "<worldbody><replicate count='2000'><replicate count='2000'><geom/></replicate></replicate></worldbody>",
        '<worldbody><body><composite type="cable" count="2000000000 1 1"/></body></worldbody>',
        '<asset><texture type="2d" builtin="flat" name="t" width="100000" height="100000"/></asset>',
        '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
        '<size nuser_body="2000000000"/>',
        '<custom><numeric name="n" size="2000000000"/></custom>',
    ],
)
def test_mjcf_that_asks_for_gigabytes_is_refused_before_it_is_compiled(model: Path, body: str) -> None:
    path = model / "robot.xml"
    path.write_text(f"<mujoco>{body}</mujoco>")
    with pytest.raises(AssetError, match=r"robot\.xml.*raise ReadLimits"):
        load_articulation(path)


def test_an_accessor_of_zeros_is_refused_before_they_are_made(model: Path) -> None:
    accessor = {"componentType": 5126, "count": 2_000_000_000, "type": "VEC3"}
    (model / "zeros.gltf").write_text(json.dumps({"asset": {"version": "2.0"}, "accessors": [accessor]}))
    with pytest.raises(AssetError, match=r"zeros\.gltf' has an accessor of 2000000000 elements"):
        load_mesh(model / "zeros.gltf")
