"""USD files as ``mujoco-usd-converter`` writes them mean what the MJCF that they come from means."""

from __future__ import annotations

import math
import shutil
import subprocess
from dataclasses import astuple
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from orbit_assets import load_articulation
from orbit_assets.options import ReadOptions, Unsupported
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Articulation, DriveGains, Mimic
from tests.assets.usd_files import body, joint, stage

DROP = ReadOptions(unsupported=Unsupported.DROP)
MJCF = """<mujoco><compiler angle="degree"/><worldbody><body name="a"><freejoint/><geom mass="1" size="0.1"/>
  <body name="b" pos="0 0 -0.3">
    <joint name="roll" axis="1 0 0" range="-20 30" damping="0.5" armature="0.01" stiffness="4" springref="10"/>
    <joint name="pitch" axis="0 1 0" pos="0 0 0.1" range="-90 90" damping="0.2"/>
    <joint name="reach" type="slide" axis="0 0 1" range="0 0.2" frictionloss="0.3"/>
    <geom mass="2" size="0.05" pos="0 0 -0.1"/></body></body></worldbody>
  <actuator><general joint="roll" gear="2" gainprm="30" biastype="affine" biasprm="0 -30 -1" forcerange="-5 5"/>
    <motor joint="pitch" gear="40" ctrlrange="-1 1"/></actuator></mujoco>"""
"""The model that :func:`converted` holds in USD."""
NUMBERS = (
    "lower_limit", "upper_limit", "effort_limit", "damping", "friction", "armature", "stiffness", "rest_position",
)  # fmt: skip
STACKED = """
    uniform bool newton:jointsAddMobility = 1
    """


def frames(height: float, at: float) -> str:
    return f"point3f physics:localPos0 = (0, 0, {height})\n point3f physics:localPos1 = (0, 0, {at})"


def converted(tmp_path: Path, *, flipped: str = "", flag: str = STACKED, schema: str = "MjcJointAPI") -> Path:
    """The file of the model, ``flipped`` naming the joint that names its bodies the other way round."""
    parent = body("a", flag, schemas=', "PhysicsArticulationRootAPI", "NewtonArticulationRootAPI"')
    child = body("b", at=(0, 0, -0.3))
    per_degree = math.radians(1.0)
    said = {
        "roll": f"""{frames(-0.3, 0.0)}
            uniform token physics:axis = "X"
            float physics:lowerLimit = -20
            float physics:upperLimit = 30
            float newton:damping = {0.5 * per_degree}
            float newton:armature = 0.01
            uniform double mjc:stiffness = 4
            uniform double mjc:springref = 10""",
        "pitch": f"""{frames(-0.2, 0.1)}
            uniform token physics:axis = "Y"
            float physics:lowerLimit = -90
            float physics:upperLimit = 90
            float newton:damping = {0.2 * per_degree}""",
        "reach": f"""{frames(-0.3, 0.0)}
            uniform token physics:axis = "Z"
            float physics:lowerLimit = 0
            float physics:upperLimit = 0.2
            float newton:friction = 0.3""",
    }
    schemas = f'"{schema}", "NewtonJointAPI"' if schema else '"NewtonJointAPI"'
    written = ""
    for name, inner in said.items():
        kind = "Prismatic" if name == "reach" else "Revolute"
        if name == flipped:
            inner = inner.replace("localPos0", "spare").replace("localPos1", "localPos0").replace("spare", "localPos1")
            inner += "\n rel physics:body0 = </top/b>\n rel physics:body1 = </top/a>"
            written += f'\n    def Physics{kind}Joint "{name}" (prepend apiSchemas = [{schemas}])\n{{\n{inner}\n}}\n'
        else:
            written += joint(kind, name, "a", "b", inner, schemas)
    actuators = """
    def MjcActuator "motor_of_roll"
    {
        uniform double[] mjc:gainPrm = [30, 0, 0]
        uniform double[] mjc:biasPrm = [0, -30, -1]
        uniform token mjc:biasType = "affine"
        uniform double[] mjc:gear = [2, 0, 0, 0, 0, 0]
        uniform double mjc:forceRange:min = -5
        uniform double mjc:forceRange:max = 5
        rel mjc:target = </top/roll>
    }
    def MjcActuator "motor_of_pitch"
    {
        uniform double[] mjc:gear = [40, 0, 0, 0, 0, 0]
        uniform token mjc:ctrlLimited = "true"
        uniform double mjc:ctrlRange:min = -1
        uniform double mjc:ctrlRange:max = 1
        rel mjc:target = </top/pitch>
    }"""
    return stage(tmp_path, parent + child + written + actuators)


