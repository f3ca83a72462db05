"""Models open files of their own folder and packages, and no others unless the caller says so."""

from __future__ import annotations

import base64
import json
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import mujoco
import pytest

from orbit_assets import load_articulation
from orbit_assets.audit.audit import audit_file
from orbit_assets.meshes import load_mesh, load_parts
from orbit_assets.options import ReadLimits, ReadOptions
from orbit_assets.outside import model_folder, resolve_file
from orbit_assets.textures import texture_file
from orbit_assets.urdf import read_urdf
from orbit_core.interfaces.errors import ArgumentError, AssetError
from tests.fuzz.watch import watched

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


@pytest.mark.parametrize(
    "reference",
    [
        "file://meshes/mesh.obj",
        "file:meshes/mesh.obj",
        "file://./meshes/mesh.obj",
        "file://localhost{here}/meshes/mesh.obj",
        "file://{here}/meshes/mesh.obj",
        "package://robot//meshes/mesh.obj",
        "package://robot/meshes//mesh.obj",
        "package:///robot/meshes/mesh.obj",
        "model://robot//meshes/mesh.obj",
    ],
)
def test_uris_with_more_or_fewer_slashes_than_the_standard_has_are_read(model: Path, reference: str) -> None:
    (model / "meshes").mkdir()
    (model / "mesh.obj").rename(model / "meshes" / "mesh.obj")
    path = model / "robot.urdf"
    path.write_text(URDF.format(reference.format(here=model)))
    assert load_articulation(path).root.visuals


@pytest.mark.parametrize(
    "reference", ["file://../mesh.obj", "package://robot//../mesh.obj", "file:///{above}/mesh.obj"]
)
def test_such_uris_lead_to_nothing_outside(model: Path, reference: str) -> None:
    path = model / "robot.urdf"
    path.write_text(URDF.format(reference.format(above=model.parent)))
    with pytest.raises(AssetError, match="outside the model's folder"):
        load_articulation(path)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda path: load_articulation(5), "path is 5"),
        (lambda path: load_articulation(path, options={}), r"options is \{\}: give a ReadOptions"),
        (lambda path: load_articulation(path, merge="no"), "merge is 'no': give true or false"),
        (lambda path: read_urdf(path, ["robot"]), "packages is .*: give a dictionary"),
        (lambda path: read_urdf(path, name=3), "name is 3"),
        (lambda path: load_mesh(path, 2.0), "scale is 2.0: give a tuple"),
        (lambda path: ReadOptions(repair="balance"), "ReadOptions.repair is 'balance': give a Repair"),
        (lambda path: ReadOptions(allow_outside=[path]), "ReadOptions.allow_outside is .*: give True or a tuple"),
        (lambda path: ReadOptions(allow_outside=(3,)), "names the folder 3: give a path"),
        (lambda path: ReadOptions(environment="HOME"), "ReadOptions.environment is 'HOME': give a tuple"),
        (lambda path: ReadOptions(packages={"robot": None}), "names the folder None: give a path"),
    ],
)
def test_a_callers_wrong_argument_is_not_blamed_on_the_file(
    model: Path, call: Callable[[Path], object], message: str
) -> None:
    path = model / "robot.urdf"
    path.write_text(URDF.format("mesh.obj"))
    with pytest.raises(ArgumentError, match=message) as caught:
        call(path)
    assert "correct the file" not in str(caught.value)


def test_an_unknown_argument_is_pythons_own_error(model: Path) -> None:
    with pytest.raises(TypeError, match="unexpected keyword argument 'repair'"):
        load_articulation(model / "robot.urdf", repair="balance")  # pyright: ignore[reportCallIssue]


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


INCLUDED = '<mujocoinclude><asset><mesh name="m" file="{}"/></asset></mujocoinclude>'
INCLUDING = """<mujoco>{}<worldbody><body><geom type="mesh" mesh="m" density="1000"/></body></worldbody></mujoco>"""


