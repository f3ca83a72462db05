"""Franka's protocol against franky-sim, which speaks it from a process of its own (MuJoCo at 1 kHz)."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from orbit_assets.catalogue import robot
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_deploy.computer import RobotComputer
from orbit_deploy.description import RobotDescription
from orbit_deploy.follower import FollowerSettings
from orbit_deploy.hardware import open_hardware
from orbit_deploy.link import RobotLinkError, connect
from orbit_deploy.messages import Fault, Mode
from orbit_zmq.server import ZmqServer
from tests.deploy.rig import PERIOD, eventually

ADDRESS = "franka://127.0.0.1?realtime=no"


def description(name: str = "franka_panda") -> RobotDescription:
    return RobotDescription.of(robot(name), 500.0)


@pytest.fixture(scope="module")
def simulator() -> Iterator[subprocess.Popen[str]]:
    pytest.importorskip("franky", reason="Franka's robots need franky: pip install orbit-deploy[franka]")
    pytest.importorskip("franky_sim", reason="the simulated Franka is not installed: pip install franky-sim")
    code = "from franky_sim.run_server import main; main()"
    words = [sys.executable, "-uc", code, "-s", "mujoco", "--hostname", "127.0.0.1"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert any("Connect to the server" in line for line in process.stdout)
        yield process
        process.kill()


@contextmanager
def served() -> Iterator[tuple[RobotComputer, str, list[Fault]]]:
    """The arm's computer in a thread behind ZeroMQ, its address and its faults."""
    hardware = open_hardware(ADDRESS, description())
    computer = RobotComputer(hardware, FollowerSettings(watchdog=0.3))
    faults: list[Fault] = []
    computer.on_fault.append(faults.append)
    server = ZmqServer(computer, "zmq://127.0.0.1:0")
    thread = threading.Thread(target=_run, args=(computer,), daemon=True)
    thread.start()
    try:
        yield computer, server.address, faults
    finally:
        computer.end()
        thread.join(5.0)
        server.close()
        hardware.close()


def _run(computer: RobotComputer) -> None:
    try:
        computer.run()
    except RobotLinkError:
        return  # a fault has said so


def test_a_franka_follows_commands_and_its_hand_closes(simulator: subprocess.Popen[str]) -> None:
    with served() as (computer, address, faults):
        link = connect(address, PERIOD)
        begin = link.state()
        assert not link.description.simulated
        # Its fingers are symmetric, and open to 40 mm at first.
        goal = [*begin.positions[:7], 0.01, 0.01]
        goal[0] += 0.2

        def followed() -> bool:
            link.send(goal, [0.0] * 9, [0.0] * 9)
            state = link.state()
            return abs(state.positions[0] - goal[0]) < 0.02 and abs(state.positions[7] - 0.01) < 0.002

        assert eventually(followed, 30.0)
        np.testing.assert_allclose(link.state().positions[1:7], begin.positions[1:7], atol=0.02)
        link.close()
        assert eventually(lambda: computer.follower.mode is Mode.HOLDING)
        assert not [fault for fault in faults if fault.code not in ("watchdog", "overrun")]


def test_a_franka_that_stops_answering_is_one_fault_that_names_it(simulator: subprocess.Popen[str]) -> None:
    with served() as (_, address, faults):
        link = connect(address, PERIOD)
        link.send(link.state().positions, [0.0] * 9, [0.0] * 9)
        simulator.kill()
        assert eventually(lambda: any(fault.code == "robot" for fault in faults), 10.0)
        (text,) = [fault.text for fault in faults if fault.code == "robot"]
        assert "the robot at franka://127.0.0.1" in text
        link.close()


def test_a_franka_that_is_not_there_and_other_robots_are_one_clear_error() -> None:
    pytest.importorskip("franky", reason="Franka's robots need franky: pip install orbit-deploy[franka]")
    with pytest.raises(RobotLinkError, match=r"no Franka robot to control at franka://127\.0\.0\.77"):
        # Another address of this machine, where nothing listens.
        open_hardware("franka://127.0.0.77?realtime=no", description())
    with pytest.raises(ConfigurationError, match="unitree_go2 is no Franka arm"):
        open_hardware(ADDRESS, description("unitree_go2"))


@pytest.mark.parametrize("address", ["franka://", "franka://host?speed=1", "franka://host/arm"])
def test_an_address_that_is_none_is_one_clear_error(address: str) -> None:
    with pytest.raises(ConfigurationError, match="is no address of a Franka robot"):
        open_hardware(address, description())


def test_an_unknown_driver_is_named() -> None:
    with pytest.raises(UnknownNameError, match="kuka"):
        open_hardware("kuka://host", description())
    with pytest.raises(ConfigurationError, match="franka://172"):
        open_hardware("172.16.0.2", description())
