"""MJCF files that ORBIT writes: MuJoCo compiles them, and reading them gives the articulation back."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_assets.audit.mjcf_reference import MujocoReference
from orbit_assets.audit.reference import compare
from orbit_assets.compose import sort_links
from orbit_assets.joint_models import BALL, compound
from orbit_assets.mjcf import read_mjcf, write_mjcf
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    Box,
    DriveGains,
    Frame,
    Joint,
    JointType,
    Link,
    LoopJoint,
    LoopType,
    Mesh,
    Mimic,
    PhysicsMaterial,
    Pose,
    Shape,
    Sphere,
)
from tests.assets.test_round_trips import articulations, assert_same, link_poses


def solid(name: str, *shapes: Shape) -> Link:
    return Link(name, 1.0, (0.1, 0.0, 0.0), np.diag((0.02, 0.03, 0.04)), shapes, shapes)


def pair(joint: Joint, **fields: object) -> Articulation:
    ball = Shape(Sphere(0.1), name="ball")
    return Articulation("pair", (solid("a", ball), solid("b", replace(ball, name="tip"))), (joint,), **fields)  # type: ignore[arg-type]


def there_and_back(articulation: Articulation, tmp_path: Path) -> Articulation:
    write_mjcf(articulation, tmp_path / "model.xml")
    return validate(read_mjcf(tmp_path / "model.xml"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mjcf")


@settings(max_examples=20, deadline=None)
@given(articulations(), st.booleans())
def test_random_articulations_come_back(folder: Path, asked: Articulation, self_collisions: bool) -> None:
    asked = sort_links(replace(asked, self_collisions=self_collisions))
    got = there_and_back(asked, folder)
    assert_same(got, asked, lost=("velocity_limit",))
    reference = compare(got, MujocoReference(folder / "model.xml", got.root.name))
    assert reference.mass < 1e-9
    assert reference.kinematics < 1e-6
    assert reference.mass_matrix < 1e-5


def test_springs_drives_and_home_come_back(tmp_path: Path) -> None:
    joint = Joint(
        "j", JointType.PRISMATIC, "a", "b", lower_limit=0.0, stiffness=40.0, rest_position=0.25, effort_limit=9.0
    )
    for drive in (DriveGains("j", 100.0, 5.0, 9.0), DriveGains("j", 0.0, 5.0), DriveGains("j", 0.0, 0.0, 9.0)):
        got = there_and_back(pair(joint, drives=(drive,), home=(("j", 0.125),)), tmp_path)
        (one,) = got.joints
        assert (one.stiffness, one.rest_position, one.effort_limit) == (40.0, 0.25, 9.0)
        assert (one.lower_limit, one.upper_limit) == (0.0, math.inf)
        assert got.drives == (drive,)
        assert got.home == (("j", 0.125),)


@pytest.mark.parametrize("mimic", [Mimic("j_1", 0.5, 0.1), Mimic("j_1", 0.5, 0.1, (0.25, -0.5, 0.125))])
def test_followers_come_back(tmp_path: Path, mimic: Mimic) -> None:
    links = tuple(solid(name) for name in "abc")
    joints = (
        Joint("j_1", JointType.CONTINUOUS, "a", "b"),
        Joint("j_2", JointType.CONTINUOUS, "b", "c", mimic=mimic),
    )
    got = there_and_back(Articulation("chain", links, joints), tmp_path)
    assert got.joints[1].mimic == mimic


@pytest.mark.parametrize("kind", list(LoopType))
def test_loops_come_back_without_frames_of_their_own(tmp_path: Path, kind: LoopType) -> None:
    links = tuple(solid(name) for name in "abc")
    joints = tuple(Joint(f"j_{name}", JointType.CONTINUOUS, "a", name) for name in "bc")
    turned = Pose.from_euler(0.3, 0.2, 0.1).orientation if kind is LoopType.WELD else (1.0, 0.0, 0.0, 0.0)
    loop = LoopJoint("knee", "b", "c", (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), kind, turned)
    got = there_and_back(Articulation("loop", links, joints, (Frame("tool", "c"),), loops=(loop,)), tmp_path)
    (back,) = got.loops
    assert (back.name, back.first, back.second, back.type) == ("knee", "b", "c", kind)
    np.testing.assert_allclose(back.first_point, loop.first_point)
    np.testing.assert_allclose(back.second_point, loop.second_point)
    np.testing.assert_allclose(back.orientation, turned, atol=1e-12)
    assert [frame.name for frame in got.frames] == ["tool"]


def test_a_ball_joint_is_three_on_one_body(tmp_path: Path) -> None:
    whole = Joint(
        "j", JointType.CONTINUOUS, "a", "b", Pose((1.0, 2.0, 3.0)), Pose.from_euler(0.1, 0.2, 0.3, (0.4, 0.5, 0.6))
    )
    between, joints = compound(whole, BALL)
    asked = Articulation("ball", (solid("a"), *between, solid("b")), joints)
    assert write_mjcf(asked, tmp_path / "model.xml") == ()
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml")).nbody == 3
    got = validate(read_mjcf(tmp_path / "model.xml"))
    assert (got.link_names, got.joint_names) == (asked.link_names, asked.joint_names)
    positions = {"j_rx": 0.3, "j_ry": -0.4, "j_rz": 0.5}
    np.testing.assert_allclose(link_poses(got, positions)["b"], link_poses(asked, positions)["b"], atol=1e-12)


def test_meshes_come_back_where_they_were(tmp_path: Path) -> None:
    """MuJoCo moves a mesh's frame to its middle; its corners stay where they are, and a flat one is drawn."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    solid_mesh = Mesh(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    flat = Mesh(corners[:3], np.array([[0, 1, 2]]))
    pose = Pose.from_euler(0.1, 0.2, 0.3, (0.4, 0.5, 0.6))
    link = replace(solid("a"), collisions=(Shape(solid_mesh, pose),), visuals=(Shape(flat, pose, name="sheet"),))
    got = there_and_back(Articulation("mesh", (link,)), tmp_path).root
    for shapes, asked in ((got.collisions, solid_mesh), (got.visuals, flat)):
        (shape,) = shapes
        assert isinstance(shape.geometry, Mesh)
        back = shape.pose.transform(shape.geometry.vertices)[shape.geometry.faces.ravel()]
        np.testing.assert_allclose(back, pose.transform(asked.vertices)[asked.faces.ravel()], atol=1e-6)


