"""Teleoperation: devices by recorded streams, any motion generator by any device, and recordings that lose nothing."""

from __future__ import annotations

import math
import os
import pty
import struct
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.dynamics.transforms import pose_error
from orbit_core.envs import Environment, make
from orbit_core.envs.actors import Actor, scripted_actor
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_data.formats import opened, write_dataset
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.recording import RecordingFile
from orbit_data.teleoperation.browser import Browser
from orbit_data.teleoperation.device import FARTHEST, MOST_EVENTS, Device, DeviceLostError, Event, Reading, Speeds
from orbit_data.teleoperation.devices import Gamepad, Keyboard, SpaceMouse, open_device
from orbit_data.teleoperation.driver import Driver
from orbit_data.teleoperation.intervention import Intervention
from orbit_data.teleoperation.session import Session
from orbit_learn.cloning.demonstrations import load_demonstrations

BACKEND = default_backend()
SPEEDS = Speeds()
UP = Reading(twist=(0.0, 0.0, 0.2, 0.0, 0.0, 0.0))


class Played(Device):
    """Gives the readings that it was given, and is then unplugged."""

    def __init__(self, *readings: Reading) -> None:
        self._left = list(readings)

    def read(self) -> Reading:
        if not self._left:
            raise DeviceLostError("the device was unplugged")
        return self._left.pop(0)


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    made = make("Lift", 1, BACKEND, seed=2, episode_length=10.0)
    yield made
    made.close()


# Devices ------------------------------------------------------------------------------------------------------------


