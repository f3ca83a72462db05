"""Terms that many tasks share. The robot of a task is the scene's entity named ``robot``, unless an agent is named."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from orbit_core.dynamics.constants import constant
from orbit_core.dynamics.transforms import quat_multiply, quat_rotate_inverse, yaw_angle
from orbit_core.envs.environment import Environment
from orbit_core.envs.task import ROBOT
from orbit_core.envs.terms import (
    ENVIRONMENT,
    POSE,
    Bounds,
    EventFunction,
    ObservationGroup,
    TermFunction,
    means,
    measured_in,
    once_per_state,
)
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import gripper_positions
from orbit_core.scene import Plane, Pose, RobotSpec, Shape, Workspace
from orbit_core.scene.pose import Vector3


def floor(height: float = 0.0) -> Shape:
    """The ground plane."""
    return Shape(Plane(), Pose((0.0, 0.0, height)), color=(0.35, 0.38, 0.42, 1.0), name="floor")


def robot_of(world: World, agent: str = ROBOT) -> Robot:
    """The task's robot."""
    return world.robots[agent]


def workspace(world: World, agent: str = ROBOT) -> tuple[Vector3, Vector3]:
    """Lowest and highest corner of where the robot's hand reaches, in the environment's frame; its root stands upright.

    Raises:
        ConfigurationError: the robot has no workspace.
    """
    box = placed_workspace(world.robots[agent].spec)
    return box.low, box.high


def placed_workspace(spec: RobotSpec) -> Workspace:
    """Return where the hand of a robot reaches, in the environment's frame; the robot's root stands upright.

    Raises:
        ConfigurationError: the robot has no workspace: it was not made by :func:`arm`.
    """
    return workspace_of(spec).placed(spec.pose)


def workspace_of(spec: RobotSpec) -> Workspace:
    """Return where the hand of a robot reaches, in its root link's frame.

    Raises:
        ConfigurationError: the robot has no workspace: it was not made by :func:`arm`.
    """
    if spec.end_effector.workspace is None:
        raise ConfigurationError(
            f"robot '{spec.articulation.name}' has no workspace: take it through "
            "orbit_motion.workspace.with_workspace, or give its end effector one"
        )
    return spec.end_effector.workspace


def _joint_names(env: Environment, agent: str = ROBOT) -> Sequence[str]:
    return env.world.robots[agent].joint_names


def _home_positions(env: Environment, agent: str = ROBOT) -> Tensor:
    return env.world.robots[agent].home_positions


def _action_components(env: Environment, agent: str | None = None) -> Sequence[str]:
    return env.actions.components if agent is None else env.actions.components[env.actions.slices[agent]]


@means("measured position of each joint minus its home position", components=_joint_names, offset=_home_positions)
@measured_in("rad or m")
def joint_positions(env: Environment, agent: str = ROBOT) -> Tensor:
    """(N, J) relative to the home pose."""
    body = env.world.robots[agent]
    return body.joint_positions - body.home_positions


@means("measured velocity of each joint", components=_joint_names)
@measured_in("rad/s or m/s")
def joint_velocities(env: Environment, agent: str = ROBOT) -> Tensor:
    """(N, J)"""
    return env.world.robots[agent].joint_velocities


@means("temperature of each joint's motor windings, 25 where they are not described", components=_joint_names)
@measured_in("degrees Celsius")
def motor_temperatures(env: Environment, agent: str = ROBOT) -> Tensor:
    """(N, J) of the windings, 25 where a motor's are not described."""
    return env.world.robots[agent].motor_temperatures


@means(
    "action that was given at the last step, clipped to [-1, 1], before it is decoded; zero when an episode begins",
    components=_action_components,
)
@measured_in("1")
def last_action(env: Environment, agent: str | None = None) -> Tensor:
    """(N, A) the action in effect; an agent's own part of it where one is named."""
    return env.state.last_action if agent is None else env.state.last_action[:, env.actions.slices[agent]]


@means("pose of the end effector's frame", frame=ENVIRONMENT)
@measured_in(POSE)
@once_per_state
def hand_pose(env: Environment, agent: str = ROBOT) -> Tensor:
    """(N, 7) of the end effector, in the environment's frame."""
    robot = env.world.robots[agent]
    return robot.frame_pose(robot.spec.end_effector.frame)


@once_per_state
def hand_position(env: Environment, agent: str = ROBOT) -> Tensor:
    """(N, 3) of the end effector's origin, in the environment's frame, m."""
    robot = env.world.robots[agent]
    return robot.frame_position(robot.spec.end_effector.frame)


@functools.cache
def object_pose(name: str) -> TermFunction:
    """Make a term of the pose (N, 7) of an object, in the environment's frame."""

    @means(f"pose of the origin of '{name}'", frame=ENVIRONMENT)
    @measured_in(POSE)
    def pose(env: Environment) -> Tensor:
        return env.world.objects[name].root_pose

    return pose


