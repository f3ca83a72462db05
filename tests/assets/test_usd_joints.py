"""Joints of USD files by other hands: drives, loops, ball and generic joints, schemas of several engines."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from orbit_assets import load_articulation
from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.usd import read_usd
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate
from orbit_core.scene import DriveGains, JointType, LoopType, Mimic
from tests.assets.usd_files import CENTIMETRES, body, joint, stage

DROP = ReadOptions(unsupported=Unsupported.DROP)
BODIES = body("a") + body("b") + body("c")


def test_drive_gains_become_si(tmp_path: Path) -> None:
    # In centimetres and kilograms: forces x 1e-2, torques x 1e-4; a gain per degree is 180 / pi of it per radian.
    swing = """
        float drive:angular:physics:stiffness = 10000
        float drive:angular:physics:damping = 500
        float drive:angular:physics:maxForce = 200000"""
    slide = """
        float drive:linear:physics:stiffness = 300
        float drive:linear:physics:damping = 20"""
    bare = "float drive:angular:physics:maxForce = 100000"
    accelerating = """
        uniform token drive:angular:physics:type = "acceleration"
        float drive:angular:physics:stiffness = 10"""
    content = (
        BODIES
        + body("d")
        + body("e")
        + joint("Revolute", "swing", "a", "b", swing, '"PhysicsDriveAPI:angular"')
        + joint("Prismatic", "slide", "b", "c", slide, '"PhysicsDriveAPI:linear"')
        + joint("Revolute", "bare", "c", "d", bare, '"PhysicsDriveAPI:angular"')
        + joint("Revolute", "odd", "d", "e", accelerating, '"PhysicsDriveAPI:angular"')
    )
    got = read_usd(stage(tmp_path, content, CENTIMETRES))
    turn = math.degrees(1.0)
    first, second = got.drives
    assert first == DriveGains("swing", pytest.approx(turn), pytest.approx(0.05 * turn), pytest.approx(20.0))
    assert second == DriveGains("slide", pytest.approx(300.0), pytest.approx(20.0), math.inf)
    assert got.joints[2].effort_limit == pytest.approx(10.0)
    assert any("'odd' is in accelerations" in note for note in got.notes)


def test_physx_schemas_are_read_as_plain_attributes(tmp_path: Path) -> None:
    leader = """
        float physxJoint:armature = 0.5
        float physxJoint:maxJointVelocity = 90
        float physxJoint:jointFriction = 0.1"""
    follower = """
        float physxJointAxis:angular:armature = 0.25
        float physxJoint:armature = 0.75
        float physxJointAxis:angular:maxJointVelocity = 180
        float physxJointAxis:angular:staticFrictionEffort = 3
        float physxJointAxis:angular:dynamicFrictionEffort = 2
        float physxJointAxis:angular:viscousFrictionCoefficient = 1
        rel physxMimicJoint:rotX:referenceJoint = </top/leader>
        float physxMimicJoint:rotX:gearing = -2
        float physxMimicJoint:rotX:offset = 45"""
    content = (
        BODIES
        + joint("Revolute", "leader", "a", "b", leader, '"PhysxJointAPI"')
        + joint("Revolute", "follower", "b", "c", follower, '"PhysxMimicJointAPI:rotX", "PhysxJointAxisAPI:angular"')
    )
    got = validate(read_usd(stage(tmp_path, content)))
    one, other = got.joints
    assert (one.armature, other.armature) == (0.5, 0.25)
    assert (one.velocity_limit, other.velocity_limit) == (pytest.approx(math.pi / 2), pytest.approx(math.pi))
    assert other.friction == 2.0
    assert other.damping == pytest.approx(math.degrees(1.0))
    assert other.mimic == Mimic("leader", pytest.approx(2.0), pytest.approx(-math.pi / 4))
    assert any("in proportion to its load" in note for note in got.notes)
    assert any("friction that acts while it moves" in note for note in got.notes)


def test_mjc_attributes_are_per_radian(tmp_path: Path) -> None:
    inner = """
        uniform double mjc:damping = 0.5
        uniform double mjc:frictionloss = 0.25
        uniform double mjc:armature = 0.125
        uniform double mjc:stiffness = 4
        uniform double mjc:springref = 90"""
    content = body("a") + body("b") + joint("Revolute", "turn", "a", "b", inner, '"MjcJointAPI"')
    (turn,) = read_usd(stage(tmp_path, content)).joints
    assert (turn.damping, turn.friction, turn.armature, turn.stiffness) == (0.5, 0.25, 0.125, 4.0)
    assert turn.rest_position == pytest.approx(math.pi / 2)


def test_a_ball_joint_is_a_chain_of_three(tmp_path: Path) -> None:
    content = (
        body("a")
        + body("b", at=(0, 0, 1))
        + joint("Spherical", "ball", "a", "b", "point3f physics:localPos0 = (0, 0, 1)")
    )
    got = load_articulation(stage(tmp_path, content))
    assert got.joint_names == ("ball_rotX", "ball_rotY", "ball_rotZ")
    assert [joint.axis for joint in got.joints] == [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    assert [link.mass for link in got.links] == [1.0, 0.0, 0.0, 1.0]
    assert got.joints[0].parent_pose.position == (0.0, 0.0, 1.0)


def test_a_generic_joint_moves_where_it_is_not_locked(tmp_path: Path) -> None:
    limits = {
        "transX": (1, -1),
        "transY": (-0.5, 0.5),
        "transZ": (1, -1),
        "rotX": (1, -1),
        "rotY": (1, -1),
        "rotZ": (-90, 45),
    }
    inner = "".join(
        f"float limit:{axis}:physics:low = {low}\nfloat limit:{axis}:physics:high = {high}\n"
        for axis, (low, high) in limits.items()
    )
    inner += "float drive:rotZ:physics:stiffness = 3\n"
    schemas = ", ".join(f'"PhysicsLimitAPI:{axis}"' for axis in limits) + ', "PhysicsDriveAPI:rotZ"'
    got = load_articulation(stage(tmp_path, body("a") + body("b") + joint("", "some", "a", "b", inner, schemas)))
    slide, turn = got.joints
    assert (slide.name, slide.type, slide.axis) == ("some_transY", JointType.PRISMATIC, (0.0, 1.0, 0.0))
    assert (slide.lower_limit, slide.upper_limit) == (-0.5, 0.5)
    assert (turn.name, turn.type, turn.axis) == ("some_rotZ", JointType.REVOLUTE, (0.0, 0.0, 1.0))
    assert (turn.lower_limit, turn.upper_limit) == (pytest.approx(-math.pi / 2), pytest.approx(math.pi / 4))
    assert [drive.joint for drive in got.drives] == ["some_rotZ"]
    locked = ", ".join(f'"PhysicsLimitAPI:{axis}"' for axis in limits)
    inner = "".join(f"float limit:{axis}:physics:low = 1\nfloat limit:{axis}:physics:high = -1\n" for axis in limits)
    (fixed,) = read_usd(stage(tmp_path, body("a") + body("b") + joint("", "none", "a", "b", inner, locked))).joints
    assert fixed.type is JointType.FIXED


def four_bar(closing: str) -> str:
    """A square of one metre: a is the ground, b and d its sides, c the coupler; ``closing`` joins c and d."""
    square = body("a") + body("b") + body("c", at=(0, 1, 0)) + body("d", at=(1, 0, 0))
    axis = 'uniform token physics:axis = "Z"\n'
    return (
        square
        + joint("Revolute", "ab", "a", "b", axis)
        + joint("Revolute", "bc", "b", "c", axis + "point3f physics:localPos0 = (0, 1, 0)")
        + joint("Revolute", "ad", "a", "d", axis + "point3f physics:localPos0 = (1, 0, 0)")
        + closing
    )


ENDS = "point3f physics:localPos0 = (1, 0, 0)\npoint3f physics:localPos1 = (0, 1, 0)\n"


def test_joints_that_close_loops_are_balls_and_welds(tmp_path: Path) -> None:
    excluded = "bool physics:excludeFromArticulation = true\n"
    ball = load_articulation(stage(tmp_path, four_bar(joint("Spherical", "cd", "c", "d", ENDS + excluded))))
    (loop,) = ball.loops
    assert (loop.name, loop.first, loop.second, loop.type) == ("cd", "c", "d", LoopType.BALL)
    assert (loop.first_point, loop.second_point) == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    weld = read_usd(stage(tmp_path, four_bar(joint("Fixed", "cd", "c", "d", ENDS))))
    assert [loop.type for loop in weld.loops] == [LoopType.WELD]
    hinge = read_usd(
        stage(tmp_path, four_bar(joint("Revolute", "cd", "c", "d", ENDS + 'uniform token physics:axis = "Z"')))
    )
    one, other = hinge.loops
    assert (one.first_point, other.first_point) == ((1.0, 0.0, -0.05), (1.0, 0.0, 0.05))
    assert hinge.joint_names == ("ab", "bc", "ad")


def test_a_weld_holds_the_orientation_that_its_frames_say(tmp_path: Path) -> None:
    quarter = "quatf physics:localRot1 = (0.70710678, 0, 0, 0.70710678)\n"
    (loop,) = read_usd(stage(tmp_path, four_bar(joint("Fixed", "cd", "c", "d", ENDS + quarter)))).loops
    np.testing.assert_allclose(loop.orientation, (math.sqrt(0.5), 0, 0, -math.sqrt(0.5)), atol=1e-7)


def test_bodies_away_from_zero_are_at_home_there(tmp_path: Path) -> None:
    slide = 'uniform token physics:axis = "X"\nfloat physics:lowerLimit = 0\nfloat physics:upperLimit = 1'
    content = body("a") + body("b", at=(0.25, 0, 0)) + joint("Prismatic", "slide", "a", "b", slide)
    assert read_usd(stage(tmp_path, content)).home == (("slide", pytest.approx(0.25)),)
    stated = slide + "\nfloat state:linear:physics:position = 0.5"
    content = body("a") + body("b", at=(0.25, 0, 0)) + joint("Prismatic", "slide", "a", "b", stated)
    assert read_usd(stage(tmp_path, content)).home == (("slide", pytest.approx(0.5)),)
    content = body("a") + body("b", at=(0.25, 0.5, 0)) + joint("Prismatic", "slide", "a", "b", slide)
    got = read_usd(stage(tmp_path, content))
    assert got.home == ()
    assert any("stand 0.5 m and 0 rad from where" in note for note in got.notes)


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (
            body("a") + body("b") + joint("Revolute", "j", "a", "b") + joint("Distance", "rod", "a", "b"),
            "/top/rod is a distance joint",
        ),
        (
            body("a") + body("b") + joint("Spherical", "j", "a", "b", "float physics:coneAngle0Limit = 30"),
            "/top/j limits its ball joint by a cone",
        ),
        (
            body("a", schemas=', "PhysxTendonAxisRootAPI:t"') + body("b") + joint("Revolute", "j", "a", "b"),
            r"/top/a is a tendon \(PhysxTendonAxisRootAPI\)",
        ),
    ],
)
def test_what_the_description_lacks_is_refused_or_dropped_with_a_note(tmp_path: Path, content: str, what: str) -> None:
    path = stage(tmp_path, content)
    with pytest.raises(AssetError, match=what):
        read_usd(path)
    got = read_usd(path, options=DROP)
    assert got.link_names[0] == "a"
    assert any("left out" in note and note.startswith("/top/") for note in got.notes)