def test_a_terminal_moves_hand_and_base_and_asks() -> None:
    controller, terminal = pty.openpty()
    keyboard = Keyboard(SPEEDS, terminal)
    os.write(controller, b"w\x1b[A vw")
    time.sleep(0.05)
    reading = keyboard.read()
    assert reading.twist == (0.25, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert reading.base == (1.0, 0.0, 0.0)
    assert reading.events == (Event.GRIPPER, Event.SAVE)
    assert reading.moved_at is not None
    time.sleep(0.2)
    assert keyboard.read() == Reading(twist=(0.0,) * 6)
    keyboard.close()
    os.close(controller)
    with pytest.raises(DeviceLostError, match="terminal"):
        keyboard.read()


def test_a_gamepad_by_a_recorded_stream_of_events() -> None:
    import pygame

    types = (pygame.JOYAXISMOTION, pygame.JOYBUTTONDOWN, pygame.JOYBUTTONUP, pygame.JOYDEVICEREMOVED)
    stream = [
        [pygame.event.Event(types[0], axis=1, value=-1.0), pygame.event.Event(types[0], axis=5, value=1.0)],
        [pygame.event.Event(types[1], button=0), pygame.event.Event(types[1], button=5)],
        [pygame.event.Event(types[2], button=5), pygame.event.Event(types[0], axis=1, value=0.05)],
        [pygame.event.Event(types[3])],
    ]
    pad = Gamepad(SPEEDS, lambda: stream.pop(0), types)
    assert pad.read().twist == (0.25, 0.0, 0.25, 0.0, 0.0, 0.0)
    second = pad.read()
    assert second.events == (Event.GRIPPER,)
    assert second.base == (1.0, 0.0, 0.0)
    assert second.twist is not None
    assert second.twist[0] == 0.0
    assert pad.read().twist == (0.0, 0.0, 0.25, 0.0, 0.0, 0.0)
    with pytest.raises(DeviceLostError, match="unplugged"):
        pad.read()


def test_a_spacemouse_by_recorded_reports() -> None:
    reports = [
        b"\x01" + struct.pack("<3h", 0, -350, -175), b"\x02" + struct.pack("<3h", 0, 0, 700), b"\x03\x01", b"",
        b"\x01" + struct.pack("<6h", 175, 0, 0, 0, 0, 3), b"\x03\x03", b"",
    ]  # fmt: skip
    mouse = SpaceMouse(SPEEDS, lambda: reports.pop(0))
    first = mouse.read()
    assert first.twist == pytest.approx((0.25, 0.0, 0.125, 0.0, 0.0, -1.0))
    assert first.events == (Event.GRIPPER,)
    second = mouse.read()
    assert second.twist == pytest.approx((0.0, -0.125, 0.0, 0.0, 0.0, 0.0))
    assert second.events == (Event.RECORD,)
    with pytest.raises(DeviceLostError, match="unplugged"):
        SpaceMouse(SPEEDS, lambda: (_ for _ in ()).throw(OSError("read error"))).read()


# Driving ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("action", ["joint_position", "joint_velocity", "ik_absolute", "ik_relative", "osc", "rmpflow"])
def test_a_twist_moves_the_hand_in_every_action_space(action: str) -> None:
    environment = make("Reach", 1, BACKEND, action=action, episode_length=10.0)
    driver = Driver(environment)
    driver.restart()
    hand = driver.hand
    assert hand is not None
    begin = hand.measured
    for _ in range(50):
        environment.step(driver.act(UP))
    for _ in range(25):
        environment.step(driver.act(Reading(twist=(0.0,) * 6)))
    moved = pose_error(begin, hand.measured)[0]
    assert moved[2] == pytest.approx(0.2, abs=0.05)
    assert moved[:2].abs().max() < 0.03
    assert moved[3:].abs().max() < 0.15
    environment.close()


@pytest.mark.parametrize("action", ["joint_position", "ik_relative"])
def test_joint_values_and_poses_are_followed(action: str) -> None:
    environment = make("Reach", 1, BACKEND, action=action, episode_length=10.0)
    driver = Driver(environment)
    driver.restart()
    hand = driver.hand
    assert hand is not None
    name = hand.robot.joint_names[0]
    for _ in range(75):
        environment.step(driver.act(Reading(joints={name: 0.3})))
    assert hand.robot.joint_positions[0, 0] == pytest.approx(0.3, abs=0.05)
    wanted = hand.target[0].clone()
    wanted[2] += 0.1
    for _ in range(75):
        environment.step(driver.act(Reading(pose=tuple(wanted.tolist()))))
    assert (hand.measured[0, :3] - wanted[:3]).norm() < 0.02
    with pytest.raises(UnknownNameError, match="joint 'elbow'"):
        driver.act(Reading(joints={"elbow": 0.0}))
    other = hand.robot.joint_names[3]
    begin = hand.robot.joint_positions[0, 3].item()
    for _ in range(25):
        environment.step(driver.act(Reading(joints={name: FARTHEST, other: begin + 0.2})))
    assert hand.robot.joint_positions.isfinite().all()
    if action == "joint_position":  # a joint at its limit does not hold up the others
        assert hand.robot.joint_positions[0, 3] > begin + 0.02
    environment.close()


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        ({"joints": {"elbow": 1e308}}, r"position 1e.308 of joint 'elbow'"),
        ({"joints": {"elbow": float("nan")}}, "position nan of joint 'elbow'"),
        ({"twist": (0.0, 0.0, float("inf"), 0.0, 0.0, 0.0)}, "twist"),
        ({"pose": (1e9, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)}, "pose"),
        ({"pose": (0.0,) * 7}, "quaternion is zero"),
        ({"base": (float("nan"), 0.0, 0.0)}, "base"),
    ],
)
def test_no_reading_asks_for_what_single_precision_cannot_hold(asked: dict[str, Any], why: str) -> None:
    with pytest.raises(ConfigurationError, match=why):
        Reading(**asked)


def test_a_page_that_sends_what_no_page_shows_changes_nothing(environment: Environment) -> None:
    """A gizmo or slider with numbers that are not finite, and more events than a person can ask for."""
    browser = Browser(SPEEDS, Driver(environment))
    for pose in ((math.nan,) * 7, (0.0,) * 7, (1e308,) * 7):
        browser._gizmo = SimpleNamespace(position=pose[:3], wxyz=pose[3:])
        browser._dragged(SimpleNamespace(phase="end"))
    browser._slid("elbow", SimpleNamespace(client=1, target=SimpleNamespace(value=math.inf)))
    for _ in range(1000):
        browser._ask(Event.NEXT)
    reading = browser.read()
    assert (reading.pose, reading.joints, len(reading.events)) == (None, None, MOST_EVENTS)


def test_several_robots_are_driven_in_turn() -> None:
    environment = make("Handover", 1, BACKEND)
    driver = Driver(environment)
    driver.restart()
    first, second = driver.choices
    begin = {name: hand.measured for name, hand in driver.hands.items()}
    driver.act(Reading(events=(Event.NEXT,)))
    assert driver.active == second
    for _ in range(30):
        environment.step(driver.act(UP))
    assert driver.hands[second].measured[0, 2] - begin[second][0, 2] > 0.08
    assert (driver.hands[first].measured - begin[first])[0, :3].norm() < 0.02
    environment.close()


