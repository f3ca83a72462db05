"""Motion generators one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from orbit_core.actions import (
    ActionTerm,
    CommandMode,
    DifferentialIk,
    DifferentialIkConfig,
    IkMethod,
    JointEffort,
    JointEffortConfig,
    JointPosition,
    JointPositionConfig,
    JointVelocity,
    JointVelocityConfig,
    joint_delta,
)
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.dynamics.transforms import pose_error, pose_multiply
from orbit_core.interfaces import ConfigurationError
from orbit_motion import CartesianImpedanceConfig, HybridForceMotionConfig, PrioritizedIkConfig, RmpFlowConfig
from orbit_motion.full_ik import FullIkTermConfig
from tests.motion.servo_world import BACKENDS, held

MakeRobot = Callable[..., Any]


def _random(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(3))


@pytest.mark.parametrize("method", [IkMethod.PSEUDO_INVERSE, IkMethod.SVD_ADAPTIVE])
def test_exact_methods_solve_regular_systems(method: IkMethod) -> None:
    jacobian, error = _random(8, 6, 9), 0.1 * _random(8, 6)
    delta = joint_delta(method, jacobian, error, singular_threshold=1e-3)
    torch.testing.assert_close((jacobian @ delta[..., None]).squeeze(-1), error, atol=1e-5, rtol=1e-4)


def test_damped_least_squares_is_the_minimiser() -> None:
    jacobian, error, damping = _random(8, 6, 7), _random(8, 6), 0.3
    delta = joint_delta(IkMethod.DAMPED_LEAST_SQUARES, jacobian, error, damping)
    gradient = (
        jacobian.transpose(1, 2) @ (jacobian @ delta[..., None] - error[..., None]) + damping**2 * delta[..., None]
    )
    assert gradient.abs().max() < 1e-4


@pytest.mark.parametrize("method", [IkMethod.DAMPED_LEAST_SQUARES, IkMethod.SVD_ADAPTIVE, IkMethod.TRANSPOSE])
def test_singular_jacobians_give_bounded_steps(method: IkMethod) -> None:
    jacobian = _random(8, 6, 7)
    jacobian[:, 5] = 1e-6 * jacobian[:, 4]
    error, damping = _random(8, 6), 0.1
    # No singular value s amplifies by more than s / (s^2 + damping^2) <= 1 / (2 damping).
    assert (joint_delta(method, jacobian, error, damping).norm(dim=-1) <= error.norm(dim=-1) / (2 * damping)).all()


def test_transpose_never_increases_the_error() -> None:
    jacobian, error = _random(16, 6, 7), _random(16, 6)
    delta = joint_delta(IkMethod.TRANSPOSE, jacobian, error)
    left = error - (jacobian @ delta[..., None]).squeeze(-1)
    assert (left.norm(dim=-1) < error.norm(dim=-1)).all()


@pytest.mark.parametrize("method", list(IkMethod))
def test_relative_ik_moves_the_hand_by_the_command(kinematic_robot: MakeRobot, method: IkMethod) -> None:
    robot = kinematic_robot()
    config = DifferentialIkConfig(method=method, position_scale=0.002, rotation_scale=0.01, damping=0.01)
    generator = DifferentialIk("ik", robot, config)
    before = robot.frame_pose(generator.frame)[:, :3].clone()
    command = torch.eye(4, 6)
    targets = generator.compute({"command": command})["position_targets"]
    robot.set_position_targets(targets, generator.joints)
    moved = robot.frame_pose(generator.frame)[:, :3] - before
    along = (moved[:3] * command[:3, :3]).sum(-1)
    assert (along > (0.0 if method is IkMethod.TRANSPOSE else 0.0019)).all()


def test_absolute_ik_command_is_a_pose_in_the_root_frame(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    generator = DifferentialIk("ik", robot, DifferentialIkConfig(mode=CommandMode.ABSOLUTE, position_scale=0.4))
    home = robot.frame_pose(generator.frame)
    ahead = torch.tensor([0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]).expand(4, 7)
    root = robot.root_pose
    local = pose_multiply(torch.cat((-torch.zeros(4, 3), root[:, 3:]), -1), ahead)[:, :3]
    wanted = torch.cat((home[:, :3] + local, home[:, 3:]), -1)
    command = generator.encode(wanted, torch.ones(4, dtype=torch.bool))
    torch.testing.assert_close(command, torch.tensor([[0.25, 0, 0, 0, 0, 0]]).expand(4, 6), atol=1e-5, rtol=0)


def test_large_steps_are_scaled_down_as_a_whole(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    command = torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).expand(4, 6)
    deltas = []
    for step in (0.02, 10.0):
        config = DifferentialIkConfig(position_scale=0.1, max_joint_step=step)
        generator = DifferentialIk("ik", robot, config)
        deltas.append(generator.compute({"command": command})["position_targets"] - generator.positions)
    assert deltas[0].abs().amax() == pytest.approx(0.02, abs=1e-5)
    torch.testing.assert_close(deltas[0] / deltas[0].norm(), deltas[1] / deltas[1].norm(), atol=1e-3, rtol=1e-3)


def test_limit_mapping_spans_lower_home_upper(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    generator = JointPosition("joints", robot, JointPositionConfig(scale=None))
    for value, expected in ((-1.0, generator.lower_limits), (1.0, generator.upper_limits)):
        targets = generator.compute({"command": torch.full((4, 7), value)})["position_targets"]
        torch.testing.assert_close(targets, expected.expand(4, 7))
        torch.testing.assert_close(generator.encode_positions(targets), torch.full((4, 7), value))


def test_relative_targets_accumulate_and_start_from_the_measured_positions(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    generator = JointPosition("joints", robot, JointPositionConfig(scale=0.1, mode=CommandMode.INTEGRATED))
    start = robot.q[:, :7].clone()
    for _ in range(2):
        targets = generator.compute({"command": torch.full((4, 7), 0.5)})["position_targets"]
    torch.testing.assert_close(targets, start + 0.1)
    generator.reset(torch.tensor([1]))
    robot.q[1, :7] += 0.3  # an event after the reset
    targets = generator.compute({"command": torch.zeros(4, 7)})["position_targets"]
    torch.testing.assert_close(targets, start + torch.tensor([[0.1], [0.3], [0.1], [0.1]]))


@pytest.mark.parametrize("mode", list(CommandMode))
def test_at_the_velocity_limit_a_speed_limited_drive_pushes_no_more(
    kinematic_robot: MakeRobot, mode: CommandMode
) -> None:
    robot = kinematic_robot()
    config = JointPositionConfig(scale=3.0, mode=mode, limit_speed=True)
    generator = JointPosition("joints", robot, config)
    (drive,) = (group for group in robot.spec.actuators if "panda_joint[1-7]" in group.joints)
    targets = generator.compute({"command": torch.full((4, 7), 1.0)})["position_targets"]
    limits = torch.tensor([joint.velocity_limit for joint in robot.joints[:7]])
    effort = drive.stiffness * (targets - generator.positions) - drive.damping * limits
    assert (effort < 1e-3).all()
    free = targets < generator.upper_limits - 1e-3
    assert free.any()
    assert (effort[free] > -1e-3).all()


@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_a_speed_limit_takes_no_effort_from_a_weakly_damped_drive(kinematic_robot: MakeRobot, damping: float) -> None:
    robot = kinematic_robot()
    drives = tuple(replace(group, damping=damping) for group in robot.spec.actuators)
    robot._spec = replace(robot.spec, actuators=drives)
    generator = JointPosition("joints", robot, JointPositionConfig(scale=3.0, limit_speed=True))
    targets = generator.compute({"command": torch.full((4, 7), 1.0)})["position_targets"]
    free = targets < generator.upper_limits - 1e-3
    limits = torch.tensor([joint.effort_limit for joint in robot.joints[:7]]).expand(4, 7)
    assert free.any()
    assert (drives[0].stiffness * (targets - generator.positions)[free] > limits[free] - 1e-3).all()


def test_relative_joint_positions_need_a_scale(kinematic_robot: MakeRobot) -> None:
    with pytest.raises(ConfigurationError, match="scale"):
        JointPosition("joints", kinematic_robot(), JointPositionConfig(scale=None, mode=CommandMode.INTEGRATED))


def test_velocity_commands_scale(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    generator = JointVelocity("joints", robot, JointVelocityConfig(joints=("panda_joint[13]",), scale=2.0))
    outputs = generator.compute({"command": torch.tensor([[0.5, -1.0]]).expand(4, 2)})
    assert outputs["velocity_targets"][0].tolist() == [1.0, -2.0]
    torch.testing.assert_close(outputs["position_targets"], robot.q[:, [0, 2]])


@pytest.mark.parametrize("config", [JointVelocityConfig, JointEffortConfig])
def test_changes_of_velocity_or_effort_start_from_what_is_measured(kinematic_robot: MakeRobot, config: Any) -> None:
    robot = kinematic_robot()
    joints = ("panda_joint[13]",)
    measured = torch.tensor([[0.4, -0.2]] * 4)
    robot.v[:, [0, 2]], robot.efforts[:, [0, 2]] = measured, measured
    half = torch.full((4, 2), 0.5)
    for mode, steps in ((CommandMode.ABSOLUTE, 0.0), (CommandMode.RELATIVE, 1.0), (CommandMode.INTEGRATED, 2.0)):
        generator = config(joints=joints, scale=0.2, mode=mode).build("it", robot)
        for _ in range(2):
            outputs = generator.compute({"command": half})
        targets = outputs["velocity_targets" if config is JointVelocityConfig else "effort_targets"]
        expected = {0.0: half * 0.2, 1.0: measured + 0.1, 2.0: measured + 0.2}[steps]
        torch.testing.assert_close(targets, expected)
    for _ in range(200):
        targets = generator.compute({"command": torch.ones(4, 2)})[[*outputs][-1]]
    limit = "velocity_limit" if config is JointVelocityConfig else "effort_limit"
    ends = [getattr(robot.joints[j], limit) for j in (0, 2)]
    torch.testing.assert_close(targets, torch.tensor([ends]).expand(4, 2).clamp(max=40.3), atol=0.5, rtol=0.0)


def test_efforts_scale_with_the_joints_limits(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    generator = JointEffort("joints", robot, JointEffortConfig())
    outputs = generator.compute({"command": torch.full((4, 7), -0.5)})
    limits = torch.tensor([joint.effort_limit for joint in robot.joints[:7]])
    torch.testing.assert_close(outputs["effort_targets"], (-0.5 * limits).expand(4, 7))
    torch.testing.assert_close(outputs["position_targets"], robot.q[:, :7])


def test_unlimited_efforts_need_a_scale(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    unlimited = replace(robot.joints[2], effort_limit=float("inf"))
    joints = tuple(unlimited if joint is robot.joints[2] else joint for joint in robot.joints)
    robot._spec = replace(robot.spec, articulation=replace(robot.spec.articulation, joints=joints))
    with pytest.raises(ConfigurationError, match=unlimited.name):
        JointEffort("joints", robot, JointEffortConfig())


def test_encoded_efforts_bring_the_hand_to_a_pose(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    generator = JointEffort("joints", robot, JointEffortConfig())
    model = RigidBodyModel(robot.spec.articulation, fixed_base=True, gravity=(0.0, 0.0, 0.0))
    frame, dt, arm = robot.spec.end_effector.frame, 0.02, slice(0, 7)
    goal = robot.frame_pose(frame).clone()
    goal[:, :3] += torch.tensor([[0.1, 0.0, -0.1], [-0.05, 0.1, 0.1], [0.0, -0.15, 0.05], [0.05, 0.1, 0.0]])
    for _ in range(80):
        command = generator.encode(goal, torch.ones(4, dtype=torch.bool))
        efforts = generator.compute({"command": command})["effort_targets"]
        poses = robot.link_poses
        bias = model.bias_forces(poses, robot.root_velocity, robot.v)[:, arm]
        robot.v[:, arm] += dt * torch.linalg.solve(model.mass_matrix(poses)[:, arm, arm], efforts - bias)
        robot.q[:, arm] += dt * robot.v[:, arm]
    assert pose_error(robot.frame_pose(frame), goal).abs().max() < 5e-3


@pytest.mark.parametrize(
    ("config", "fields", "told"),
    [
        (DifferentialIkConfig, {"position_scale": -0.1}, "position_scale is -0.1: give a number above zero"),
        (DifferentialIkConfig, {"damping": -1.0}, "damping is -1: give a number not below zero"),
        (FullIkTermConfig, {"seeds": 0}, "seeds is 0: give a number above zero"),
        (HybridForceMotionConfig, {"force_scale": -1.0}, "force_scale is -1: give a number above zero"),
        (JointPositionConfig, {"scale": 0.0}, "scale is 0: give a number above zero"),
        (PrioritizedIkConfig, {"posture_gain": -1.0}, "posture_gain is -1: give a number not below zero"),
        (RmpFlowConfig, {"max_lead": 0.0}, "max_lead is 0: give a number above zero"),
    ],
)
def test_values_that_mean_nothing_are_refused_at_once(
    config: type[ActionTerm], fields: dict[str, float], told: str
) -> None:
    with pytest.raises(ConfigurationError, match=f"{config.__name__}: {told}"):
        config(**fields)


def test_gains_that_diverge_are_refused() -> None:
    for config, told in (
        (RmpFlowConfig(goal_gain=1e6), r"a gain of 1e\+06 is unstable in steps of 0.002 s: take at most 1.7e\+05"),
        (HybridForceMotionConfig(force_damping=1e6), r"a force_damping of 1e\+06 .* is unstable"),
        (CartesianImpedanceConfig(posture_stiffness=1e7), r"a posture_stiffness of 1e\+07 is unstable"),
    ):
        with pytest.raises(ConfigurationError, match=told):
            held(config, BACKENDS[0])
