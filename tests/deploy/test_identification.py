"""Friction, damping, armature, delay and payload are recovered from a log; the fitted robot is one of the catalogue."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orbit_assets.catalogue import robot, robot_info
from orbit_assets.fitted import FittedRobot, read_fitted
from orbit_core.backends import default_backend
from orbit_core.interfaces import AssetError, ConfigurationError, OrbitError
from orbit_core.scene import Scene
from orbit_deploy.cli.identify import main as identify_command
from orbit_deploy.identification import IdentificationSettings, identify
from orbit_deploy.local import LocalLink
from orbit_deploy.log import RobotLog
from orbit_deploy.log_replay import (
    LogReplay,
    ParameterNames,
    fitted_joints,
    payload_link_of,
    predict,
    quantities_of,
    rms,
)
from orbit_deploy.motion_log import MotionLog, read_log
from orbit_deploy.simulated import Imperfections, SimulatedHardware
from tests.deploy.rig import PERIOD, arm

BACKEND = default_backend()
TRUTH = FittedRobot(
    robot="",
    source="",
    joints={f"joint{i}": {"friction": 1.0 + 0.5 * i, "armature": 0.05 + 0.03 * i} for i in range(3)},
    payload_link="link2",
    payload=0.7,
    delay=0.008,
)


def recorded(file: Path, truth: FittedRobot, seconds: float = 1.4) -> MotionLog:
    """Log of an arm with other parameters than :func:`arm`, as its computer writes it."""
    scene = Scene(robots=(truth.apply(arm()),), physics_dt=0.001)
    link = LocalLink(SimulatedHardware(scene, BACKEND, 1000.0, Imperfections(delay=truth.delay)), PERIOD)
    link.computer._log = RobotLog(file, link.description)
    for step in range(round(seconds / PERIOD)):
        t = PERIOD * step
        link.send([0.3 * math.sin(6.0 * (0.7 + 0.2 * i) * t) for i in range(3)], [0.0] * 3, [0.0] * 3)
        link.wait(link.now() + PERIOD)
    link.computer._log.close()
    link.close()
    return read_log(file)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> MotionLog:
    pytest.importorskip("mcap", reason="the extra orbit-deploy[log] is not installed")
    return recorded(tmp_path_factory.mktemp("logs") / "arm.mcap", TRUTH)


def test_a_replayed_log_gives_the_motion_that_was_recorded(log: MotionLog) -> None:
    assert log.joints == ("joint0", "joint1", "joint2")
    assert log.duration == pytest.approx(1.4, abs=0.01)
    # States come at half the rate of the targets, which are interpolated.
    assert rms(predict(log, TRUTH.apply(arm()), BACKEND, TRUTH.delay) - log.position) < 2e-5
    assert rms(predict(log, arm(), BACKEND) - log.position) > 1e-3


def test_a_log_as_csv_is_the_same_log(log: MotionLog, tmp_path: Path) -> None:
    log.write_csv(tmp_path / "arm.csv")
    again = read_log(tmp_path / "arm.csv")
    assert again.joints == log.joints
    for name in ("times", "target", "target_velocity", "position", "velocity", "effort"):
        assert getattr(again, name) == pytest.approx(getattr(log, name), rel=1e-8, abs=1e-12), name


def test_parameters_are_recovered_within_five_percent_with_their_uncertainty(log: MotionLog) -> None:
    names = ParameterNames(fitted_joints(arm(), log), ("friction", "armature"), ("delay", "payload"))
    replay = LogReplay(log, arm(), BACKEND, names, payload_link_of(arm()))
    found = identify(replay, "arm", BACKEND, IdentificationSettings(generations=0))
    replay.close()
    true = {f"{what}:{joint}": value for joint, each in TRUTH.joints.items() for what, value in each.items()}
    true |= {"delay": TRUTH.delay, "payload": TRUTH.payload}
    for name, value, deviation in zip(found.names, found.values, found.deviations, strict=True):
        assert value == pytest.approx(true[name], rel=0.05), name
        assert deviation < 0.05 * true[name], name
    assert found.after < 0.02 * found.before
    assert found.fitted.payload_link == "link2"
    assert found.fitted.source.startswith("arm.mcap (sha256 ")


def test_the_search_by_cma_es_comes_near_from_far_away(log: MotionLog) -> None:
    pytest.importorskip("cmaes", reason="the extra orbit-deploy[identify] is not installed")
    names = ParameterNames(("joint0",), ("friction",), ())
    truth = replace(TRUTH, joints={**TRUTH.joints, "joint0": {"friction": 0.0, "armature": 0.05}})
    replay = LogReplay(log.selected(0.0, 0.6), truth.apply(arm()), BACKEND, names, dt=0.002)
    found = identify(replay, "arm", BACKEND, IdentificationSettings(generations=3, worlds=6))
    replay.close()
    # Friction takes a part of the effect of the delay, which is not fitted here.
    assert found.after < found.before
    assert 0.5 < found.values[0] < 6.0


def test_engines_without_joint_parameters_per_world_are_given_robots_with_these_parameters(log: MotionLog) -> None:
    short = log.selected(0.0, 0.1)
    names = ParameterNames(short.joints, ("friction", "damping", "armature"), ("delay", "payload", "gain"))
    values = np.array([[1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.01, 0.02, 0.03, 0.004, 0.5, 0.9]])
    together = LogReplay(short, arm(), BACKEND, names, "link2")
    apart = LogReplay(short, arm(), BACKEND, names, "link2")
    apart._together = False
    assert apart.run(values) == pytest.approx(together.run(values), abs=1e-5)
    together.close()


@pytest.mark.parametrize(
    ("name", "link"), [("franka_panda", "panda_link7"), ("ur10", "wrist_3_link"), ("kuka_iiwa7", "lbr_iiwa_link_7")]
)
def test_the_link_behind_a_hands_frame_carries_the_payload(name: str, link: str) -> None:
    spec = robot(name)
    assert payload_link_of(spec) == link
    FittedRobot(robot=name, source="", payload_link=link, payload=0.5).apply(spec)


def test_what_a_log_does_not_determine_is_named(log: MotionLog) -> None:
    still = replace(log, target=log.target[:1] + 0.0 * log.target, position=log.position[:1] + 0.0 * log.position)
    with pytest.raises(ConfigurationError, match=r"no joint of 'three_joints' moved by more than 0\.05"):
        fitted_joints(arm(), still)
    # Without gravity a joint that rests shows nothing of its armature.
    names = ParameterNames(("joint0",), ("armature",), ())
    replay = LogReplay(replace(still, velocity=0.0 * log.velocity).selected(0.0, 0.2), arm(), BACKEND, names)
    found = identify(replay, "arm", BACKEND, IdentificationSettings(generations=0))
    replay.close()
    assert found.deviations[0] == np.inf


def test_a_fitted_robot_is_one_of_the_catalogue_with_its_source(tmp_path: Path) -> None:
    file = tmp_path / "fitted.json"
    fitted = FittedRobot(
        robot="franka_panda",
        source="robot.mcap (sha256 1234)",
        backend=BACKEND,
        joints={"panda_joint2": {"friction": 1.5}},
        payload_link="panda_link7",
        payload=0.5,
        gain=0.9,
        deviations={"friction:panda_joint2": float("inf")},
    )
    fitted.write(file)
    assert read_fitted(file).joints == fitted.joints
    own, base = robot(str(file)), robot("franka_panda")
    frictions = {joint.name: joint.friction for joint in own.articulation.joints}
    assert frictions["panda_joint2"] == 1.5
    masses = [{link.name: link.mass for link in each.articulation.links}["panda_link7"] for each in (own, base)]
    assert masses[0] == pytest.approx(masses[1] + 0.5)
    assert own.actuators[0].stiffness == pytest.approx(0.9 * base.actuators[0].stiffness)
    assert "robot.mcap (sha256 1234)" in robot_info(str(file)).source


def corrupted(change: Callable[[dict], object]) -> str:
    document = json.loads(json.dumps({"format": "orbit.fitted_robot/1", "robot": "franka_panda", "source": "x"}))
    change(document)
    return json.dumps(document)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is no fitted robot"),
        ("[]", "is no fitted robot"),
        (corrupted(lambda d: d.pop("format")), "lacks .format."),
        (corrupted(lambda d: d.update(weight=1)), "fields that a fitted robot has not: weight"),
        (corrupted(lambda d: d.update(gain=-1.0)), "negative or no finite number"),
        (corrupted(lambda d: d.update(joints={"a": {"mass": 1.0}})), "fits mass of joints"),
        (corrupted(lambda d: d.update(joints={"elbow": {"friction": 1.0}})), "lacks elbow"),
    ],
)
def test_a_file_that_is_no_fitted_robot_is_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "fitted.json"
    file.write_text(text)
    with pytest.raises(AssetError, match=message):
        robot(str(file))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no column 'time'"),
        ("time,position:a\n0,1\n", "holds 1 states of the robot, fewer than 20"),
        ("time,position:a\n0,x\n", "something that is no number"),
        ("time,position:a,speed:a\n" + "".join(f"{i},0,0\n" for i in range(30)), "mean nothing here: speed:a"),
        ("time,position:a\n" + "".join(f"{i % 25},0\n" for i in range(30)), "goes back in time at state 25"),
        ("time,position:a\n" + "".join(f"{i},{'nan' if i == 7 else 0}\n" for i in range(30)), "not finite, 7.000 s in"),
        ("time,target:a\n" + "".join(f"{i},0\n" for i in range(30)), "holds no measured positions"),
    ],
)
def test_a_damaged_log_is_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        read_log(file)


def test_other_logs_and_words_are_refused(log: MotionLog, tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(b"\x89MCAP0\r\n and then nothing")
    log.write_csv(tmp_path / "arm.csv")
    for path, message in ((tmp_path / "log.mcap", "is damaged"), (tmp_path / "gone.csv", "there is no log")):
        with pytest.raises(OrbitError, match=message):
            read_log(path)
    with pytest.raises(ConfigurationError, match=r"what is fitted is of friction.*not mass"):
        quantities_of(("mass",))
    with pytest.raises(ConfigurationError, match="no joint of 'franka_panda' moved"):
        identify_command(
            [str(tmp_path / "arm.csv"), "--robot", "franka_panda", "--output", str(tmp_path / "fitted.json")]
        )
    with pytest.raises(ConfigurationError, match="hang the robot up"):
        LogReplay(log, replace(arm(), fixed_base=False), BACKEND, ParameterNames((), (), ()))