def test_a_base_takes_what_is_for_bases() -> None:
    environment = make("Velocity-Flat", 1, BACKEND, action="locomotion")
    driver = Driver(environment)
    driver.restart()
    assert driver.act(Reading(base=(1.0, -0.5, 0.25))).tolist() == [[1.0, -0.5, 0.25]]
    environment.close()
    environment = make("Velocity-Flat", 1, BACKEND)
    with pytest.raises(ConfigurationError, match="locomotion"):
        Driver(environment)
    environment.close()


# Recording ----------------------------------------------------------------------------------------------------------


def run(session: Session) -> None:
    session.reset()
    while True:
        session.step(session.act())


def test_episodes_are_kept_on_demand_and_survive_a_lost_device(environment: Environment, tmp_path: Path) -> None:
    path = tmp_path / "own.hdf5"
    ask = {event: Reading(events=(event,)) for event in Event}
    stream = [
        UP, ask[Event.SAVE], ask[Event.RECORD], *[UP] * 9, ask[Event.SUCCESS], ask[Event.SAVE], UP, ask[Event.RECORD],
        UP, ask[Event.DISCARD], ask[Event.RECORD], UP, UP, ask[Event.RESET], UP, ask[Event.SAVE], ask[Event.RECORD], UP,
    ]  # fmt: skip
    environment.reset(2)
    session = Session(environment, Driver(environment), Played(*stream), "gamepad", RecordingFile(path), "Lift", 2)
    with pytest.raises(DeviceLostError, match="unplugged"):
        run(session)
    assert session.close() == 2
    dataset = Hdf5Dataset(path)
    assert [(info.length, info.success) for info in dataset.episodes] == [(11, True), (2, False)]
    assert dataset.known().input_device == "gamepad"
    episode = dataset.read(0)
    assert episode.arrays["dones"].tolist() == [False] * 10 + [True]
    hand = next(poses for name, poses in episode.named("poses/").items() if name != "cube")
    heights = hand[:, 2]
    assert heights[-1] > heights[0]
    dataset.close()
    environment.reset(2)  # as in another process
    again = Session(environment, Driver(environment), Played(ask[Event.RECORD], UP, ask[Event.SAVE]), "browser",
                    RecordingFile(path), "Lift", 2)  # fmt: skip
    with pytest.raises(DeviceLostError):
        run(again)
    assert again.close() == 3
    dataset = Hdf5Dataset(path)
    numbers = [info.number for info in dataset.episodes]
    assert numbers == sorted({*numbers})
    assert [info.episode for info in dataset.episodes] == numbers
    starts = [dataset.read(place).arrays["states"][0] for place in range(3)]
    assert not np.array_equal(starts[2], starts[0])
    assert not np.array_equal(starts[2], starts[1])
    dataset.close()


def test_a_session_that_overwrites_leaves_the_dataset_until_an_episode_is_saved(
    environment: Environment, tmp_path: Path
) -> None:
    path = tmp_path / "own.hdf5"
    save = [Reading(events=(Event.RECORD,)), UP, Reading(events=(Event.SAVE,))]
    for stream, lengths in (([*save, *save], 2), ([UP], 2), (save, 1)):
        file = RecordingFile(path)
        file.check_begun(resume=False, overwrite=path.exists())
        if path.exists():
            file.begin_anew()
        session = Session(environment, Driver(environment), Played(*stream), "gamepad", file, "Lift", 2)
        with pytest.raises(DeviceLostError):
            run(session)
        session.close()
        dataset = Hdf5Dataset(path)
        assert len(dataset.episodes) == lengths
        dataset.close()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["own.hdf5", "own.md"]


def test_nothing_is_left_where_nothing_was_saved(environment: Environment, tmp_path: Path) -> None:
    path = tmp_path / "none.hdf5"
    session = Session(environment, Driver(environment), Played(UP), "leader", RecordingFile(path), "Lift", 2)
    with pytest.raises(DeviceLostError):
        run(session)
    assert session.close() == 0
    assert [*tmp_path.iterdir()] == []


# Bad input ----------------------------------------------------------------------------------------------------------


