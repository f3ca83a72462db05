"""URDF files read exactly, and refused with the culprit's name where they cannot be."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.exchange.dae import export_collada
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from orbit_assets.audit.checks import shape_points
from orbit_assets.files import asset_file, load_articulation
from orbit_assets.meshes import load_mesh, load_parts, simplified_hull
from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.urdf import read_urdf
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, Box, Capsule, Cylinder, JointType, Mesh, Mimic, Plane, Pose, Sphere

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
        ('<link name="a"><collision><geometry><cone/></geometry></collision></link>', "<cone>, which ORBIT does not"),
        ('<link name="a"><collision><geometry/></collision></link>', "empty <geometry>"),
        ('<joint name="j" type="planar"/>', "joint 'j' lacks <parent>"),
        ('<link name="a"/><link name="b"/>', "several roots, 'a', 'b'.*ReadOptions\\(articulation"),
        ('<joint name="j" type="screw"/>', "use one of fixed, revolute"),
        ('<joint name="j" type="prismatic"><parent link="a"/><child link="b"/></joint>', "joint 'j' has no <limit>"),
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
    hull = simplified_hull(Mesh(np.asarray(ball.vertices), np.asarray(ball.faces)))
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


BODY = f'<link name="base">{INERTIAL}</link><link name="arm">{INERTIAL}</link>'


def joint(kind: str, rest: str = "", ends: tuple[str, str] = ("base", "arm")) -> str:
    parent, child = ends
    return f'<joint name="j" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{rest}</joint>'


def tip_at(articulation: Articulation, positions: dict[str, float]) -> np.ndarray:
    """The last link's transform in the root, by the definition of a joint."""
    poses = {articulation.root.name: Pose()}
    for each in articulation.joints:
        value = positions.get(each.name, 0.0)
        moved = Pose.from_axis_angle(each.axis, value)
        if each.type is JointType.PRISMATIC:
            moved = Pose(tuple(value * along for along in each.axis))
        poses[each.child] = poses[each.parent] @ each.parent_pose @ moved @ each.child_pose.inverse()
    return poses[articulation.links[-1].name].matrix()


def test_a_planar_joint_moves_in_the_plane_of_its_normal(tmp_path: Path) -> None:
    origin = '<origin xyz="0 0 1" rpy="0.3 0.2 0.1"/><axis xyz="0 1 0"/>'
    articulation = validate(read(tmp_path, BODY + joint("planar", origin)))
    assert articulation.joint_names == ("j_tx", "j_ty", "j_rz")
    frame = Pose.from_euler(0.3, 0.2, 0.1, (0.0, 0.0, 1.0)).matrix()
    np.testing.assert_allclose(tip_at(articulation, {}), frame, atol=1e-12)
    moved = np.linalg.inv(frame) @ tip_at(articulation, {"j_tx": 0.5, "j_ty": -0.7, "j_rz": 0.4})
    np.testing.assert_allclose(moved[1, :], [0, 1, 0, 0], atol=1e-12, err_msg="y, the normal, stays")
    assert np.linalg.norm(moved[:3, 3]) == pytest.approx(np.hypot(0.5, 0.7))
    np.testing.assert_allclose(moved[:3, :3], Pose.from_axis_angle((0, 1, 0), 0.4).rotation_matrix(), atol=1e-12)


def test_a_floating_joint_within_the_robot_is_six_joints_and_a_base_that_floats_is_none(tmp_path: Path) -> None:
    within = validate(read(tmp_path, BODY + joint("floating")))
    assert len(within.joint_names) == 6
    assert within.links[-1].name == "arm"
    base = read(
        tmp_path, f'<link name="world"/><link name="arm">{INERTIAL}</link>' + joint("floating", "", ("world", "arm"))
    )
    assert (base.link_names, base.joints) == (("arm",), ())
    assert "fixed_base=False" in base.notes[0]


