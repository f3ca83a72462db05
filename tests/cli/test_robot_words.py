"""Compositions of robots by every door: the command line, a file of settings, Python."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.envs import make
from orbit_core.interfaces import OrbitError

WRONG = [
    ("ur5+ur10", "allowed are base, base+arm"),
    ("unitree_go2+robotiq_2f85", "allowed are base, base+arm"),
    ("ur5+", "empty part"),
    ("ur5+robotiq", "did you mean 'robotiq_2f85'"),
    ("unitree_g1+ur5", "has no flange"),
]
SHORT = ["--backend", default_backend(), "--agent", "zero", "--num-envs", "1", "--episodes", "1"]


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(list(words)) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    return message


@pytest.mark.parametrize(("name", "words"), WRONG)
def test_wrong_compositions_are_told_in_one_line_by_every_door(
    name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert words in refused(capsys, "run", "Reach", "--robot", name, *SHORT)
    assert words in refused(capsys, "info", name)
    settings = tmp_path / "settings.toml"
    settings.write_text(f'robot = "{name}"\n')
    assert words in refused(capsys, "run", "Reach", "--config", str(settings), *SHORT)
    with pytest.raises(OrbitError) as told:
        make("Reach", num_envs=1, backend=default_backend(), robot=name)
    assert words in str(told.value)


def test_a_composition_of_a_file_of_settings_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text('robot = "ur5 + robotiq_2f85"\n')
    short = ["--set", "episode_length=0.04", *SHORT]
    assert main(["run", "Reach", "--config", str(settings), *short]) == 0
    assert "ur5 + robotiq_2f85" in capsys.readouterr().out


def test_gains_and_armatures_are_told_with_the_responses_that_they_give(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "ur5+robotiq_2f85"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "categories: arm, gripper" in told
    assert "stiffness/damping for the inertia that each joint moves: shoulder_pan_joint" in told
    assert "armature where the model has none, from effort and velocity limits: shoulder_pan_joint" in told
    assert re.search(
        r"actuators shoulder_pan_joint: ImplicitPd, .* natural frequency 4 to 1\d Hz, damping ratio 1 to", told
    )
