"""The hand under operational-space control and Cartesian impedance, against closed forms on two engines."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_core.actions import CommandMode
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_motion import CartesianImpedanceConfig, GainCommand, OperationalSpaceConfig
from tests.motion.servo_world import BACKENDS, ENGINES, held, wrench_on_hand

OPEN = torch.ones(6, dtype=torch.bool)


def response(stiffness: float, ratio: float, time: float) -> float:
    """The share of a step that an underdamped unit mass on a spring has done after ``time`` s."""
    rate = math.sqrt(stiffness)
    damped = rate * math.sqrt(1.0 - ratio**2)
    wave = math.cos(damped * time) + ratio * rate / damped * math.sin(damped * time)
    return 1.0 - math.exp(-ratio * rate * time) * wave


@pytest.mark.parametrize(("backend", "engine_compensates"), [*zip(ENGINES, [False, True] * 2, strict=False)])
def test_each_axis_of_the_hand_is_a_second_order_system_of_its_own(backend: str, engine_compensates: bool) -> None:
    config = OperationalSpaceConfig(
        stiffness=100.0, rotational_stiffness=100.0, damping_ratio=0.5, mode=CommandMode.ABSOLUTE,
        position_scale=0.02, rotation_scale=0.1,
    )  # fmt: skip
    arm = held(config, backend, num_envs=6, physics_dt=0.001, gravity_compensation=engine_compensates)
    home = arm.hand()
    for _ in range(3):
        arm.run(torch.eye(6), 120)
        moved = pose_error(home, arm.hand()) / torch.tensor([0.02] * 3 + [0.1] * 3)
        expected = response(100.0, 0.5, 0.001 * arm.world.clock.steps)
        # 2 % of frequency turn the phase by 0.07 at the last of these times: 0.03 of the step.
        assert moved.diagonal() == pytest.approx(expected, abs=0.02)
        across = moved - torch.diag(moved.diagonal())
        # A centimetre and 0.05 rad are units here: the axes do not see each other.
        assert across.abs().max() < 0.02
    arm.world.close()


@pytest.mark.parametrize("backend", ENGINES)
def test_the_hand_yields_to_a_force_by_force_over_stiffness(backend: str) -> None:
    config = CartesianImpedanceConfig(gains=GainCommand.STIFFNESS, stiffness=400.0)
    arm = held(config, backend, physics_dt=0.004, gravity_compensation=False)
    home = arm.hand()
    wrench_on_hand(arm, (3.0, -4.0, 8.0))
    low, high = config.stiffness_factor.low, config.stiffness_factor.high
    place = 2.0 * math.log(1.0 / low) / math.log(high / low) - 1.0  # where the factor is one
    commands = torch.tensor([[0.0] * 6 + [place] * 6, [0.0] * 6 + [place, place, 1.0] + [place] * 3])
    arm.run(commands, 400)
    yielded = (arm.hand() - home)[:, :3]
    expected = torch.tensor([3.0, -4.0, 8.0]) / torch.tensor([[400.0] * 3, [400.0, 400.0, 1600.0]])
    torch.testing.assert_close(yielded, expected, rtol=0.01, atol=5e-5)
    arm.world.close()


@pytest.mark.parametrize(
    ("config", "mode"),
    [
        (OperationalSpaceConfig, CommandMode.INTEGRATED),
        (CartesianImpedanceConfig, CommandMode.ABSOLUTE),
    ],
)
def test_encoded_commands_lead_the_hand_to_a_pose(
    config: type[OperationalSpaceConfig | CartesianImpedanceConfig], mode: CommandMode
) -> None:
    scales = {"position_scale": 0.4, "rotation_scale": 1.0} if mode is CommandMode.ABSOLUTE else {}
    stiff = {"stiffness": 1000.0, "rotational_stiffness": 100.0} if config is CartesianImpedanceConfig else {}
    arm = held(config(mode=mode, **scales, **stiff), BACKENDS[0], physics_dt=0.004)
    goal = arm.hand()
    goal[:, :3] += torch.tensor([[0.1, 0.15, -0.1], [-0.05, -0.2, 0.1]])
    for _ in range(120):
        arm.run(arm.generator.encode(goal, OPEN[:2]), 4)
    assert pose_error(arm.hand(), goal).abs().max() < 0.01
    arm.world.close()


def test_joints_that_the_hand_leaves_free_go_home() -> None:
    arm = held(OperationalSpaceConfig(mode=CommandMode.ABSOLUTE, posture_stiffness=20.0), BACKENDS[0], physics_dt=0.004)
    robot, generator = arm.robot, arm.generator
    home = arm.hand()
    turned = generator.positions.clone()
    turned[:, 0] += 0.4
    robot.set_joint_state(turned, joints=generator.joints)
    arm.run(torch.zeros(6), 500)
    assert pose_error(arm.hand(), home).abs().max() < 2e-3
    assert (generator.positions - robot.home_positions[generator.joints]).abs().max() < 0.01
    arm.world.close()


def test_what_cannot_be_is_refused_by_name() -> None:
    with pytest.raises(UnknownNameError, match=r"panda_hand_tcb.*did you mean 'panda_hand_tcp'"):
        held(OperationalSpaceConfig(frame="panda_hand_tcb"), BACKENDS[0])
    with pytest.raises(ConfigurationError, match=r"panda_finger_joint1 of robot 'robot', none of which moves 'panda_"):
        held(OperationalSpaceConfig(joints=("panda_finger.*",)), BACKENDS[0])
    with pytest.raises(ConfigurationError, match=r"'it': a stiffness of 4e\+06 .*is unstable"):
        held(OperationalSpaceConfig(stiffness=4e6), BACKENDS[0])
    with pytest.raises(ConfigurationError, match=r"'it': a stiffness of 1e\+06 .*is unstable"):
        held(CartesianImpedanceConfig(stiffness=1e6), BACKENDS[0])
    with pytest.raises(ConfigurationError, match="rotational_stiffness is -3: give a number not below zero"):
        held(CartesianImpedanceConfig(rotational_stiffness=-3.0), BACKENDS[0])
