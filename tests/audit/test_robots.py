"""What an audit of a robot finds: nothing wrong with the catalogue's, and each fault that is put into one."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from orbit_assets.audit.checks import Severity
from orbit_assets.audit.robots.report import RobotReport, audit_robot, audit_spec
from orbit_assets.catalogue import RobotEntry, robot, robot_info
from orbit_core.cli import main
from orbit_core.scene import IdealPd, Pose, RobotSpec

Edit = Callable[[RobotSpec], RobotSpec]


def audited(name: str, edit: Edit = lambda spec: spec, **entry: str) -> RobotReport:
    return audit_spec(replace(robot_info(name), **entry), edit(robot(name)))


def told(report: RobotReport) -> list[str]:
    return [f"{finding.severity.value} {finding.element}: {finding.text}" for finding in report.findings]


@pytest.mark.parametrize("name", ["cartpole", "franka_panda", "ur10+robotiq_2f85", "unitree_go1"])
def test_the_catalogues_robots_have_no_faults(name: str) -> None:
    report = audit_robot(name)
    assert report.faults == ()
    assert report.joints


def test_grippers_and_stances_are_measured() -> None:
    (hand,) = audit_robot("panda_hand").hands
    assert hand.opening == pytest.approx(0.08, abs=2e-3)
    assert hand.closing < 2e-3
    assert hand.along_y == pytest.approx(1.0, abs=1e-6)
    stance = audit_robot("unitree_go1").stance
    assert stance is not None
    assert abs(stance.clearance) < 0.02
    assert stance.margin > 0.03


def test_a_frame_that_only_closing_fingers_reach_has_no_opening(capsys: pytest.CaptureFixture[str]) -> None:
    report = audit_robot("kinova_kg2")
    (hand,) = report.hands
    assert hand.meets_nothing_open
    assert hand.closing < 1e-3
    assert hand.overhang == pytest.approx(0.004, abs=1e-3)
    assert any("note kg2_tcp: nothing is within 200 mm of it along y when open" in line for line in told(report))
    main(["check-robot", "kinova_kg2"])
    printed = " ".join(capsys.readouterr().out.split())
    assert "meets nothing along y when open, closes to 0.0 mm" in printed
    assert "400" not in printed


def joints(**values: Any) -> Edit:
    def edit(spec: RobotSpec) -> RobotSpec:
        changed = tuple(replace(joint, **values) for joint in spec.articulation.joints)
        return replace(spec, articulation=replace(spec.articulation, joints=changed))

    return edit


def drives(**values: Any) -> Edit:
    return lambda spec: replace(spec, actuators=tuple(replace(group, **values) for group in spec.actuators))


def explicit(spec: RobotSpec) -> RobotSpec:
    group = IdealPd(joints=("panda_joint.*",), stiffness=1e6, damping=1e4)
    return replace(spec, actuators=(group,))


def turned(frame: str, pose: Pose) -> Edit:
    def edit(spec: RobotSpec) -> RobotSpec:
        frames = tuple(replace(f, pose=f.pose @ pose) if f.name == frame else f for f in spec.articulation.frames)
        return replace(spec, articulation=replace(spec.articulation, frames=frames))

    return edit


def heavy_head(spec: RobotSpec) -> RobotSpec:
    trunk, *others = spec.articulation.links
    return replace(spec, articulation=replace(
        spec.articulation, links=(replace(trunk, center_of_mass=(2.0, 0.0, 0.0)), *others)))  # fmt: skip


def colliding(spec: RobotSpec) -> RobotSpec:
    return replace(spec, articulation=replace(spec.articulation, self_collisions=True, collision_exclusions=()))


def raised(height: float) -> Edit:
    return lambda spec: replace(spec, pose=Pose((0.0, 0.0, spec.pose.position[2] + height)))


def exchanged(spec: RobotSpec) -> RobotSpec:
    effector = spec.end_effector
    assert effector.gripper is not None
    gripper = replace(effector.gripper, open_position=0.0, closed_position=0.04)
    return replace(spec, end_effectors=(replace(effector, gripper=gripper),))


@pytest.mark.parametrize(
    ("name", "edit", "words"),
    [
        ("franka_panda", joints(effort_limit=math.inf), "warning .*panda_joint1.*: has no effort limit"),
        ("franka_panda", joints(velocity_limit=math.inf), "warning .*panda_joint1.*: has no velocity limit"),
        ("franka_panda", joints(armature=0.0), "warning .*panda_joint1.*: has no armature"),
        ("franka_panda", drives(effort_limit=0.0), "warning .*: has an effort limit of 0"),
        ("franka_panda", drives(stiffness=1.0, damping=2.0), "natural frequency .* is slow"),
        ("franka_panda", drives(damping=0.5), "damping ratio .*: it rings"),
        ("franka_panda", drives(damping=4000.0), "damping ratio .*: it creeps"),
        ("franka_panda", drives(stiffness=1e6), "more than a radian in a step of 0.005 s"),
        ("franka_panda", explicit, "fault panda_joint.*: .* diverge in steps of 0.005 s"),
        (
            "franka_panda",
            lambda spec: replace(drives(effort_limit=5.0)(spec), gravity_compensation=False),
            "fault panda_joint[24]: holding home against gravity takes",
        ),
        (
            "franka_panda",
            lambda spec: replace(spec, gravity_compensation=False),
            "warning panda_joint[24]: gives way by",
        ),
        ("franka_panda", lambda spec: replace(spec, actuators=spec.actuators[:1]), "no actuator drives it"),
        ("franka_panda", lambda spec: replace(spec, home={"panda_joint1": 9.0}), "fault model: home position 9.0"),
        ("franka_panda", lambda spec: replace(spec, home={"panda_joint9": 0.0}), "fault model: unknown joint"),
        ("franka_panda", lambda spec: replace(spec, home={"panda_joint4": -3.07}), "note .*panda_joint4.*: is at its"),
        ("ur10+robotiq_2f85", colliding, "fault .*: touch at home"),
        ("franka_panda", raised(-2.0), "warning pose: reaches .* mm below the ground"),
        (
            "franka_panda",
            turned("panda_hand_tcp", Pose.from_axis_angle((1.0, 0.0, 0.0), math.pi)),
            "warning panda_hand_tcp: its z leads back into the arm",
        ),
        (
            "franka_panda",
            turned("panda_hand_tcp", Pose.from_axis_angle((0.0, 0.0, 1.0), math.pi / 2)),
            "warning panda_hand_tcp: the fingers move 90 degrees from its y",
        ),
        ("panda_hand", turned("panda_hand_tcp", Pose((0.0, 0.0, -0.1))), "mm are free about it along y when open"),
        (
            "panda_hand",
            turned("panda_hand_tcp", Pose((0.0, 0.0, 0.1))),
            "warning panda_hand_tcp: nothing is within 200 mm .* open or closed, the fingers end 9. mm short",
        ),
        (
            "robotiq_2f85",
            joints(armature=0.0),
            r"warning .*: follows another joint, moves as little as \S+e-\S+ kg m\^2 \(kg\) and has no armature",
        ),
        ("panda_hand", exchanged, "are the positions exchanged"),
        ("unitree_go1", raised(0.1), "warning pose: starts 1.. mm above the ground"),
        ("unitree_go1", raised(-0.1), "fault pose: starts .* mm within the ground"),
        ("unitree_go1", heavy_head, "fault centre of mass: lies .* mm outside its support"),
        (
            "unitree_go1",
            lambda spec: replace(spec, home={**spec.home, "FL_calf_joint": -2.4}),
            "warning feet: are .* mm from level",
        ),
        ("unitree_go1", lambda spec: replace(spec, feet=()), "names neither feet nor wheels"),
    ],
)
def test_each_fault_is_told(name: str, edit: Edit, words: str) -> None:
    def found(report: RobotReport) -> bool:
        return any(re.search(words, line) for line in told(report))

    assert found(audited(name, edit)), told(audited(name, edit))
    assert not found(audited(name))


def test_an_entry_says_where_its_model_comes_from() -> None:
    report = audit_spec(RobotEntry("own", ""), replace(robot("cartpole"), licence="", source=""))
    assert [finding.text.partition(":")[0] for finding in report.faults] == ["names no licence", "names no source"]
    assert any(finding.text == "has no description" for finding in report.findings)


def test_the_command_prints_figures_and_exits_with_1_for_a_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "robot.json"
    assert main(["check-robot", "panda_hand", "--json", str(path)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "opens to 79.9 mm along y, closes to 0.0 mm" in printed
    assert "0 faults" in printed
    values = json.loads(path.read_text())
    assert values["hands"][0]["opening"] == pytest.approx(0.08, abs=2e-3)
    assert {finding["severity"] for finding in values["findings"]} <= {severity.value for severity in Severity}
    assert main(["check-robot", "panda_hnad"]) == 2
    assert "did you mean 'panda_hand'" in capsys.readouterr().err
    assert main(["check-robot", "panda_hand", "--time-step", "0"]) == 2
    sunk = audited("unitree_go1", raised(-0.1))
    monkeypatch.setattr("orbit_assets.cli.check_robot.audit_robot", lambda name, step: sunk)
    assert main(["check-robot", "unitree_go1"]) == 1
    assert "1 fault," in capsys.readouterr().out
