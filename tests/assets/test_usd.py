"""What USD files by other hands say: units, up axes, densities, nesting, and what is refused."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from orbit_assets.usd import read_usd, write_usd
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Compliance,
    Cylinder,
    HeightField,
    Joint,
    JointType,
    Link,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from tests.assets.usd_files import body, joint, stage

PAINT = (0.5, 0.25, 1.0, 1.0)
CONE = 'def Cone "tip" (prepend apiSchemas = ["PhysicsCollisionAPI"])\n{\n}'
CENTIMETRES = 'metersPerUnit = 0.01\n    kilogramsPerUnit = 0.001\n    upAxis = "Y"'


def test_units_and_up_axis_become_si_and_z_up(tmp_path: Path) -> None:
    # In centimetres and grams: lengths x 0.01, masses x 1e-3, inertias x 1e-7, forces x 1e-5, torques x 1e-7.
    inner = """
        point3f physics:centerOfMass = (0, 10, 0)
        def Cylinder "post" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
            token axis = "Y"
            double radius = 5
            double height = 40
            double3 xformOp:translate = (0, 20, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }"""
    slide = """
        uniform token physics:axis = "Y"
        float physics:lowerLimit = -10
        float physics:upperLimit = 30
        float drive:linear:physics:maxForce = 100000
        float newton:friction = 200000
        float newton:damping = 3000
        float newton:armature = 500
        float newton:velocityLimit = 150"""
    swing = """
        uniform token physics:axis = "X"
        float physics:lowerLimit = -90
        float physics:upperLimit = 180
        float drive:angular:physics:maxForce = 20000000
        float newton:damping = 10000000
        float newton:armature = 20000000
        float newton:velocityLimit = 360"""
    schemas = '"PhysicsDriveAPI:{}", "NewtonJointAPI"'
    content = (
        body("a", inner)
        + body("b")
        + body("c")
        + joint("Prismatic", "slide", "a", "b", slide, schemas.format("linear"))
        + joint("Revolute", "swing", "b", "c", swing, schemas.format("angular"))
    )
    got = read_usd(stage(tmp_path, content, CENTIMETRES))
    root = got.root
    assert root.mass == pytest.approx(1e-3)
    np.testing.assert_allclose(root.inertia, 1e-7 * np.eye(3), rtol=1e-5)
    np.testing.assert_allclose(root.center_of_mass, (0.0, 0.0, 0.1), atol=1e-9)
    (post,) = root.collisions
    assert post.geometry == Cylinder(pytest.approx(0.05), pytest.approx(0.2))
    np.testing.assert_allclose(post.pose.position, (0.0, 0.0, 0.2), atol=1e-9)
    np.testing.assert_allclose(np.abs(post.pose.rotation_matrix()[:, 2]), (0.0, 0.0, 1.0), atol=1e-9)
    slide_joint, swing_joint = got.joints
    axis = slide_joint.parent_pose.rotation_matrix() @ slide_joint.axis
    np.testing.assert_allclose(axis, (0.0, 0.0, 1.0), atol=1e-9)
    assert slide_joint.lower_limit == pytest.approx(-0.1)
    assert slide_joint.upper_limit == pytest.approx(0.3)
    assert slide_joint.effort_limit == pytest.approx(1.0)
    assert slide_joint.friction == pytest.approx(2.0)
    assert slide_joint.damping == pytest.approx(3.0)
    assert slide_joint.armature == pytest.approx(0.5)
    assert slide_joint.velocity_limit == pytest.approx(1.5)
    assert swing_joint.lower_limit == pytest.approx(-math.pi / 2)
    assert swing_joint.upper_limit == pytest.approx(math.pi)
    assert swing_joint.effort_limit == pytest.approx(2.0)
    assert swing_joint.damping == pytest.approx(math.degrees(1.0))
    assert swing_joint.armature == pytest.approx(2.0)
    assert swing_joint.velocity_limit == pytest.approx(2 * math.pi)


def test_mass_comes_from_the_density_nearest_the_collider(tmp_path: Path) -> None:
    def cube(name: str, x: float, density: str) -> str:
        return f"""
        def Cube "{name}" (prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMassAPI"])
        {{
            double size = 0.1
            {density}
            double3 xformOp:translate = ({x}, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}"""

    shapes = cube("own", 0.0, "float physics:density = 3000") + cube("bodys", 1.0, "")
    content = f"""
    def Xform "a" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
    {{
        float physics:density = 2000
        {shapes}
    }}"""
    root = read_usd(stage(tmp_path, content)).root
    assert root.mass == pytest.approx(3.0 + 2.0)
    assert root.center_of_mass[0] == pytest.approx(0.4)
    assert root.inertia[1, 1] == pytest.approx(5.0 * 0.01 / 6 + 3 * 0.4**2 + 2 * 0.6**2, rel=1e-5)
    default = read_usd(stage(tmp_path, content.replace("float physics:density = 2000", ""))).root
    assert default.mass == pytest.approx(3.0 + 1.0)


@pytest.mark.parametrize(("along", "scale"), [("X", (1, 1, 1)), ("Y", (1, 1, 1)), ("Z", (2, 1, -1))])
def test_a_cone_is_a_pyramid_of_its_volume(tmp_path: Path, along: str, scale: tuple[int, int, int]) -> None:
    cone = f"""
        def Cone "tip" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {{
            double radius = 0.1
            double height = 0.4
            uniform token axis = "{along}"
            double3 xformOp:scale = {scale}
            uniform token[] xformOpOrder = ["xformOp:scale"]
        }}"""
    articulation = read_usd(stage(tmp_path, body("a", cone)))
    (shape,) = articulation.root.collisions
    assert isinstance(shape.geometry, Mesh)
    assert any("tip is a cone and is read as a pyramid of 32 sides" in note for note in articulation.notes)
    points = shape.pose.transform(shape.geometry.vertices)
    solid = trimesh.Trimesh(points, shape.geometry.faces, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(np.pi * 0.01 * 0.4 / 3 * abs(np.prod(scale)), rel=1e-6), "faces look outwards"
    column = "XYZ".index(along)
    sign = np.sign(scale[column])
    np.testing.assert_allclose(points[np.argmax(sign * points[:, column])], sign * 0.2 * np.eye(3)[column], atol=1e-7)


def test_what_is_drawn_with_size_zero_is_left_out(tmp_path: Path) -> None:
    articulation = read_usd(stage(tmp_path, body("a", 'def Sphere "dot"\n{\n    double radius = 0\n}')))
    assert articulation.root.visuals == ()
    assert any("/top/a/dot is drawn with size zero" in note for note in articulation.notes)


def test_a_joint_written_against_the_tree_is_turned_round(tmp_path: Path) -> None:
    marked = body("a").replace('"PhysicsMassAPI"]', '"PhysicsMassAPI", "PhysicsArticulationRootAPI"]')
    limits = """
        uniform token physics:axis = "Z"
        float physics:upperLimit = 90
        float physics:lowerLimit = 0
        point3f physics:localPos0 = (-1, 0, 0)"""
    content = body("b", at=(1.0, 0.0, 0.0)) + marked + joint("Revolute", "turn", "b", "a", limits)
    got = read_usd(stage(tmp_path, content))
    assert got.link_names == ("a", "b")
    (turn,) = got.joints
    assert (turn.parent, turn.child) == ("a", "b")
    assert turn.axis == (0.0, 0.0, -1.0)
    np.testing.assert_allclose(turn.child_pose.position, (-1.0, 0.0, 0.0))
    assert turn.upper_limit == pytest.approx(math.pi / 2)


def test_joints_to_the_world(tmp_path: Path) -> None:
    content = body("a") + body("b") + joint("Revolute", "turn", "a", "b")
    fixed = read_usd(stage(tmp_path, content + joint("Fixed", "hold", None, "a")))
    assert fixed.link_names == ("a", "b")
    assert fixed.joints[0].type is JointType.CONTINUOUS
    assert any("fixed joint to the world" in note for note in fixed.notes)
    slider = read_usd(stage(tmp_path, content + joint("Prismatic", "slide", None, "a")))
    assert slider.link_names == ("world", "a", "b")
    assert slider.root.mass == 0.0
    assert validate(slider).joint_names == ("slide", "turn")


def test_a_stage_without_bodies_is_one_static_link(tmp_path: Path) -> None:
    content = """
    def Plane "ground" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {
    }
    def Cube "step" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {
        double3 xformOp:scale = (1, 2, 3)
        uniform token[] xformOpOrder = ["xformOp:scale"]
    }"""
    got = read_usd(stage(tmp_path, content))
    assert [shape.geometry for shape in got.root.collisions] == [Plane(), Box((1.0, 2.0, 3.0))]
    assert validate(got).mass == 0.0


def test_polygons_mirrors_and_purposes(tmp_path: Path) -> None:
    quad = """
        def Mesh "quad" (prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"])
        {
            point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
            int[] faceVertexCounts = [4]
            int[] faceVertexIndices = [0, 1, 2, 3]
            uniform token physics:approximation = "none"
            uniform token purpose = "guide"
            double3 xformOp:scale = (-2, 1, 1)
            uniform token[] xformOpOrder = ["xformOp:scale"]
        }
        def Sphere "drawn"
        {
            double radius = 0.2
            color3f[] primvars:displayColor = [(1, 0, 0.5)]
        }
        def Sphere "hidden"
        {
            token visibility = "invisible"
        }"""
    root = read_usd(stage(tmp_path, body("a", quad))).root
    (collider,), (drawn,) = root.collisions, root.visuals
    assert drawn.geometry == Sphere(0.2)
    assert drawn.color == (1.0, 0.0, 0.5, 1.0)
    mesh = collider.geometry
    assert isinstance(mesh, Mesh)
    assert mesh.collision is MeshCollision.TRIANGLES
    points = collider.pose.transform(mesh.vertices)
    np.testing.assert_allclose(sorted(points[:, 0]), (-2.0, -2.0, 0.0, 0.0), atol=1e-9)
    for face in mesh.faces:
        a, b, c = points[face]
        # The mirror is undone in the order of corners: the side that looked up still does.
        assert np.cross(b - a, c - a)[2] > 0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (body("a") + body("b") + joint("Distance", "rod", "a", "b"), "/top/rod is a distance joint"),
        (
            body("a") + body("b") + joint("Revolute", "one", "a", "b") + joint("Prismatic", "two", "a", "b"),
            "/top/two closes a loop and is neither hinge, ball nor fixed",
        ),
        (body("a") + body("b"), r"holds 2 articulations, 'a' \(/top/a\), 'b' \(/top/b\): name one"),
        (
            body("a", 'def BasisCurves "tip" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {}'),
            "tip is a collider of type BasisCurves",
        ),
        (body("a") + joint("Revolute", "self", "a", "a"), "connects /top/a with itself"),
        ("", "holds no rigid body"),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_path(tmp_path: Path, content: str, message: str) -> None:
    with pytest.raises(AssetError, match=message):
        read_usd(stage(tmp_path, content))


def test_an_egg_is_no_sphere(tmp_path: Path) -> None:
    egg = """
        def Sphere "egg" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
            double3 xformOp:scale = (1, 2, 1)
            uniform token[] xformOpOrder = ["xformOp:scale"]
        }"""
    with pytest.raises(AssetError, match="egg is a sphere scaled by"):
        read_usd(stage(tmp_path, body("a", egg)))


def test_files_that_are_none(tmp_path: Path) -> None:
    broken = tmp_path / "broken.usda"
    broken.write_text("no stage")
    faults = {broken: "no USD file that can be opened", tmp_path / "missing.usda": "does not exist"}
    for path, message in faults.items():
        with pytest.raises(AssetError, match=message):
            read_usd(path)


def test_materials_meshes_labels_and_odd_names_survive(tmp_path: Path) -> None:
    rubber = PhysicsMaterial(0.75, 0.5, 0.25, 0.125, 0.5, Compliance(1000.0, 20.0))
    triangles = Mesh(np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]), MeshCollision.TRIANGLES)
    solid = Shape(triangles, Pose((0.0, 0.5, 0.0)), rubber, PAINT, "solid part")
    hidden = Shape(Capsule(0.25, 0.5), material=rubber, color=PAINT, name="hidden")
    drawn = Shape(Sphere(0.5), color=(0.5, 0.25, 1.0, 0.5), name="drawn")
    root = Link(
        "left-hand link",
        1.0,
        inertia=np.eye(3),
        collisions=(solid, hidden),
        visuals=(solid, drawn),
        semantic_label="palm",
    )
    tip = Link("2nd", 1.0, inertia=np.eye(3))
    hinge = Joint("joint/1", JointType.CONTINUOUS, root.name, tip.name, axis=(1.0, 0.0, 0.0))
    write_usd(Articulation("my hand", (root, tip), (hinge,)), tmp_path / "hand.usda")
    got = read_usd(tmp_path / "hand.usda")
    assert (got.name, got.link_names, got.joint_names) == ("my hand", ("left-hand link", "2nd"), ("joint/1",))
    assert got.root.collisions == (solid, hidden)
    assert got.root.visuals == (solid, drawn)
    assert got.root.semantic_label == "palm"


def test_a_base_that_collides_without_mass_stays_without(tmp_path: Path) -> None:
    base = Link("a", collisions=(Shape(Sphere(0.1)),))
    (said,) = write_usd(Articulation("a", (base,)), tmp_path / "a.usda")
    assert "compute a mass of link 'a'" in said
    assert read_usd(tmp_path / "a.usda").root.mass == 0.0


def test_what_usd_cannot_hold_is_refused(tmp_path: Path) -> None:
    hills = Shape(HeightField(np.zeros((2, 2)), (1.0, 1.0)))
    with pytest.raises(AssetError, match="USD has no HeightField"):
        write_usd(Articulation("a", (Link("a", visuals=(hills,)),)), tmp_path / "a.usda")
    with pytest.raises(AssetError, match=r"name it \*\.usda"):
        write_usd(Articulation("a", (Link("a"),)), tmp_path / "a.txt")


def test_without_usd_the_error_says_how_to_get_it(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['pxr'] = None\n"
        "from orbit_assets.usd import read_usd\n"
        f"read_usd({str(tmp_path / 'a.usda')!r})"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert "AssetError: USD files need the packages usd-core and newton-usd-schemas: pip install " in run.stderr
    assert '[usd]"' in run.stderr
