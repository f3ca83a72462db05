"""SDFormat files read exactly, and refused with the culprit's name where they cannot be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from orbit_assets.files import load_articulation
from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.sdf import read_sdf, read_sdf_models
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    Frame,
    JointType,
    LoopType,
    Mesh,
    Mimic,
    Plane,
    Pose,
    Sphere,
)

INERTIAL = "<inertial><mass>2</mass><pose>0.1 0 0 0 0 1.5707963267948966</pose><inertia><ixx>1</ixx><iyy>2</iyy>\
<izz>2.5</izz><ixy>0.1</ixy></inertia></inertial>"
AXIS = "<axis><xyz>0 0 1</xyz><limit><lower>-1</lower><upper>2</upper></limit></axis>"


def write(folder: Path, body: str, version: str = "1.7", name: str = "thing.sdf") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(f'<?xml version="1.0"?><!-- a comment --><sdf version="{version}">{body}</sdf>')
    return folder / name


def model(body: str, name: str = "thing") -> str:
    return f'<model name="{name}">{body}</model>'


def link(name: str, rest: str = "") -> str:
    return f'<link name="{name}">{INERTIAL}{rest}</link>'


def joint(kind: str, rest: str = AXIS, ends: tuple[str, str] = ("base", "arm"), name: str = "j") -> str:
    parent, child = ends
    return f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{rest}</joint>'


def read(folder: Path, body: str, version: str = "1.7") -> Articulation:
    return read_sdf(write(folder, model(body), version))


def positions(articulation: Articulation, values: dict[str, float]) -> dict[str, Pose]:
    """Every link's pose in the root, by the definition of a joint."""
    poses = {articulation.root.name: Pose()}
    for each in articulation.joints:
        value = values.get(each.name, 0.0)
        moved = Pose.from_axis_angle(each.axis, value)
        if each.type is JointType.PRISMATIC:
            moved = Pose(tuple(value * along for along in each.axis))
        poses[each.child] = poses[each.parent] @ each.parent_pose @ moved @ each.child_pose.inverse()
    return poses


def test_links_joints_and_inertia(tmp_path: Path) -> None:
    dynamics = "<dynamics><damping>0.3</damping><friction>0.1</friction><spring_stiffness>4</spring_stiffness>\
<spring_reference>0.2</spring_reference></dynamics>"
    limit = "<limit><lower>-1</lower><upper>2</upper><effort>87</effort><velocity>-1</velocity></limit>"
    axis = f"<axis><xyz>0 1 0</xyz>{limit}{dynamics}</axis>"
    arm = link("arm", "<pose>0 0 1 0.1 0.2 0.3</pose>")
    articulation = validate(read(tmp_path, arm + link("base") + joint("revolute", f"<pose>0.5 0 0 0 0 0</pose>{axis}")))
    assert articulation.link_names == ("base", "arm")
    (each,) = articulation.joints
    assert (each.type, each.lower_limit, each.upper_limit) == (JointType.REVOLUTE, -1.0, 2.0)
    assert (each.effort_limit, each.velocity_limit) == (87.0, np.inf)
    assert (each.damping, each.friction, each.stiffness, each.rest_position) == (0.3, 0.1, 4.0, 0.2)
    assert (articulation.links[1].mass, articulation.links[1].center_of_mass) == (2.0, (0.1, 0.0, 0.0))
    np.testing.assert_allclose(articulation.links[1].inertia, [[2, -0.1, 0], [-0.1, 1, 0], [0, 0, 2.5]], atol=1e-12)
    at_zero = Pose.from_euler(0.1, 0.2, 0.3, (0.0, 0.0, 1.0))
    np.testing.assert_allclose(positions(articulation, {})["arm"].matrix(), at_zero.matrix(), atol=1e-12)
    turned = at_zero @ Pose((0.5, 0.0, 0.0)) @ Pose.from_axis_angle((0.0, 1.0, 0.0), 0.7) @ Pose((-0.5, 0.0, 0.0))
    np.testing.assert_allclose(positions(articulation, {"j": 0.7})["arm"].matrix(), turned.matrix(), atol=1e-12)


