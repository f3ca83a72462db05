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
from orbit_core.interfaces import AssetError, ConfigurationError
from orbit_core.scene import Scene
from orbit_deploy.cli.identify import main as identify_command
from orbit_deploy.description import RobotDescription
from orbit_deploy.excitation import PERIOD as EXCITATION_PERIOD
from orbit_deploy.excitation import Excitation, ExcitationSettings, excite
from orbit_deploy.identification import LONGEST_DELAY, IdentificationSettings, identify
from orbit_deploy.local import LocalLink
from orbit_deploy.log import RobotLog
from orbit_deploy.log_replay import (
    LogReplay,
    ParameterNames,
    fitted_joints,
    payload_link_of,
    predict,
    quantities_of,
    resampled,
    rms,
)
from orbit_deploy.motion_log import MotionLog, motion_log, read_log
from orbit_deploy.simulated import Imperfections, SimulatedHardware
from orbit_deploy.twin import replay_twin
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
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mcap", reason="the extra orbit-deploy[log] is not installed")
    file = tmp_path_factory.mktemp("logs") / "arm.mcap"
    recorded(file, TRUTH)
    return file


@pytest.fixture(scope="module")
def log(written: Path) -> MotionLog:
    return read_log(written)


def test_a_gap_in_a_log_is_named_with_the_way_around_it(log: MotionLog) -> None:
    kept = (log.times < 0.5) | (log.times > 0.8)
    columns = {name: getattr(log, name)[kept] for name in ("target", "position")}
    gapped = motion_log(log.joints, log.times[kept], columns, "gapped.csv")
    with pytest.raises(
        ConfigurationError, match=r"gapped.csv has a gap from 0\.49\d to 0\.80\d s .* --begin and --seconds"
    ):
        replay_twin(gapped, arm(), BACKEND)
    LogReplay(gapped.selected(0.81), arm(), BACKEND, ParameterNames((), (), ())).close()


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


def test_a_part_of_a_log_that_begins_in_motion_is_replayed_with_the_targets_before_it(log: MotionLog) -> None:
    part, truth = log.selected(0.5, 0.5), TRUTH.apply(arm())
    # Drives that are 8 ms late still follow targets from before the part.
    assert rms(predict(part, truth, BACKEND, TRUTH.delay) - part.position) < 2e-5
    names = ParameterNames((), (), ("delay",))
    without = LogReplay(part, truth, BACKEND, names)
    assert rms(without.run(np.array([[TRUTH.delay]]))[0] - part.position) > 4e-5
    without.close()


def test_targets_between_rows_follow_the_curve_of_a_motion_and_keep_steps() -> None:
    times, grid = np.arange(0.0, 1.0, 0.02), np.arange(0.0, 0.97, 0.001)
    smooth = np.sin(4.0 * times)[:, None]
    lines = np.interp(grid, times, smooth[:, 0])
    curve = resampled(grid, times, smooth)[:, 0]
    # Inside, where there is no turn: monotone cubics are flat at turns.
    inside = (grid > 0.45) & (grid < 0.7)
    exact = np.sin(4.0 * grid)
    assert np.abs(curve - exact)[inside].max() < 0.1 * np.abs(lines - exact)[inside].max()
    steps = np.repeat([0.0, 1.0], 25)[:, None]
    assert resampled(grid, times, steps).min() == 0.0
    assert resampled(grid, times, steps).max() == 1.0


def excited(file: Path, truth: FittedRobot, seconds: float) -> MotionLog:
    """Log of an arm with other parameters than :func:`arm` that was moved for identification."""
    scene = Scene(robots=(truth.apply(arm()),))
    link = LocalLink(SimulatedHardware(scene, BACKEND, 250.0, Imperfections(delay=truth.delay)), EXCITATION_PERIOD)
    written = RobotLog(file, link.description)
    excite(link, Excitation(link.description, ExcitationSettings(seconds=seconds)), written)
    assert link.state().limited == link.state().clamped == 0
    written.close()
    link.close()
    return read_log(file)