def test_a_ball_joint_turns_all_ways(tmp_path: Path) -> None:
    articulation = validate(read(tmp_path, BODY + joint("spherical", '<limit effort="5"/>')))
    assert [each.effort_limit for each in articulation.movable_joints] == [5.0] * 3
    expected = np.eye(4)
    for axis, angle in (((1, 0, 0), 0.3), ((0, 1, 0), 0.4), ((0, 0, 1), 0.5)):
        expected[:3, :3] = expected[:3, :3] @ Pose.from_axis_angle(axis, angle).rotation_matrix()
    found = tip_at(articulation, {"j_rx": 0.3, "j_ry": 0.4, "j_rz": 0.5})
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_mimic_of_a_mimic_follows_the_leader_of_both(tmp_path: Path) -> None:
    laws = ("", '<mimic joint="a_joint" multiplier="2" offset="0.1"/>', '<mimic joint="b_joint" multiplier="-3"/>')
    fingers = "".join(FINGER.format(name, law) for name, law in zip("abc", laws, strict=True))
    articulation = read(tmp_path, '<link name="arm"/>' + fingers)
    law = articulation.joints[2].mimic
    assert law is not None
    assert (law.joint, law.multiplier) == ("a_joint", -6.0)
    assert law.offset == pytest.approx(-0.3)
    assert "'c_joint'" in articulation.notes[0]
    circle = FINGER.format("a", '<mimic joint="b_joint"/>') + FINGER.format("b", '<mimic joint="a_joint"/>')
    with pytest.raises(AssetError, match="itself mimics"):
        validate(read(tmp_path, '<link name="arm"/>' + circle))


def test_a_mimic_of_an_unknown_joint_is_named_and_dropped_where_asked(tmp_path: Path) -> None:
    body = '<link name="arm"/>' + FINGER.format("a", '<mimic joint="nobody"/>')
    with pytest.raises(AssetError, match=r"joint 'a_joint' has a <mimic> of the unknown joint 'nobody'.*DROP"):
        read(tmp_path, body)
    articulation = read_urdf(tmp_path / "thing.urdf", options=ReadOptions(unsupported=Unsupported.DROP))
    assert articulation.joints[0].mimic is None
    assert "a <mimic> of the unknown joint 'nobody' is left out of joint 'a_joint'" in articulation.notes


@pytest.mark.parametrize(
    "nothing",
    [
        "<sphere radius='0'/>",
        "<box size='1 0 1'/>",
        "<cylinder radius='0' length='1'/>",
        "<cylinder radius='1' length='0'/>",
        "<capsule radius='0' length='1'/>",
        "<mesh filename='box.stl' scale='0 0 0'/>",
    ],
)
def test_a_shape_without_size_is_left_out_where_it_is_only_drawn(tmp_path: Path, nothing: str) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "box.stl")
    shape = f"<geometry>{nothing}</geometry>"
    articulation = read(tmp_path, f'<link name="a"><visual>{shape}</visual></link>')
    assert articulation.root.visuals == ()
    assert articulation.notes == ("a <visual> of size zero, which shows nothing, is left out of link 'a'",)


@pytest.mark.parametrize(
    ("thin", "half_extents"),
    [
        ("<sphere radius='0'/>", None),
        ("<box size='0 0 0'/>", None),
        ("<box size='1 0 0'/>", None),
        ("<cylinder radius='0' length='1'/>", None),
        ("<capsule radius='0' length='1'/>", None),
        ("<box size='1 0 1'/>", (0.5, 0.0005, 0.5)),
        ("<cylinder radius='1' length='0'/>", (1.0, 1.0, 0.0005)),
        ("<mesh filename='tile.stl'/>", (1.0, 2.0, 0.0005)),
    ],
)
def test_what_collides_without_volume_is_a_plate_or_nothing(
    tmp_path: Path, thin: str, half_extents: tuple[float, float, float] | None
) -> None:
    corners = [(-1, -2, 0), (1, -2, 0), (1, 2, 0), (-1, 2, 0)]
    trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)]).export(tmp_path / "tile.stl")
    body = f'<link name="a"><collision><geometry>{thin}</geometry></collision></link>'
    articulation = validate(read(tmp_path, body))
    notes = set(articulation.notes) - {"collision meshes of the URDF collide as their convex hulls"}
    if half_extents is None:
        assert articulation.root.collisions == ()
        assert notes == {"a <collision> of size zero, which nothing touches, is left out of link 'a'"}
        return
    (shape,) = articulation.root.collisions
    points = shape_points(shape)
    np.testing.assert_allclose(points.max(axis=0), half_extents, atol=1e-6)
    assert notes == {"a flat <collision> of link 'a' is a plate 1 mm thick"}


