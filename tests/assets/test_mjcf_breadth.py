"""What MJCF has beyond hinges: balls, springs, tendons, welds, drives, keyframes, several articulations in a file."""

from __future__ import annotations

import math
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbit_assets.audit.checks import mass_matrix, posture
from orbit_assets.mjcf import read_mjcf, read_mjcf_all
from orbit_assets.options import ReadLimits, ReadOptions, Unsupported
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, DriveGains, HeightField, JointType, LoopType, Plane

DROP = ReadOptions(unsupported=Unsupported.DROP)
GEOM = '<geom size="0.1"/>'
TWO = (
    f'<body name="base">{GEOM}<body name="one"><joint name="a" axis="0 1 0"/>{GEOM}</body>'
    f'<body name="two"><joint name="b" axis="0 1 0" ref="0.2"/>{GEOM}</body></body>'
)


def write(tmp_path: Path, worldbody: str, rest: str = "") -> Path:
    path = tmp_path / "model.xml"
    path.write_text(f'<mujoco><compiler angle="radian"/><worldbody>{worldbody}</worldbody>{rest}</mujoco>')
    return path


def read(tmp_path: Path, worldbody: str, rest: str = "", options: ReadOptions = ReadOptions()) -> Articulation:
    return validate(read_mjcf(write(tmp_path, worldbody, rest), options=options))


def test_a_ball_joint_moves_as_the_engine_moves_it(tmp_path: Path) -> None:
    """Its pose and kinetic energy are MuJoCo's, at an orientation and a velocity of the child."""
    got = read(
        tmp_path,
        f'<body name="base">{GEOM}<body name="tip" pos="1 2 3" quat="0.8 0.6 0 0">'
        '<joint name="j" type="ball" pos="0.1 0.2 0.3"/><geom type="box" size="0.1 0.2 0.3" pos="0.3 0 0"/></body>'
        "</body>",
    )
    assert got.joint_names == ("j_rx", "j_ry", "j_rz")
    assert [link.mass for link in got.links[1:3]] == [0.0, 0.0]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    data.qpos[:] = np.array((0.5, -0.3, 0.4, 0.2)) / np.linalg.norm((0.5, -0.3, 0.4, 0.2))
    data.qvel[:] = (0.7, -0.2, 0.4)
    mujoco.mj_forward(model, data)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, data.qpos)
    m = rotation.reshape(3, 3)
    angles = np.array((math.atan2(-m[1, 2], m[2, 2]), math.asin(m[0, 2]), math.atan2(-m[0, 1], m[0, 0])))
    at = posture(got, dict(zip(got.joint_names, angles, strict=True)))
    np.testing.assert_allclose(at.links["tip"][:3, 3], data.body("tip").xpos, atol=1e-9)
    np.testing.assert_allclose(at.links["tip"][:3, :3], data.body("tip").xmat.reshape(3, 3), atol=1e-9)
    axes = np.stack([at.axes[name] for name in got.joint_names], axis=1)
    rates = np.linalg.solve(axes, data.body("tip").xmat.reshape(3, 3) @ data.qvel)
    full = np.zeros((3, 3))
    mujoco.mj_fullM(model, data, full)
    assert rates @ mass_matrix(got, at) @ rates == pytest.approx(data.qvel @ full @ data.qvel, rel=1e-9)


def test_a_ball_in_a_keyframe_is_three_angles(tmp_path: Path) -> None:
    body = f'<body name="base">{GEOM}<body name="tip"><joint name="j" type="ball"/>{GEOM}</body></body>'
    key = '<keyframe><key name="away" qpos="1 0 0 0"/><key name="home" qpos="0.8 0 0.6 0"/></keyframe>'
    got = read(tmp_path, body, key)
    assert dict(got.home) == pytest.approx({"j_rx": 0.0, "j_ry": 2 * math.asin(0.6), "j_rz": 0.0}, abs=1e-12)
    assert "of 2 keyframes, 'home' is home" in got.notes


def test_springs_are_the_joints_own(tmp_path: Path) -> None:
    got = read(
        tmp_path,
        f'<body name="base">{GEOM}<body name="tip">'
        f'<joint name="j" ref="0.5" stiffness="3" springref="0.7" damping="0.2"/>{GEOM}</body></body>',
    )
    (joint,) = got.joints
    assert (joint.stiffness, joint.rest_position, joint.damping) == (3.0, 0.7, 0.2)
    assert got.home == (("j", 0.5),)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.1
    mujoco.mj_forward(model, data)
    assert data.qfrc_spring[0] == pytest.approx(-joint.stiffness * (0.1 - joint.rest_position))