def test_all_parameters_are_recovered_from_a_motion_for_identification(tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra orbit-deploy[log] is not installed")
    truth = replace(TRUTH, joints={j: {**each, "damping": 1.5} for j, each in TRUTH.joints.items()}, gain=0.9)
    log = excited(tmp_path / "arm.mcap", truth, 2.0)
    names = ParameterNames(fitted_joints(arm(), log), ("friction", "damping", "armature"), ("delay", "payload", "gain"))
    replay = LogReplay(log, arm(), BACKEND, names, payload_link_of(arm()), lead=LONGEST_DELAY)
    found = identify(replay, "arm", BACKEND)
    replay.close()
    true = {f"{what}:{joint}": value for joint, each in truth.joints.items() for what, value in each.items()}
    true |= {"delay": truth.delay, "payload": truth.payload, "gain": truth.gain}
    assert dict(zip(found.names, found.values, strict=True)) == pytest.approx(true, rel=0.01)
    assert np.isfinite(found.deviations).all()


@pytest.mark.parametrize("name", ["franka_panda", "ur10", "anymal_b"])
def test_a_motion_for_identification_keeps_the_limits_and_begins_and_ends_at_rest(name: str) -> None:
    described = RobotDescription.of(robot(name))
    motion, limits = Excitation(described, ExcitationSettings(seconds=4.0)), described.limits
    times = np.arange(0.0, 4.0, 0.002)
    positions = np.stack([motion.targets(time) for time in times])
    moved = motion.moved
    assert len(moved) == len([each for each in described.joints if "finger" not in each])
    assert (positions > limits.lower).all() or "finger" in " ".join(described.joints)
    assert (positions[:, moved] < limits.upper[moved]).all()
    derivative = positions
    for most in (limits.velocity, limits.acceleration, limits.jerk):
        derivative = np.gradient(derivative, 0.002, axis=0)
        assert (np.abs(derivative)[:, moved] < 0.7 * most[moved]).all()
    assert positions[0] == pytest.approx(motion.middle)
    assert positions[-1] == pytest.approx(motion.middle, abs=1e-6)
    # Each joint uses one of its limits, or the reach.
    assert (np.ptp(positions, axis=0)[moved] > 0.03).all()


def test_parameters_that_a_log_does_not_determine_keep_their_values_and_get_no_number() -> None:
    """A slow motion cannot separate delay, damping and armature: all are said to be unknown, friction is known."""
    times = np.arange(0.0, 1.6, 0.004)
    target = np.stack([0.2 * np.sin(2.0 * times), 0.0 * times, 0.0 * times], 1)
    zero = np.zeros_like(target)
    made = MotionLog(("joint0", "joint1", "joint2"), times, target, zero, zero, target, zero, zero, "made")
    truth = FittedRobot(robot="", source="", joints={"joint0": {"friction": 4.0, "damping": 0.1}}, delay=0.001)
    position = predict(made, truth.apply(arm()), BACKEND, truth.delay, 0.004)
    # Noise of an encoder
    position += np.random.default_rng(0).normal(0.0, 2e-3, position.shape)
    log = replace(made, position=position)
    names = ParameterNames(("joint0",), ("friction", "damping", "armature"), ("delay",))
    replay = LogReplay(log, arm(), BACKEND, names, dt=0.004)
    found = identify(replay, "arm", BACKEND)
    replay.close()
    known = dict(zip(found.names, np.isfinite(found.deviations).tolist(), strict=True))
    assert known == dict.fromkeys(found.names, False) | {"friction:joint0": True}
    # In the file they are those of the catalogue.
    assert set(found.fitted.joints["joint0"]) == {"friction"}
    assert found.fitted.delay == 0.0
    assert found.fitted.joints["joint0"]["friction"] == pytest.approx(4.0, rel=0.2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seconds": 1.0}, "lasts 2 to 600 s, not 1"),
        ({"reach": 0.0}, r"reach .* is in \(0, 3.2\] rad, not 0"),
        ({"fastest": 40.0}, "from 1 to 10 Hz, not 40"),
    ],
)
def test_motions_that_cannot_be_made_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        ExcitationSettings(**change)  # pyright: ignore[reportArgumentType] - by name