def test_poses_stand_in_the_frames_that_they_name(tmp_path: Path) -> None:
    body = f"""{link("base")}<frame name="mount" attached_to="base"><pose>0 0 1 0 0 0</pose></frame>
    {link("arm", '<pose relative_to="mount">0 2 0 0 0 90</pose>').replace("<pose rel", '<pose degrees="true" rel')}
    {joint("prismatic", '<axis><xyz expressed_in="mount">0 0 1</xyz></axis>')}"""
    articulation = read(tmp_path, body)
    assert articulation.frames == (Frame("mount", "base", Pose((0.0, 0.0, 1.0))),)
    arm = positions(articulation, {"j": 0.5})["arm"]
    np.testing.assert_allclose(arm.position, (0, 2, 1.5), atol=1e-12)
    np.testing.assert_allclose(arm.rotation_matrix()[:, 0], (0, 1, 0), atol=1e-12)
    quaternion = '<pose rotation_format="quat_xyzw">1 0 0 0 0 1 0</pose>'
    assert read(tmp_path, f'<link name="a"/><frame name="f" attached_to="a">{quaternion}</frame>').frames[
        0
    ].pose == Pose((1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


@pytest.mark.parametrize("old", [("1.4", ""), ("1.6", "<use_parent_model_frame>1</use_parent_model_frame>")])
def test_old_files_give_axes_in_the_models_frame(tmp_path: Path, old: tuple[str, str]) -> None:
    version, flag = old
    arm = link("arm", "<pose>0 0 1 0 1.5707963267948966 0</pose>")
    axis = f"<axis><xyz>0 0 1</xyz>{flag}</axis>"
    (each,) = read(tmp_path, link("base") + arm + joint("revolute", axis), version).joints
    assert each.type is JointType.CONTINUOUS
    np.testing.assert_allclose(each.axis, (-1, 0, 0), atol=1e-12)
    (each,) = read(tmp_path, link("base") + arm + joint("revolute"), "1.6").joints
    assert each.axis == (0.0, 0.0, 1.0)


def test_shapes_with_friction_and_colour(tmp_path: Path) -> None:
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "box.stl")
    solids = (
        "<box><size>1 2 3</size></box>",
        "<sphere><radius>0.2</radius></sphere>",
        "<cylinder><radius>0.2</radius><length>1</length></cylinder>",
        "<capsule><radius>0.2</radius><length>1</length></capsule>",
        "<plane><normal>0 0 1</normal></plane>",
        "<mesh><uri>box.stl</uri><scale>1 1 2</scale></mesh>",
    )
    surface = "<surface><friction><ode><mu>0.4</mu></ode></friction><bounce><restitution_coefficient>0.2\
</restitution_coefficient></bounce></surface>"
    collisions = "".join(
        f'<collision name="c{i}"><pose>0 0 {i} 0 0 0</pose><geometry>{solid}</geometry>{surface}</collision>'
        for i, solid in enumerate(solids)
    )
    red = f'<visual name="v"><geometry>{solids[0]}</geometry><material><diffuse>1 0 0</diffuse></material></visual>'
    root = read(tmp_path, link("base", collisions + red)).root
    assert [shape.geometry for shape in root.collisions[:5]] == [
        Box((0.5, 1.0, 1.5)), Sphere(0.2), Cylinder(0.2, 0.5), Capsule(0.2, 0.5), Plane(),
    ]  # fmt: skip
    assert isinstance(root.collisions[5].geometry, Mesh)
    assert np.ptp(root.collisions[5].geometry.vertices, axis=0) == pytest.approx([1, 2, 6])
    assert [shape.pose.position[2] for shape in root.collisions] == [0, 1, 2, 3, 4, 5]
    material = root.collisions[0].material
    assert (material.static_friction, material.dynamic_friction, material.restitution) == (0.4, 0.4, 0.2)
    assert root.visuals[0].color == (1.0, 0.0, 0.0, 1.0)


def test_a_shape_without_size_is_left_out_where_it_is_only_drawn(tmp_path: Path) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "box.stl")
    solids = ("<sphere><radius>0</radius></sphere>", "<mesh><uri>box.stl</uri><scale>0 0 0</scale></mesh>")
    drawn = "".join(f"<visual name='v'><geometry>{solid}</geometry></visual>" for solid in solids)
    articulation = read(tmp_path, link("a", drawn))
    assert articulation.root.visuals == ()
    assert articulation.notes == ("a <visual> of size zero, which shows nothing, is left out of link 'a'",)