def model(tmp_path: Path) -> Articulation:
    path = tmp_path / "model.xml"
    path.write_text(MJCF)
    return load_articulation(path, options=DROP)


def assert_same_joints(got: Articulation, asked: Articulation, against: str = "") -> None:
    """Names, limits, passive forces and drives of all joints; and poses of all links with mass, wherever they stand.

    The joint ``against`` counts the other way in ``got``.
    """
    assert got.joint_names == asked.joint_names
    assert not got.loops
    for one, other in zip(got.movable_joints, asked.movable_joints, strict=True):
        for name in NUMBERS:
            assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-5, abs=1e-6), (one.name, name)
        assert one.mimic == other.mimic
    drives = {drive.joint: astuple(drive)[1:] for drive in got.drives}
    assert drives.keys() == {drive.joint for drive in asked.drives}
    for drive in asked.drives:
        assert drives[drive.joint] == pytest.approx(astuple(drive)[1:], rel=1e-5)
    generator = np.random.default_rng(0)
    positions = {name: float(generator.uniform(-0.5, 0.5)) for name in asked.joint_names}
    own = {name: -value if name == against else value for name, value in positions.items()}
    poses, others = link_poses(got, own), link_poses(asked, positions)
    for link in asked.links:
        if link.mass > 0:
            np.testing.assert_allclose(poses[link.name].matrix(), others[link.name].matrix(), atol=1e-4)


@pytest.mark.parametrize("flipped", ["", "pitch", "reach"])
def test_several_joints_between_two_bodies_act_one_after_another(tmp_path: Path, flipped: str) -> None:
    got = load_articulation(converted(tmp_path, flipped=flipped))
    assert_same_joints(got, model(tmp_path), against=flipped)
    assert got.drives == (
        DriveGains("roll", pytest.approx(120.0), pytest.approx(4.0), 10.0),
        DriveGains("pitch", 0.0, 0.0, 40.0),
    )


def test_joints_of_mujocos_schema_act_so_without_the_flag_of_newtons(tmp_path: Path) -> None:
    assert_same_joints(load_articulation(converted(tmp_path, flag="")), model(tmp_path))


@pytest.mark.parametrize(("flag", "schema"), [("uniform bool newton:jointsAddMobility = 0", "MjcJointAPI"), ("", "")])
def test_joints_that_constrain_each_other_close_loops(tmp_path: Path, flag: str, schema: str) -> None:
    """As UsdPhysics has it: two hinges of a door are one hinge."""
    door = body("a", flag, schemas=', "PhysicsArticulationRootAPI"') + body("b")
    schemas = f'"{schema}"' if schema else ""
    hinges = "".join(
        joint("Revolute", name, "a", "b", f'{frames(height, height)}\n uniform token physics:axis = "Z"', schemas)
        for name, height in (("upper", 0.5), ("lower", -0.5))
    )
    got = load_articulation(stage(tmp_path, door + hinges))
    assert got.joint_names == ("upper",)
    assert [loop.name for loop in got.loops] == ["lower_1", "lower_2"]


