"""Gains and home positions of a file reach a robot where they are asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orbit_assets.scene_files import drives_from_model, home_from_model
from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.interfaces.layout import SceneLayout
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, DriveGains, Joint, JointType, Link, RobotSpec, Scene

LINKS = tuple(Link(name, 1.0, inertia=np.eye(3)) for name in "abcd")
JOINTS = (
    Joint("hip.l", JointType.REVOLUTE, "a", "b", effort_limit=7.0),
    Joint("hip.r", JointType.REVOLUTE, "b", "c"),
    Joint("hip_l", JointType.PRISMATIC, "c", "d"),
)
DRIVES = (DriveGains("hip.l", 100.0, 2.0), DriveGains("hip.r", 100.0, 2.0, 30.0), DriveGains("hip_l", 5.0))
LEGS = Articulation("legs", LINKS, JOINTS, drives=DRIVES, home=(("hip.l", 0.2), ("hip_l", -0.1)))


def test_gains_limits_and_home_reach_the_joints_that_the_file_names() -> None:
    spec = RobotSpec(
        name="legs", articulation=validate(LEGS), actuators=drives_from_model(LEGS), home=home_from_model(LEGS)
    )
    parameters = SceneLayout.of(Scene(robots=(spec,))).joint_parameters
    assert parameters.drive_stiffness.tolist() == [100.0, 100.0, 5.0]
    assert parameters.drive_damping.tolist() == [2.0, 2.0, 0.0]
    assert parameters.effort_limit.tolist() == [7.0, 30.0, np.inf]
    assert parameters.home.tolist() == [0.2, 0.0, -0.1]


def test_nothing_is_taken_over_unasked() -> None:
    spec = RobotSpec(name="legs", articulation=LEGS)
    parameters = SceneLayout.of(Scene(robots=(spec,))).joint_parameters
    assert not parameters.drive_stiffness.any()
    assert not parameters.home.any()


def test_a_file_without_drives_or_home_says_so() -> None:
    bare = replace(LEGS, drives=(), home=())
    with pytest.raises(ConfigurationError, match="'legs' says of no drive"):
        drives_from_model(bare)
    with pytest.raises(ConfigurationError, match="'legs' names no home pose"):
        home_from_model(bare)
