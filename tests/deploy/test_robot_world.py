"""A world over a robot's computer is the core's own world: same tensors, same terms, real time in place of steps."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from msgspec import structs

from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError, UnsupportedCapabilityError
from orbit_core.scene import ContactSensorSpec, Scene
from orbit_core.world import simulate
from orbit_deploy.computer import ComputerSettings, RobotBusyError
from orbit_deploy.engine import RobotWorld
from orbit_deploy.follower import PathKind
from orbit_deploy.link import RobotFaultError
from orbit_deploy.local import LocalLink
from orbit_deploy.log import RobotLog
from orbit_deploy.messages import Arrangement, Mode
from orbit_deploy.simulated import Imperfections
from tests.deploy.rig import PERIOD, hardware, lockstep, scene


@pytest.fixture
def link() -> Iterator[LocalLink]:
    with lockstep() as link:
        yield link


def world_over(link: LocalLink, what: Scene | None = None) -> RobotWorld:
    return RobotWorld(what or scene(), link, PERIOD, 1, torch.device("cpu"), 0)


def test_a_robots_world_shows_links_frames_and_objects_as_a_simulated_one(link: LocalLink) -> None:
    world, simulated = world_over(link), simulate(scene(), 1, default_backend())
    positions, place = torch.tensor([[0.3, -0.5, 0.2]]), torch.tensor([[1.2, 0.3, 0.05, 1.0, 0.0, 0.0, 0.0]])
    for each in (world, simulated):
        each.robots["arm"].set_joint_state(positions)
        each.objects["cube"].set_root_pose(place)
    for name in ("arm", "cube"):
        here = world.robots[name] if name == "arm" else world.objects[name]
        there = simulated.robots[name] if name == "arm" else simulated.objects[name]
        assert torch.allclose(here.link_poses, there.link_poses, atol=1e-5)
    jacobians = [each.robots["arm"].jacobian("link2") for each in (world, simulated)]
    assert torch.allclose(*jacobians, atol=1e-5)
    assert world.settings is None
    simulated.close()


def test_a_step_sends_targets_waits_its_time_and_reads_the_robot(link: LocalLink) -> None:
    world = world_over(link)
    robot, begin = world.robots["arm"], link.now()
    robot.set_position_targets(torch.tensor([[0.2, 0.0, -0.2]]))
    for _ in range(40):
        world.step(4)
    assert link.now() - begin == pytest.approx(40 * PERIOD, abs=2e-3)
    assert robot.joint_positions[0].tolist() == pytest.approx([0.2, 0.0, -0.2], abs=0.01)
    assert link.state().mode is Mode.FOLLOWING
    assert world.engine.times.overruns == 0  # pyright: ignore[reportAttributeAccessIssue]


def test_a_reset_puts_a_simulated_robot_at_home(link: LocalLink) -> None:
    world = world_over(link)
    world.robots["arm"].set_joint_state(torch.full((1, 3), 0.4))
    world.reset()
    assert link.state().positions == pytest.approx([0.0] * 3, abs=1e-4)


def test_a_real_robot_goes_home_slowly_and_softly_to_its_first_targets_and_refuses_to_place_things(
    link: LocalLink,
) -> None:
    link.arrange(Arrangement(positions=[0.3, 0.3, 0.3]))
    link.description = structs.replace(link.description, arranges=False)
    world = world_over(link)
    begin = link.now()
    world.reset()
    assert link.now() - begin > 0.5
    assert link.state().positions == pytest.approx([0.0] * 3, abs=0.02)
    world.robots["arm"].set_position_targets(torch.full((1, 3), 0.3))
    begin = link.now()
    world.step(4)
    assert link.now() - begin > 0.5
    with pytest.raises(UnsupportedCapabilityError, match="'cube' at a real robot is placed by hand"):
        world.objects["cube"].set_root_pose(torch.tensor([[1.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]]))


def test_what_a_robot_cannot_measure_or_set_is_refused(link: LocalLink) -> None:
    with pytest.raises(UnsupportedCapabilityError, match="backend 'robot' does not do contact forces"):
        world_over(link, scene_with_touch())
    world = world_over(link)
    with pytest.raises(UnsupportedCapabilityError):
        world.save_state()
    link.description = structs.replace(link.description, objects=[])
    with pytest.raises(ConfigurationError, match="tracks no 'cube': it tracks nothing"):
        world_over(link)


def scene_with_touch() -> Scene:
    return replace(scene(), sensors=(ContactSensorSpec(name="touch", entity="cube"),))


def test_a_fault_is_raised_with_its_reason_and_cleared(link: LocalLink) -> None:
    world = world_over(link)
    link.send([float("nan"), 0.0, 0.0], [0.0] * 3, [0.0] * 3)
    with pytest.raises(RobotFaultError, match=r"has stopped \(nan\): command 0 is no finite number for joint joint0"):
        world.step(4)
    link.wait(link.now() + 0.1)
    assert link.state().mode is Mode.FAULT
    assert link.clear().mode is Mode.HOLDING


def test_a_second_client_is_refused_by_the_name_of_the_first(link: LocalLink) -> None:
    with pytest.raises(RobotBusyError, match="client local commands the robot"):
        link.computer.open("another", PERIOD)
    with pytest.raises(ConfigurationError, match="set its rate"):
        link.computer.open("local", 5.0)


def test_a_client_that_goes_without_a_word_is_forgotten_and_the_robot_rests(link: LocalLink) -> None:
    link.send([0.3] * 3, [0.0] * 3, [0.0] * 3)
    computer = link.computer
    for _ in range(2200):
        link._clock.set(link._clock.now() + 1_000_000)
        computer.cycle()
    assert computer.client == ""
    assert computer.follower.limiter.at_rest
    computer.open("another", PERIOD)


@pytest.mark.parametrize(
    ("imperfections", "least"),
    [
        (Imperfections(delay=0.05), 0.02),
        (Imperfections(friction=0.5), 0.02),
        (Imperfections(position_noise=0.01), 0.002),
    ],
    ids=["delay", "friction", "noise"],
)
def test_imperfections_change_what_is_measured(imperfections: Imperfections, least: float) -> None:
    found = []
    for each in (Imperfections(), imperfections):
        with lockstep(each) as link:
            way = []
            for step in range(20):
                link.send([0.02 * step] * 3, [0.0] * 3, [0.0] * 3)
                link.wait(link.now() + PERIOD)
                way.append(link.state().positions)
            found.append(np.array(way))
    assert np.abs(found[0] - found[1]).max() > least


def test_a_robot_whose_link_loses_a_fifth_of_the_messages_still_follows() -> None:
    with lockstep(settings=ComputerSettings(loss=0.2), path=PathKind.QUINTIC) as link:
        for step in range(60):
            link.send([0.3 * np.sin(0.1 * step)] * 3, [0.0] * 3, [0.0] * 3)
            link.wait(link.now() + PERIOD)
        assert link.state().targets[0] == pytest.approx(0.3 * np.sin(0.1 * 58), abs=0.05)
        assert 30 < link.computer.follower.accepted < 60


def test_a_log_holds_commands_states_and_faults_in_order(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "run.mcap"
    link = LocalLink(hardware(), PERIOD)
    log = link.computer._log = RobotLog(path, link.description)
    for step in range(5):
        link.send([0.01 * step] * 3, [0.0] * 3, [0.0] * 3)
        link.wait(link.now() + PERIOD)
    link.send([float("nan")] * 3, [0.0] * 3, [0.0] * 3)
    link.wait(link.now() + PERIOD)
    log.close()
    link.close()
    with path.open("rb") as file:
        found = [
            (channel.topic, json.loads(message.data))
            for _, channel, message in reader.make_reader(file).iter_messages()
        ]
    commands = [values for topic, values in found if topic == "/command"]
    assert [values["sequence"] for values in commands] == [*range(6)]
    assert [values["code"] for topic, values in found if topic == "/fault"] == ["nan"]
    states = [values["stamp"] for topic, values in found if topic == "/state"]
    assert len(states) >= 50
    assert states == sorted(states)