def test_the_outer_joint_stays_outer_where_the_tree_runs_against_it(tmp_path: Path) -> None:
    """The articulation's root is the joints' second body."""
    asked = load_articulation(converted(tmp_path))
    text = converted(tmp_path).read_text()
    root = '"PhysicsRigidBodyAPI", "PhysicsMassAPI", "PhysicsArticulationRootAPI", "NewtonArticulationRootAPI"'
    plain = '"PhysicsRigidBodyAPI", "PhysicsMassAPI"'
    head, tail = text.split('def Xform "b"')
    path = tmp_path / "against.usda"
    path.write_text(head.replace(root, plain) + 'def Xform "b"' + tail.replace(plain, root, 1))
    got = load_articulation(path)
    assert got.root.name == "b"
    assert got.joint_names == ("reach", "pitch", "roll")
    positions = {"roll": 0.2, "pitch": -0.4, "reach": 0.1}
    there = link_poses(asked, positions)["b"]
    back = link_poses(got, positions)["a"]
    np.testing.assert_allclose((there @ back).matrix(), np.eye(4), atol=1e-6)


def test_a_joint_follows_by_a_polynomial(tmp_path: Path) -> None:
    """Newton's attributes are in degrees, MuJoCo's in radians; either may stand for the two lowest powers."""
    newton = "rel newton:mimicJoint = </top/lead>\n float newton:mimicCoef0 = 90\n float newton:mimicCoef1 = -2"
    old = "rel mjc:target = </top/lead>\n uniform double mjc:coef0 = 1.5\n uniform double mjc:coef1 = -2"
    powers = "\n uniform double mjc:coef2 = 0.25\n uniform double mjc:coef3 = 0.5"
    off = newton + "\n bool newton:mimicEnabled = 0"
    names = {"lead": "", "new": newton + powers, "old": old + powers, "off": off}
    bodies = "".join(body(name) for name in ("root", *(f"of_{each}" for each in names)))
    both = '"NewtonMimicAPI", "MjcEqualityJointAPI"'
    applied = {"lead": "", "new": both, "old": '"MjcEqualityJointAPI"', "off": both}
    joints = "".join(
        joint("Revolute", name, "root", f"of_{name}", inner, applied[name]) for name, inner in names.items()
    )
    got = load_articulation(stage(tmp_path, bodies + joints))
    mimics = {each.name: each.mimic for each in got.joints}
    assert mimics["new"] == Mimic("lead", -2.0, pytest.approx(math.pi / 2), (0.25, 0.5))
    assert mimics["old"] == Mimic("lead", -2.0, 1.5, (0.25, 0.5))
    assert mimics["off"] is None
    assert any("'off' does not follow its leader at first" in note for note in got.notes)


def test_a_follower_without_a_leader_is_refused(tmp_path: Path) -> None:
    content = body("a") + body("b") + joint("Revolute", "j", "a", "b", "", '"MjcEqualityJointAPI"')
    with pytest.raises(AssetError, match=r"/top/j follows no joint .*: name one by mjc:target"):
        load_articulation(stage(tmp_path, content))


def test_what_actuators_and_bodies_have_beyond_a_description_is_told(tmp_path: Path) -> None:
    """A law that is no spring and damper, a transmission to no joint, a range that differs by direction."""
    content = (
        body("a")
        + body("b")
        + body("c")
        + joint("Revolute", "j", "a", "b", "", '"MjcJointAPI"')
        + joint(
            "Revolute",
            "k",
            "b",
            "c",
            "uniform double mjc:actuatorfrcrange:min = -2\n uniform double mjc:actuatorfrcrange:max = 6",
            '"MjcJointAPI"',
        )
        + """
    def MjcActuator "muscle"
    {
        uniform token mjc:gainType = "muscle"
        rel mjc:target = </top/j>
    }
    def MjcActuator "thruster"
    {
        rel mjc:target = </top/b>
    }"""
    )
    got = load_articulation(stage(tmp_path, content))
    assert got.drives == ()
    told = " ".join(got.notes)
    assert "actuators that are no spring and damper on one joint are left out: 'muscle'" in told
    assert "actuators that drive no joint are left out: 'thruster'" in told
    assert "the effort limit of joint 'k' differs by direction, -2 to 6: 6 holds in both" in told
    assert [each.effort_limit for each in got.joints] == [math.inf, 6.0]
    held = body("a", "custom float mjc:body:gravcomp = 1")
    with pytest.raises(AssetError, match="/top/a is held up against gravity"):
        load_articulation(stage(tmp_path, held))


