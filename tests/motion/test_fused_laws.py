"""Servos' laws as one kernel: the same efforts as operation by operation, alone and in a compiled step."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from orbit_core.capture.fusion import fusing
from orbit_core.capture.replay import CapturedFunction
from orbit_core.motion import HybridForceMotionConfig, JointImpedanceConfig, OperationalSpaceConfig
from orbit_core.motion.gains import GainCommand
from orbit_core.motion.servo import Servo
from tests.motion.servo_world import BACKENDS, held


@pytest.mark.parametrize(
    "term",
    [
        OperationalSpaceConfig(gains=GainCommand.IMPEDANCE),
        HybridForceMotionConfig(axes="panda_hand"),
        JointImpedanceConfig(inertia_compensation=False),
    ],
    ids=["osc", "hybrid", "joint_impedance"],
)
def test_efforts(term: OperationalSpaceConfig | JointImpedanceConfig) -> None:
    with_generator = held(term, BACKENDS[0], num_envs=5)
    servo = with_generator.generator
    assert isinstance(servo, Servo)
    torch.manual_seed(3)
    with_generator.run(2.0 * torch.rand(5, servo.command_size) - 1.0, 40)
    given = {**servo.dynamics.measured(), **servo.aims()}
    with fusing(True):
        made = servo.law(**given)[0].clone()
    assert servo.law.operations > 1000, servo.law.refusal
    torch.testing.assert_close(made, servo.law(**given)[0], rtol=1e-4, atol=2e-3)
    with_generator.world.close()


def positions_after_steps(compile: bool) -> Tensor:
    arm = held(JointImpedanceConfig(), BACKENDS[0], num_envs=3)
    arm.generator.compute({"command": torch.linspace(-0.3, 0.3, 21).view(3, 7)})

    def operations() -> tuple[Tensor, ...]:
        arm.world.step(2)
        return (arm.robot.joint_positions.clone(),)

    step = CapturedFunction(arm.world, operations, dict, compile)
    for _ in range(49):
        step()
    (positions,) = step()
    assert step.replay is not None, step.refusal
    arm.world.close()
    return positions.clone()


def test_in_a_compiled_step() -> None:
    torch.testing.assert_close(positions_after_steps(False), positions_after_steps(True), rtol=0.0, atol=1e-4)
