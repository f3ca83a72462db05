"""Bases on wheels, arms that bases carry, and hands that move by synergies."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from orbit_core.actions import BaseVelocityConfig, CommandMode, DifferentialDriveConfig, preset_terms
from orbit_core.dynamics.transforms import pose_error, quat_yaw
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Plane, Shape
from orbit_motion import WholeBodyIkConfig
from orbit_motion.synergies import GraspSynergiesConfig, synergies_of
from tests.motion.servo_world import BACKENDS, held

MakeRobot = Callable[..., Any]
GROUND = (Shape(Plane(), name="ground"),)


def test_wheels_turn_as_the_base_moves_and_keep_its_curve_at_their_limits(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot("tiago_base", 3)
    base = robot.spec.differential_base
    generator = DifferentialDriveConfig(max_speed=0.5, max_yaw_rate=0.8).build("base", robot)
    commands = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.4, -0.5]])
    speeds = generator.compute({"command": commands})["velocity_targets"]
    forward = base.radius * speeds.mean(1)
    turning = base.radius * (speeds[:, 1] - speeds[:, 0]) / base.track
    torch.testing.assert_close(torch.stack((forward, turning), 1), commands * torch.tensor([0.5, 0.8]))
    assert not generator.clamped.any()
    beyond = generator.compute({"command": torch.tensor([[1.0, 0.0], [0.0, 1.5], [3.0, 0.0]])})["velocity_targets"]
    torch.testing.assert_close(beyond[:2], speeds[:2])
    torch.testing.assert_close(beyond[2], speeds[0])
    assert generator.clamped.tolist() == [0, 1, 1]
    beside, open_ = robot.root_pose.clone(), torch.ones(3, dtype=torch.bool)
    beside[:, 1] += 1.0
    assert generator.encode(beside, open_)[:, 1].abs().min() > 0.1
    # The positions of an arm belong to the place where its base stands now.
    assert generator.encode_posture(robot.joint_positions, beside, open_).abs().max() == 0.0
    fast = DifferentialDriveConfig(max_speed=20.0, max_yaw_rate=30.0).build("base", robot)
    speeds = fast.compute({"command": commands})["velocity_targets"]
    limit = min(robot.joints[joint].velocity_limit for joint in fast.joints)
    torch.testing.assert_close(speeds.abs().amax(1), torch.full((3,), limit))
    curve = (base.radius * (speeds[2, 1] - speeds[2, 0]) / base.track) / (base.radius * speeds[2].mean())
    assert float(curve) == pytest.approx(-0.5 * 30.0 / (0.4 * 20.0), rel=1e-4)
    assert [*preset_terms(robot.spec, "joint_position")][-1] == "base"


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_base_on_two_wheels_drives_the_arc_that_is_asked_for(backend: str) -> None:
    base = held(DifferentialDriveConfig(), backend, name="tiago_base", physics_dt=0.005, terrain=GROUND)
    base.run(torch.zeros(2), 200)
    start = base.robot.root_pose.clone()
    forward, turn, time = 0.4, 0.5, 3.0
    base.run(torch.tensor([forward, turn]), round(time / 0.005))
    moved = base.robot.root_pose - start
    radius, angle = forward / turn, turn * time
    expected = torch.tensor([[radius * math.sin(angle), radius * (1.0 - math.cos(angle))]] * 2)
    # It speeds up for a tenth of a second, and its tyres and casters scrub in the curve.
    torch.testing.assert_close(moved[:, :2], expected, rtol=0.0, atol=0.1)
    yaw = quat_yaw(base.robot.root_pose[:, 3:])
    assert 2.0 * torch.atan2(yaw[:, 3], yaw[:, 0]) == pytest.approx(angle, abs=0.12)
    base.world.close()


@pytest.mark.parametrize(
    ("backend", "name"),
    [(BACKENDS[0], "base_omni_franka_panda"), (BACKENDS[-1], "base_omni_franka_panda"), (BACKENDS[0], "tiago")],
)
def test_base_and_arm_go_together_to_what_the_arm_cannot_reach(backend: str, name: str) -> None:
    config = WholeBodyIkConfig(damping=0.02, weights=(1.0,) * 3 + (0.3,) * 3)
    robot = held(config, backend, name=name, num_envs=5, physics_dt=0.005, terrain=GROUND)
    goal = robot.hand()
    goal[:, :3] += torch.tensor([1.2, 0.3, 0.05])
    goal[:, 0] += torch.tensor([-1e-3, -1e-4, 0.0, 1e-4, 1e-3])
    for _ in range(150):
        robot.run(robot.generator.encode(goal, torch.ones(5, dtype=torch.bool)), 8, decimation=8)
    # TIAGo's drives sag under its arm, whose weight nothing cancels, and wheels on the ground leave its base where the
    # last bits say: between 1.6 and 3.6 cm for goals that are a tenth of a millimetre apart, on any processor.
    away = pose_error(robot.hand(), goal)[:, :3].abs().amax(1)
    assert away.median() < (0.03 if name == "tiago" else 0.01)
    assert away.max() < (0.05 if name == "tiago" else 0.01)
    base = robot.robot.link_poses[:, robot.robot.link_names.index(robot.robot.spec.base_link)]
    assert 0.4 < float(base[0, 0]) < 1.6
    robot.world.close()


def test_a_planar_base_keeps_its_curve_at_its_joints_limits(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot("base_omni_franka_panda", 1)
    generator = BaseVelocityConfig(max_speed=10.0, max_yaw_rate=5.0).build("base", robot)
    velocities = generator.compute({"command": torch.tensor([[0.6, 0.0, 0.4]])})["velocity_targets"]
    limits = torch.tensor([robot.joints[joint].velocity_limit for joint in generator.joints])
    assert (velocities.abs() <= limits + 1e-5).all()
    assert float(velocities[0, 2] / velocities[0, 0]) == pytest.approx(2.0 / 6.0, rel=1e-4)


def test_synergies_are_the_principal_components_of_postures(kinematic_robot: MakeRobot) -> None:
    rng = np.random.default_rng(0)
    directions = np.linalg.qr(rng.normal(size=(6, 2)))[0].T
    scores = np.array([[2.0, 0.5], [-2.0, 0.5], [1.0, -0.5], [-1.0, -0.5]])
    found = synergies_of(1.0 + scores @ directions, 2)
    np.testing.assert_allclose(np.abs(found.directions @ directions.T), np.eye(2), atol=1e-9)
    np.testing.assert_allclose((found.low[0], found.high[0]), (-2.0, 2.0))
    robot = kinematic_robot("allegro_right")
    generator = GraspSynergiesConfig().build("hand", robot)
    opened = torch.tensor([True, False, True, False])
    command = generator.encode(robot.root, opened)
    torch.testing.assert_close(command, torch.tensor([[1.0], [-1.0], [1.0], [-1.0]]))
    targets = generator.compute({"command": command})["position_targets"]
    home = robot.home_positions[generator.joints]
    torch.testing.assert_close(targets[0], home, atol=1e-4, rtol=0.0)  # it is open at home
    middle = generator.compute({"command": torch.zeros(4, 1)})["position_targets"]
    torch.testing.assert_close(middle, targets[:2].mean(0).expand(4, -1), atol=1e-4, rtol=0.0)


def test_what_a_robot_lacks_is_told(kinematic_robot: MakeRobot) -> None:
    arm = kinematic_robot()
    with pytest.raises(ConfigurationError, match="has no differential base"):
        DifferentialDriveConfig().build("base", arm)
    with pytest.raises(ConfigurationError, match="has no base that moves"):
        WholeBodyIkConfig(mode=CommandMode.RELATIVE).build("body", arm)
    with pytest.raises(ConfigurationError, match="'hand': a posture has 2 positions for 1 joints"):
        GraspSynergiesConfig(postures=((0.0, 0.1),)).build("hand", arm)
    with pytest.raises(ConfigurationError, match="'hand': 2 postures vary in 1 directions, of which 2 are asked for"):
        GraspSynergiesConfig(count=2).build("hand", arm)