def test_colliders_of_mujocos_schema_touch_and_weigh_as_mujoco_has_it(tmp_path: Path) -> None:
    """A mass of zero is one, ``condim`` opens directions of friction, softness is in proportion to mass."""

    def ball(name: str, inner: str) -> str:
        schemas = '"PhysicsCollisionAPI", "MjcCollisionAPI", "PhysicsMassAPI", "MaterialBindingAPI"'
        bound = "rel material:binding:physics = </top/rubber>"
        return (
            f'def Sphere "{name}" (prepend apiSchemas = [{schemas}])\n{{\n double radius = 0.1\n{bound}\n{inner}\n}}\n'
        )

    material = """
    def Material "rubber" (prepend apiSchemas = ["PhysicsMaterialAPI", "NewtonMaterialAPI"])
    {
        float physics:staticFriction = 0.7
        float physics:dynamicFriction = 0.7
        float newton:torsionalFriction = 0.02
        float newton:rollingFriction = 0.001
        float newton:contactStiffness = 2500
        float newton:contactDamping = 100
    }
    def Xform "a" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
    {
    """
    shapes = (
        ball("none", "float physics:mass = 0\n uniform int mjc:condim = 1")
        + ball("some", "float physics:mass = 3")
        + ball("spin", "float physics:mass = 1\n uniform int mjc:condim = 4")
        + ball("roll", "float physics:mass = 1\n uniform int mjc:condim = 6")
        + 'def Sphere "tip" (prepend apiSchemas = ["MjcSiteAPI"])\n{\n uniform token purpose = "guide"\n}\n'
    )
    got = load_articulation(stage(tmp_path, material + shapes + "}"))
    (root,) = got.links
    assert root.mass == pytest.approx(5.0)
    frictions = [
        (shape.material.static_friction, shape.material.torsional_friction, shape.material.rolling_friction)
        for shape in root.collisions
    ]
    asked = [(0.0, 0.0, 0.0), (0.7, 0.0, 0.0), (0.7, 0.02, 0.0), (0.7, 0.02, 0.001)]
    np.testing.assert_allclose(frictions, asked, rtol=1e-6)
    assert all(shape.material.compliance is None for shape in root.collisions)
    assert any("softness of contacts" in note for note in got.notes)
    assert [frame.name for frame in got.frames] == ["tip"]


@pytest.mark.parametrize("name", ["humanoid", "walker2d_v5"])
def test_the_converter_itself_is_read_as_the_mjcf_is(tmp_path: Path, name: str) -> None:
    converter = shutil.which("mujoco_usd_converter")
    if converter is None:
        pytest.skip(
            "conversion from MJCF to USD needs the command mujoco_usd_converter on PATH, from another environment: its "
            "package brings a pxr of its own, which takes the place of usd-core's"
        )
    found = find_spec("gymnasium")
    assert found is not None
    assert found.origin is not None
    source = Path(found.origin).parent / "envs" / "mujoco" / "assets" / f"{name}.xml"
    subprocess.run([converter, str(source), str(tmp_path)], check=True, capture_output=True, timeout=60)
    (path,) = tmp_path.glob("*.usda")
    got, asked = load_articulation(path, options=DROP), load_articulation(source, options=DROP)
    assert_same_joints(got, asked)
    links = {link.name: link for link in got.links}
    for link in asked.links:
        if link.mass > 0:
            assert links[link.name].mass == pytest.approx(link.mass, rel=1e-5)
            np.testing.assert_allclose(links[link.name].inertia, link.inertia, rtol=1e-4, atol=1e-7)