def test_what_is_not_read_is_noted_once_a_kind(tmp_path: Path) -> None:
    safety = '<safety_controller k_velocity="1"/><calibration rising="0"/>'
    body = BODY + joint("continuous", safety) + "<transmission/><transmission/><gazebo/>"
    notes = read(tmp_path, body).notes
    assert notes == (
        "<transmission> is left out of the robot",
        "<gazebo> is left out of the robot",
        "<safety_controller> is left out of joint 'j'",
        "<calibration> is left out of joint 'j'",
    )


def test_what_orbit_lacks_is_dropped_where_asked(tmp_path: Path) -> None:
    path = tmp_path / "thing.urdf"
    path.write_text(f'<robot name="thing">{visual("<cone/>", "collision")}</robot>')
    articulation = read_urdf(path, options=ReadOptions(unsupported=Unsupported.DROP))
    assert articulation.root.collisions == ()
    assert articulation.notes == ("a <geometry> of kind <cone> is left out of link 'base'",)


def test_one_of_several_trees_is_read_by_its_root(tmp_path: Path) -> None:
    path = tmp_path / "two.urdf"
    path.write_text(f'<robot name="two">{BODY}<link name="other"/>{joint("continuous")}</robot>')
    articulation = read_urdf(path, options=ReadOptions(articulation="base"))
    assert (articulation.name, articulation.link_names) == ("base", ("base", "arm"))
    with pytest.raises(AssetError, match=r"unknown articulation 'arm'.*base, other"):
        read_urdf(path, options=ReadOptions(articulation="arm"))


def test_planes_face_their_normals(tmp_path: Path) -> None:
    for normal in ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, -2.0, 0.5)):
        text = " ".join(str(component) for component in normal)
        (shape,) = read(tmp_path, visual(f'<plane normal="{text}"/>', "collision")).root.collisions
        assert shape.geometry == Plane()
        found = shape.pose.rotation_matrix()[:, 2]
        np.testing.assert_allclose(found, np.asarray(normal) / np.linalg.norm(normal), atol=1e-12)


def test_a_package_may_be_a_folder_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "meshes" / "box.stl")
    assert read(tmp_path, visual('<mesh filename="package://meshes/box.stl"/>')).root.visuals
    with pytest.raises(AssetError, match="unknown package"):
        read(tmp_path, visual('<mesh filename="package://../box.stl"/>'))


def test_ten_thousand_links_take_seconds(tmp_path: Path) -> None:
    chain = "".join(
        f'<link name="l{i}">{INERTIAL}</link><joint name="j{i}" type="{"fixed" if i % 2 else "continuous"}">'
        f'<parent link="l{i - 1}"/><child link="l{i}"/><origin xyz="0 0 1"/></joint>'
        for i in range(1, 10_000)
    )
    path = tmp_path / "chain.urdf"
    path.write_text(f'<robot name="chain"><link name="l0">{INERTIAL}</link>{chain}</robot>')
    start = time.process_time()
    assert len(load_articulation(path).links) == 5_000
    assert time.process_time() - start < 20.0, "on a slow machine; quadratic time would be minutes"
