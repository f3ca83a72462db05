"""The demonstrations that the guide shows: a person with a SpaceMouse, waypoints around a post, a learned walk."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from importlib import util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.envs.configuration import configure
from orbit_core.envs.registry import task_entry
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import ImplicitPd
from orbit_deploy.cli.deploy import DeploySettings, deploy
from orbit_deploy.description import JointKind
from orbit_deploy.follower import PathKind
from orbit_deploy.local import LocalLink
from orbit_deploy.messages import RobotState
from orbit_deploy.simulated import Imperfections, SimulatedHardware

ROOT = Path(__file__).parents[2]
# Fitted by `orbit train-actuator` to two minutes of `tools/series_elastic.py`, at 200 Hz
NETWORK = Path(__file__).with_name("series_elastic.safetensors")
TILT = 200


@pytest.fixture
def waypoints() -> Iterator[ModuleType]:
    pytest.importorskip("ompl", reason="the extra orbit-core[planning] is not installed")
    described = util.spec_from_file_location("waypoints", ROOT / "packages/orbit-deploy/examples/waypoints.py")
    assert described is not None
    assert described.loader is not None
    module = util.module_from_spec(described)
    sys.modules["waypoints"] = module
    described.loader.exec_module(module)
    yield module
    del sys.modules["waypoints"]


@pytest.mark.parametrize("robot", ["franka_panda", "franka_panda_allegro"])
def test_a_hand_goes_around_a_post_that_the_direct_way_would_hit(waypoints: ModuleType, robot: str) -> None:
    waypoints.WAYPOINTS = waypoints.WAYPOINTS[:2]
    hardware = SimulatedHardware(waypoints.scene(robot, falls=True), default_backend())
    link = LocalLink(hardware, 1.0 / waypoints.RATE)
    report = waypoints.drive(robot, link)
    assert report.direct < -0.05
    assert report.clearance > 0.005
    assert report.missed < 0.005
    # It settles by less than this, and would fall over if it were touched.
    assert report.moved < 0.002
    assert link.computer.follower.limited == 0


def deployed(
    monkeypatch: pytest.MonkeyPatch, hardware: SimulatedHardware, settings: DeploySettings
) -> tuple[dict[str, Any], list[RobotState]]:
    """Results and states of a robot in this process, whatever the address is."""
    states: list[RobotState] = []

    def connect(address: str, period: float, keys: None, path: PathKind) -> LocalLink:
        link = LocalLink(hardware, period, path=path)
        link.computer.on_state.append(states.append)
        return link

    monkeypatch.setattr("orbit_deploy.link.connect", connect)
    return deploy(settings), states


def test_the_kept_policy_lifts_the_cube_within_the_limits_of_a_panda(monkeypatch: pytest.MonkeyPatch) -> None:
    hardware = SimulatedHardware(configure(task_entry("Lift").task_type(), {}).scene(), default_backend())
    settings = DeploySettings(agent="lift_cloned", path="drive", countdown=0.0, seed=1, table=False)
    results, _ = deployed(monkeypatch, hardware, settings)
    assert results["success_rate"] == 1.0
    # Limits of acceleration and jerk hold back a policy that was trained without them nearly all the time.
    assert results["held_back"] < 0.2


def test_a_policy_walks_on_series_elastic_actuators_at_200_hz(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = configure(task_entry("Velocity-Flat").task_type(), {"robot": "anymal_b"}).scene()
    hardware = SimulatedHardware(scene, default_backend(), 200.0, Imperfections(actuator_network=NETWORK), direct=True)
    # Clients command positions at 50 Hz and see the drives that the network imitates.
    assert {*hardware.description.kinds} == {JointKind.POSITION}
    results, _ = deployed(
        monkeypatch,
        hardware,
        DeploySettings(
            agent="velocity_flat_anymal_b", path="direct", countdown=0.0, set=("episode_length=1.5",), table=False
        ),
    )
    assert results["success_rate"] == 1.0
    assert results["metrics"]["linear_error_m_s"] < 0.25
    assert results["steps"] == 75


def test_an_actuator_network_needs_its_own_rate_and_drives_of_positions() -> None:
    entry = task_entry("Velocity-Flat")
    scene = configure(entry.task_type(), {"robot": "anymal_b"}).scene()
    with pytest.raises(ConfigurationError, match="200 Hz"):
        SimulatedHardware(scene, default_backend(), 1000.0, Imperfections(actuator_network=NETWORK))
    cart = configure(task_entry("Cartpole-Balance").task_type(), {}).scene()
    assert not any(isinstance(group, ImplicitPd) and group.stiffness for group in cart.robots[0].actuators)
    with pytest.raises(ConfigurationError, match="no drive of 'cartpole' follows positions"):
        SimulatedHardware(cart, default_backend(), 200.0, Imperfections(actuator_network=NETWORK))


class Mouse:
    """A SpaceMouse as hidapi opens it, whose cap is pushed away from the person."""

    def open_path(self, path: bytes) -> None:
        assert path == b"/dev/hidraw7"
        self._reports = [struct.pack("<B6h", 1, 0, -TILT, 0, 0, 0, 0)]

    def set_nonblocking(self, nonblocking: bool) -> None:
        assert nonblocking

    def read(self, size: int) -> list[int]:
        return [*self._reports.pop()] if self._reports else []

    def close(self) -> None:
        self._reports.clear()


def test_a_spacemouse_moves_the_hand_of_a_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    hid = ModuleType("hid")
    hid.device = Mouse
    hid.enumerate = lambda: [{"vendor_id": 0x256F, "product_id": 0xC635, "path": b"/dev/hidraw7"}]
    monkeypatch.setitem(sys.modules, "hid", hid)
    scene = configure(task_entry("Reach").task_type(), {"action": "ik_relative"}).scene()
    settings = DeploySettings(
        agent="teleop",
        task="Reach",
        action="ik_relative",
        device="spacemouse",
        countdown=0.0,
        set=("episode_length=1.0", "events.place_robot=none"),
        table=False,
    )
    results, states = deployed(monkeypatch, SimulatedHardware(scene, default_backend()), settings)
    assert results["steps"] == 50
    spec = scene.robots[0]
    tree, root = KinematicTree(spec.articulation), torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    begin, end = (
        tree.frame_pose(tree.forward(root, torch.tensor([state.positions])), spec.end_effectors[0].frame)[0, :3]
        for state in (states[0], states[-1])
    )
    # A second at some 4/7 of 0.25 m/s, less the start and the end of the motion
    assert (end - begin).tolist() == pytest.approx([0.13, 0.0, 0.0], abs=0.03)
