"""Drives are as fast and as damped as they are designed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from orbit_assets.drive_design import (
    MOTOR_TIME,
    DriveDesign,
    designed_drives,
    with_armature,
)
from orbit_core.dynamics.rigid_body import drive_responses, reflected_inertia
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.scene import Articulation, ImplicitPd, Joint, JointType, Link, Mimic, Pose, RobotSpec

LENGTH, MASS = 0.5, 2.0


def pendulums(count: int = 1, **changes: object) -> Articulation:
    """Point masses on rods, hinged to each other about y."""
    links = [Link("base")]
    joints = []
    for index in range(count):
        bob = Link(f"bob{index}", MASS, (LENGTH, 0.0, 0.0), np.eye(3) * 1e-9)
        place = Pose((LENGTH if index else 0.0, 0.0, 0.0))
        joints.append(Joint(f"joint{index}", JointType.REVOLUTE, links[-1].name, bob.name, place, axis=(0.0, 1.0, 0.0)))
        links.append(bob)
    joints = [
        replace(joint, lower_limit=-3.0, upper_limit=3.0, effort_limit=20.0, velocity_limit=4.0) for joint in joints
    ]
    return Articulation("pendulums", tuple(links), tuple(replace(joint, **changes) for joint in joints))


def test_reflected_inertia_is_that_of_a_double_pendulum():
    inertia = reflected_inertia(pendulums(2, armature=0.1))
    arm = MASS * LENGTH**2
    assert inertia.largest == pytest.approx([arm + 4 * arm + 0.1, arm + 0.1], rel=1e-2)
    assert inertia.smallest == pytest.approx([arm + 0.1, arm + 0.1], rel=2e-2)
    assert np.all(inertia.smallest <= inertia.mean + 1e-12)
    assert np.all(inertia.mean <= inertia.largest + 1e-12)


def test_a_follower_adds_to_its_leader():
    arm = MASS * LENGTH**2
    two = pendulums(2)
    follower = replace(two.joints[1], parent="base", parent_pose=Pose(), mimic=Mimic("joint0", 3.0))
    inertia = reflected_inertia(replace(two, joints=(two.joints[0], follower)))
    assert inertia.largest == pytest.approx([10 * arm, 10 * arm], rel=1e-4)


def test_gains_give_the_frequency_and_damping_asked_for():
    (drive,), note = designed_drives(
        pendulums(), (DriveDesign(joints=(".*",), natural_frequency=3.0, damping_ratio=0.7),)
    )
    inertia = MASS * LENGTH**2
    assert math.sqrt(drive.stiffness / inertia) == pytest.approx(2 * math.pi * 3.0, rel=5e-3)
    assert drive.damping / (2 * math.sqrt(drive.stiffness * inertia)) == pytest.approx(0.7, rel=5e-3)
    assert f"joint0 {drive.stiffness:g}/{drive.damping:g}" in note


def test_dry_friction_holds_a_joint_no_farther_from_its_target_than_asked():
    (drive,), _ = designed_drives(
        pendulums(friction=3.0), (DriveDesign(joints=(".*",), natural_frequency=0.5, friction_error=0.02),)
    )
    inertia = MASS * LENGTH**2
    assert drive.stiffness == 150.0 > inertia * (2 * math.pi * 0.5) ** 2
    assert drive.damping / (2 * math.sqrt(drive.stiffness * inertia)) == pytest.approx(1.0, rel=5e-3)


def test_armature_comes_from_limits_and_leaves_what_the_model_has():
    body = with_armature(pendulums())
    assert body.joints[0].armature == pytest.approx(MOTOR_TIME * 20.0 / 4.0)
    assert "joint0 0.025" in body.notes[-1]
    own = pendulums(armature=0.3)
    assert with_armature(own) is own
    without_limit = pendulums(velocity_limit=math.inf)
    assert with_armature(without_limit) is without_limit


def test_responses_span_the_workspace_and_count_the_mechanisms_damping():
    body = pendulums(2, armature=0.1, damping=1.5)
    spec = RobotSpec(
        name="pendulums",
        articulation=body,
        fixed_base=True,
        actuators=(ImplicitPd(joints=("joint0",), stiffness=400.0, damping=8.5, armature=0.3),),
    )
    (response,) = drive_responses(spec)
    arm = MASS * LENGTH**2
    least, most = 0.3 + arm, 0.3 + 5 * arm  # folded back, and stretched
    assert response.joint == "joint0"
    assert response.slowest == pytest.approx(math.sqrt(400.0 / most) / (2 * math.pi), rel=1e-2)
    assert response.fastest == pytest.approx(math.sqrt(400.0 / least) / (2 * math.pi), rel=1e-2)
    assert response.least_damped == pytest.approx(10.0 / (2 * math.sqrt(400.0 * most)), rel=1e-2)
    assert response.most_damped == pytest.approx(10.0 / (2 * math.sqrt(400.0 * least)), rel=1e-2)
    speed_only = replace(spec, actuators=(ImplicitPd(joints=(".*",), damping=8.5),))
    assert drive_responses(speed_only) == ()


def test_bad_designs_are_named():
    with pytest.raises(ConfigurationError, match="joint 'joint0': its frequency is -1"):
        designed_drives(pendulums(), (DriveDesign(joints=(".*",), natural_frequency=-1.0),))
    with pytest.raises(ConfigurationError, match="its friction error is 0"):
        designed_drives(pendulums(), (DriveDesign(joints=(".*",), friction_error=0.0),))
    twice = (DriveDesign(joints=(".*",)), DriveDesign(joints=("joint0",)))
    with pytest.raises(ConfigurationError, match="'joint0' has two designs"):
        designed_drives(pendulums(), twice)
    with pytest.raises(UnknownNameError, match="elbow"):
        designed_drives(pendulums(), (DriveDesign(joints=("elbow",)),))
