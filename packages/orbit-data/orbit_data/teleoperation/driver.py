"""Driver: converts readings of a device to joint positions, hand poses and grips, and these to actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.actions import MotionGenerator, driven_joints
from orbit_core.actions.grippers import gripper_positions
from orbit_core.actions.ik import PoseFollower, displaced, towards_pose
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error, pose_inverse, pose_multiply
from orbit_core.interfaces import ConfigurationError, Robot, UnknownNameError
from orbit_core.scene import EndEffector
from orbit_data.teleoperation.device import Event, Reading

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

# Limits in m and rad of the lead of the requested pose over the measured one. A longer lead would make a hand that was
# held back jump once it is free.
_LEADS = (0.1, 0.5)
# Limit in rad or m of the same lead of joints.
_JOINT_LEAD = 0.2


class Hand:
    """Target of one end effector and its gripper.

    Args:
        robot: robot in one environment.
        effector: one of the robot's end effectors.
    """

    def __init__(self, robot: Robot, effector: EndEffector) -> None:
        self.robot, self.effector = robot, effector
        self.frame = effector.frame
        """Frame of the robot that the target is for."""
        gripper = effector.gripper
        self.arm = _driven(robot, effector.arm_joints)
        """Indices of the joints that move the end effector."""
        self.fingers = _driven(robot, gripper.joints if gripper else ())
        """Indices of its gripper's joints."""
        self.gripper_open = True
        """Wanted state of the gripper; open at first."""
        self.by_joints = False
        """True if joint values were requested, and the pose follows from them."""
        self.target = self.measured
        """Target pose (1, 7)."""

    @property
    def measured(self) -> Tensor:
        """Measured pose (1, 7) of the end effector."""
        return self.robot.frame_pose(self.frame).clone()

    @property
    def led(self) -> Tensor:
        """Pose (1, 7) on the way to the target, within the allowed lead of the measured pose."""
        measured = self.measured
        return displaced(measured, _shortened(pose_error(measured, self.target)))

    def move(self, twist: Sequence[float], dt: float) -> None:
        """Move the target.

        Args:
            twist: six numbers in m/s and rad/s, in world axes.
            dt: seconds for which the target moves.
        """
        displacement = dt * torch.tensor([twist], dtype=torch.float32, device=self.target.device)
        measured = self.measured
        # The lead is limited here too, so that a hand that is held back does not have to catch up later.
        self.target = displaced(measured, _shortened(pose_error(measured, displaced(self.target, displacement))))
        self.by_joints = False

    def place(self, pose: Sequence[float]) -> None:
        """Set the target to a pose: position and quaternion (w, x, y, z) of any length except zero."""
        target = torch.tensor([pose], dtype=torch.float32, device=self.target.device)
        self.target = torch.cat((target[:, :3], torch.nn.functional.normalize(target[:, 3:], dim=1)), 1)
        self.by_joints = False

    def grip(self) -> Tensor:
        """Return the positions (1, k) of the gripper's joints, open or closed."""
        gripper = self.effector.gripper
        assert gripper is not None
        value = gripper.open_position if self.gripper_open else gripper.closed_position
        positions = gripper_positions(value, gripper.joints, self.fingers, self.robot.spec, self.frame)
        return torch.tensor([positions], device=self.target.device)


