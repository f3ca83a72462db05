"""Joints on commanded springs move as the closed form of a unit mass on a spring and damper."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_core.actions import CommandMode
from orbit_core.actions.ik import towards_pose
from orbit_core.envs import make
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.interfaces import ConfigurationError
from orbit_motion import GainCommand, GainRange, JointImpedanceConfig
from tests.motion.servo_world import BACKENDS, held, wrench_on_hand

STIFFNESS = 60.0


def critically_damped(stiffness: float, time: float) -> float:
    """The share of a step that is done after ``time`` s."""
    rate = math.sqrt(stiffness)
    return 1.0 - (1.0 + rate * time) * math.exp(-rate * time)


@pytest.mark.parametrize(("backend", "engine_compensates"), [(BACKENDS[0], False), (BACKENDS[-1], True)])
def test_with_inertia_compensation_every_joint_is_a_unit_mass_on_a_spring(
    backend: str, engine_compensates: bool
) -> None:
    config = JointImpedanceConfig(stiffness=STIFFNESS, scale=0.2)
    arm = held(config, backend, physics_dt=0.001, gravity_compensation=engine_compensates)
    home = arm.generator.positions.clone()
    command = torch.tensor([1.0, 0.5, -1.0, 0.5, 1.0, -0.5, 1.0])
    for steps in (100, 100, 200):
        arm.run(command, steps)
        time = 0.001 * arm.world.clock.steps
        share = (arm.generator.positions - home) / (0.2 * command)
        assert share == pytest.approx(critically_damped(STIFFNESS, time), abs=0.01), time
    arm.world.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_commanded_stiffness_yields_to_a_force_by_force_over_stiffness(backend: str) -> None:
    config = JointImpedanceConfig(
        stiffness=400.0, gains=GainCommand.IMPEDANCE, inertia_compensation=False,
        stiffness_factor=GainRange(low=0.25, high=2.0), ratio_range=GainRange(low=1.0, high=1.0),
    )  # fmt: skip
    arm = held(config, backend)
    assert config.components(arm.robot.spec, "it")[7::7] == ("stiffness panda_joint1", "damping panda_joint1")
    home = arm.generator.positions.clone()
    gains = torch.tensor([[-1.0] * 7, [1.0] * 7])
    stiffness = torch.tensor([[100.0], [800.0]])
    wrench_on_hand(arm, (0.0, 6.0, 0.0))
    arm.run(torch.cat((torch.zeros(2, 7), gains, torch.zeros(2, 7)), 1), 800)
    force = torch.tensor([0.0, 6.0, 0.0, 0.0, 0.0, 0.0])
    torques = arm.robot.jacobian(arm.robot.spec.end_effector.frame, arm.generator.joints).mT @ force
    # The force's arm follows the hand; it stays where it was put on the link, within the small turn.
    assert arm.generator.positions - home == pytest.approx(torques / stiffness, rel=0.02, abs=2e-3)
    arm.world.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_joints_keep_to_their_velocity_limits_and_stop_at_their_position_limits(backend: str) -> None:
    arm = held(JointImpedanceConfig(stiffness=400.0, scale=6.0), backend)
    generator = arm.generator
    fastest = torch.tensor([joint.velocity_limit for joint in arm.robot.joints[:7]])
    reached = torch.zeros(7)
    for _ in range(120):
        arm.run(torch.tensor([1.0, 1.0, -1.0, 1.0, -1.0, 1.0, 1.0]), 8)
        reached = torch.maximum(reached, generator.velocities.abs().amax(0) / fastest)
        assert (generator.positions <= generator.upper_limits + 1e-3).all()
        assert (generator.positions >= generator.lower_limits - 1e-3).all()
    assert reached.max() > 0.9
    assert (reached < 1.05).all()
    arm.world.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_dry_friction_is_compensated_and_shakes_nothing(backend: str) -> None:
    arm = held(JointImpedanceConfig(scale=0.2), backend, name="xarm7", physics_dt=0.01)
    generator = arm.generator
    command = torch.tensor([[1.0] * 7, [1.0, -1.0, 0.5, -0.5, 1.0, -1.0, 0.3]])
    arm.run(command, 180)
    missing = generator.positions - arm.robot.home_positions[generator.joints] - 0.2 * command
    # 1 N m would hold the wrists, whose inertia is 0.03 kg m^2, wherever they are within 0.2 rad.
    assert missing.abs().max() < 0.012
    assert generator.velocities.abs().max() < 2e-3
    arm.world.close()


@pytest.mark.parametrize("inertia_compensation", [True, False])
def test_unstable_gains_are_refused_with_what_is_stable(inertia_compensation: bool) -> None:
    config = JointImpedanceConfig(stiffness=1e6, inertia_compensation=inertia_compensation)
    with pytest.raises(ConfigurationError, match=r"'it': a stiffness of 1e\+06 .* is unstable.* take at most"):
        held(config, BACKENDS[0])
    with pytest.raises(ConfigurationError, match="JointImpedanceConfig: stiffness is -1: give a number not below zero"):
        held(JointImpedanceConfig(stiffness=-1.0), BACKENDS[0])


def test_commands_lead_the_hand_to_a_pose() -> None:
    arm = held(JointImpedanceConfig(stiffness=400.0, mode=CommandMode.INTEGRATED), BACKENDS[0])
    goal = arm.hand()
    goal[:, :3] += torch.tensor([0.05, 0.1, -0.05])
    for _ in range(120):
        arm.run(arm.generator.encode(goal, torch.ones(2, dtype=torch.bool)), 8, decimation=8)
    assert towards_pose(arm.robot, arm.generator.joints, goal).abs().max() < 0.01
    arm.world.close()


@pytest.mark.parametrize("action", ["joint_impedance", "osc", "impedance", "hybrid", "qp_ik", "full_ik", "rmpflow"])
def test_a_captured_step_is_the_step(action: str) -> None:
    paths = []
    for captured in (False, True):
        env = make("Reach", num_envs=2, backend=BACKENDS[0], action=action)
        if captured:
            env._closed = CapturedStep(env, compile=False, whole=True)
        env.reset(seed=3)
        generator = torch.Generator().manual_seed(0)
        for _ in range(6):
            env.step(2.0 * torch.rand(2, env.action_size, generator=generator) - 1.0)
        paths.append(env.world.robots["robot"].joint_positions.clone())
        env.close()
    torch.testing.assert_close(*paths, atol=1e-5, rtol=0.0)
