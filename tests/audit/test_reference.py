"""The measuring stick measures: what is the same compares as the same, and each kind of change shows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orbit_assets import load_articulation
from orbit_assets.audit.checks import mass_matrix, posture
from orbit_assets.audit.mjcf_reference import MujocoReference
from orbit_assets.audit.reference import Comparison, PinocchioReference, compare, pinocchio_installed
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Pose

ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="base">
  <geom type="box" size="0.1 0.1 0.1" mass="3"/>
  <body name="upper" pos="0 0.1 0.2" quat="0.9 0.1 0.3 0.2">
    <joint name="shoulder" axis="0 1 0" armature="0.1" range="-1 1" limited="true"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.03" mass="2"/>
    <body name="rail" pos="0 0 0.4">
      <joint name="slide" type="slide" axis="1 0 0.5"/><geom type="sphere" size="0.05" mass="0.7"/>
      <body name="tip" pos="0.1 0 0"><geom type="sphere" size="0.02" pos="0 0.1 0" mass="0.2"/></body>
</body></body></body></worldbody></mujoco>"""

PENDULUM = """<robot name="pendulum"><link name="base"/>
<link name="arm"><inertial><origin xyz="0 0 -0.5" rpy="0.1 0 0.2"/><mass value="1.5"/>
  <inertia ixx="0.1" iyy="0.12" izz="0.03" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
<link name="bob"><inertial><mass value="0.5"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swing" type="continuous"><origin xyz="0 0 1" rpy="0 0.2 0"/><parent link="base"/><child link="arm"/>
  <axis xyz="0 1 0"/></joint>
<joint name="hold" type="fixed"><origin xyz="0 0 -1"/><parent link="arm"/><child link="bob"/></joint></robot>"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


def compared(articulation: Articulation, path: Path) -> Comparison:
    return compare(articulation, MujocoReference(path, "base"))


def test_what_was_read_is_what_the_formats_compiler_made(arm: Path) -> None:
    found = compared(load_articulation(arm, merge=False), arm)
    assert (found.reader, found.links, found.joints) == ("MuJoCo", 4, 2)
    assert max(found.mass, found.kinematics, found.rotation, found.mass_matrix) < 1e-12


def test_each_kind_of_change_shows(arm: Path) -> None:
    read = load_articulation(arm)
    upper, joint = read.links[1], read.joints[0]

    def changed_link(**changes: object) -> Articulation:
        return replace(read, links=(read.links[0], replace(upper, **changes), *read.links[2:]))

    def changed_joint(**changes: object) -> Articulation:
        return replace(read, joints=(replace(joint, **changes), *read.joints[1:]))

    assert compared(changed_link(mass=2.001), arm).mass == pytest.approx(1e-3)
    assert compared(changed_link(inertia=upper.inertia * 1.1), arm).mass_matrix > 1e-4
    assert compared(changed_link(center_of_mass=(0.01, 0.0, 0.2)), arm).mass_matrix > 1e-4
    assert compared(changed_joint(armature=0.2), arm).mass_matrix > 1e-2
    moved = compared(changed_joint(parent_pose=joint.parent_pose @ Pose((0.0, 1e-3, 0.0))), arm)
    assert moved.kinematics == pytest.approx(1e-3)
    assert compared(changed_joint(axis=(1.0, 0.0, 0.0)), arm).rotation > 1e-2


def test_a_pendulums_mass_matrix_is_the_closed_form(tmp_path: Path) -> None:
    path = tmp_path / "pendulum.urdf"
    path.write_text(PENDULUM)
    read = load_articulation(path)
    matrix = mass_matrix(read, posture(read, {"swing": 0.7}))
    inertia = load_articulation(path, merge=False).links[1].inertia
    np.testing.assert_allclose(matrix, [[1.5 * 0.25 + inertia[1, 1] + 0.5 + 0.01]], rtol=1e-12)


@pytest.mark.skipif(not pinocchio_installed(), reason="pinocchio, the reference for URDF, is not installed (pip: pin)")
def test_pinocchio_agrees_on_a_urdf(tmp_path: Path) -> None:
    path = tmp_path / "pendulum.urdf"
    path.write_text(PENDULUM)
    found = compare(load_articulation(path, merge=False), PinocchioReference(path))
    assert (found.links, found.joints) == (3, 1)
    assert max(found.mass, found.kinematics, found.rotation, found.mass_matrix) < 1e-12
    path.write_text("<robot/>")
    with pytest.raises(AssetError, match="pinocchio refuses"):
        PinocchioReference(path)


@pytest.mark.skipif(not pinocchio_installed(), reason="pinocchio, the reference for URDF, is not installed (pip: pin)")
@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_pinocchio_is_given_text_that_it_can_read(
    encoding: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "pendulum.urdf"
    named = PENDULUM.replace('name="pendulum"', 'name="pendule_é"')
    path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>\n{named}'.encode(encoding))
    found = compare(load_articulation(path, merge=False), PinocchioReference(path))
    assert found.joints == 1
    assert capfd.readouterr() == ("", "")
