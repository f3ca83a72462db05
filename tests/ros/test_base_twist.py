"""A mobile base is driven by ``cmd_vel``, as a robot of ROS programs and by us."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="ROS over DDS needs cyclonedds: pip install orbit-ros")

from orbit_assets.catalogue import robot
from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Scene
from orbit_deploy.computer import ComputerSettings, RobotComputer
from orbit_deploy.description import RobotDescription
from orbit_deploy.follower import FollowerSettings
from orbit_deploy.link import bridge, connect
from orbit_deploy.simulated import SimulatedHardware
from orbit_ros import topics
from orbit_ros.base_twist import BaseTwist
from orbit_ros.dds import Ros2Node
from orbit_ros.messages import Twist, Vector3
from tests.deploy.rig import eventually
from tests.ros.rig import free_domain


@pytest.mark.parametrize("name", ["base_omni", "tiago_base"])
def test_a_twist_becomes_joint_velocities_and_back(name: str) -> None:
    description = RobotDescription.of(robot(name))
    base = BaseTwist.of(description)
    assert base is not None
    positions = np.zeros(len(description.joints))
    positions[base.joints[-1]] = 0.7
    twist = Twist(Vector3(0.4, 0.0 if base.wheels else 0.2), Vector3(z=-0.3))
    back = base.twist(base.velocities(twist, positions), positions)
    for part in ("linear", "angular"):
        for axis in "xyz":
            assert getattr(getattr(back, part), axis) == pytest.approx(getattr(getattr(twist, part), axis))


def test_an_arm_has_no_base() -> None:
    assert BaseTwist.of(RobotDescription.of(robot("franka_panda"))) is None


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[RobotComputer, int]]:
    spec = replace(robot("base_omni"), name="robot")
    hardware = SimulatedHardware(Scene(robots=(spec,)), default_backend(), 500.0)
    computer = RobotComputer(hardware, FollowerSettings(watchdog=0.5), ComputerSettings(state_rate=100.0))
    domain = free_domain()
    server = bridge("ros2").serve(computer, f"ros2://127.0.0.1:{domain}")
    thread = threading.Thread(target=computer.run, daemon=True)
    thread.start()
    yield computer, domain
    computer.end()
    thread.join(5.0)
    server.close()
    hardware.close()


def test_a_program_of_ros_drives_the_base_which_stops_without_commands(served: tuple[RobotComputer, int]) -> None:
    computer, domain = served
    node = Ros2Node(domain)
    publish = node.advertise(topics.TWIST, Twist)

    def there() -> bool:
        publish(Twist(Vector3(0.3), Vector3(z=0.2)))
        return computer.follower.measured[0] > 0.1 and computer.follower.measured[2] > 0.03

    assert eventually(there, 15.0)
    assert eventually(lambda: not computer.client or computer.follower.limiter.at_rest)
    assert abs(computer.follower.limiter.velocity).max() < 1e-6
    node.close()


def test_we_drive_a_base_of_ros_by_twists(served: tuple[RobotComputer, int]) -> None:
    computer, domain = served
    before = computer.follower.measured[0]
    link = connect(f"ros2://127.0.0.1:{domain}?command=twist", 0.02)

    def there() -> bool:
        link.send([0.0] * 3, [-0.3, 0.0, 0.0], [0.0] * 3)
        return link.state().positions[0] < before - 0.1

    try:
        assert eventually(there, 15.0)
    finally:
        link.close()
    assert eventually(lambda: computer.follower.limiter.at_rest)


def test_a_robot_without_a_base_takes_no_twist() -> None:
    with pytest.raises(ConfigurationError, match="franka_panda has no mobile base that takes a twist"):
        connect(f"ros2://127.0.0.1:{free_domain()}?robot=franka_panda&command=twist", 0.02)