def test_compound_joints_and_loops(tmp_path: Path) -> None:
    links = link("base") + link("arm", "<pose>1 0 0 0 0 0</pose>") + link("rod", "<pose>2 0 0 0 0 0</pose>")
    second = AXIS.replace("axis>", "axis2>").replace("0 0 1", "0 1 0")
    body = links + joint("universal", AXIS + second) + joint("ball", "", ("arm", "rod"), "b")
    articulation = validate(read(tmp_path, body))
    assert articulation.joint_names == ("j_axis", "j_axis2", "b_rx", "b_ry", "b_rz")
    assert [(each.lower_limit, each.upper_limit) for each in articulation.joints[:2]] == [(-1.0, 2.0)] * 2
    assert articulation.joints[1].axis == (0.0, 1.0, 0.0)
    poses = positions(articulation, {})
    assert (poses["arm"].position, poses["rod"].position) == ((1, 0, 0), (2, 0, 0))
    for kind, type_ in (("ball", LoopType.BALL), ("fixed", LoopType.WELD), ("revolute", LoopType.BALL)):
        closed = body + joint(kind, "<pose>0 0 0.5 0 0 0</pose>" + AXIS, ("base", "rod"), "loop")
        (loop,) = read(tmp_path, closed).loops
        assert (loop.type, loop.first_point, loop.second_point) == (type_, (2.0, 0.0, 0.5), (0.0, 0.0, 0.5))


def test_couplings_and_the_world(tmp_path: Path) -> None:
    law = '<mimic joint="j"><multiplier>2</multiplier><offset>1</offset><reference>0.25</reference></mimic>'
    held = joint("fixed", "", ("world", "base"), "w") + link("base") + link("arm") + link("tip") + joint("revolute")
    follower = joint("prismatic", AXIS.replace("</axis>", f"{law}</axis>"), ("arm", "tip"), "k")
    articulation = read(tmp_path, held + follower)
    assert articulation.root.name == "base"
    assert any("fixed_base=True" in note for note in articulation.notes)
    assert articulation.joints[1].mimic == Mimic("j", 2.0, 0.5)
    slider = read(tmp_path, link("base", "<pose>0 0 3 0 0 0</pose>") + joint("prismatic", AXIS, ("world", "base")))
    assert (slider.link_names, slider.root.mass) == (("world", "base"), 0.0)
    assert positions(slider, {"j": 1.0})["base"].position == (0.0, 0.0, 4.0)


def test_nested_models_are_part_of_theirs(tmp_path: Path) -> None:
    hand = model(link("palm") + link("finger") + joint("revolute", AXIS, ("palm", "finger")), "hand")
    hand = hand.replace('"hand">', '"hand"><pose>0 0 1 0 0 0</pose>', 1)
    body = link("base") + hand + joint("fixed", "", ("base", "hand::palm"), "mount")
    articulation = validate(read(tmp_path, body))
    assert articulation.link_names == ("base", "hand::palm", "hand::finger")
    assert articulation.joint_names == ("hand::j",)
    assert merge_fixed_links(articulation).frame("hand::palm").pose.position == (0.0, 0.0, 1.0)


def test_worlds_hold_models_by_name_and_include_others(tmp_path: Path) -> None:
    write(tmp_path / "cup", model(link("cup"), "cup"), name="model.sdf")
    cup = "<include><uri>cup</uri><name>mug</name><pose>1 2 3 0 0 0</pose></include>"
    table = model("<static>true</static><pose>0 0 5 0 0 0</pose>" + link("top"), "table")
    path = write(tmp_path, f'<world name="w"><gravity>0 0 -9.8</gravity>{table}{cup}</world>')
    first, second = read_sdf_models(path)
    assert (first.articulation.name, first.static, first.pose.position) == ("table", True, (0.0, 0.0, 5.0))
    assert (second.articulation.name, second.static, second.pose.position) == ("mug", False, (1.0, 2.0, 3.0))
    assert load_articulation(path, options=ReadOptions(articulation="mug")).root.name == "cup"
    with pytest.raises(AssetError, match="several models, 'table', 'mug'"):
        load_articulation(path)
    with pytest.raises(AssetError, match="unknown model 'cup'"):
        load_articulation(path, options=ReadOptions(articulation="cup"))


