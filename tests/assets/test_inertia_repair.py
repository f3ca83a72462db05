"""Inertias that no body has are mended where asked, as little as makes them sound, with a note."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbit_assets.files import load_articulation
from orbit_assets.mass_properties import balance_inertias, balanced
from orbit_assets.options import ReadOptions, Repair
from orbit_assets.sdf import read_sdf
from orbit_assets.urdf import read_urdf
from orbit_assets.usd import read_usd
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, Joint, JointType, Link, Pose

moments = st.tuples(st.floats(-1.0, 1.0), st.floats(0.0, 1.0), st.floats(1e-3, 1.0))


@given(moments, st.tuples(*[st.floats(-3, 3)] * 3))
def test_any_moments_become_a_bodys_and_never_fall(given_moments: tuple[float, ...], angles: tuple[float, ...]) -> None:
    rotation = Pose.from_euler(*angles).rotation_matrix()
    tensor = rotation @ np.diag(given_moments) @ rotation.T
    mended = balanced(tensor)
    small, middle, large = np.linalg.eigvalsh(mended)
    assert small > 0
    assert small + middle >= large * (1 - 1e-12)
    assert np.linalg.eigvalsh(mended - tensor)[0] >= -1e-12
    assert large == pytest.approx(max(given_moments), rel=1e-9), "the largest moment stays"


def _arm(inertia: np.ndarray, mass: float = 1.0) -> Articulation:
    links = (Link("base", 1.0, inertia=np.eye(3)), Link("arm", mass, inertia=inertia))
    return Articulation("robot", links, (Joint("shoulder", JointType.REVOLUTE, "base", "arm"),))


def test_only_unsound_bodies_change_and_the_note_names_them() -> None:
    mended = balance_inertias(_arm(np.diag([0.1, 0.1, 0.9])))
    validate(mended)
    np.testing.assert_allclose(mended.links[1].inertia, np.diag([0.45, 0.45, 0.9]))
    assert mended.links[1].mass == 1.0
    (note,) = mended.notes
    assert "'arm' (0.1, 0.1, 0.9) -> (0.45, 0.45, 0.9)" in note
    assert "base" not in note
    sound = _arm(np.eye(3))
    assert balance_inertias(sound) is sound


def test_an_unsound_entry_in_a_sound_body_stays() -> None:
    arm = _arm(np.diag([1e-6, 1e-6, 9e-6]))
    carried = Articulation(arm.name, arm.links, (Joint("weld", JointType.FIXED, "base", "arm"),))
    assert balance_inertias(carried) is carried


def test_no_inertia_becomes_a_balls_of_water() -> None:
    mended = validate(balance_inertias(_arm(np.zeros((3, 3)), mass=1000.0)))
    radius = (3 / (4 * np.pi)) ** (1 / 3)  # a cubic metre
    np.testing.assert_allclose(mended.links[1].inertia, 400.0 * radius**2 * np.eye(3))


def test_files_are_mended_where_asked(tmp_path: Path) -> None:
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="9" ixy="0" ixz="0" iyz="0"/></inertial>'
    path = tmp_path / "disc.urdf"
    path.write_text(f'<robot name="disc"><link name="disc">{body}</link></robot>')
    with pytest.raises(AssetError, match="exceeds the sum"):
        load_articulation(path)
    disc = load_articulation(path, options=ReadOptions(repair=Repair.BALANCE))
    np.testing.assert_allclose(disc.root.inertia, np.diag([4.5, 4.5, 9.0]))
    assert "'disc'" in disc.notes[0]


DISC = {
    "a.urdf": '<robot name="r"><link name="disc"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="9" ixy="0" '
    'ixz="0" iyz="0"/></inertial></link></robot>',
    "a.sdf": '<sdf version="1.9"><model name="r"><link name="disc"><inertial><mass>1</mass><inertia><izz>9</izz>'
    "</inertia></inertial></link></model></sdf>",
    "a.usda": '#usda 1.0\n(\nmetersPerUnit = 1\nupAxis = "Z"\n)\n'
    'def Xform "disc" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {\n'
    "float physics:mass = 1\nfloat3 physics:diagonalInertia = (1, 1, 9)\n}\n",
}


@pytest.mark.parametrize(("name", "reader"), zip(DISC, (read_urdf, read_sdf, read_usd), strict=True))
def test_every_reader_repairs_where_asked(tmp_path: Path, name: str, reader: Callable[..., Articulation]) -> None:
    (tmp_path / name).write_text(DISC[name])
    assert np.ptp(np.diag(reader(tmp_path / name).root.inertia)) == pytest.approx(8.0)
    repaired = reader(tmp_path / name, options=ReadOptions(repair=Repair.BALANCE))
    np.testing.assert_allclose(sorted(np.diag(repaired.root.inertia)), (4.5, 4.5, 9.0))
    assert any("'disc'" in note for note in repaired.notes)


def test_a_link_with_mass_and_without_inertia_is_a_ball_of_water_where_asked(tmp_path: Path) -> None:
    path = tmp_path / "ball.urdf"
    path.write_text('<robot name="r"><link name="ball"><inertial><mass value="1000"/></inertial></link></robot>')
    with pytest.raises(AssetError, match=r"link 'ball' lacks <inertia>.*Repair\.BALANCE"):
        load_articulation(path)
    ball = load_articulation(path, options=ReadOptions(repair=Repair.BALANCE))
    np.testing.assert_allclose(ball.root.inertia, 400.0 * (3 / (4 * np.pi)) ** (2 / 3) * np.eye(3))
    assert any("'ball'" in note for note in ball.notes)