class Body:
    """Targets of all joints of one robot, and of its hands. Joints without requests hold their positions.

    Args:
        robot: robot in one environment.
        effectors: the robot's end effectors that the action moves.
        carried: whether the base is driven, and moves the target poses with it.
    """

    def __init__(self, robot: Robot, effectors: Sequence[EndEffector], carried: bool) -> None:
        self.robot = robot
        self.hands = tuple(Hand(robot, effector) for effector in effectors)
        """Targets of the end effectors, in their order."""
        self._tree = KinematicTree(robot.spec.articulation, robot.joint_positions.device)
        self._carried = carried
        self.hold()

    def hold(self) -> None:
        """Set all targets to the measured state, with open grippers."""
        self._posture = self.robot.joint_positions.clone()
        self._base = self._base_pose()
        for hand in self.hands:
            hand.target, hand.by_joints, hand.gripper_open = hand.measured, False, True

    def carry(self) -> None:
        """Move the target poses with a driven base."""
        if not self._carried:
            return
        base = self._base_pose()
        moved = pose_multiply(base, pose_inverse(self._base))
        for hand in self.hands:
            hand.target = pose_multiply(moved, hand.target)
        self._base = base

    def take(self, reading: Reading, hand: Hand, dt: float) -> None:
        """Apply a reading to a hand and to joints.

        Args:
            reading: reading of the device.
            hand: hand that the person drives.
            dt: seconds that the reading lasts.

        Raises:
            UnknownNameError: the reading names a joint that the robot does not have.
        """
        opened = hand.gripper_open if reading.gripper_open is None else reading.gripper_open
        opened ^= reading.events.count(Event.GRIPPER) % 2 == 1  # two presses within one step cancel
        if opened != hand.gripper_open:
            hand.gripper_open = opened
            if hand.fingers:
                self._posture[:, hand.fingers] = hand.grip()
        if reading.joints is not None:
            self._take_joints(reading)
        elif reading.pose is not None:
            hand.place(reading.pose)
        elif reading.twist is not None and any(reading.twist):
            hand.move(reading.twist, dt)

    def encode(self, generator: MotionGenerator, hand: Hand | None) -> Tensor:
        """Compute the command (1, k) of a generator that comes nearest to the targets.

        Args:
            generator: generator of a part of the action.
            hand: hand that the generator moves; None if it moves none.
        """
        if (encode := getattr(generator, "encode_positions", None)) is not None:
            return encode(self._positions()[:, generator.joints])
        if hand is None:
            return torch.zeros(1, generator.command_size, device=generator.device)
        opened = torch.tensor([hand.gripper_open], device=generator.device)
        positions = self._positions()
        pose = self._pose_at(hand, positions) if hand.by_joints else hand.led
        return generator.encode_posture(positions, pose, opened)

    def _take_joints(self, reading: Reading) -> None:
        names = self.robot.joint_names
        values = dict(reading.joints or {})
        for name in values:
            if name not in names:
                raise UnknownNameError("joint", name, names)
        asked = {names.index(name): value for name, value in values.items()}
        for hand in self.hands:
            # The arm's other joints start from where they are: their last targets may be old.
            if not hand.by_joints and not asked.keys().isdisjoint(hand.arm):
                self._posture[:, hand.arm] = self.robot.joint_positions[:, hand.arm]
                hand.by_joints = True
        wanted = torch.tensor([*asked.values()], device=self._posture.device)
        low, high = self.robot.position_limits[[*asked]].unbind(1)
        self._posture[:, [*asked]] = wanted.clamp(low, high)
        for hand in self.hands:
            if hand.by_joints:
                hand.target = self._pose_at(hand, self._posture)

    def _positions(self) -> Tensor:
        """Return target positions (1, J) of all joints, within the allowed lead of the measured ones."""
        here = self.robot.joint_positions
        wanted = self._posture.clone()
        # Arms whose pose was requested follow it by inverse kinematics; other joints go straight to their values.
        led = [hand for hand in self.hands if hand.arm and not hand.by_joints]
        for hand in led:
            wanted[:, hand.arm] = here[:, hand.arm] + towards_pose(self.robot, hand.arm, hand.led)
        others = {*range(wanted.shape[1])}.difference(
            *(hand.arm for hand in led), *(hand.fingers for hand in self.hands)
        )
        rest = sorted(others)
        way = wanted[:, rest] - here[:, rest]
        if rest:
            # One factor for all joints, so that they move along a straight line and arrive together.
            wanted[:, rest] = here[:, rest] + way * (_JOINT_LEAD / way.abs().amax(1, keepdim=True)).clamp(max=1.0)
        return wanted

    def _pose_at(self, hand: Hand, positions: Tensor) -> Tensor:
        """Compute the end effector's pose (1, 7) at joint ``positions`` (1, J)."""
        return self._tree.frame_pose(self._tree.forward(self.robot.root_pose, positions), hand.frame)

    def _base_pose(self) -> Tensor:
        return self.robot.frame_pose(self.robot.spec.base_link).clone()


def _driven(robot: Robot, patterns: Sequence[str]) -> list[int]:
    """Return indices of the joints with those names that have their own actuators."""
    driven = {*driven_joints(robot.spec)}
    return [joint for joint in robot.find_joints(*patterns) if joint in driven] if patterns else []


def _shortened(displacement: Tensor) -> Tensor:
    """Shorten a displacement (1, 6) in m and rad to the allowed leads."""
    parts = displacement.view(1, 2, 3)
    leads = torch.tensor(_LEADS, device=parts.device).view(1, 2, 1)
    lengths = torch.linalg.vector_norm(parts, dim=-1, keepdim=True)
    return (parts * (leads / lengths.clamp_min(1e-9)).clamp(max=1.0)).view(1, 6)


_BASE = ("forward", "left", "turn")


@dataclass(frozen=True)
class _Part:
    """Part of the action."""

    generator: MotionGenerator
    robot: str
    base: tuple[int, ...] | None
    """Indices of a base's components that the generator takes; None if it moves no base."""
    frame: str | None
    """Frame of the first end effector that the generator moves; None if it moves none."""


