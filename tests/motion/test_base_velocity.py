"""A base that is commanded by velocities in its own axes; generators of other packages."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from orbit_core.actions import BaseVelocityConfig, action_words, motion_generators, preset_terms
from orbit_core.interfaces import ConfigurationError, UnknownNameError

MakeRobot = Callable[..., Any]
JOINTS = ("panda_joint2", "panda_joint4", "panda_joint1")  # any three will do where there is no physics


def test_commands_are_turned_with_the_base_and_kept_within_their_limits(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    base = BaseVelocityConfig(joints=JOINTS, max_speed=0.5, max_yaw_rate=2.0).build("base", robot)
    x, y, yaw = robot.find_joints(JOINTS[0]) + robot.find_joints(JOINTS[1]) + robot.find_joints(JOINTS[2])
    assert base.joints == [x, y, yaw]
    robot.q[:, yaw] = torch.pi / 2
    command = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.8, 0.5], [1.0, -1.0, -1.0]])
    velocities = base.compute({"command": command})["velocity_targets"]
    diagonal = 0.5 / 2.0**0.5
    wanted = [[0.0, 0.5, 0.0], [-0.5, 0.0, 0.0], [-0.4, 0.3, 1.0], [diagonal, diagonal, -2.0]]
    torch.testing.assert_close(velocities, torch.tensor(wanted), atol=1e-6, rtol=0.0)
    command = torch.tensor([[0.0, 0.0, -3.0], [0.0, 0.0, 1.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    velocities = base.compute({"command": command})["velocity_targets"]
    assert velocities[:, 2].tolist() == [-2.0, 2.0, 0.0, 0.0]
    assert base.clamped.tolist() == [1, 0, 1, 1]
    base.reset(torch.tensor([0]))
    assert base.clamped.tolist() == [0, 0, 1, 1]


def test_a_hand_without_end_effector_spans_its_joints(kinematic_robot: MakeRobot) -> None:
    spec = replace(kinematic_robot().spec, end_effectors=())
    terms = preset_terms(spec, "joint_position")
    assert [*terms] == ["joint_position"]
    assert terms["joint_position"].components(spec, "joint_position")[-1] == "panda_finger_joint1"
    assert getattr(terms["joint_position"], "scale", "unset") is None


def test_the_presets_and_all_generators_are_words() -> None:
    words = action_words()
    assert [*words][:2] == ["joint_position", "joint_position_relative"]
    assert {*motion_generators().names} <= {*words}
    assert all(words.values())
    with pytest.raises(UnknownNameError, match="unknown motion generator 'base_velocty': did you mean 'base_velocity'"):
        motion_generators().get("base_velocty")


def test_a_word_for_what_the_robot_lacks_is_refused(kinematic_robot: MakeRobot) -> None:
    with pytest.raises(ConfigurationError, match="robot 'franka_panda' has no planar base"):
        preset_terms(kinematic_robot().spec, "base_velocity")


_THEIRS = '''
from dataclasses import dataclass
from typing import ClassVar
from orbit_motion import CommandMode, JointPosition, JointPositionConfig

@dataclass(frozen=True, kw_only=True)
class Gentle(JointPositionConfig):
    """A command is a small step of each joint."""
    name: ClassVar[str] = "gentle"
    scale: float | None = 0.01
    mode: CommandMode = CommandMode.INTEGRATED

class Nothing:
    pass
'''


def orbit(folder: Path, points: str, *words: str) -> subprocess.CompletedProcess[str]:
    """``orbit WORDS`` where a distribution 'theirs' brings these motion generators."""
    (folder / "theirs.py").write_text(_THEIRS)
    about = folder / "theirs-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[orbit.motion]\n{points}\n")
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    code = "import sys; from orbit_core.cli import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        capture_output=True, text=True, timeout=120, check=False, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip


def test_packages_bring_generators_and_broken_ones_are_named(tmp_path: Path) -> None:
    points = "good = theirs:Gentle\nbad = theirs:Nothing\nworse = theirs:missing"
    listed = orbit(tmp_path, points, "list", "motion")
    assert listed.returncode == 0, listed.stderr
    assert re.search(r"^gentle +A command is a small step of each joint\.$", listed.stdout, re.MULTILINE)
    told = " ".join(listed.stderr.split())
    assert "entry point 'bad' (theirs:Nothing, of distribution theirs)" in told
    assert "no dataclass of class ActionTerm" in told
    assert "entry point 'worse'" in told


def test_a_packages_generator_is_an_action_space_at_once(tmp_path: Path) -> None:
    words = ("run", "Lift", "--action", "gentle", "--backend", os.environ["ORBIT_BACKEND"], "--agent", "random")
    ran = orbit(tmp_path, "good = theirs:Gentle", *words, "--num-envs", "2", "--episodes", "2")
    assert ran.returncode == 0, ran.stderr
    assert "gentle" in ran.stdout