def test_a_frame_of_the_model_stands_where_the_file_places_it(tmp_path: Path) -> None:
    links = link("base", "<pose>0 0 0.5 0 0 0</pose>") + link("top", '<pose degrees="true">0 0 1 0 0 90</pose>')
    links += joint("fixed", "", ("base", "top"))
    body = f"<pose>1 2 3 0 0 0</pose>{links}"
    path = write(tmp_path, model(body).replace('"thing"', '"thing" placement_frame="top"', 1))
    (placed,) = read_sdf_models(path)
    turned = Pose.from_euler(0.0, 0.0, np.pi / 2, (0.0, 0.0, 1.0))
    np.testing.assert_allclose((placed.pose @ turned).matrix(), Pose((1.0, 2.0, 3.0)).matrix(), atol=1e-12)
    np.testing.assert_allclose(placed.root_pose.matrix(), (placed.pose @ Pose((0.0, 0.0, 0.5))).matrix(), atol=1e-12)
    assert any("root link 'base' stands at (1, 2, 2.5)" in note for note in read_sdf(path).notes)
    nested = model(links, "hand").replace('"hand"', '"hand" placement_frame="top"', 1)
    mounted = link("root") + nested + joint("fixed", "", ("root", "hand::base"))
    pose = read(tmp_path / "nested", mounted).joints[0].parent_pose
    np.testing.assert_allclose(pose.matrix(), (turned.inverse() @ Pose((0.0, 0.0, 0.5))).matrix(), atol=1e-12)
    with pytest.raises(AssetError, match="frame 'nose', which does not exist"):
        read_sdf(write(tmp_path, model(body).replace('"thing"', '"thing" placement_frame="nose"', 1)))


def test_worlds_place_models_in_frames_and_in_each_other(tmp_path: Path) -> None:
    part = model("<pose>0 0 7 0 0 0</pose>" + link("l", "<pose>0 0 1 0 0 0</pose>"), "part")
    write(tmp_path / "part", part, name="model.sdf")
    (tmp_path / "part" / "model.config").write_text("<model><name>part</name></model>")
    frames = '<frame name="F"><pose>0 0 100 0 0 0</pose></frame><frame name="G" attached_to="p1::l"/>'
    lifted = '<placement_frame>l</placement_frame><pose relative_to="F">1 2 3 0 0 0</pose>'
    world = f"""<world name="w">{frames}<include><uri>part</uri><name>p1</name>{lifted}</include>
    <include><uri>part</uri><name>p2</name></include>
    <include><uri>part</uri><name>p3</name><pose relative_to="G">0 0 10 0 0 0</pose></include>
    {model('<pose relative_to="p2">0 0 1 0 0 0</pose>' + link("l"), "own")}</world>"""
    path = write(tmp_path, world)
    placed = {each.articulation.name: each.pose.position for each in read_sdf_models(path)}
    assert placed == {"p1": (1, 2, 102), "p2": (0, 0, 7), "p3": (1, 2, 113), "own": (0, 0, 8)}
    for wrong, message in (
        (lifted.replace('"F"', '"H"'), "frame 'H', which does not exist"),
        ("<placement_frame>l</placement_frame>", "has a <placement_frame> and no <pose>"),
    ):
        with pytest.raises(AssetError, match=message):
            read_sdf(write(tmp_path, world.replace(lifted, wrong)), options=ReadOptions(articulation="p1"))
    joined = write(tmp_path, world.replace("</world>", joint("fixed", "", ("p1::l", "p2::l")) + "</world>"))
    with pytest.raises(AssetError, match="joint 'j' has ends in two models of a world"):
        read_sdf_models(joined)
    notes = read_sdf_models(joined, options=ReadOptions(unsupported=Unsupported.DROP))[0].articulation.notes
    assert "ends in two models of a world is left out of joint 'j'" in notes


def test_joints_end_at_frames_and_at_nested_models(tmp_path: Path) -> None:
    turn = '<pose degrees="true">0 0 0.5 0 0 90</pose>'
    body = f"""{link("base")}{link("arm", "<pose>0 0 1 0 0 0</pose>")}<frame name="f" attached_to="g">{turn}</frame>
    <frame name="g" attached_to="arm"/>{joint("revolute", AXIS.replace("0 0 1", "1 0 0"), ("base", "f"))}"""
    articulation = read(tmp_path, body)
    (each,) = articulation.joints
    assert (each.parent, each.child) == ("base", "arm")
    assert each.parent_pose.position == (0.0, 0.0, 1.5)
    np.testing.assert_allclose(each.parent_pose.rotation_matrix() @ each.axis, (0, 1, 0), atol=1e-12)
    assert [(frame.name, frame.link) for frame in articulation.frames] == [("f", "arm"), ("g", "arm")]
    assert not articulation.notes
    hand = model(
        link("palm") + link("tip", "<pose>0 0 0.25 0 0 0</pose>") + joint("fixed", "", ("tip", "palm")), "hand"
    )
    hand = hand.replace('"hand">', '"hand" canonical_link="tip"><pose>0 0 1 0 0 0</pose><frame name="grip"/>', 1)
    articulation = read(tmp_path, link("base") + hand + joint("revolute", ends=("base", "hand")))
    each = articulation.joints[0]
    assert (each.child, each.parent_pose.position) == ("hand::tip", (0.0, 0.0, 1.0))
    assert each.child_pose.position == (0.0, 0.0, -0.25)
    assert articulation.frames == (Frame("hand::grip", "hand::tip", Pose((0.0, 0.0, -0.25))),)


