"""From readings of a device to actions, whatever motion generators the action is made of."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces import ConfigurationError, Robot, UnknownNameError
from orbit_core.motion.pose_command import displaced
from orbit_core.teleoperation.device import Event, Reading

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_core.motion import MotionGenerator

_LEADS = (0.1, 0.5)
"""m and rad by which the pose that is asked for may lead the measured one."""
_JOINT_LEAD = 0.2
"""rad or m, likewise of joints."""
_BASE = ("forward", "left", "turn")


class Driver:
    """Drives the robots of one environment by readings.

    A twist moves the pose that is wanted of the robot's first end effector; a pose is that pose; joint values are
    followed by joint spaces, and by their hand's pose in all others. Components of the action called forward, left and
    turn are a base's. Whoever is not driven holds still.

    Args:
        environment: with a single environment.

    Raises:
        ConfigurationError: there are several environments, or nothing that a person could drive.
    """

    def __init__(self, environment: Environment) -> None:
        if environment.num_envs != 1:
            raise ConfigurationError(f"a person drives one environment, not {environment.num_envs}: num_envs=1")
        self._dt = environment.step_dt
        self._parts: list[tuple[MotionGenerator, str, list[int] | None]] = []
        """Each generator, its robot's name, and the base's components that it takes, by place."""
        for (name, term), generator in zip(
            environment.actions.terms.items(), environment.actions.generators, strict=True
        ):
            components = term.components(generator.robot.spec, name)
            base = [_BASE.index(each) for each in components] if {*components} <= {*_BASE} else None
            self._parts.append((generator, generator.robot.spec.name, base))
        robots = {name: generator.robot for generator, name, _ in self._parts}
        self.hands = {name: Hand(robot) for name, robot in robots.items() if robot.spec.end_effectors}
        """By the name of the robot."""
        based = {name for _, name, base in self._parts if base is not None}
        self.robots = tuple(name for name in robots if name in self.hands or name in based)
        """Names of the robots that can be driven."""
        lost = [name for name, robot in robots.items() if name not in self.robots and robot.spec.articulation.joints]
        if not self.robots:
            raise ConfigurationError(
                f"no device can drive {', '.join(map(repr, lost or robots))}: it has no end effector, and the action "
                "space no base; choose another, such as --action locomotion for a walking robot"
            )
        self.active = self.robots[0]
        """Name of the robot that readings drive."""

    @property
    def hand(self) -> Hand | None:
        """Of the active robot."""
        return self.hands.get(self.active)

    def restart(self) -> None:
        """Everything holds where it is, grippers open: an episode has begun."""
        for hand in self.hands.values():
            hand.hold()
            hand.gripper_open = True

    def act(self, reading: Reading) -> Tensor:
        """(1, A) the action that does what is asked for.

        Raises:
            UnknownNameError, ConfigurationError: joint values of other joints than the robot's, or of a robot without
                end effector.
        """
        if Event.NEXT in reading.events:
            self.active = self.robots[(self.robots.index(self.active) + 1) % len(self.robots)]
        if self.hand is not None:
            self.hand.take(reading, self._dt)
        elif reading.joints is not None:
            raise ConfigurationError(f"robot '{self.active}' has no arm that joint values could move")
        commands = []
        for generator, name, base in self._parts:
            if base is not None:
                asked = reading.base if name == self.active else (0.0, 0.0, 0.0)
                commands.append(torch.tensor([[asked[place] for place in base]], device=generator.device))
            elif name in self.hands:
                commands.append(self.hands[name].encode(generator))
            else:
                commands.append(torch.zeros(1, generator.command_size, device=generator.device))
        return torch.cat(commands, 1).clamp(-1.0, 1.0)


class Hand:
    """What is wanted of one robot's first end effector, and of its gripper.

    Args:
        robot: in one environment.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.frame = robot.spec.end_effector.frame
        self.gripper_open = True
        self._tree = KinematicTree(robot.spec.articulation, robot.joint_positions.device)
        self.target = self.measured
        """(1, 7)"""
        self._joints: Tensor | None = None
        """(1, J) what is wanted of all joints, where a device says so."""

    @property
    def measured(self) -> Tensor:
        """(1, 7) the end effector's pose."""
        return self.robot.frame_pose(self.frame).clone()

    def hold(self) -> None:
        """Want what is."""
        self.target, self._joints = self.measured, None

    def take(self, reading: Reading, dt: float) -> None:
        """Take over what a reading asks for, over ``dt`` seconds."""
        if reading.gripper_open is not None:
            self.gripper_open = reading.gripper_open
        if reading.events.count(Event.GRIPPER) % 2:
            self.gripper_open = not self.gripper_open
        if reading.joints is not None:
            self._take_joints(reading)
        elif reading.pose is not None:
            pose = torch.tensor([reading.pose], dtype=torch.float32, device=self.target.device)
            self.target = torch.cat((pose[:, :3], torch.nn.functional.normalize(pose[:, 3:], dim=1)), 1)
            self._joints = None
        elif reading.twist is not None and any(reading.twist):
            twist = torch.tensor([reading.twist], dtype=torch.float32, device=self.target.device)
            measured = self.measured
            # A hand that is held back does not gather a debt.
            led = _shortened(pose_error(measured, displaced(self.target, twist * dt)))
            self.target, self._joints = displaced(measured, led), None

    def encode(self, generator: MotionGenerator) -> Tensor:
        """(1, k) the command of a generator that comes nearest to what is wanted."""
        opened = torch.tensor([self.gripper_open], device=self.target.device)
        measured = self.measured
        if self._joints is None:
            return generator.encode(displaced(measured, _shortened(pose_error(measured, self.target))), opened)
        here = self.robot.joint_positions
        way = self._joints - here
        positions = here + way * (_JOINT_LEAD / way.abs().amax(1, keepdim=True).clamp_min(_JOINT_LEAD))
        return generator.encode_posture(positions, self._pose_at(positions), opened)

    def _take_joints(self, reading: Reading) -> None:
        names = self.robot.joint_names
        wanted = self.robot.joint_positions.clone() if self._joints is None else self._joints.clone()
        for name, value in (reading.joints or {}).items():
            if name not in names:
                raise UnknownNameError("joint", name, names)
            if not math.isfinite(value):
                raise ConfigurationError(f"the device wants joint '{name}' at {value}, which is no position")
            wanted[:, names.index(name)] = value
        self._joints = wanted
        self.target = self._pose_at(wanted)

    def _pose_at(self, positions: Tensor) -> Tensor:
        """(1, 7) the end effector's pose, were the joints at ``positions`` (1, J)."""
        return self._tree.frame_pose(self._tree.forward(self.robot.root_pose, positions), self.frame)


def _shortened(displacement: Tensor) -> Tensor:
    """(1, 6) metres and radians, each no longer than may be led by."""
    parts = displacement.view(1, 2, 3)
    leads = torch.tensor(_LEADS, device=parts.device).view(1, 2, 1)
    lengths = torch.linalg.vector_norm(parts, dim=-1, keepdim=True)
    return (parts * (leads / lengths.clamp_min(1e-9)).clamp(max=1.0)).view(1, 6)
