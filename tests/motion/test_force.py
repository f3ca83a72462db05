"""Forces that a hand exerts and yields to, on two engines."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from orbit_core.actions import CommandMode, JointPositionConfig
from orbit_core.actions.term import ActionTerm
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import quat_multiply, quat_rotate
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.scene import (
    Articulation,
    Box,
    ContactSensorSpec,
    ForceTorqueSpec,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    Shape,
    single_link,
)
from orbit_core.sensors import ContactSensor, ForceTorqueSensor
from orbit_motion import AdmittanceConfig, HybridForceMotionConfig
from orbit_motion.full_ik import FullIk
from tests.motion.servo_world import BACKENDS, ENGINES, Held, held, wrench_on_hand

TOUCH = ContactSensorSpec(name="touch", entity="robot", links=("panda_link7", ".*finger"), rate=500.0)
TABLE = 0.3
"""m: height of the table's top."""


SIDE = 0.25
"""m: the rigid block is as far to the right of the arm as the plate on a spring is to the left."""
STIFFNESS = 4000.0
"""N/m of the spring."""
SLIPPERY = PhysicsMaterial(static_friction=0.0, dynamic_friction=0.0)
TOP = Shape(Box((0.12, 0.12, 0.05)), material=SLIPPERY)


def rigid() -> ObjectSpec:
    """A slippery block that does not move."""
    body = single_link("rigid", TOP, 10.0, np.eye(3))
    return ObjectSpec(name="rigid", articulation=body, fixed_base=True, pose=Pose((0.45, -SIDE, TABLE - 0.05)))


def compliant() -> ObjectSpec:
    """A slippery plate on a spring that lets it move up and down, at the rigid block's height under its own weight."""
    plate = Link("plate", mass=1.0, inertia=0.01 * np.eye(3), collisions=(TOP,))
    slide = Joint(
        "slide", JointType.PRISMATIC, "ground", "plate", lower_limit=-0.05, upper_limit=0.05,
        stiffness=STIFFNESS, rest_position=9.81 / STIFFNESS, damping=60.0,
    )  # fmt: skip
    ground = Link("ground", mass=1.0, inertia=plate.inertia)
    body = Articulation("compliant", links=(ground, plate), joints=(slide,))
    return ObjectSpec(name="compliant", articulation=body, fixed_base=True, pose=Pose((0.45, SIDE, TABLE - 0.05)))


def put_hand(arm: Held, pose: torch.Tensor) -> None:
    """Put the hand at poses (N, 7), and make it as slippery as what it touches, for a pair's larger friction holds."""
    robot = arm.robot
    solver = FullIk(
        KinematicTree(robot.spec.articulation), robot.spec.end_effector.frame, arm.generator.joints,
        robot.position_limits, robot.home_positions,
    )  # fmt: skip
    positions = robot.joint_positions.clone()
    positions[:, arm.generator.joints] = solver.solve(pose, positions).positions
    robot.set_joint_state(positions)
    robot.set_friction(torch.zeros(len(pose), len(robot.link_names)))


def above_the_tops(term: ActionTerm, backend: str, height: float) -> Held:
    """The hand points straight down, its finger tips that high above a rigid top, then above a compliant one."""
    arm = held(term, backend, objects=(rigid(), compliant()), sensors=(TOUCH,))
    put_hand(arm, torch.tensor([[0.45, side, TABLE + height, 0.0, 1.0, 0.0, 0.0] for side in (-SIDE, SIDE)]))
    return arm


@pytest.mark.parametrize(("backend", "axes"), [*zip(ENGINES, [None, "panda_hand_tcp"] * 2, strict=False)])
def test_the_hand_pushes_with_20_n_on_rigid_and_compliant_tops_while_it_draws_a_circle(
    backend: str, axes: str | None
) -> None:
    config = HybridForceMotionConfig(
        sensor="touch", axes=axes, position_scale=0.01, stiffness=400.0, rotational_stiffness=400.0
    )
    arm = above_the_tops(config, backend, 0.015)
    push = -1.0 if axes is None else 1.0  # the hand's own z points down
    arm.run(torch.tensor([0.0, 0.0, push, 0.0, 0.0, 0.0]), 360)
    radius, turns = 0.02, 140
    center = arm.hand()[:, :2] - torch.tensor([radius, 0.0])
    forces, misses = [], []
    touch = arm.world.sensors["touch"]
    assert isinstance(touch, ContactSensor)
    for step in range(turns + 10):
        angle = 2.0 * math.pi * step / turns
        dx, dy = (radius * 2.0 * math.pi / turns / 0.01 * part for part in (-math.sin(angle), math.cos(angle)))
        across = torch.tensor([dx, dy if axes is None else -dy])  # the hand's own y points back
        arm.run(torch.cat((across, torch.tensor([push, 0.0, 0.0, 0.0]))), 4)
        if step > 20:
            forces.append(touch.forces.sum(1)[:, 2].clone())
            misses.append((arm.hand()[:, :2] - center).norm(dim=1) - radius)
    assert (torch.stack(forces) - 20.0).square().mean(0).sqrt().max() < 1.0
    assert torch.stack(misses).abs().max() < 2e-3
    pressed = arm.world.objects["compliant"].joint_positions[:, 0]
    torch.testing.assert_close(pressed, torch.tensor([0.0, -20.0 / STIFFNESS]), rtol=0.0, atol=1.0 / STIFFNESS)
    arm.world.close()


