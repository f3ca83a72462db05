"""Unitree's messages: bytes, checksums, the order of joints, and a simulated Go2 behind DDS."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="ROS over DDS needs cyclonedds: pip install orbit-ros")

from orbit_assets.catalogue import robot
from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.scene import Scene
from orbit_deploy.computer import ComputerSettings, RobotComputer
from orbit_deploy.follower import FollowerSettings, PathKind
from orbit_deploy.link import RobotLinkError, connect
from orbit_deploy.messages import Fault
from orbit_deploy.simulated import SimulatedHardware
from orbit_ros.dds import Ros2Node
from orbit_ros.unitree import robot as robot_module
from orbit_ros.unitree.layout import Fixed, GoLowCmd, GoLowState, HgLowCmd, HgLowState, checksum
from orbit_ros.unitree.robot import MODELS
from orbit_ros.unitree.server import UnitreeServer
from tests.deploy.rig import eventually
from tests.ros.rig import free_domain

# C's layouts by `struct`, and lengths of CDR with its header, as Unitree's own library has them
LAYOUTS = {
    GoLowCmd: ("<4B4IH2x" + "B3x5f3I" * 20 + "4B" + "55Bx2I", 812),
    GoLowState: ("<4B4IH2x13fb3x" + "B3x7fb3x3I" * 20 + "4BiH4b15H8hI41B3xf2b2x2f4h2I", 1180),
    HgLowCmd: ("<2B2x" + "B3x5fI" * 35 + "5I", 1004),
    HgLowState: ("<2I2B2xI13fh2x" + "B3x4f2hf7I" * 35 + "40B5I", 2092),
}


@pytest.mark.parametrize("kind", LAYOUTS)
def test_a_message_has_the_bytes_of_unitrees_layout(kind: type[Fixed]) -> None:
    layout, length = LAYOUTS[kind]
    message = kind.empty()
    assert message.record.dtype.itemsize == struct.calcsize(layout)
    assert len(message.serialize()) == length


def test_a_command_has_its_motors_where_unitree_reads_them() -> None:
    message = GoLowCmd.empty()
    motors = message.record["motor_cmd"][0]
    motors["mode"], motors["q"] = 1, np.arange(20)
    data = message.serialize()[4:]
    assert [data[22]] == [1]
    assert struct.unpack_from("<f", data, 24 + 3 * 36) == (3.0,)


def test_a_checksum_is_the_crc_of_words_from_their_highest_bit() -> None:
    words = np.array([0x12345678, 0x00000001, 0xDEADBEEF], "<u4")
    crc = 0xFFFFFFFF
    for word in words.tolist():
        for bit in range(31, -1, -1):
            mixed = ((crc >> 31) & 1) ^ ((word >> bit) & 1)
            crc = ((crc << 1) & 0xFFFFFFFF) ^ (0x04C11DB7 if mixed else 0)
    assert checksum(words.view(np.uint8)) == crc


def test_a_message_read_back_is_the_one_that_was_written() -> None:
    for kind in LAYOUTS:
        message = kind.empty()
        message.record["reserve"] = 77
        assert message.seal().sealed
        read = kind.deserialize(message.serialize())
        assert read.sealed
        assert read.record == message.record
        data = bytearray(message.serialize())
        data[40] ^= 1
        assert not kind.deserialize(bytes(data)).sealed


def test_another_models_message_is_rejected() -> None:
    with pytest.raises(ConfigurationError, match="no LowState of unitree_hg"):
        HgLowState.deserialize(GoLowState.empty().serialize())


def test_joints_are_in_the_order_of_unitrees_motors() -> None:
    legs = [f"{side}_{part}_joint" for side in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]
    joints = [joint.name for joint in robot("unitree_go2").articulation.movable_joints]
    assert [legs[motor] for motor in MODELS["go2"].motors] == joints
    assert MODELS["g1"].motors == tuple(range(len(robot("unitree_g1").articulation.movable_joints)))


@contextmanager
def served_go2() -> Iterator[tuple[int, list[Fault]]]:
    """A simulated Go2 that hangs in the air behind DDS, and the faults of its computer."""
    spec = replace(robot("unitree_go2"), name="robot", fixed_base=True)
    hardware = SimulatedHardware(Scene(robots=(spec,)), default_backend(), 250.0, direct=True)
    computer = RobotComputer(hardware, FollowerSettings(watchdog=0.5), ComputerSettings(state_rate=125.0))
    faults: list[Fault] = []
    computer.on_fault.append(faults.append)
    domain = free_domain()
    server = UnitreeServer(computer, Ros2Node(domain), "test")
    thread = threading.Thread(target=computer.run, daemon=True)
    thread.start()
    try:
        yield domain, faults
    finally:
        computer.end()
        thread.join(5.0)
        server.close()
        hardware.close()


def test_a_simulated_go2_follows_low_level_commands() -> None:
    with served_go2() as (domain, faults):
        link = connect(f"unitree://127.0.0.1:{domain}/go2?odometry=no", 0.02, path=PathKind.DIRECT)
        try:
            assert not link.description.arranges
            targets = list(link.state().positions)
            targets[0] += 0.2
            zeros = [0.0] * 12

            def followed() -> bool:
                link.send(targets, zeros, zeros)
                return abs(link.state().positions[0] - targets[0]) < 0.08

            assert eventually(followed)
            assert not [fault for fault in faults if fault.code != "watchdog"]
        finally:
            link.close()


def test_commands_with_other_gains_or_a_wrong_checksum_are_not_carried_out() -> None:
    with served_go2() as (domain, faults):
        node = Ros2Node(domain)
        publish = node.advertise("lowcmd", GoLowCmd)
        command = GoLowCmd.empty()
        command.record["head"] = (0xFE, 0xEF)
        command.record["motor_cmd"]["mode"] = 1

        def reported(code: str) -> bool:
            publish(command)
            return code in [fault.code for fault in faults]

        assert eventually(lambda: reported("checksum"))
        command.seal()
        assert eventually(lambda: reported("gains"))
        node.close()


def test_commands_of_a_second_program_are_ignored_with_a_fault() -> None:
    with served_go2() as (domain, faults):
        link = connect(f"unitree://127.0.0.1:{domain}/go2?odometry=no", 0.02, path=PathKind.DIRECT)
        try:
            where, zeros = list(link.state().positions), [0.0] * 12
            link.send(where, zeros, zeros)
            node = Ros2Node(domain)
            publish = node.advertise("lowcmd", GoLowCmd)
            command = GoLowCmd.empty()
            command.record["head"] = (0xFE, 0xEF)
            command.record["motor_cmd"]["mode"] = 1
            command.seal()

            def ignored() -> bool:
                link.send(where, zeros, zeros)
                publish(command)
                return "busy" in [fault.code for fault in faults]

            assert eventually(ignored)
            np.testing.assert_allclose(link.state().positions, where, atol=0.1)
            node.close()
        finally:
            link.close()


def test_a_robot_that_is_not_there_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_module, "_FOUND", 0.1)
    with pytest.raises(RobotLinkError, match="no unitree_go2 publishes 'rt/lowstate'"):
        connect(f"unitree://127.0.0.1:{free_domain()}/go2", 0.02)
    with pytest.raises(UnknownNameError, match="h9"):
        connect(f"unitree://127.0.0.1:{free_domain()}/h9", 0.02)
