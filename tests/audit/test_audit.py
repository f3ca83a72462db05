"""The audit of a file: sound models pass, each fault is found where it is, and the command's exit code tells."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from orbit_assets.audit.audit import AssetReport, audit_file
from orbit_assets.audit.checks import Severity
from orbit_core.cli import main

SOUND = """<robot name="arm">
<link name="base"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
<link name="arm">
  <inertial><origin xyz="0 0 0.25"/><mass value="5"/>
    <inertia ixx="0.109" iyy="0.109" izz="0.009" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><origin xyz="0 0 0.25"/><geometry><box size="0.1 0.1 0.5"/></geometry></visual>
  <collision><origin xyz="0 0 0.25"/><geometry><box size="0.1 0.1 0.5"/></geometry></collision></link>
<joint name="shoulder" type="revolute"><origin xyz="0 0 0.1"/><parent link="base"/><child link="arm"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="50" velocity="3"/></joint>
</robot>"""


def audited(folder: Path, text: str) -> AssetReport:
    path = folder / "model.urdf"
    path.write_text(text)
    return audit_file(path)


def found(report: AssetReport) -> list[tuple[Severity, str, str]]:
    return [(finding.severity, finding.element, finding.text) for finding in report.findings]


def test_of_a_sound_model_only_its_missing_armature_is_noted(tmp_path: Path) -> None:
    report = audited(tmp_path, SOUND)
    assert [(severity, element) for severity, element, _ in found(report)] == [(Severity.NOTE, "model")]
    assert "armature" in report.findings[0].text
    (body,) = (body for body in report.bodies if body.name == "arm")
    assert body.density == pytest.approx(1000.0)
    assert body.collision_volume == pytest.approx(body.visual_volume) == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("old", "new", "severity", "element", "words"),
    [
        ('<mass value="5"/>', '<mass value="500"/>', Severity.WARNING, "arm", "kg/m^3"),
        ('"0.109" iyy="0.109" izz="0.009"', '"109" iyy="109" izz="9"', Severity.FAULT, "arm", "largest principal"),
        ('"0.109" iyy="0.109" izz="0.009"', '"1e-6" iyy="1e-6" izz="1e-6"', Severity.WARNING, "arm", "least principal"),
        ('<origin xyz="0 0 0.25"/><mass', '<origin xyz="0 1 0.25"/><mass', Severity.WARNING, "arm", "centre of mass"),
        ('lower="-1" upper="1"', 'lower="-180" upper="180"', Severity.WARNING, "shoulder", "degrees"),
        ('lower="-1" upper="1"', 'lower="0.5" upper="0.5"', Severity.WARNING, "shoulder", "cannot move"),
        ('effort="50"', 'effort="0"', Severity.WARNING, "shoulder", "effort limit of 0"),
        ('velocity="3"', 'velocity="0"', Severity.WARNING, "shoulder", "velocity limit of 0"),
        ('effort="50"', "", Severity.NOTE, "shoulder", "no effort limit"),
        (
            '<collision><origin xyz="0 0 0.25"/><geometry><box size="0.1 0.1 0.5"/>',
            '<collision><origin xyz="0 0 0.25"/><geometry><box size="0.5 0.5 0.5"/>',
            Severity.WARNING,
            "arm",
            "times the volume",
        ),
        (
            '<collision><origin xyz="0 0 0.25"/>',
            '<collision><origin xyz="0 1 0.25"/>',
            Severity.WARNING,
            "arm",
            "beyond what is seen",
        ),
    ],
)
def test_a_fault_is_found_where_it_is(
    tmp_path: Path, old: str, new: str, severity: Severity, element: str, words: str
) -> None:
    assert old in SOUND
    report = audited(tmp_path, SOUND.replace(old, new))
    assert any((s, e) == (severity, element) and words in text for s, e, text in found(report)), found(report)
    assert bool(report.faults) == (severity is Severity.FAULT)


def test_links_that_touch_at_home_are_named(tmp_path: Path) -> None:
    third = """<link name="hand"><inertial><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
      <collision><geometry><sphere radius="0.05"/></geometry></collision></link>
      <joint name="wrist" type="continuous"><origin xyz="0 0 {height}"/><parent link="arm"/><child link="hand"/></joint>
      </robot>"""
    near, far = (audited(tmp_path, SOUND.replace("</robot>", third.format(height=z))) for z in (0.04, 0.3))
    assert "base with hand" in [finding.element for finding in near.findings]
    assert "base with hand" not in [finding.element for finding in far.findings]


def test_the_command_tells_by_its_exit_code_and_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, written = tmp_path / "model.urdf", tmp_path / "audit.json"
    path.write_text(SOUND)
    assert main(["check-asset", str(path), "--json", str(written)]) == 0
    assert "0 faults" in capsys.readouterr().out
    values = json.loads(written.read_text())
    assert values["mass"] == 5.0
    assert values["joints"] == ["shoulder"]
    path.write_text(SOUND.replace('"0.109" iyy="0.109" izz="0.009"', '"109" iyy="109" izz="9"'))
    assert main(["check-asset", str(path)]) == 1
    assert "1 fault" in capsys.readouterr().out


def test_the_command_tells_of_a_file_that_cannot_be_read_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "model.urdf"
    path.write_text(SOUND.replace('mass value="5"', 'mass value="heavy"'))
    assert main(["check-asset", str(path)]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "arm" in message
    assert main(["check-asset", str(path), "--package", "nothing"]) == 2
    assert "NAME=FOLDER" in capsys.readouterr().err
