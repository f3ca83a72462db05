"""Inverse kinematics against two libraries that have nothing of ours: mink, on MuJoCo's own kinematics, and Pink, on
Pinocchio's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mink
import numpy as np
import pink
import pinocchio
import torch
from pink.limits import ConfigurationLimit, VelocityLimit

from orbit_core.actions.ik import damped_least_squares
from orbit_core.envs import make
from orbit_motion import PrioritizedIkConfig
from orbit_motion.mpc.predictive import pinocchio_model

MakeRobot = Callable[..., Any]


def test_damped_least_squares_move_joints_as_minks_do() -> None:
    env = make("Reach", num_envs=8, backend="mujoco")
    robot = env.world.robots["robot"]
    noise = torch.randn(8, len(robot.joint_names), generator=torch.Generator().manual_seed(2))
    arm = robot.find_joints("panda_joint[1-7]")
    chosen = robot.joint_positions.clone()
    chosen[:, arm] += 0.3 * noise[:, arm]
    robot.set_joint_state(chosen, torch.zeros_like(chosen))
    link = robot.link_names[7]
    errors = 1e-3 * torch.randn(8, 6, generator=torch.Generator().manual_seed(3))
    own = damped_least_squares(robot.jacobian(link, arm), errors, damping=0.05)
    configuration = mink.Configuration(env.world.engine.native[0])
    for positions, error, expected in zip(chosen.double().numpy(), errors.double().numpy(), own.numpy(), strict=True):
        configuration.update(positions)
        pose = configuration.get_transform_frame_to_world("link7", "body")
        task = mink.FrameTask("link7", "body", position_cost=1.0, orientation_cost=1.0)
        turned = mink.SO3.exp(error[3:]) @ pose.rotation()
        task.set_target(mink.SE3.from_rotation_and_translation(turned, pose.translation() + error[:3]))
        velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", damping=0.05**2, limits=[])
        np.testing.assert_allclose(expected, velocity[arm], atol=2e-5)
    env.close()


def reduced_model(robot: Any, generator: Any) -> tuple[pinocchio.Model, list[int]]:
    """Pinocchio's model of the joints that the generator moves, the frame "hand" that it moves, and their columns."""
    articulation = robot.spec.articulation
    model, ids = pinocchio_model(articulation)
    moved = [articulation.joint_names[joint] for joint in generator.joints]
    held, positions = [name for name in ids if name not in moved], pinocchio.neutral(model)
    for name in held:
        positions[model.joints[ids[name]].idx_q] = float(robot.home_positions[articulation.joint_names.index(name)])
    reduced = pinocchio.buildReducedModel(model, [ids[name] for name in held], positions)
    frame = articulation.frame(generator.frame)
    link = reduced.frames[reduced.getFrameId(frame.link)]
    w, x, y, z = frame.pose.orientation
    offset = pinocchio.SE3(pinocchio.Quaternion(w, x, y, z).matrix(), np.array(frame.pose.position))
    hand = pinocchio.Frame("hand", link.parentJoint, link.placement * offset, pinocchio.FrameType.OP_FRAME)
    reduced.addFrame(hand)
    return reduced, [reduced.joints[reduced.getJointId(name)].idx_v for name in moved]


def test_prioritized_steps_miss_the_hand_s_goal_hardly_more_than_pinks(kinematic_robot: MakeRobot) -> None:
    """20 poses, half of them at a joint's limit, with steps that the joints' speed bounds."""
    robot = kinematic_robot(num_envs=20)
    robot.root[:] = torch.tensor([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    generator = PrioritizedIkConfig(posture_gain=0.0, speed=0.1).build("ik", robot)
    random = np.random.default_rng(0)
    low, high = generator.lower_limits.double().numpy(), generator.upper_limits.double().numpy()
    positions = low + (high - low) * random.uniform(size=(20, 7))
    positions[::2, 0] = high[0] - 1e-3
    robot.q[:, generator.joints] = torch.as_tensor(positions).float()
    errors = 2e-3 * random.normal(size=(20, 6)) * (np.arange(20)[:, None] % 4 + 1)
    own = generator.solve(torch.as_tensor(errors).float()).double().numpy()

    model, columns = reduced_model(robot, generator)
    model.lowerPositionLimit[columns], model.upperPositionLimit[columns] = low, high
    model.velocityLimit[columns] = generator._step_limit.numpy()
    jacobians = generator.jacobian().double().numpy()
    weights = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    bound = 0
    for row, (jacobian, error, found) in enumerate(zip(jacobians, errors, own, strict=True)):
        start = np.zeros(model.nq)
        start[columns] = robot.q[row, generator.joints].double().numpy()
        configuration = pink.Configuration(model, model.createData(), start)
        pose = configuration.get_transform_frame_to_world("hand")
        task = pink.FrameTask("hand", position_cost=1.0, orientation_cost=0.5)
        task.set_target(pinocchio.SE3(pinocchio.exp3(error[3:]) @ pose.rotation, pose.translation + error[:3]))
        limits = [ConfigurationLimit(model, 0.5), VelocityLimit(model)]
        best = pink.solve_ik(
            configuration, [task], 1.0, solver="daqp", damping=generator.config.damping**2, limits=limits
        )[columns]  # fmt: skip

        def cost(step: np.ndarray, jacobian: np.ndarray = jacobian, error: np.ndarray = error) -> float:
            missing = weights * (jacobian @ step - error)
            return float(missing @ missing + generator.config.damping**2 * step @ step)

        at_limit = np.abs(np.abs(best) - generator._step_limit.numpy()) < 1e-6
        bound += int(at_limit.sum())
        assert cost(found) <= 1.12 * cost(best)
        np.testing.assert_allclose(found, best, atol=0.013)
    assert bound, "no step was bounded"