class GripperOpening:
    """Opening of the robot's gripper; made once, in the ``start`` of a task's state.

    Raises:
        ConfigurationError: the robot has no end effector, or no gripper on it.
    """

    def __init__(self, world: World, agent: str = ROBOT) -> None:
        self._robot = robot_of(world, agent)
        opened, closed = _gripper_ends(self._robot.spec, "open")
        self._joints = torch.tensor(list(opened), device=world.device)
        self._closed = torch.tensor([closed[joint] for joint in opened], device=world.device)
        self._span = torch.tensor([opened[joint] for joint in opened], device=world.device) - self._closed

    def __call__(self) -> Tensor:
        """(N,) in [0, 1], 1 where it is open, the mean of its joints."""
        # An index_select, because indexing by a tensor costs more on few numbers.
        positions = self._robot.joint_positions.index_select(1, self._joints)
        return ((positions - self._closed) / self._span).clamp(0.0, 1.0).mean(1)

    def speed(self) -> Tensor:
        """(N,) 1/s, at which it opens or closes: that of its fastest joint."""
        return (self._robot.joint_velocities.index_select(1, self._joints) / self._span).abs().amax(1)


def closing_time(world: World, agent: str = ROBOT) -> float:
    """Seconds in which the gripper closes from its open position at its joints' velocity limits.

    Raises:
        ConfigurationError: the robot has no end effector, or no gripper on it.
    """
    spec = world.robots[agent].spec
    opened, closed = _gripper_ends(spec, "close")
    # The slowest joint decides, since a gripper is closed when all of its joints are.
    limits = [joint.velocity_limit for joint in spec.articulation.movable_joints]
    return max(abs(closed[joint] - opened[joint]) / limits[joint] for joint in opened)


def _gripper_ends(spec: RobotSpec, purpose: str) -> tuple[Mapping[int, float], Mapping[int, float]]:
    """Positions of the gripper's joints, by index, where it is open and where it is closed."""
    gripper = spec.end_effector.gripper
    if gripper is None:
        raise ConfigurationError(f"robot '{spec.name}' has no gripper that could {purpose}")
    opened, closed = gripper.open_position, gripper.closed_position
    return gripper_positions(spec, gripper, opened), gripper_positions(spec, gripper, closed)


def action_rate(env: Environment, agent: str | None = None) -> Tensor:
    """(N,) squared change of the action since the step before; of an agent's own part of it where one is named."""
    change = env.state.last_action - env.state.action_before
    return squared_norm(change if agent is None else change[:, env.actions.slices[agent]])


def action_size(env: Environment) -> Tensor:
    """(N,) sum of squared action."""
    return squared_norm(env.state.last_action)


def joint_effort(env: Environment, agent: str = ROBOT) -> Tensor:
    """(N,) sum of squared joint efforts."""
    return squared_norm(env.world.robots[agent].joint_efforts)


def joint_speed(env: Environment, agent: str = ROBOT) -> Tensor:
    """(N,) sum of squared joint velocities."""
    return squared_norm(env.world.robots[agent].joint_velocities)


def add_noise(group: ObservationGroup, **deviations: float) -> None:
    """Give some terms of an observation group white noise, by name; those that it does not show stay out."""
    for name, deviation in deviations.items():
        if (term := getattr(group, name, None)) is not None:
            setattr(group, name, replace(term, noise_std=deviation))


def squared_norm(vectors: Tensor) -> Tensor:
    """(N,) of vectors (N, k)."""
    return torch.linalg.vecdot(vectors, vectors)


def nearness(distance: Tensor, scale: float) -> Tensor:
    """(N,) ``1 - tanh(distance / scale)``: 1 at distance zero, falling to a quarter at ``scale``."""
    # The same function in one operation less; the sum doubles without a number of Python.
    half = torch.sigmoid(distance * constant(-2.0 / scale, distance.device))
    return half + half


def turned(yaw: Tensor) -> Tensor:
    """(n, 4) rotations about the vertical by ``yaw`` (n,)."""
    half = 0.5 * yaw
    zero = torch.zeros_like(yaw)
    return torch.stack((half.cos(), zero, zero, half.sin()), dim=1)


def standing(place: Tensor) -> Tensor:
    """(n, 7) poses of things that stand upright at ``place`` (n, 4): x, y and z in metres, and yaw in rad."""
    return torch.cat((place[:, :3], turned(place[:, 3])), dim=1)


def wrapped(angle: Tensor) -> Tensor:
    """The same angles in [-pi, pi]."""
    return torch.remainder(angle + math.pi, 2.0 * math.pi) - math.pi


def facing_down(yaw: Tensor) -> Tensor:
    """(n, 4) orientation of a hand that points down, its fingers opening along world y at ``yaw`` (n,) zero."""
    half = 0.5 * yaw
    zero = torch.zeros_like(yaw)
    # A half turn about x, then the yaw about z.
    return torch.stack((zero, half.cos(), half.sin(), zero), dim=1)


def turn_facing_down(orientation: Tensor) -> Tensor:
    """(n,) rad, up to whole turns: the yaw that :func:`facing_down` would need for orientations (n, 4) like its own."""
    return 2.0 * torch.atan2(orientation[:, 2], orientation[:, 1])


