"""ManiSkill's robots are in the catalogue where its package is installed, and nowhere else."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from orbit_assets import sources
from orbit_assets.catalogue import robot, robot_info, robot_names, robots
from orbit_assets.robots import maniskill
from orbit_core.interfaces import SceneLayout, UnknownNameError
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import Scene

INSTALLED = sources.installed_version("mani-skill") is not None
BODY = '<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
LIMIT = '<axis xyz="0 0 1"/><limit lower="-2.9" upper="2.9" effort="87" velocity="2"/>'


def panda_urdf() -> str:
    """The names of ManiSkill's Panda, and little else."""
    arm = ["panda_link0", *(f"panda_link{number}" for number in range(1, 8))]
    links = [*arm, "panda_hand_tcp", "panda_leftfinger", "panda_rightfinger"]
    joints = [
        f'<joint name="panda_joint{number}" type="revolute"><parent link="{arm[number - 1]}"/>'
        f'<child link="{arm[number]}"/>{LIMIT}</joint>'
        for number in range(1, 8)
    ]
    joints.append('<joint name="tcp" type="fixed"><parent link="panda_link7"/><child link="panda_hand_tcp"/></joint>')
    for number, side in enumerate(("left", "right"), start=1):
        mimic = '<mimic joint="panda_finger_joint1"/>' if side == "right" else ""
        joints.append(
            f'<joint name="panda_finger_joint{number}" type="prismatic"><parent link="panda_link7"/>'
            f'<child link="panda_{side}finger"/>{LIMIT}{mimic}</joint>'
        )
    return (
        "<robot name='panda'>"
        + "".join(f'<link name="{name}">{BODY}</link>' for name in links)
        + "".join(joints)
        + "</robot>"
    )


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package laid out as mani-skill's, of one robot; its folder of models."""
    models = tmp_path / "mani_skill" / "assets" / "robots"
    (models / "panda").mkdir(parents=True)
    (models / "panda" / "panda_v2.urdf").write_text(panda_urdf())
    (tmp_path / "mani_skill-3.0.1.dist-info").mkdir()
    (tmp_path / "mani_skill-3.0.1.dist-info" / "METADATA").write_text("Name: mani-skill\nVersion: 3.0.1\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    robots.cache_clear()
    maniskill._articulation.cache_clear()
    yield models
    robots.cache_clear()
    maniskill._articulation.cache_clear()


def test_an_installed_package_adds_its_robots_with_their_licence(installed: Path) -> None:
    spec, info = robot("maniskill_panda"), robot_info("maniskill_panda")
    validate_entity(spec)
    assert info.source == spec.source == "mani-skill"
    assert info.licence == spec.licence
    assert "no commercial use" in spec.licence
    assert info.dof == 8
    assert spec.end_effector.frame == "panda_hand_tcp"
    SceneLayout.of(Scene(robots=(spec,)))  # every pattern of home and actuators matches


def test_nothing_of_the_package_is_kept(installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tmp_path / "cache"
    monkeypatch.setenv("ORBIT_CACHE_DIR", str(cache))
    robot("maniskill_panda")
    assert not cache.exists()


@pytest.mark.skipif(INSTALLED, reason="mani-skill is installed here")
def test_without_the_package_its_robots_are_unknown() -> None:
    assert not [name for name in robot_names() if name.startswith("maniskill")]
    with pytest.raises(UnknownNameError, match="maniskill_panda"):
        robot("maniskill_panda")


@pytest.mark.skipif(not INSTALLED, reason="needs the package mani-skill: extra 'maniskill'")
@pytest.mark.parametrize("name", ["koch", "panda", "panda_stick", "panda_wristcam", "so100", "xarm7_ability"])
def test_the_packages_robots_are_whole(name: str) -> None:
    spec, info = robot(f"maniskill_{name}"), robot_info(f"maniskill_{name}")
    validate_entity(spec)
    assert (spec.name, spec.licence, spec.source) == (info.name, info.licence, info.source)
    SceneLayout.of(Scene(robots=(spec,)))
