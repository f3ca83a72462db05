"""Forces that a hand exerts and yields to, on two engines."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.motion import AdmittanceConfig, CommandMode, HybridForceMotionConfig
from orbit_core.motion.full_ik import FullIk
from orbit_core.motion.term import ActionTerm
from orbit_core.scene import (
    Box,
    ContactSensorSpec,
    ForceTorqueSpec,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    Shape,
    single_link,
)
from tests.motion.servo_world import BACKENDS, Held, held, wrench_on_hand

TOUCH = ContactSensorSpec(name="touch", entity="robot", links=("panda_link7", ".*finger"), rate=500.0)
TABLE = 0.3
"""m: height of the table's top."""


def table() -> ObjectSpec:
    """A slippery block that does not move."""
    shape = Shape(Box((0.3, 0.3, 0.05)), material=PhysicsMaterial(static_friction=0.0, dynamic_friction=0.0))
    body = single_link("table", shape, 10.0, np.eye(3))
    return ObjectSpec(name="table", articulation=body, fixed_base=True, pose=Pose((0.5, 0.0, TABLE - 0.05)))


def above_the_table(term: ActionTerm, backend: str, height: float) -> Held:
    """The hand points straight down, its finger tips that high above the table."""
    arm = held(term, backend, num_envs=1, objects=(table(),), sensors=(TOUCH,))
    robot, frame = arm.robot, arm.robot.spec.end_effector.frame
    solver = FullIk(
        KinematicTree(robot.spec.articulation), frame, arm.generator.joints, robot.position_limits, robot.home_positions
    )
    pose = torch.tensor([[0.5, 0.0, TABLE + height, 0.0, 1.0, 0.0, 0.0]])
    positions = robot.joint_positions.clone()
    positions[:, arm.generator.joints] = solver.solve(pose, positions).positions
    robot.set_joint_state(positions)
    robot.set_friction(torch.zeros(1, len(robot.link_names)))  # else the larger of a pair's would hold
    return arm


@pytest.mark.parametrize(("backend", "axes"), [(BACKENDS[0], None), (BACKENDS[-1], "panda_hand_tcp")])
def test_the_hand_pushes_with_20_n_while_it_draws_a_circle(backend: str, axes: str | None) -> None:
    config = HybridForceMotionConfig(
        sensor="touch", axes=axes, position_scale=0.01, stiffness=400.0, rotational_stiffness=400.0
    )
    arm = above_the_table(config, backend, 0.02)
    push = -1.0 if axes is None else 1.0  # the hand's own z points down
    arm.run(torch.tensor([0.0, 0.0, push, 0.0, 0.0, 0.0]), 400)
    center, radius, turns = arm.hand()[0, :2], 0.03, 200
    forces, misses = [], []
    for step in range(turns + turns // 4):
        angle = 2.0 * math.pi * step / turns
        dx, dy = (radius * 2.0 * math.pi / turns / 0.01 * part for part in (-math.sin(angle), math.cos(angle)))
        across = torch.tensor([dx, dy if axes is None else -dy])  # the hand's own y points back
        arm.run(torch.cat((across, torch.tensor([push, 0.0, 0.0, 0.0]))), 4)
        if step > 50:
            forces.append(float(arm.world.sensors["touch"].forces.sum(1)[0, 2]))
            around = arm.hand()[0, :2] - (center - torch.tensor([radius, 0.0]))
            misses.append(float(around.norm()) - radius)
    assert float(np.sqrt(np.mean(np.square(np.array(forces) - 20.0)))) < 1.0
    assert np.abs(misses).max() < 2e-3
    arm.world.close()


@pytest.mark.parametrize(("backend", "engine_compensates"), [(BACKENDS[0], True), (BACKENDS[-1], False)])
def test_a_position_driven_arm_yields_by_force_over_stiffness(backend: str, engine_compensates: bool) -> None:
    wrist = ForceTorqueSpec(name="wrist", entity="robot", link="panda_link7")
    config = AdmittanceConfig(sensor="wrist", stiffness=400.0, rotational_stiffness=1e3, inertia=10.0)
    arm = held(config, backend, sensors=(wrist,), gravity_compensation=engine_compensates)
    arm.run(torch.zeros(6), 1200)  # the drives sag under the arm's weight, which is no force on the hand
    home = arm.hand()
    wrench_on_hand(arm, (6.0, 0.0, -8.0))
    arm.run(torch.zeros(6), 2400)
    yielded = (arm.hand() - home)[:, :3]
    torch.testing.assert_close(yielded, torch.tensor([[0.015, 0.0, -0.02]] * 2), rtol=0.0, atol=5e-4)
    arm.world.close()


def test_what_measures_no_force_is_refused_by_name() -> None:
    with pytest.raises(UnknownNameError, match="touhc"):
        held(HybridForceMotionConfig(sensor="touhc"), BACKENDS[0], sensors=(TOUCH,))
    with pytest.raises(
        ConfigurationError, match=r"controls torques, which the contact sensor 'touch' does not measure"
    ):
        held(HybridForceMotionConfig(sensor="touch", force=(False,) * 5 + (True,)), BACKENDS[0], sensors=(TOUCH,))
    with pytest.raises(ConfigurationError, match=r"'it' needs forces: name a contact or force-torque sensor"):
        held(AdmittanceConfig(), BACKENDS[0])
    with pytest.raises(ConfigurationError, match="force names 2 of 6 axes"):
        held(HybridForceMotionConfig(force=(True, False)), BACKENDS[0])
    with pytest.raises(ConfigurationError, match="from which relative commands count"):
        held(AdmittanceConfig(sensor="touch", mode=CommandMode.RELATIVE), BACKENDS[0], sensors=(TOUCH,))
