"""Whole USD stages by other hands: several articulations, instances, units, names, layers, size."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from orbit_assets import load_articulation
from orbit_assets.options import ReadLimits, ReadOptions
from orbit_assets.usd import read_usd, read_usd_all
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Box, Sphere
from tests.assets.usd_files import CENTIMETRES, CUBE, body, joint, stage


def robot(name: str, at: tuple[float, float, float]) -> str:
    return f"""
    def Xform "{name}"
    {{
        double3 xformOp:translate = {at}
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {body("base", CUBE, schemas=', "PhysicsArticulationRootAPI"')}
        {body("arm", CUBE, at=(0, 0, 1))}
        def PhysicsRevoluteJoint "turn"
        {{
            rel physics:body0 = </top/{name}/base>
            rel physics:body1 = </top/{name}/arm>
            point3f physics:localPos0 = (0, 0, 1)
        }}
        def PhysicsFixedJoint "hold"
        {{
            rel physics:body1 = </top/{name}/base>
        }}
    }}"""


def test_a_reference_in_other_units_counts_in_the_stages_and_is_noted(tmp_path: Path) -> None:
    """As in USD itself, which converts nothing: a box of 100 cm becomes one of 100 m."""
    box = 'def Cube "cube" (prepend apiSchemas = ["PhysicsCollisionAPI"])\n{\n    double size = 100\n}'
    stage(tmp_path, body("a", box), CENTIMETRES, "part.usda")
    content = '    def "part" (prepend references = @part.usda@)\n    {\n    }'
    got = load_articulation(stage(tmp_path, content))
    assert got.root.collisions[0].geometry == Box((50.0, 50.0, 50.0))
    told = " ".join(got.notes)
    assert "part.usda has metersPerUnit 0.01, and the stage 1.0: its numbers count in the stage's" in told
    assert "part.usda has upAxis Y, and the stage Z" in told


def test_one_of_several_articulations_is_read_by_name_or_path(tmp_path: Path) -> None:
    path = stage(tmp_path, robot("left", (1, 0, 0)) + robot("right", (-1, 0, 0)) + body("cup", CUBE, at=(0, 0, 2)))
    with pytest.raises(AssetError, match=r"holds 3 articulations, 'left' \(/top/left\), 'right' \(/top/right\), 'cup'"):
        read_usd(path)
    for name in ("right", "/top/right", "/top/right/"):
        got = read_usd(path, options=ReadOptions(articulation=name))
        assert (got.name, got.link_names, got.joint_names) == ("right", ("base", "arm"), ("turn",))
    with pytest.raises(AssetError, match="none of the file's articulations is called 'middle'"):
        read_usd(path, options=ReadOptions(articulation="middle"))
    left, right, cup = read_usd_all(path)
    assert (left.pose.position, right.pose.position) == ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    assert (left.fixed_base, right.fixed_base, cup.fixed_base) == (True, True, False)
    assert cup.pose.position == (0.0, 0.0, 2.0)


def test_poses_in_a_stage_of_centimetres_with_y_up(tmp_path: Path) -> None:
    turned = body("cup", at=(10, 20, 30)).replace(
        'uniform token[] xformOpOrder = ["xformOp:translate"]',
        'double xformOp:rotateY = 90\nuniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY"]',
    )
    (cup,) = read_usd_all(stage(tmp_path, turned, CENTIMETRES))
    np.testing.assert_allclose(cup.pose.position, (0.1, -0.3, 0.2), atol=1e-12)
    np.testing.assert_allclose(cup.pose.orientation, (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)), atol=1e-9)


def test_bodies_of_one_name_are_told_apart_by_what_is_above_them(tmp_path: Path) -> None:
    def finger(side: str) -> str:
        return f'\ndef Xform "{side}"\n{{\n{body("tip")}\ndef Xform "point" {{\nbool orbit:frame = true\n}}\n\n}}'

    def hinge(side: str) -> str:
        return f"""
        def Scope "{side}_joints"\n{{
        def PhysicsRevoluteJoint "hinge"
        {{
            rel physics:body0 = </top/palm>
            rel physics:body1 = </top/{side}/tip>
        }}\n}}"""

    content = body("palm") + finger("left") + finger("right") + hinge("left") + hinge("right")
    got = load_articulation(stage(tmp_path, content))
    assert got.link_names == ("palm", "left_tip", "right_tip")
    assert got.joint_names == ("left_joints_hinge", "right_joints_hinge")


def test_instancers_and_instances_are_read_as_what_they_draw(tmp_path: Path) -> None:
    instancer = """
    def PointInstancer "many"
    {
        rel prototypes = [</top/many/small>, </top/many/ball>]
        int[] protoIndices = [0, 1, 0]
        point3f[] positions = [(0, 0, 1), (0, 1, 0), (0, 0, 3)]
        def Xform "small" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
        {
            def Cube "cube" (prepend apiSchemas = ["PhysicsCollisionAPI"])
            {
                double size = 0.1
            }
        }
        def Xform "ball" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
        {
            def Sphere "sphere" (prepend apiSchemas = ["PhysicsCollisionAPI"])
            {
                double radius = 0.2
            }
        }
    }"""
    path = stage(tmp_path, instancer)
    before = path.read_text()
    placed = read_usd_all(path)
    assert [each.articulation.name for each in placed] == ["small_0", "ball_1", "small_2"]
    assert [each.pose.position for each in placed] == [(0, 0, 1), (0, 1, 0), (0, 0, 3)]
    geometries = [each.articulation.root.collisions[0].geometry for each in placed]
    assert geometries == [Box((0.05, 0.05, 0.05)), Sphere(0.2), Box((0.05, 0.05, 0.05))]
    assert path.read_text() == before
    with pytest.raises(AssetError, match=r"draws 3 instances|composes to some"):
        read_usd_all(path, options=ReadOptions(limits=ReadLimits(elements=2)))
    for wrong, said in (("[0, 2, 0]", "draws prototypes 0 to 2 of 2"), ("[0, 1]", "has 2 indices and")):
        broken = stage(tmp_path, instancer.replace("[0, 1, 0]", wrong), name="broken.usda")
        with pytest.raises(AssetError, match=said):
            read_usd_all(broken)


def test_instanceable_references_keep_their_contents(tmp_path: Path) -> None:
    stage(tmp_path, body("foot", CUBE), name="part.usda")
    content = """
    def Xform "one" (instanceable = true
        references = @part.usda@)
    {
    }
    def Xform "two" (instanceable = true
        references = @part.usda@)
    {
        double3 xformOp:translate = (2, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }"""
    one, two = read_usd_all(stage(tmp_path, content))
    assert (one.articulation.name, two.articulation.name) == ("one_foot", "two_foot")
    assert two.pose.position == (2.0, 0.0, 0.0)
    assert len(one.articulation.root.collisions) == 1


def test_variants_are_read_as_the_file_selects_and_told(tmp_path: Path) -> None:
    content = f"""
    def Xform "thing" (
        variants = {{
            string size = "small"
        }}
        prepend variantSets = "size"
    )
    {{
        variantSet "size" = {{
            "small" {{
                {body("cup", CUBE)}
            }}
            "missing" (references = @nowhere.usda@) {{
            }}
        }}
    }}"""
    got = read_usd(stage(tmp_path, content))
    assert len(got.root.collisions) == 1
    assert any("is read as the file selects: size = 'small'" in note for note in got.notes)


def test_what_usd_would_print_is_a_note_or_an_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    # A body with frames is the default prim itself: USD's remark on its own schemas must not reach the terminal.
    content = '#usda 1.0\n(\n    defaultPrim = "cup"\n)\n' + body("cup", CUBE)
    path = tmp_path / "cup.usda"
    path.write_text(content)
    got = read_usd(path)
    assert got.name == got.root.name == "cup"
    path.write_text(content.replace('def Cube "cube" (', 'def Cube "cube" (\nreferences = @missing.usda@\n'))
    with pytest.raises(AssetError, match=r"missing\.usda"):
        read_usd(path)
    assert capfd.readouterr() == ("", "")


def test_colours_and_textures(tmp_path: Path) -> None:
    looks = """
    def Material "paint"
    {
        token outputs:surface.connect = </top/paint/shader.outputs:surface>
        def Shader "shader"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.25, 0.5, 0.75)
            color3f inputs:diffuseColor.connect = </top/paint/picture.outputs:rgb>
            token outputs:surface
        }
        def Shader "picture"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @wood.png@
            color3f outputs:rgb
        }
    }"""
    bound = 'def Sphere "ball" (prepend apiSchemas = ["MaterialBindingAPI"])\n{\nrel material:binding = </top/paint>\n}'
    got = read_usd(stage(tmp_path, looks + body("a", bound)))
    assert got.root.visuals[0].color == (0.25, 0.5, 0.75, 1.0)
    assert "the picture 'wood.png' of /top/paint/picture is missing, and left out" in got.notes


@pytest.mark.parametrize(
    ("inner", "said"),
    [
        ("int[] faceVertexCounts = [2000000000]\nint[] faceVertexIndices = [0, 1, 2]", "faces of 2e"),
        ("int[] faceVertexCounts = [3, -3]\nint[] faceVertexIndices = []", "faces of 0 corners|without faces"),
        ("int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 3]", "vertices that it lacks"),
        ("int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, -1]", "vertices that it lacks"),
    ],
)
def test_meshes_that_cannot_be(tmp_path: Path, inner: str, said: str) -> None:
    mesh = f'def Mesh "mesh"\n{{\npoint3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\n{inner}\n}}'
    with pytest.raises(AssetError, match=said):
        read_usd(stage(tmp_path, body("a", mesh)))


@pytest.mark.parametrize("unit", ["metersPerUnit = nan", "metersPerUnit = -1", "kilogramsPerUnit = 0"])
def test_units_that_cannot_be(tmp_path: Path, unit: str) -> None:
    with pytest.raises(AssetError, match=f"the stage's {unit.split()[0]} is"):
        read_usd(stage(tmp_path, body("a"), unit))


def test_a_thousand_bodies_in_seconds(tmp_path: Path) -> None:
    count = 1000
    links = "".join(body(f"b{index}", CUBE, at=(0, 0, index)) for index in range(count))
    hinges = "".join(
        joint("Revolute", f"j{i}", f"b{i - 1}", f"b{i}", "point3f physics:localPos0 = (0, 0, 1)")
        for i in range(1, count)
    )
    path = stage(tmp_path, links + hinges)
    began = time.process_time()
    got = load_articulation(path)
    assert len(got.links) == count
    assert time.process_time() - began < 8.0


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (body("a", 'def Cylinder "c"\n{\nuniform token axis = "W"\n}'), r"/top/a/c\.axis is 'W'"),
        (body("a").replace("(1, 1, 1)", "(1, inf, 1)"), r"/top/a\.physics:diagonalInertia is"),
        (body("a").replace("physics:mass = 1", "physics:mass = nan"), r"/top/a\.physics:mass is nan"),
        (body("a", at=(0.0, 0.0, 7.0)).replace("7.0", "inf"), "/top/a has a transform that is not finite"),
        (
            body("a") + body("b") + joint("Revolute", "j", "a", "b", "point3f physics:localPos0 = (nan, 0, 0)"),
            r"/top/j\.physics:localPos0 is",
        ),
        (
            body("a") + body("b") + joint("Revolute", "j", "a", "b", "quatf physics:localRot1 = (nan, 0, 0, 0)"),
            r"/top/j\.physics:localRot1 is",
        ),
    ],
)
def test_numbers_that_cannot_be_are_named_by_prim_and_attribute(tmp_path: Path, content: str, said: str) -> None:
    with pytest.raises(AssetError, match=said):
        read_usd(stage(tmp_path, content))