@pytest.mark.parametrize("merge", [False, True])
def test_a_model_includes_others(tmp_path: Path, merge: bool) -> None:
    hand = link("palm", "<pose>0 0 0.1 0 0 0</pose>") + '<frame name="grip"><pose relative_to="__model__"/></frame>'
    (tmp_path / "hand").mkdir()
    (tmp_path / "hand" / "model.config").write_text(
        '<model><sdf version="1.4">a.sdf</sdf><sdf version="1.10">new.sdf</sdf><sdf version="1.9">b.sdf</sdf></model>'
    )
    write(tmp_path / "hand", model(hand, "hand"), name="new.sdf")
    flag, prefix = (' merge="true"', "") if merge else ("", "left::")
    include = f"""<include{flag}><uri>hand</uri><name>left</name><placement_frame>palm</placement_frame>
    <pose relative_to="arm">0 0 2 0 0 0</pose></include>"""
    ends = ("arm", f"{prefix}palm")
    articulation = read(tmp_path, link("arm", "<pose>5 0 0 0 0 0</pose>") + include + joint("revolute", ends=ends))
    assert articulation.link_names == ends
    assert articulation.joints[0].parent_pose.position == (0.0, 0.0, 2.0)
    (frame,) = articulation.frames
    assert (frame.name, frame.link) == (f"{prefix}grip", f"{prefix}palm")
    np.testing.assert_allclose(frame.pose.position, (0.0, 0.0, -0.1), atol=1e-12)
    write(tmp_path / "hand", model("<include><uri>../hand</uri></include>", "hand"), name="new.sdf")
    with pytest.raises(AssetError, match="files deep"):
        read(tmp_path, link("arm") + include)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (joint("screw") + link("base") + link("arm"), "joint 'j' has the type 'screw'"),
        (joint("gearbox") + link("base") + link("arm"), "type 'gearbox'"),
        (link("base") + joint("revolute", ""), "frame 'arm', which does not exist"),
        (link("base") + link("arm") + joint("revolute", ""), "joint 'j' lacks <axis>"),
        (link("a", '<pose relative_to="a">0 0 0 0 0 0</pose>'), "the pose of 'a' is given in itself"),
        (link("a", "<pose>0 0 x 0 0 0</pose>"), "give 6 number"),
        (link("a", "<visual name='v'><geometry><ellipsoid/></geometry></visual>"), "kind <ellipsoid>"),
        (link("a", "<collision name='c'/>"), "without <geometry>"),
        (link("a", "<gravity>false</gravity>"), "no gravity of its own"),
        (link("a") + link("a"), "link 'a' has the name of another"),
        ("<link/>", "lacks attribute 'name'"),
        (link("a") + '<frame name="a"/>', "frame 'a' has the name of another link"),
        (link("a") + '<frame name="f" attached_to="g"/><frame name="g" attached_to="f"/>', "'f' is attached to itself"),
        (
            "<include><uri>x</uri><placement_frame>l</placement_frame></include>" + link("a"),
            "model.sdf' does not exist",
        ),
    ],
)
def test_faults_are_named(tmp_path: Path, body: str, message: str) -> None:
    path = write(tmp_path, model(body))
    with pytest.raises(AssetError, match=message) as caught:
        read_sdf(path)
    assert "thing.sdf" in str(caught.value)


def test_a_file_without_models_or_that_includes_itself_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="holds no <model>"):
        read_sdf(write(tmp_path, ""))
    with pytest.raises(AssetError, match="files deep"):
        read_sdf(write(tmp_path, '<world name="w"><include><uri>thing.sdf</uri></include></world>'))


def test_what_orbit_lacks_is_dropped_where_asked(tmp_path: Path) -> None:
    path = write(tmp_path, model(link("base") + link("arm") + joint("revolute") + joint("gearbox", AXIS, name="g")))
    articulation = read_sdf(path, options=ReadOptions(unsupported=Unsupported.DROP))
    assert articulation.joint_names == ("j",)
    assert "the type 'gearbox' is left out of joint 'g'" in articulation.notes