@pytest.mark.parametrize(
    "rest",
    [
        '<equality><joint joint1="b" joint2="a" polycoef="0.1 0.5 0.3 -0.2 0.1"/></equality>',
        '<tendon><fixed name="s"><joint joint="a" coef="0.5"/></fixed>'
        '<fixed name="t"><joint joint="b" coef="2"/></fixed></tendon>'
        '<equality><tendon tendon1="t" tendon2="s" polycoef="0.1 0.5 0.3 0 0"/></equality>',
        '<tendon><fixed name="t"><joint joint="a" coef="0.5"/><joint joint="b" coef="2"/></fixed></tendon>'
        '<equality><tendon tendon1="t" polycoef="0.1 0 0 0 0"/></equality>',
    ],
)
def test_constraints_on_joints_and_tendons_become_followers(tmp_path: Path, rest: str) -> None:
    """Where the description says that the follower is, MuJoCo's constraint has no residual."""
    got = read(tmp_path, TWO, rest)
    (follower,) = [joint for joint in got.joints if joint.mimic]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    assert follower.mimic is not None
    for at in (-0.4, 0.6):
        data.joint(follower.mimic.joint).qpos[:] = at
        data.joint(follower.name).qpos[:] = follower.mimic.position(at)
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.efc_pos[: data.ne], 0.0, atol=1e-12)


def test_a_joint_that_is_held_is_fixed_there(tmp_path: Path) -> None:
    got = read(tmp_path, TWO, '<equality><joint joint1="b" polycoef="0.3 0 0 0 0"/></equality>')
    assert got.joint_names == ("a",)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    data.joint("b").qpos[:] = 0.5
    mujoco.mj_forward(model, data)
    assert data.efc_pos[0] == pytest.approx(0.0, abs=1e-12)
    two = posture(got, {}).links["two"]
    np.testing.assert_allclose(two[:3, :3], data.body("two").xmat.reshape(3, 3), atol=1e-12)


def test_a_tendon_over_one_joint_is_the_joints_own(tmp_path: Path) -> None:
    tendon = (
        '<fixed name="t" limited="true" range="-1 2" stiffness="3" springlength="0.4" damping="0.5" armature="0.25">'
        '<joint joint="a" coef="-2"/></fixed>'
    )
    got = read(tmp_path, TWO.replace('name="a"', 'name="a" stiffness="4"'), f"<tendon>{tendon}</tendon>")
    joint = got.joints[0]
    assert (joint.type, joint.lower_limit, joint.upper_limit) == (JointType.REVOLUTE, -1.0, 0.5)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    data.joint("a").qpos[:], data.joint("a").qvel[:] = 0.3, 0.7
    mujoco.mj_forward(model, data)
    assert data.qfrc_spring[0] == pytest.approx(-joint.stiffness * (0.3 - joint.rest_position))
    assert data.qfrc_damper[0] == pytest.approx(-joint.damping * 0.7)
    full = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, full)
    assert mass_matrix(got, posture(got, {}))[0, 0] == pytest.approx(full[0, 0])


def test_a_motor_that_pulls_on_two_joints_couples_them(tmp_path: Path) -> None:
    tendon = '<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="2"/></fixed></tendon>'
    got = read(tmp_path, TWO, f'{tendon}<actuator><position name="m" tendon="t" kp="1"/></actuator>')
    mimic = got.joints[1].mimic
    assert mimic is not None
    assert (mimic.joint, mimic.multiplier, mimic.offset) == ("a", 2.0, 0.2)
    assert any("tendon 't', by which one motor pulls on joints 'a' and 'b', couples them" in note for note in got.notes)


