"""Servos' laws as one kernel: the same efforts as operation by operation, alone and in a compiled step."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from orbit_core.capture.replay import CapturedFunction, fusing
from orbit_core.scene import Plane, Shape
from orbit_motion import HybridForceMotionConfig, JointImpedanceConfig, OperationalSpaceConfig, RmpFlowConfig
from orbit_motion.compliant import Servo
from orbit_motion.gains import GainCommand
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

    step = CapturedFunction(arm.world, operations, compile)
    for _ in range(49):
        step()
    (positions,) = step()
    assert step.replay is not None, step.refusal
    arm.world.close()
    return positions.clone()


def test_in_a_compiled_step() -> None:
    torch.testing.assert_close(positions_after_steps(False), positions_after_steps(True), rtol=0.0, atol=1e-4)


def test_substeps_of_rmpflow_are_handed_from_kernel_to_kernel() -> None:
    arm = held(RmpFlowConfig(), BACKENDS[0], num_envs=3, terrain=(Shape(Plane()),))
    command = torch.linspace(-0.2, 0.2, 18).view(3, 6)

    def operations() -> tuple[Tensor, ...]:
        return tuple(arm.generator.compute({"command": command}).values())

    plain = CapturedFunction(arm.world, operations, False)
    fused = CapturedFunction(arm.world, operations, False)
    fused._compiles = True  # the law's own kernels, without the compiler for what is between them
    ends = []
    for step in (plain, fused):
        arm.generator.reset()
        for _ in range(4):
            positions, _ = step()
        assert step.replay is not None, step.refusal
        ends.append(positions.clone())
    torch.testing.assert_close(*ends, rtol=0.0, atol=1e-4)
    arm.world.close()