def test_the_command_moves_the_robot_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mcap", reason="the extra orbit-deploy[log] is not installed")
    truth = FittedRobot(robot="", source="", joints={"joint1": {"friction": 2.0}})
    scene = Scene(robots=(truth.apply(arm()),))
    link = LocalLink(SimulatedHardware(scene, BACKEND, 250.0), EXCITATION_PERIOD)
    monkeypatch.setattr("orbit_assets.catalogue.robot", lambda name: arm())
    monkeypatch.setattr("orbit_deploy.link.connect", lambda address, period, keys: link)
    words = [str(tmp_path / "arm.mcap"), "--robot", "three_joints", "--excite", "local://", "--countdown", "0"]
    words += ["--seconds", "2", "--fit", "friction", "--backend", BACKEND, "--output", str(tmp_path / "fitted.json")]
    identify_command(words)
    joints = json.loads((tmp_path / "fitted.json").read_text())["joints"]
    assert joints["joint1"]["friction"] == pytest.approx(2.0, rel=0.01)
    assert joints["joint0"]["friction"] == pytest.approx(0.0, abs=0.01)


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
    with pytest.raises(ConfigurationError, match=r"no joint of 'three_joints' moved by more than 0\.02"):
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
        ("time,position:a\n" + "".join(f"{i},{'inf' if i == 3 else 0}\n" for i in range(30)), "a position that is not"),
        (
            "time,position:a\n" + "".join(f"{'nan' if i == 3 else i},0\n" for i in range(30)),
            "no finite time at state 3",
        ),
        ("time,target:a\n" + "".join(f"{i},0\n" for i in range(30)), "holds no measured positions"),
        ("time,position:a\n", "holds 0 states of the robot"),
        ("time,position:a\n" + "".join(f"{i},0\n" for i in range(30)) + "31", "1 numbers in line 32.*cut off"),
        ("time,position:a,position:a\n" + "".join(f"{i},0,1\n" for i in range(30)), "several columns of one name"),
        ("t,q1\n0,1\n", "has no column 'time'"),
        ("time,position:a\r0,1\r\x00", "is no CSV file|has no column"),
    ],
)
def test_a_damaged_log_is_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        read_log(file)


@pytest.mark.parametrize(("kept", "least"), [(0.5, 0.3), (1.0, 1.0)])
def test_a_log_whose_writer_was_killed_is_read_as_far_as_it_is_whole(
    kept: float, least: float, log: MotionLog, written: Path, tmp_path: Path
) -> None:
    data = written.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(kept * len(data)) - 20])
    with pytest.warns(RuntimeWarning, match=r"was cut off or is damaged after \d+\.\d s"):
        found = read_log(tmp_path / "cut.mcap")
    complete = read_log(written)
    count = len(found.times)
    assert least * len(complete.times) <= count <= len(complete.times)
    np.testing.assert_array_equal(found.position, complete.position[:count])


def test_other_logs_and_words_are_refused(log: MotionLog, written: Path, tmp_path: Path) -> None:
    whole = written.read_bytes()
    for name, data in (("cut", whole[:200]), ("empty", b""), ("log", b"\x89MCAP0\r\n")):
        (tmp_path / f"{name}.mcap").write_bytes(data)
        with pytest.raises(ConfigurationError, match=r"is damaged or was cut off: .+"):
            read_log(tmp_path / f"{name}.mcap")
    log.write_csv(tmp_path / "arm.csv")
    with pytest.raises(ConfigurationError, match="there is no log"):
        read_log(tmp_path / "gone.csv")
    with pytest.raises(ConfigurationError, match=r"what is fitted is of friction.*not mass"):
        quantities_of(("mass",))
    with pytest.raises(ConfigurationError, match="no joint of 'franka_panda' moved"):
        identify_command(
            [str(tmp_path / "arm.csv"), "--robot", "franka_panda", "--output", str(tmp_path / "fitted.json")]
        )
    with pytest.raises(ConfigurationError, match="hang the robot up"):
        LogReplay(log, replace(arm(), fixed_base=False), BACKEND, ParameterNames((), (), ()))