def test_exclusions_and_materials_come_back(tmp_path: Path) -> None:
    material = PhysicsMaterial(0.5, 0.5, 0.25, 0.0)
    links = tuple(solid(name, Shape(Box((0.1, 0.1, 0.1)), material=material, name="box")) for name in "abcd")
    joints = tuple(Joint(f"j_{b}", JointType.CONTINUOUS, a, b) for a, b in ("ab", "bc", "cd"))
    asked = Articulation("chain", links, joints, self_collisions=True, collision_exclusions=(("b", "d"),))
    got = there_and_back(asked, tmp_path)
    assert got.self_collisions
    assert got.collision_exclusions == (("b", "d"),)
    assert [shape.material for link in got.links for shape in link.collisions] == [material] * 4


def test_what_the_format_lacks_is_said(tmp_path: Path) -> None:
    joint = Joint("j", JointType.REVOLUTE, "a", "b", velocity_limit=3.0)
    asked = pair(joint)
    asked = replace(asked, links=(asked.links[0], replace(asked.links[1], semantic_label="tip")))
    said = write_mjcf(asked, tmp_path / "model.xml")
    assert said == (
        "MJCF does not hold velocity limits, which joints have: 'j'",
        "MJCF does not hold semantic labels, which links have: 'b'",
        "joints without limits become continuous: 'j'",
    )


@pytest.mark.parametrize("fixed_base", [True, False])
def test_a_link_named_world_that_has_mass_is_told_its_new_name(tmp_path: Path, fixed_base: bool) -> None:
    joint = Joint("j", JointType.CONTINUOUS, "world", "world_1")
    asked = Articulation(
        "arm",
        (solid("world"), solid("world_1")),
        (joint,),
        frames=(Frame("mount", "world", Pose((0.1, 0.0, 0.0))),),
        self_collisions=True,
    )
    said = write_mjcf(asked, tmp_path / "a.xml", fixed_base=fixed_base)
    assert "MJCF keeps the name 'world' for the world: what has it becomes 'world_2'" in said
    got = read_mjcf(tmp_path / "a.xml")
    assert got.link_names == ("world_2", "world_1")
    assert got.root.mass == asked.root.mass
    assert got.frame("mount").link == "world_2"


def test_a_floating_base_is_written_where_asked(tmp_path: Path) -> None:
    asked = pair(Joint("j", JointType.CONTINUOUS, "a", "b"), home=(("j", 0.5),))
    write_mjcf(asked, tmp_path / "model.xml", fixed_base=False)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    assert (model.nq, model.nv) == (8, 7)
    assert model.key_qpos[0].tolist() == [0, 0, 0, 1, 0, 0, 0, 0.5]
    assert_same(validate(read_mjcf(tmp_path / "model.xml")), asked)


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"name it \*.xml or \*.mjcf"):
        write_mjcf(pair(Joint("j", JointType.CONTINUOUS, "a", "b")), tmp_path / "model.urdf")
    drawn = Link("b", visuals=(Shape(Sphere(0.1)),))
    joints = (
        Joint("j", JointType.CONTINUOUS, "a", "b"),
        Joint("k", JointType.CONTINUOUS, "b", "c", axis=(1.0, 0.0, 0.0)),
    )
    with pytest.raises(AssetError, match="link 'b' moves without mass"):
        write_mjcf(Articulation("x", (solid("a"), drawn, solid("c")), joints), tmp_path / "model.xml")
