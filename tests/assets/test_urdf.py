"""URDF files read exactly, and refused with the culprit's name where they cannot be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.exchange.dae import export_collada
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from orbit_core.assets.files import asset_file, load_articulation
from orbit_core.assets.meshes import load_mesh, load_parts, simplified_hull
from orbit_core.assets.urdf import read_urdf
from orbit_core.assets.validation import validate
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.scene import Articulation, Box, Capsule, Cylinder, JointType, Mesh, Mimic, Sphere

INERTIAL = """<inertial><mass value="2"/><origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/>
<inertia ixx="1" iyy="2" izz="2.5" ixy="0.1" ixz="0" iyz="0"/></inertial>"""
FINGER = """<link name="{0}"/><joint name="{0}_joint" type="prismatic"><parent link="arm"/><child link="{0}"/>
<axis xyz="0 2 0"/><limit lower="0" upper="0.04" effort="20" velocity="0.2"/>{1}</joint>"""


def read(tmp_path: Path, body: str, root: str = '<robot name="thing">') -> Articulation:
    path = tmp_path / "thing.urdf"
    path.write_text(f"{root}{body}</robot>")
    return read_urdf(path)


def visual(inside: str, tag: str = "visual", rest: str = "") -> str:
    return f'<link name="base"><{tag}><geometry>{inside}</geometry>{rest}</{tag}></link>'


def test_links_joints_and_inertia(tmp_path: Path) -> None:
    body = f"""<link name="arm">{INERTIAL}</link><link name="base"/>
    <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1" rpy="0.1 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="2" effort="87" velocity="2.5"/>
    <dynamics damping="0.3" friction="0.1"/></joint>"""
    articulation = validate(read(tmp_path, body))
    assert articulation.link_names == ("base", "arm")
    (joint,) = articulation.joints
    assert joint.type is JointType.REVOLUTE
    assert (joint.lower_limit, joint.upper_limit, joint.effort_limit, joint.velocity_limit) == (-1, 2, 87, 2.5)
    assert (joint.damping, joint.friction, joint.armature) == (0.3, 0.1, 0.0)
    assert joint.parent_pose.position == (0, 0, 1)
    arm = articulation.links[1]
    assert (arm.mass, arm.center_of_mass) == (2.0, (0.1, 0.0, 0.0))
    # A quarter turn about z exchanges x and y and changes the sign of their product.
    np.testing.assert_allclose(arm.inertia, [[2, -0.1, 0], [-0.1, 1, 0], [0, 0, 2.5]], atol=1e-12)


def test_mimic_fixed_and_continuous(tmp_path: Path) -> None:
    follower = '<mimic joint="left_joint" multiplier="-1" offset="0.01"/>'
    body = f"""<link name="base"/><link name="arm"/>
    <joint name="weld" type="fixed"><parent link="base"/><child link="arm"/></joint>
    {FINGER.format("left", "")}{FINGER.format("right", follower)}
    <link name="wheel"/><joint name="spin" type="continuous"><parent link="arm"/><child link="wheel"/></joint>"""
    articulation = read(tmp_path, body)
    weld, left, right, spin = articulation.joints
    assert not weld.movable
    assert left.mimic is None
    assert right.mimic == Mimic("left_joint", -1.0, 0.01)
    assert (spin.axis, spin.lower_limit, spin.upper_limit) == ((1, 0, 0), -np.inf, np.inf)


@pytest.mark.parametrize(
    ("xml", "geometry"),
    [
        ('<box size="1 2 3"/>', Box((0.5, 1.0, 1.5))),
        ('<sphere radius="0.2"/>', Sphere(0.2)),
        ('<cylinder radius="0.2" length="1"/>', Cylinder(0.2, 0.5)),
        ('<capsule radius="0.2" length="1"/>', Capsule(0.2, 0.5)),
    ],
)
def test_primitives(tmp_path: Path, xml: str, geometry: object) -> None:
    (shape,) = read(tmp_path, visual(xml, "collision")).root.collisions
    assert shape.geometry == geometry


def test_colours_named_and_inline(tmp_path: Path) -> None:
    red = '<material name="red"><color rgba="1 0 0 1"/></material>'
    box = '<box size="1 1 1"/>'
    for body in (red + visual(box, rest='<material name="red"/>'), visual(box, rest=red)):
        assert read(tmp_path, body).root.visuals[0].color == (1.0, 0.0, 0.0, 1.0)


def test_prefixes_that_nobody_declared(tmp_path: Path) -> None:
    body = '<link name="base"/><drake:joint drake:kind="x"/><gazebo:plugin name="y"/>'
    assert read(tmp_path, body).link_names == ("base",)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("<link/>", "a link lacks attribute 'name'"),
        ('<link name="a"><inertial><mass value="1"/></inertial></link>', "link 'a' lacks <inertia>"),
        ('<link name="a"><inertial><mass value="heavy"/><inertia/></inertial></link>', 'value="heavy"'),
        ('<link name="a"><collision><geometry><cone/></geometry></collision></link>', "no known kind"),
        ('<joint name="j" type="floating"/>', "fixed_base=False"),
        ('<joint name="j" type="planar"/>', "two prismatic joints"),
        ('<joint name="j" type="screw"/>', "use one of fixed, revolute"),
        ('<joint name="j" type="prismatic"><parent link="a"/><child link="b"/></joint>', "joint 'j' has no <limit>"),
        ('<link name="base"/><xacro:macro name="m"/>', "expand it with xacro"),
        ("<link name='a'>", "not well-formed"),
        (visual('<mesh filename="missing.stl"/>'), "link 'base': file '.*missing.stl' does not exist"),
        (visual('<mesh filename="package://nobody/a.stl"/>'), r"packages=\{'nobody': folder\}"),
    ],
)
def test_faults_are_named(tmp_path: Path, body: str, message: str) -> None:
    with pytest.raises(AssetError, match=message):
        read(tmp_path, body)


def test_meshes_by_package_with_scale_and_parts(tmp_path: Path) -> None:
    folder = tmp_path / "robot_models" / "meshes"
    folder.mkdir(parents=True)
    trimesh.creation.box((1, 2, 3)).export(folder / "box.stl")
    body = visual('<mesh filename="package://robot_models/meshes/box.stl" scale="0.1 0.1 -0.1"/>', "collision")
    path = tmp_path / "robot_models" / "thing.urdf"
    path.write_text(f'<robot name="thing">{body}</robot>')
    found_above, given = read_urdf(path), read_urdf(path, {"robot_models": folder.parent})
    for articulation in (found_above, given):
        mesh = articulation.root.collisions[0].geometry
        assert isinstance(mesh, Mesh)
        assert mesh.vertices.shape == (8, 3)
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces)
        assert solid.volume == pytest.approx(0.006), "a reflected mesh must stay outside out"
    assert "convex hulls" in found_above.notes[0]


def test_scene_graphs_and_colours_of_mesh_files(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for index, color in enumerate(([255, 0, 0, 255], [0, 0, 255, 255])):
        box = trimesh.creation.box((1, 1, 1))
        box.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=color))
        scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([3.0 * index, 0, 0]))
    scene.export(tmp_path / "two.glb")
    assert load_mesh(tmp_path / "two.glb").vertices[:, 0].max() == pytest.approx(3.5)
    parts = {part.color: part.mesh for part in load_parts(tmp_path / "two.glb")}
    assert parts[(1.0, 0.0, 0.0, 1.0)].vertices[:, 0].max() == pytest.approx(0.5)
    assert parts[(0.0, 0.0, 1.0, 1.0)].vertices[:, 0].min() == pytest.approx(2.5)


def test_a_dae_in_inches_comes_out_in_metres(tmp_path: Path) -> None:
    text = export_collada(trimesh.creation.box((1, 1, 1))).decode()
    assert '<unit name="meter" meter="1"' in text or "<unit" not in text
    unit = '<asset><unit name="inch" meter="0.0254"/>'
    text = text.replace('<unit name="meter" meter="1"/>', "").replace("<asset>", unit, 1)
    (tmp_path / "inch.dae").write_text(text)
    mesh = load_mesh(tmp_path / "inch.dae")
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([0.0254] * 3)


def test_unreadable_meshes(tmp_path: Path) -> None:
    (tmp_path / "bad.stl").write_bytes(b"solid but not really")
    (tmp_path / "bad.xyzw").write_bytes(b"?")
    for name, message in (
        ("bad.stl", "bad.stl"),
        ("bad.xyzw", "of no format"),
        ("none.stl", "does not exist"),
    ):
        with pytest.raises(AssetError, match=message):
            load_mesh(tmp_path / name)


def test_simplified_hull_lies_within_and_keeps_the_extent() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    hull = simplified_hull(Mesh(np.asarray(ball.vertices), np.asarray(ball.faces)), directions=32)
    assert len(hull.vertices) <= 38
    assert np.linalg.norm(hull.vertices, axis=1).max() <= 1 + 1e-6
    np.testing.assert_allclose(np.ptp(hull.vertices, axis=0), np.ptp(ball.vertices, axis=0), atol=1e-6)
    assert trimesh.Trimesh(hull.vertices, hull.faces).volume > 0.8 * ball.volume


def test_load_articulation_by_suffix(tmp_path: Path) -> None:
    path = tmp_path / "thing.urdf"
    path.write_text(
        f'<robot name="thing"><link name="base">{INERTIAL}</link><link name="tip"/>'
        '<joint name="weld" type="fixed"><parent link="base"/><child link="tip"/></joint></robot>'
    )
    assert load_articulation(path).link_names == ("base",)
    assert load_articulation(path, merge=False).link_names == ("base", "tip")
    with pytest.raises(AssetError, match="known format"):
        load_articulation(tmp_path / "thing.step")
    with pytest.raises(AssetError, match="does not exist"):
        load_articulation(tmp_path / "other.urdf")
    with pytest.raises(UnknownNameError, match="asset file 'nothing"):
        asset_file("nothing.usda")
