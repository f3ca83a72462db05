"""``orbit convert``: one format into another, and what is told on the way."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import orbit_assets as assets
from orbit_assets import load_articulation
from orbit_assets.cli.reading import in_flags
from orbit_core.cli import main
from tests.faults import no_file_beyond

ROBOT = """<robot name="lamp">
  <link name="base"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.1 0.1 0.4"/></geometry></collision></link>
  <link name="plate"/>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" effort="9" velocity="3"/><dynamics damping="0.5" friction="0.25"/></joint>
  <joint name="end" type="fixed"><parent link="arm"/><child link="plate"/><origin xyz="0 0 0.4"/></joint>
</robot>"""


def robot(folder: Path) -> Path:
    path = folder / "lamp.urdf"
    path.write_text(ROBOT)
    return path


@pytest.mark.parametrize("suffix", ["usda", "usdc", "urdf", "xml"])
def test_a_robot_survives_conversion(tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]) -> None:
    if suffix == "xml":
        pytest.importorskip("mujoco", reason="MJCF files are read by MuJoCo's own parser")
    out = tmp_path / f"copy.{suffix}"
    assert main(["convert", str(robot(tmp_path)), str(out)]) == 0
    assert "lamp, 3 kg, links: 3, joints: 1" in " ".join(capsys.readouterr().out.split())
    got, asked = load_articulation(out), load_articulation(robot(tmp_path))
    assert got.joint_names == asked.joint_names == ("turn",)
    (one,), (other,) = got.joints, asked.joints
    for name in ("lower_limit", "upper_limit", "effort_limit", "damping", "friction"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-6), name
    assert [link.mass for link in got.links] == pytest.approx([link.mass for link in asked.links])


def test_a_mesh_becomes_usd(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = tmp_path / "wedge.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    out = tmp_path / "wedge.usda"
    words = ["--friction", "0.4", "--density", "600", "--collision", "triangles", "--scale", "0.1"]
    assert main(["convert", str(mesh), str(out), *words]) == 0
    assert "changed: mesh wedge.obj is one rigid body of 0.1 kg" in capsys.readouterr().out
    root = load_articulation(out).root
    assert root.mass == pytest.approx(0.1, rel=1e-5)
    assert root.collisions[0].material.static_friction == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--friction", "1"], "--friction is for meshes"),
        (["--package", "nonsense"], "--package takes NAME=FOLDER"),
    ],
)
def test_mistakes_are_told_in_one_line(
    tmp_path: Path, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(robot(tmp_path)), str(tmp_path / "a.usda"), *words]) == 2
    assert said in capsys.readouterr().err


MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual><inertial>'


@pytest.mark.parametrize("command", ["convert", "check-asset"])
@pytest.mark.parametrize(
    ("old", "new", "remedy"),
    [
        ('ixx="1"', 'ixx="9"', "repair it with --repair balance"),
        ("<inertial>", MESH.format("../wheel.stl"), "let it by --allow-outside"),
        ("<inertial>", MESH.format("package://nobody/wheel.stl"), "give its folder, --package nobody=FOLDER"),
        ("<box ", "<cone ", "leave it out by --unsupported drop"),
        ('<link name="plate"/>', '<link name="plate"/><link name="other"/>', "--articulation NAME"),
    ],
)
def test_remedies_are_flags_of_the_command_line(
    tmp_path: Path, command: str, old: str, new: str, remedy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "lamp.urdf"
    source.write_text(ROBOT.replace(old, new))
    assert main([command, str(source), *([str(tmp_path / "a.usda")] if command == "convert" else [])]) == 2
    said = capsys.readouterr().err
    assert remedy in said
    assert "ReadOptions" not in said


def test_every_remedy_that_a_reader_names_has_a_flag() -> None:
    remedies = re.compile(r"ReadOptions\([a-z_]+=.+?\)(?=[\"', ]|\)$)")
    texts = {
        found.replace("{{", "{").replace("}}", "}").replace("{package}", "arm")
        for path in Path(assets.__file__).parent.rglob("*.py")
        for line in path.read_text().splitlines()
        if re.search(r"^\s*\S*f?\".*ReadOptions\(", line)
        for found in remedies.findall(line)
    }
    assert len(texts) >= 6
    assert not [text for text in texts if "ReadOptions" in in_flags(text)]


def test_a_xacro_file_reads_the_environment_variables_that_the_command_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("xacro")
    monkeypatch.setenv("MASS_OF_ARM", "7")
    source = tmp_path / "lamp.urdf.xacro"
    source.write_text(ROBOT.replace('<mass value="1"/>', '<mass value="$(env MASS_OF_ARM)"/>'))
    assert main(["convert", str(source), str(tmp_path / "a.xml")]) == 2
    assert "variable 'MASS_OF_ARM' is not set, or not among" in capsys.readouterr().err
    assert main(["convert", str(source), str(tmp_path / "a.xml"), "--environment", "MASS_OF_ARM"]) == 0
    assert load_articulation(tmp_path / "a.xml").mass == pytest.approx(9.0)


def test_files_are_not_overwritten_unasked_and_formats_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = robot(tmp_path), tmp_path / "copy.usda"
    assert main(["convert", str(source), str(out)]) == 0
    assert main(["convert", str(source), str(out)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["convert", str(source), str(out), "--overwrite"]) == 0
    assert main(["convert", str(source), str(tmp_path / "copy.step")]) == 2
    assert "of no format that is written" in capsys.readouterr().err


def test_a_model_is_replaced_by_one_that_is_whole_and_keeps_its_meshes_until_then(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Meshes of one name in one folder: the second model replaces none of the first one's."""
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 {}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    for folder, height in (("low", 1), ("high", 2)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "wedge.obj").write_text(corners.format(height))

    def convert(folder: str, *words: str) -> int:
        return main(["convert", str(tmp_path / folder / "wedge.obj"), str(tmp_path / "wedge.urdf"), *words])

    def height() -> float:
        (shape,) = load_articulation(tmp_path / "wedge.urdf").root.collisions
        return float(np.ptp(shape.geometry.vertices[:, 2]))

    assert convert("low") == 0
    assert height() == pytest.approx(1.0)
    with no_file_beyond(300):  # the mesh has room, the model has none
        assert convert("high", "--overwrite") == 2
    assert "cannot write" in capsys.readouterr().err
    assert height() == pytest.approx(1.0)
    assert convert("high", "--overwrite") == 0
    assert height() == pytest.approx(2.0)
    same = str(tmp_path / "wedge.urdf")
    assert main(["convert", same, same, "--overwrite"]) == 2
    assert "wedge.urdf is what is read" in capsys.readouterr().err