class Driver:
    """Driver of the robots of one environment by readings.

    A twist moves the target pose of one end effector; a pose sets it. Joint spaces follow joint values, and all other
    spaces the hand's pose at these values. Components of the action called forward, left and turn belong to a base, and
    a driven base moves the target poses with it. Everything else holds still. ``Event.NEXT`` switches to the next end
    effector, of the same robot or another.

    Args:
        environment: a single environment.

    Raises:
        ConfigurationError: there are several environments, or nothing that a person could drive.
    """

    def __init__(self, environment: Environment) -> None:
        if environment.num_envs != 1:
            raise ConfigurationError(f"a person drives one environment, not {environment.num_envs}: num_envs=1")
        self._dt = environment.step_dt
        self._parts: list[_Part] = []
        robots: dict[str, Robot] = {}
        effectors: dict[str, list[EndEffector]] = {}
        terms = environment.actions.terms.items()
        for (term_name, term), generator in zip(terms, environment.actions.generators, strict=True):
            spec = generator.robot.spec
            components = term.components(spec, term_name)
            base = tuple(_BASE.index(each) for each in components) if {*components} <= {*_BASE} else None
            moved = [] if base is not None else _moved_by(generator)
            robots[spec.name] = generator.robot
            found = effectors.setdefault(spec.name, [])
            found += [each for each in moved if each not in found]
            self._parts.append(_Part(generator, spec.name, base, moved[0].frame if moved else None))
        based = {part.robot for part in self._parts if part.base is not None}
        self._bodies = {n: Body(robot, _in_order(robot, effectors[n]), n in based) for n, robot in robots.items()}
        self.hands: dict[str, Hand] = {}
        """Hands by the name of their robot, or by the robot's and the frame's names if a robot has several."""
        choices: dict[str, str] = {}
        for name, body in self._bodies.items():
            own = {name if len(body.hands) == 1 else f"{name} {hand.frame}": hand for hand in body.hands}
            self.hands |= own
            choices |= dict.fromkeys(own or ([name] if name in based else []), name)
        self._robot_of = choices
        self.choices = tuple(choices)
        """Names of the choices that can be driven in turn: end effectors with their robots' bases, or only bases."""
        if not self.choices:
            lost = [name for name, robot in robots.items() if robot.spec.articulation.joints]
            raise ConfigurationError(
                f"no device can drive {', '.join(map(repr, lost or robots))}: the action space moves no end effector "
                "and no base; choose another, such as --action locomotion for a walking robot"
            )
        self.active = self.choices[0]
        """Name of the choice that readings drive."""

    @property
    def hand(self) -> Hand | None:
        """End effector that readings drive."""
        return self.hands.get(self.active)

    def restart(self) -> None:
        """Hold everything where it is, with open grippers, because an episode has begun."""
        for body in self._bodies.values():
            body.hold()

    def act(self, reading: Reading) -> Tensor:
        """Compute the action (1, A) that does what the reading requests.

        Raises:
            UnknownNameError: the reading names a joint that the robot does not have.
            ConfigurationError: the reading has joint values, and the robot no end effector.
        """
        for _ in range(reading.events.count(Event.NEXT)):
            self.active = self.choices[(self.choices.index(self.active) + 1) % len(self.choices)]
        for body in self._bodies.values():
            body.carry()
        if self.hand is not None:
            self._bodies[self._robot_of[self.active]].take(reading, self.hand, self._dt)
        elif reading.joints is not None:
            raise ConfigurationError(f"robot '{self.active}' has no arm that joint values could move")
        return torch.cat([self._command(part, reading) for part in self._parts], 1).clamp(-1.0, 1.0)

    def reach_problem(self) -> str:
        """Describe which hands cannot reach their targets, and by how much; empty if all can.

        Each hand that rests away from its target costs a search, which takes as long as several steps.
        """
        followers = [part.generator for part in self._parts if isinstance(part.generator, PoseFollower)]
        return "; ".join(filter(None, (each.reach_problem() for each in followers if bool(each.resting_off()[0]))))

    def _command(self, part: _Part, reading: Reading) -> Tensor:
        if part.base is not None:
            asked = reading.base if part.robot == self._robot_of[self.active] else (0.0, 0.0, 0.0)
            return torch.tensor([[asked[place] for place in part.base]], device=part.generator.device)
        body = self._bodies[part.robot]
        hand = next((hand for hand in body.hands if hand.frame == part.frame), None)
        return body.encode(part.generator, hand)


def _moved_by(generator: MotionGenerator) -> list[EndEffector]:
    """Return the end effectors whose frame a generator moves, or whose arm or gripper has one of its joints."""
    effectors = generator.robot.spec.end_effectors
    framed = [each for each in effectors if each.frame == getattr(generator, "frame", None)]
    return framed or [each for each in effectors if not _joints_of(generator.robot, each).isdisjoint(generator.joints)]


def _joints_of(robot: Robot, effector: EndEffector) -> set[int]:
    patterns = (*effector.arm_joints, *(effector.gripper.joints if effector.gripper else ()))
    return {*robot.find_joints(*patterns)} if patterns else set()


def _in_order(robot: Robot, effectors: Sequence[EndEffector]) -> list[EndEffector]:
    return [each for each in robot.spec.end_effectors if each in effectors]