def solid(path: Path, size: float) -> None:
    """Write a tetrahedron of ``size`` metres, whose mass tells which file was read."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(TETRAHEDRON.replace("1 0 0", f"{size} 0 0").replace("v 0 1 0", f"v 0 {size} 0"))


@pytest.mark.parametrize(
    ("part", "reference", "meshes", "found"),
    [
        ("../../part.xml", "../mesh.obj", {"../../../mesh.obj": 3.0, "../mesh.obj": 2.0}, None),
        ("sub/part.xml", "mesh.obj", {"sub/mesh.obj": 2.0}, 2.0),
        ("sub/part.xml", "q/mesh.obj", {"sub/q/mesh.obj": 2.0, "q/q/mesh.obj": 1.5}, 1.5),
        ("sub/part.xml", "../../../../mesh.obj", {"../../../mesh.obj": 3.0}, None),
    ],
)
def test_meshes_of_included_mjcf_are_found_as_mujoco_finds_them_and_held_to_the_folder(
    tmp_path: Path, part: str, reference: str, meshes: dict[str, float], found: float | None
) -> None:
    main = tmp_path / "model" / "a" / "b" / "main.xml"
    (main.parent / part).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / "model" / "package.xml").write_text("<package/>")
    for name, size in meshes.items():
        solid(Path(os.path.normpath(main.parent / name)), size)
    main.parent.mkdir(exist_ok=True, parents=True)
    Path(os.path.normpath(main.parent / part)).write_text(INCLUDED.format(reference))
    main.write_text(INCLUDING.format(f'<include file="{part}"/><compiler meshdir="q"/>'))
    if found is None:
        with pytest.raises(AssetError, match="outside the model's folder"):
            load_articulation(main)
    else:
        assert load_articulation(main).mass == pytest.approx(1000 * found**2 / 6.0)


@pytest.mark.parametrize(
    ("included", "main", "found"),
    [
        ('assetdir=""', 'meshdir="m"', 2.0),
        ('meshdir=""', 'assetdir="n"', 1.5),
        ('meshdir="m"', 'assetdir="n"', 2.0),
        ('assetdir="m"', 'meshdir="n"', 1.5),
        ('meshdir="n"', 'assetdir=""', 1.0),
        ('meshdir="n"', 'assetdir="k"', None),
        ('strippath="true" meshdir="m"', 'assetdir="n"', 1.5),
    ],
)
def test_meshes_of_included_mjcf_are_found_whatever_compilers_say(
    tmp_path: Path, included: str, main: str, found: float | None
) -> None:
    """MuJoCo looks for them by other folders than it opens them from where several compilers name folders."""
    for name, size in {"mesh.obj": 1.0, "n/mesh.obj": 1.5, "sub/mesh.obj": 2.0}.items():
        solid(tmp_path / name, size)
    part = INCLUDED.format("mesh.obj").replace("<asset>", f"<compiler {included}/><asset>")
    (tmp_path / "sub" / "part.xml").write_text(part)
    path = tmp_path / "main.xml"
    path.write_text(INCLUDING.format(f'<include file="sub/part.xml"/><compiler {main}/>'))
    if found is None:
        with pytest.raises(ValueError, match="Error opening file"):
            mujoco.MjModel.from_xml_path(str(path))
        with pytest.raises(AssetError, match="does not exist"):
            load_articulation(path)
        return
    mass = 1000 * found**2 / 6.0
    assert mujoco.MjModel.from_xml_path(str(path)).body_mass.sum() == pytest.approx(mass)
    assert load_articulation(path).mass == pytest.approx(mass)


@pytest.mark.parametrize(
    "hidden",
    [
        '<custom><text name="a" data="<!--"/></custom>{}<custom><text name="b" data="-->"/></custom>',
        "<![CDATA[<!--]]>{}<![CDATA[-->]]>",
        "<?a <!-- ?>{}<?a --> ?>",
    ],
)
def test_mujoco_opens_no_file_by_elements_that_other_parsers_take_for_a_comment(model: Path, hidden: str) -> None:
    solid(model.parent / "mesh.obj", 3.0)
    asset = '<asset><mesh name="m" file="../mesh.obj"/></asset>'
    path = model / "robot.xml"
    for body in (asset, '<include file="../part.xml"/>'):
        (model.parent / "part.xml").write_text(f"<mujocoinclude>{asset}</mujocoinclude>")
        path.write_text(INCLUDING.format(hidden.format(body)))
        with pytest.raises(AssetError, match=r"does not compile|not well-formed"):
            load_articulation(path)


def test_the_comparison_with_mujoco_opens_no_hidden_file(model: Path) -> None:
    (model.parent / "part.xml").write_text("<mujocoinclude><option/></mujocoinclude>")
    hidden = '<option/><![CDATA[<!--]]><include file="../part.xml"/><![CDATA[-->]]>'
    path = model / "robot.xml"
    path.write_text(f'<mujoco>{hidden}<worldbody><body><geom size="1"/></body></worldbody></mujoco>')
    with watched([model.parent / "part.xml"]) as opened:
        report = audit_file(path)
    assert report.comparison is not None
    assert opened == []


def test_mjcf_of_another_encoding_is_what_mujoco_reads(model: Path) -> None:
    solid(model.parent / "mesh.obj", 3.0)
    hidden = '+ADwAIQAtAC0-<asset><mesh name="m" file="../mesh.obj"/></asset>+AC0ALQA+-'
    path = model / "robot.xml"
    path.write_text('<?xml version="1.0" encoding="utf-7"?>' + INCLUDING.format(hidden))
    with pytest.raises(AssetError, match="does not compile"):
        load_articulation(path)


@pytest.mark.parametrize("reference", ["link/../../mesh.obj", "..\\mesh.obj", "sub/..\\..\\mesh.obj"])
def test_paths_of_mjcf_are_checked_as_mujoco_reduces_them(model: Path, reference: str) -> None:
    solid(model / "a" / "mesh.obj", 1.0)
    (model / "a" / "b" / "c").mkdir(parents=True)
    (model / "link").symlink_to(model / "a" / "b" / "c")
    path = model / "robot.xml"
    path.write_text(MJCF.format(reference))
    with pytest.raises(AssetError, match="outside the model's folder"):
        load_articulation(path)


def test_models_that_mjcf_attaches_are_held_to_the_folder(model: Path) -> None:
    attach = '<asset><model name="p" file="{}"/></asset><worldbody><attach model="p" body="b" prefix="x"/></worldbody>'
    part = INCLUDING.replace("<body>", '<body name="b">')
    path = model / "robot.xml"
    path.write_text(f"<mujoco>{attach.format('parts/part.xml')}</mujoco>")
    (model / "parts").mkdir()
    for name, allowed in (("../mesh.obj", True), ("../../mesh.obj", False), ("<!--", False)):
        (model / "parts" / "part.xml").write_text(part.format(INCLUDED.format(name)[15:-16]))
        if allowed:
            assert load_articulation(path).mass == pytest.approx(1000.0 / 6.0)
        else:
            with pytest.raises(AssetError):
                load_articulation(path)


def test_models_that_attach_or_include_ever_more_are_refused(model: Path) -> None:
    attach = "".join(f'<attach model="p" body="b" prefix="x{number}"/>' for number in range(10))
    include = "<include><uri>part{}.sdf</uri></include>"
    for level in range(6):
        asset = f'<asset><model name="p" file="part{level + 1}.xml"/></asset>'
        body = f'<mujoco>{asset}<worldbody><body name="b">{attach}</body></worldbody></mujoco>'
        (model / f"part{level}.xml").write_text(body)
        (model / f"part{level}.sdf").write_text(f"<sdf><world>{include.format(level + 1) * 10}</world></sdf>")
    (model / "part6.xml").write_text('<mujoco><worldbody><body name="b"><geom size="1"/></body></worldbody></mujoco>')
    (model / "part6.sdf").write_text('<sdf><model name="m"><link name="l"/></model></sdf>')
    for name in ("part0.xml", "part0.sdf"):
        with pytest.raises(AssetError, match=r"raise ReadLimits\.copies"):
            load_articulation(model / name, options=ReadOptions(limits=ReadLimits(copies=200)))


@pytest.mark.parametrize("tag", ["Include", "INCLUDE"])
def test_an_include_in_other_letters_opens_nothing(model: Path, tag: str) -> None:
    path = model / "robot.xml"
    path.write_text(f'<mujoco><{tag} file="../part.xml"/></mujoco>')
    with pytest.raises(AssetError, match=f"<{tag}>, which MJCF lacks: write <include>"):
        load_articulation(path)


CLIPS = """#usda 1.0
def Cube "c" (
    prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"]
    clips = {
        dictionary default = {
            asset[] assetPaths = [@../layer.usda@]
            string primPath = "/c"
            double2[] active = [(0, 0)]
            double2[] times = [(0, 0)]
        }
    }
)
{
}
"""
VARIANT = """#usda 1.0
def "a" (
    prepend variantSets = "v"
    variants = {
        string v = "x"
    }
)
{
    variantSet "v" = {
        "x" (
            prepend references = @../layer.usda:SDF_FORMAT_ARGS:a=b@</c>
        ) {
        }
    }
}
"""
ARCS = {
    "references": '#usda 1.0\n({variables})\ndef "a" (prepend references = {path}</c>) {{}}\n',
    "payload": '#usda 1.0\n({variables})\ndef "a" (prepend payload = {path}</c>) {{}}\n',
    "subLayers": "#usda 1.0\n({variables}\nsubLayers = [{path}]\n)\n",
}


@pytest.mark.parametrize("arc", ARCS)
def test_usd_layers_are_checked_however_they_are_named(model: Path, arc: str) -> None:
    path = model / "stage.usda"

    def stage(name: str, variables: str = "") -> Path:
        path.unlink(missing_ok=True)
        path.write_text(ARCS[arc].format(path=name, variables=variables))
        return path

    (model / "link.usda").symlink_to(model.parent / "layer.usda")
    for name in ("@../layer.usda:SDF_FORMAT_ARGS:a=b@", "@./link.usda:SDF_FORMAT_ARGS:a=b@", "@./link.usda@"):
        with pytest.raises(AssetError, match="outside the model's folder"):
            load_articulation(stage(name))
    with pytest.raises(AssetError, match=r"names a layer by the expression .*: write the path out"):
        load_articulation(stage('@`"${UP}/layer.usda"`@', 'expressionVariables = {string UP = ".."}'))
    assert len(load_articulation(stage("@./layer.usda:SDF_FORMAT_ARGS:a=b@")).links) == 1


def test_layers_in_the_working_folder_are_not_found(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (model.parent / "other.usda").write_text(LAYER)
    (model / "stage.usda").write_text(ARCS["references"].format(path="@other.usda@", variables=""))
    monkeypatch.chdir(model.parent)
    with pytest.raises(AssetError, match="outside the model's folder"):
        load_articulation(model / "stage.usda")


def test_value_clips_and_layers_of_variants_are_refused(model: Path) -> None:
    for text, message in ((CLIPS, "/c has value clips"), (VARIANT, "outside the model's folder")):
        path = model / f"stage{len(text)}.usda"
        path.write_text(text)
        with pytest.raises(AssetError, match=message):
            load_articulation(path)


def test_layers_within_an_archive_are_checked_too(model: Path) -> None:
    sdf = pytest.importorskip("pxr.Sdf")
    for name, target in (("good", "part.usda"), ("bad", "part.usda"), ("out", str(model.parent / "layer.usda"))):
        inner = str(model.parent / "layer.usda") if name == "bad" else "last.usda"
        archive = sdf.ZipFileWriter.CreateNew(str(model / f"{name}.usdz"))
        for member, text in (
            ("root.usda", ARCS["references"].format(path=f"@{target}@", variables="")),
            ("part.usda", ARCS["references"].format(path=f"@{inner}@", variables="").replace('"a"', '"c"')),
            ("last.usda", LAYER),
        ):
            (model / member).write_text(text)
            archive.AddFile(str(model / member), member)
        archive.Save()
    assert len(load_articulation(model / "good.usdz").links) == 1
    for name in ("bad", "out"):
        with pytest.raises(AssetError, match="outside the model's folder"):
            load_articulation(model / f"{name}.usdz")


OBJ = "mtllib {}\nusemtl m\n" + TETRAHEDRON
GLTF = {
    "asset": {"version": "2.0"},
    "accessors": [{"componentType": 5126, "type": "VEC3", "bufferView": 0, "count": 3}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "nodes": [{"mesh": 0}],
    "scenes": [{"nodes": [0]}],
    "scene": 0,
}


@pytest.mark.parametrize(
    "form", ["../secret.bin", "{above}/secret.bin", "file://{above}/secret.bin", "..\\secret.bin", "link.bin"]
)
def test_buffers_and_materials_of_meshes_outside_are_not_opened(model: Path, form: str) -> None:
    secret = model.parent / "secret.bin"
    secret.write_bytes(struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0))
    (model / "link.bin").symlink_to(secret)
    uri = form.format(above=model.parent)
    (model / "mesh.gltf").write_text(json.dumps(GLTF | {"buffers": [{"uri": uri, "byteLength": 36}]}))
    with pytest.raises(AssetError, match="outside the model's folder"):
        load_mesh(model / "mesh.gltf")
    secret.write_text("newmtl m\nKd 1 0 0\n")
    (model / "mesh.obj").write_text(OBJ.format(uri))
    assert all(part.color != (1.0, 0.0, 0.0, 1.0) for part in load_parts(model / "mesh.obj"))


COLLADA = Path(__file__).parents[1] / "fuzz" / "corpus" / "box.dae"


@pytest.mark.parametrize("before", ["", " " * 100_000, "<!--" + "x" * 100_000 + "-->"])
def test_entities_are_refused_wherever_a_mesh_declares_them(model: Path, before: str) -> None:
    text = before + "<!DOCTYPE x [<!ENTITY a 'b'>]>" + COLLADA.read_text()
    (model / "mesh.dae").write_text(text)
    for name in ("mesh.zae", "mesh.3mf"):
        with zipfile.ZipFile(model / name, "w") as archive:
            archive.writestr("manifest.xml", "<dae_root>mesh.dat</dae_root>")
            archive.writestr("mesh.dat", text)
    for name in ("mesh.dae", "mesh.zae", "mesh.3mf"):
        with pytest.raises(AssetError, match="declares XML entities"):
            load_mesh(model / name)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_pictures_of_meshes_with_more_pixels_than_the_limit_are_left_out(model: Path, suffix: str) -> None:
    image = pytest.importorskip("PIL.Image")
    image.new("RGB", (40, 30)).save(model / f"skin.{suffix}")
    (model / "skin.mtl").write_text(f"newmtl m\nmap_Kd skin.{suffix}\n")
    textured = TETRAHEDRON.replace("f ", "vt 0 0\nf ", 1).replace("f 1 3 2", "f 1/1 3/1 2/1")
    (model / "mesh.obj").write_text(f"mtllib skin.mtl\nusemtl m\n{textured}")
    for pixels, drawn in ((1200, True), (1199, False)):
        options = ReadOptions(limits=ReadLimits(pixels=pixels))
        assert load_parts(model / "mesh.obj", options=options)[0].textured == drawn


POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\n0 0 8 8 rectfill\nshowpage\n%%EOF\n"


def test_pictures_that_are_programs_are_not_run(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ghostscript = model.parent / "bin" / "gs"
    ghostscript.parent.mkdir()
    ghostscript.write_text(f"#!/bin/sh\necho 9.0 >> {model.parent}/ran\n")
    ghostscript.chmod(0o755)
    monkeypatch.setenv("PATH", str(ghostscript.parent), prepend=os.pathsep)
    (model / "skin.png").write_bytes(POSTSCRIPT)
    (model / "skin.mtl").write_text("newmtl m\nmap_Kd skin.png\n")
    textured = TETRAHEDRON.replace("f ", "vt 0 0\nf ", 1).replace("f 1 3 2", "f 1/1 3/1 2/1")
    (model / "mesh.obj").write_text(f"mtllib skin.mtl\nusemtl m\n{textured}")
    image = {"images": [{"bufferView": 1}], "textures": [{"source": 0}]}
    material = {"materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}
    data = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0) + POSTSCRIPT
    views = [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": len(POSTSCRIPT)}]
    uri = f"data:application/octet-stream;base64,{base64.b64encode(data).decode()}"
    header = GLTF | image | material | {"bufferViews": views, "buffers": [{"uri": uri, "byteLength": len(data)}]}
    header["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}]
    (model / "mesh.gltf").write_text(json.dumps(header))
    for name in ("mesh.obj", "mesh.gltf"):
        with pytest.raises(AssetError, match="Ghostscript"):
            load_parts(model / name)
    with pytest.raises(AssetError, match="cannot be read as a picture"):
        texture_file(model / "skin.png")
    assert not (model.parent / "ran").exists()


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
        '<worldbody><replicate count="20000"><geom size="1"/></replicate></worldbody>',
        '<worldbody><replicate count="20000"><include file="part.xml"/></replicate></worldbody>',
        '<asset><texture name="t" builtin="flat" width="20000"/></asset>',
        '<asset><mesh name="m" builtin="supertorus" params="20000 0.3 1 1"/></asset>',
        '<asset><mesh name="m" builtin="plate" params="30000 30000"/></asset>',
        '<size nkey="1000000"/>',
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
    (model / "part.xml").write_text('<mujocoinclude><geom size="1"/></mujocoinclude>')
    with pytest.raises(AssetError, match=r"robot\.xml.*raise ReadLimits"):
        load_articulation(path)


def test_an_accessor_of_zeros_is_refused_before_they_are_made(model: Path) -> None:
    accessor = {"componentType": 5126, "count": 2_000_000_000, "type": "VEC3"}
    (model / "zeros.gltf").write_text(json.dumps({"asset": {"version": "2.0"}, "accessors": [accessor]}))
    with pytest.raises(AssetError, match=r"zeros\.gltf' has an accessor of 2000000000 elements"):
        load_mesh(model / "zeros.gltf")