@pytest.mark.parametrize("ends", ['body1="one" body2="two" relpose="0 0 0 0.8 0 0.6 0"', 'site1="s" site2="t"'])
def test_a_weld_closes_a_loop(tmp_path: Path, ends: str) -> None:
    """Its residual is zero in MuJoCo where the description's two frames meet."""
    body = TWO.replace(
        '<joint name="a" axis="0 1 0"/>', '<joint name="a" axis="0 1 0"/><site name="s" quat="0.8 0 0.6 0"/>'
    ).replace('ref="0.2"/>', '/><site name="t"/>')
    got = read(tmp_path, body, f'<equality><weld name="glue" {ends}/></equality>')
    (loop,) = got.loops
    assert (loop.name, loop.first, loop.second, loop.type) == ("glue", "one", "two", LoopType.WELD)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    data.joint("b").qpos[:] = 2 * math.asin(0.6)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.efc_pos[:6], 0.0, atol=1e-9)
    np.testing.assert_allclose(loop.orientation, (0.8, 0.0, 0.6, 0.0), atol=1e-9)


def test_actuators_become_drives(tmp_path: Path) -> None:
    actuators = (
        '<position joint="a" kp="10" kv="2" gear="3" forcerange="-4 4"/><velocity joint="b" kv="5"/>'
        '<motor name="push" site="s"/><muscle name="pull" joint="b" lengthrange="0 1"/>'
    )
    body = TWO.replace('<joint name="a"', '<site name="s"/><joint name="a"')
    got = read(tmp_path, body, f"<actuator>{actuators}</actuator>")
    assert got.drives == (DriveGains("a", 90.0, 18.0, 12.0), DriveGains("b", 0.0, 5.0, math.inf))
    assert "actuators that are no spring and damper on one joint are left out: 'pull', 'push'" in got.notes


@pytest.mark.parametrize(
    ("joint", "actuators", "limit", "noted"),
    [
        ("", '<position joint="a" kp="10" forcerange="0 5"/>', 5.0, "0 to 5"),
        ("", '<position joint="a" kp="10" forcerange="0 5" gear="-2"/>', 10.0, "-10 to 0"),
        ("", '<motor joint="a" gear="50" ctrlrange="-1 0.2"/>', 50.0, "-50 to 10"),
        ("", '<motor joint="a" gear="50" ctrlrange="0 1" forcerange="0 0.5"/>', 25.0, "0 to 25"),
        ("", '<general joint="a" gainprm="-3" ctrlrange="0 2"/>', 6.0, "-6 to 0"),
        ('actuatorfrcrange="-3 4"', "", 4.0, "-3 to 4"),
        ('actuatorfrcrange="-3 4"', '<motor joint="a" ctrlrange="-1 5"/>', 4.0, "-1 to 4"),
        ("", '<motor joint="a" ctrlrange="0 2"/><motor joint="a" gear="-1" ctrlrange="0 2"/>', 2.0, None),
        ('actuatorfrcrange="-3 3"', '<position joint="a" kp="10" forcerange="-7 7"/>', 3.0, None),
    ],
)
def test_effort_limits_that_differ_by_direction_are_noted(
    tmp_path: Path, joint: str, actuators: str, limit: float, noted: str | None
) -> None:
    body = TWO.replace('<joint name="a"', f'<joint name="a" {joint}')
    got = read(tmp_path, body, f"<actuator>{actuators}</actuator>")
    (driven,) = (each for each in got.joints if each.name == "a")
    assert driven.effort_limit == pytest.approx(limit)
    notes = [note for note in got.notes if "differ by direction" in note]
    assert len(notes) == (noted is not None)
    assert noted is None or f"in both: 'a' {noted}" in notes[0]


SEVERAL = (
    f'<geom type="plane" size="1 1 1"/><geom name="wall" type="box" size="1 1 1"/>'
    f'<body name="arm" pos="1 0 0">{GEOM}<body name="hand"><joint name="a"/>{GEOM}</body></body>'
    f'<body name="door"><joint name="d"/>{GEOM}</body><body name="cup" pos="0 0 2"><freejoint/>{GEOM}</body>'
)


def test_one_of_several_articulations_is_named(tmp_path: Path) -> None:
    path = write(tmp_path, SEVERAL)
    with pytest.raises(AssetError, match=r"holds several articulations: name one .* 'arm', 'door', 'cup', or 'world'"):
        read_mjcf(path)
    links = {
        "arm": ("arm", "hand"),
        "door": ("world", "door"),
        "cup": ("cup",),
        "world": ("world", "arm", "hand", "door"),
    }
    for name, expected in links.items():
        assert validate(read_mjcf(path, options=ReadOptions(articulation=name))).link_names == expected
    with pytest.raises(AssetError, match="holds no articulation 'leg': name one"):
        read_mjcf(path, options=ReadOptions(articulation="leg"))