def pointing_down(position: Tensor) -> Tensor:
    """(N, 7) the hand at a position (N, 3), pointing down and not turned."""
    return torch.cat((position, facing_down(torch.zeros_like(position[:, 0]))), dim=1)


def leaning(env: Environment, pose: Tensor, agent: str = ROBOT) -> Tensor:
    """Return poses (N, 7) of a hand at square things, leaning as its arm needs; unchanged for most robots.

    Args:
        env: environment.
        pose: (N, 7) of the hand, pointing straight down. The quarter turn that suits the arm is taken.
        agent: robot, whose root stands upright.
    """
    robot = env.world.robots[agent]
    lean = robot.spec.end_effector.lean
    if lean is None:
        return pose
    way = quat_rotate_inverse(robot.root_pose[:, 3:], pose[:, :3] - robot.root_pose[:, :3])
    x, y, root = way[:, 0] - lean.pan[0], way[:, 1] - lean.pan[1], yaw_angle(robot.root_pose[:, 3:])
    wanted = turn_facing_down(pose[:, 3:]) - root
    seen, reach = torch.atan2(y, x), torch.hypot(x, y).clamp_min(1e-6)
    azimuth = seen
    yaw = wanted
    # The frame is off the plane of the arm by what its roll turns aside; two rounds leave less than 0.1 mrad.
    for _ in range(2):
        middle = azimuth + lean.turn
        yaw = middle + torch.remainder(wanted - middle + 0.25 * math.pi, 0.5 * math.pi) - 0.25 * math.pi
        turn = yaw - azimuth
        aside = lean.aside[0] * turn.sin() - lean.aside[1] * turn.cos()
        azimuth = seen - torch.asin((aside / reach).clamp(-1.0, 1.0))
    half, outward = 0.5 * (lean.angle + lean.rise * way[:, 2]), azimuth + root
    tilt = torch.stack(
        (half.cos(), half.sin() * outward.sin(), -half.sin() * outward.cos(), torch.zeros_like(half)), dim=1
    )
    return torch.cat((pose[:, :3], quat_multiply(tilt, facing_down(yaw + root))), dim=1)


def randomize_robot_start(spread: float, agent: str = ROBOT):
    """Event: joint positions around the home pose, uniform within ``spread`` (rad or m), inside the limits."""

    def randomize(env: Environment, env_ids: Tensor) -> None:
        robot = env.world.robots[agent]
        count = len(robot.joint_names)
        offset = env.world.random.uniform((count,), -spread, spread, env_ids)
        limits = robot.position_limits
        robot.set_joint_state((robot.home_positions + offset).clamp(limits[:, 0], limits[:, 1]), env_ids=env_ids)

    return randomize


def place_object(name: str, x: Bounds, y: Bounds, z: float, yaw: Bounds = (0.0, 0.0)) -> EventFunction:
    """Event: an object upright on a patch, uniform within ranges of x and y (m) and of yaw (rad), its origin at z."""

    def place(env: Environment, env_ids: Tensor) -> None:
        low, high = (x[0], y[0], z, yaw[0]), (x[1], y[1], z, yaw[1])
        # One draw for all numbers: an episode's stream does not depend on which of them are ranges.
        drawn = env.world.random.uniform((4,), low, high, env_ids)
        env.world.objects[name].set_root_pose(standing(drawn), env_ids)

    return place


def random_rotations(world: World, env_ids: Tensor | None) -> Tensor:
    """(n, 4) uniform over all rotations."""
    return rotations_of(world.random.uniform((3,), 0.0, (1.0, math.tau, math.tau), env_ids))


def rotations_of(drawn: Tensor) -> Tensor:
    """(n, 4) uniform over all rotations where numbers (n, 3) are uniform in [0, 1], [0, 2 pi] and [0, 2 pi].

    Shoemake, Uniform Random Rotations, Graphics Gems III (1992).
    """
    share, first, second = drawn.unbind(1)
    a, b = (1.0 - share).sqrt(), share.sqrt()
    return torch.stack((b * second.cos(), a * first.sin(), a * first.cos(), b * second.sin()), dim=1)


def stand_facing_anywhere(world: World, position: Tensor, env_ids: Tensor) -> None:
    """Put the task's robot to positions (n, 3) in the environments' frames, upright, facing anywhere."""
    yaw = world.random.uniform((), -torch.pi, torch.pi, env_ids)
    robot_of(world).set_root_pose(torch.cat((position, turned(yaw)), dim=1), env_ids)


def place_markers(world: World, names: Sequence[str], positions: Tensor, env_ids: Tensor | None = None) -> None:
    """Stand markers upright at positions (n, len(names), 3), one each, in the environments' frames."""
    poses = torch.zeros(*positions.shape[:2], 7, device=positions.device)
    poses[..., :3], poses[..., 3] = positions, 1.0
    for number, name in enumerate(names):
        world.markers[name].set_pose(poses[:, number], env_ids)