def test_bad_calls_are_told_in_one_line(capsys: pytest.CaptureFixture[str], environment: Environment) -> None:
    assert main(["teleop", "Lift", "--device", "joystick"]) == 2
    assert "device 'joystick'" in capsys.readouterr().err
    assert main(["teleop", "Lift", "--device", "browser", "--seconds", "-1"]) == 2
    assert "seconds" in capsys.readouterr().err
    driver = Driver(environment)
    with pytest.raises(ConfigurationError, match="no gamepad"):
        open_device("gamepad", SPEEDS, driver, 0)
    with pytest.raises(ConfigurationError, match="no SpaceMouse"):
        open_device("spacemouse", SPEEDS, driver, 0)
    several = SimpleNamespace(num_envs=2)
    with pytest.raises(ConfigurationError, match="one environment"):
        Driver(several)  # pyright: ignore[reportArgumentType]


def test_the_command_serves_its_page_and_leaves_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "own.hdf5"
    words = ["teleop", "Lift", "--backend", BACKEND, "--max-steps", "5", "--port", "8180", "--output", str(output)]
    assert main([*words, "--device", "leader", "--leader-port", "0"]) == 0
    told = capsys.readouterr().out
    assert "drive and watch at http://127.0.0.1:" in told
    assert "a leader connects to 127.0.0.1:" in told
    assert [*tmp_path.iterdir()] == []
    with open(os.devnull) as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        assert main([*words, "--device", "keyboard"]) == 2
    assert "standard input is not one" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []


def test_a_person_corrects_a_policy_and_only_the_corrections_are_learned_from(
    environment: Environment, tmp_path: Path
) -> None:
    path, still = tmp_path / "corrected.hdf5", Reading(twist=(0.0,) * 6)
    patience = round(1.0 / environment.step_dt)
    begin, save = Reading(events=(Event.RECORD,)), Reading(events=(Event.SAVE,))
    # The policy, the person, a pause that is short enough, the person again, and the policy after a long pause.
    led = [False] * 10 + [True] * 20 + [True] * 10 + [True] * 20 + [True] * (patience - 1) + [False] * 11
    stream = [still] * 9 + [UP] * 20 + [still] * 10 + [UP] * 20 + [still] * (patience - 1 + 11)
    device, file = Played(begin, *stream, save, still), RecordingFile(path)
    policy = partial(scripted_actor, "expert", environment, 0)
    session = Session(environment, Driver(environment), device, "gamepad", file, "Lift", 2, make_policy=policy)
    for expected in led:
        session.step(session.act())
        assert session.information()["led by"] == ("you" if expected else "the policy")
    session.act()
    assert session.close() == 1
    with opened(path) as dataset:
        assert dataset.episodes[0].taught == sum(led)
        assert dataset.read(0).arrays["taught"].tolist() == led
        write_dataset(tmp_path / "lerobot", [dataset.read(0)], dataset.manifest)
    for each in (path, tmp_path / "lerobot"):
        shown = load_demonstrations(each, environment, False)
        assert shown.steps == sum(led)
        assert shown.ends.unique().tolist() == [sum(led) - 1]


def test_a_leader_arm_that_rests_gives_the_lead_back(environment: Environment) -> None:
    environment.reset(0)
    intervention = Intervention(environment, Driver(environment), partial(scripted_actor, "zero", environment, 0))
    patience = round(1.0 / environment.step_dt)
    joint = environment.world.robots["robot"].joint_names[0]

    def streamed(position: float) -> bool:
        # A leader sends a frame at every step, of an encoder that flickers.
        intervention.act(Reading(joints={joint: position}, gripper_open=True, moved_at=1.0))
        return intervention.leads

    assert streamed(0.1), "it has just been connected"
    assert [streamed(0.1 + 0.001 * (step % 2)) for step in range(patience + 1)] == [True] * (patience - 1) + [False] * 2
    assert [streamed(0.1 + 0.004 * step) for step in range(5)] == [False] * 3 + [True] * 2, "slow motion adds up"


def test_a_person_takes_over_with_the_gripper_as_the_policy_left_it(environment: Environment) -> None:
    class Closing(Actor):
        """Closes the gripper."""

        def act(self) -> Tensor:
            return -torch.ones(1, environment.action_size)

    environment.reset(0)
    driver = Driver(environment)
    intervention = Intervention(environment, driver, Closing)
    for _ in range(3):
        environment.step(intervention.act(Reading()))
    intervention.act(UP)
    assert driver.hand is not None
    assert not driver.hand.gripper_open
    intervention.act(Reading(events=(Event.GRIPPER,)))
    assert driver.hand.gripper_open