def test_all_articulations_stand_where_the_file_puts_them(tmp_path: Path) -> None:
    placed = read_mjcf_all(write(tmp_path, SEVERAL))
    found = {each.articulation.name: each for each in placed}
    assert list(found) == ["world", "arm", "door", "cup"]
    assert [found[name].fixed_base for name in found] == [True, True, True, False]
    assert found["arm"].pose.position == (1.0, 0.0, 0.0)
    assert found["cup"].pose.position == (0.0, 0.0, 2.0)
    ground, wall = found["world"].articulation.root.collisions
    assert isinstance(ground.geometry, Plane)
    assert wall.name == "wall"
    assert found["door"].articulation.root.collisions == ()


def test_bodies_that_a_constraint_connects_are_one_articulation(tmp_path: Path) -> None:
    bodies = "".join(f'<body name="{name}"><joint name="{name}"/>{GEOM}</body>' for name in "abc")
    placed = read_mjcf_all(
        write(tmp_path, bodies, '<equality><connect body1="a" body2="c" anchor="0 0 0"/></equality>')
    )
    assert [each.articulation.link_names for each in placed] == [("world", "a", "c"), ("world", "b")]
    assert len(placed[0].articulation.loops) == 1


def test_a_height_field_of_the_world_is_its_shape(tmp_path: Path) -> None:
    field = '<asset><hfield name="h" nrow="2" ncol="3" size="3 2 0.5 0.1" elevation="0 1 2 0 2 4"/></asset>'
    body = f'<geom type="hfield" hfield="h"/><body name="b"><freejoint/>{GEOM}</body>'
    (shape,) = read_mjcf_all(write(tmp_path, body, field))[0].articulation.root.collisions
    assert isinstance(shape.geometry, HeightField)
    assert shape.geometry.size == (6.0, 4.0)
    np.testing.assert_allclose(np.ptp(shape.geometry.heights), 0.5)


@pytest.mark.parametrize(
    ("body", "rest", "message"),
    [
        (f'<body name="b"><joint type="free" damping="1"/>{GEOM}</body>', "", "free joint .* has damping"),
        (f'<body name="b" gravcomp="1">{GEOM}</body>', "", "gravity is compensated on bodies 'b'"),
        (
            f'<body name="b"><freejoint/>{GEOM}<geom name="hill" type="hfield" hfield="h"/></body>',
            '<asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1" elevation="0 1 2 0"/></asset>',
            "geom 'hill' of body 'b' is a height field that moves",
        ),
        (
            TWO,
            '<tendon><fixed name="t" limited="true" range="0 1"><joint joint="a" coef="1"/><joint joint="b" coef="1"/>'
            "</fixed></tendon>",
            "tendon 't' has a limit",
        ),
    ],
)
def test_what_changes_motion_is_refused_or_left_out_as_asked(
    tmp_path: Path, body: str, rest: str, message: str
) -> None:
    with pytest.raises(AssetError, match=f"{message}.*Unsupported.DROP"):
        read(tmp_path, body, rest)
    assert any(note.startswith("left out: ") for note in read(tmp_path, body, rest, DROP).notes)


def test_a_file_in_another_encoding_reads(tmp_path: Path) -> None:
    path = tmp_path / "wide.xml"
    path.write_text(f'<mujoco model="wide"><worldbody><body name="b">{GEOM}</body></worldbody></mujoco>', "utf-16")
    assert read_mjcf(path).name == "wide"


def test_copies_beyond_the_limits_are_refused_before_they_are_made(tmp_path: Path) -> None:
    body = f'<replicate count="100000000"><body>{GEOM}</body></replicate>'
    start = time.process_time()
    with pytest.raises(AssetError, match="replicates its elements"):
        read_mjcf(write(tmp_path, body))
    assert time.process_time() - start < 5.0
    assert ReadLimits().elements < 100_000_000


def test_a_thousand_bodies_read_in_seconds(tmp_path: Path) -> None:
    bodies = "".join(f'<body name="b{n}" pos="0 0 1"><joint name="j{n}"/>{GEOM}</body>' for n in range(1000))
    path = write(tmp_path, f'<body name="base">{GEOM}{bodies}</body>')
    start = time.process_time()
    got = read_mjcf(path)
    assert time.process_time() - start < 10.0
    assert len(got.links) == 1001
    assert got.joints[-1].type is JointType.CONTINUOUS