@pytest.mark.parametrize("backend", BACKENDS[-1:])
def test_on_a_slope_the_hand_pushes_along_its_own_axis_and_slides_across(backend: str) -> None:
    angle = math.radians(25.0)
    turn = torch.tensor([[math.cos(0.5 * angle), 0.0, math.sin(0.5 * angle), 0.0]])  # about y
    down, normal = (quat_rotate(turn, torch.tensor([axis]))[0] for axis in ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    top = torch.tensor([0.45, 0.0, TABLE])
    place = Pose(tuple((top - 0.05 * normal).tolist()), tuple(turn[0].tolist()))
    body = single_link("slope", TOP, 10.0, np.eye(3))
    slope = ObjectSpec(name="slope", articulation=body, fixed_base=True, pose=place)
    config = HybridForceMotionConfig(
        sensor="touch", axes="panda_hand_tcp", position_scale=0.01, stiffness=400.0, rotational_stiffness=400.0
    )
    arm = held(config, backend, num_envs=1, objects=(slope,), sensors=(TOUCH,))
    facing = quat_multiply(turn, torch.tensor([[0.0, 1.0, 0.0, 0.0]]))
    put_hand(arm, torch.cat(((top + 0.015 * normal)[None], facing), 1))
    arm.run(torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), 360)
    start, touch = arm.hand()[:, :3], arm.world.sensors["touch"]
    assert isinstance(touch, ContactSensor)
    for step in range(60):
        arm.run(torch.tensor([0.06, 0.0, 1.0, 0.0, 0.0, 0.0]), 4)
        if step > 20:
            assert float(touch.forces.sum(1)[0] @ normal) == pytest.approx(20.0, abs=1.0)
    moved = (arm.hand()[:, :3] - start)[0]
    assert 0.025 < float(moved @ down) < 0.036  # it lags behind the 36 mm that were asked for
    assert abs(float(moved @ normal)) < 1e-3
    assert abs(float(moved[1])) < 1e-3
    arm.world.close()


@pytest.mark.parametrize(("backend", "engine_compensates"), [(BACKENDS[0], True), (BACKENDS[-1], False)])
def test_a_position_driven_arm_yields_by_force_over_stiffness(backend: str, engine_compensates: bool) -> None:
    wrist = ForceTorqueSpec(name="wrist", entity="robot", link="panda_link7")
    config = AdmittanceConfig(sensor="wrist", stiffness=400.0, rotational_stiffness=1e3, inertia=10.0)
    arm = held(config, backend, sensors=(wrist,), physics_dt=0.004, gravity_compensation=engine_compensates)
    start = arm.hand()
    arm.run(torch.zeros(6), 600)  # the drives sag under the arm's weight, which is no force on the hand
    home = arm.hand()
    assert (home - start)[:, :3].norm(dim=1).max() < 1e-3
    wrench_on_hand(arm, (6.0, 0.0, -8.0))
    expected, begin = torch.tensor([[0.015, 0.0, -0.02]] * 2), arm.world.clock.steps
    for steps in (20, 20, 40, 40):
        arm.run(torch.zeros(6), steps)
        turned = math.sqrt(400.0 / config.mass) * 0.004 * (arm.world.clock.steps - begin)
        share = 1.0 - (1.0 + turned) * math.exp(-turned)
        offset = arm.generator.memory()["offset"][:, :3]
        # The sensor feels as well what the load's acceleration takes: a mass of 1.5 kg beside the 4 asked for.
        torch.testing.assert_close(offset, share * expected, rtol=0.0, atol=3e-3)
        assert ((arm.hand() - home)[:, :3] - share * expected).norm(dim=1).max() < 8e-3
    arm.run(torch.zeros(6), 1080)
    yielded = (arm.hand() - home)[:, :3]
    torch.testing.assert_close(yielded, expected, rtol=0.0, atol=5e-4)
    arm.world.close()


@pytest.mark.parametrize("backend", ENGINES)
def test_a_wrist_feels_what_pushes_the_hand_and_not_the_weight_that_is_held_up(backend: str) -> None:
    wrist = ForceTorqueSpec(name="wrist", entity="robot", link="panda_link7", rate=250.0)
    arm = held(JointPositionConfig(), backend, sensors=(wrist,), physics_dt=0.004, gravity_compensation=True)
    link = arm.robot.link_names.index("panda_link7")
    sensor = arm.world.sensors["wrist"]
    assert isinstance(sensor, ForceTorqueSensor)
    for force in ((0.0, 0.0, 0.0), (3.0, -2.0, 5.0)):
        wrench_on_hand(arm, force)
        arm.run(torch.zeros(7), 160)
        felt = quat_rotate(arm.robot.link_poses[:, link, 3:], sensor.force)
        torch.testing.assert_close(felt, -torch.tensor([force] * 2), rtol=0.0, atol=0.1)
        if not any(force):
            assert sensor.torque.abs().max() < 0.02
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
