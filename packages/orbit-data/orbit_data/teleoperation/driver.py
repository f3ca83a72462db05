"""Driver: converts readings of a device to joint positions, hand poses and grips, and these to actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.actions import MotionGenerator, driven_joints
from orbit_core.actions.binary_gripper import gripper_positions
from orbit_core.actions.ik import towards_pose
from orbit_core.actions.pose_command import displaced
from orbit_core.actions.reach import PoseFollower
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error, pose_inverse, pose_multiply
from orbit_core.interfaces import ConfigurationError, Robot, UnknownNameError
from orbit_core.scene import EndEffector
from orbit_data.teleoperation.device import Event, Reading

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

# m and rad by which the pose that is asked for may lead the measured one.
_LEADS = (0.1, 0.5)
# rad or m, likewise of joints.
_JOINT_LEAD = 0.2


class Hand:
    """What is wanted of one end effector, and of its gripper.

    Args:
        robot: in one environment.
        effector: one of the robot's.
    """

    def __init__(self, robot: Robot, effector: EndEffector) -> None:
        self.robot, self.effector = robot, effector
        self.frame = effector.frame
        gripper = effector.gripper
        self.arm = _driven(robot, effector.arm_joints)
        """Indices of the joints that move it."""
        self.fingers = _driven(robot, gripper.joints if gripper else ())
        """Indices of its gripper's joints."""
        self.gripper_open = True
        self.by_joints = False
        """Whether joint values are wanted, and the pose follows from them."""
        self.target = self.measured
        """(1, 7) the pose that is wanted."""

    @property
    def measured(self) -> Tensor:
        """(1, 7) the end effector's pose."""
        return self.robot.frame_pose(self.frame).clone()

    @property
    def led(self) -> Tensor:
        """(1, 7) on the way to the target, no further from the measured pose than may be led by."""
        measured = self.measured
        return displaced(measured, _shortened(pose_error(measured, self.target)))

    def move(self, twist: Sequence[float], dt: float) -> None:
        """Move the target by six of m/s and rad/s, in world axes, for ``dt`` seconds."""
        displacement = dt * torch.tensor([twist], dtype=torch.float32, device=self.target.device)
        measured = self.measured
        # A hand that is held back does not gather a debt.
        self.target = displaced(measured, _shortened(pose_error(measured, displaced(self.target, displacement))))
        self.by_joints = False

    def place(self, pose: Sequence[float]) -> None:
        """Want a pose: position and quaternion (w, x, y, z), of any length but zero."""
        target = torch.tensor([pose], dtype=torch.float32, device=self.target.device)
        self.target = torch.cat((target[:, :3], torch.nn.functional.normalize(target[:, 3:], dim=1)), 1)
        self.by_joints = False

    def grip(self) -> Tensor:
        """(1, k) positions of the gripper's joints, open or closed."""
        gripper = self.effector.gripper
        assert gripper is not None
        value = gripper.open_position if self.gripper_open else gripper.closed_position
        positions = gripper_positions(value, gripper.joints, self.fingers, self.robot.spec, self.frame)
        return torch.tensor([positions], device=self.target.device)


class Body:
    """What is wanted of all joints of one robot, and of its hands. Joints that nobody asks anything of hold.

    Args:
        robot: in one environment.
        effectors: those of its end effectors that the action moves.
        carried: whether its base is driven, and takes the poses that are wanted along.
    """

    def __init__(self, robot: Robot, effectors: Sequence[EndEffector], carried: bool) -> None:
        self.robot = robot
        self.hands = tuple(Hand(robot, effector) for effector in effectors)
        self._tree = KinematicTree(robot.spec.articulation, robot.joint_positions.device)
        self._carried = carried
        self.hold()

    def hold(self) -> None:
        """Want what is, grippers open."""
        self._posture = self.robot.joint_positions.clone()
        self._base = self._base_pose()
        for hand in self.hands:
            hand.target, hand.by_joints, hand.gripper_open = hand.measured, False, True

    def carry(self) -> None:
        """Let the poses that are wanted go along with a base that is driven."""
        if not self._carried:
            return
        base = self._base_pose()
        moved = pose_multiply(base, pose_inverse(self._base))
        for hand in self.hands:
            hand.target = pose_multiply(moved, hand.target)
        self._base = base

    def take(self, reading: Reading, hand: Hand, dt: float) -> None:
        """Take over what a reading asks of a hand, over ``dt`` seconds, and of any joints.

        Raises:
            UnknownNameError: the reading names a joint that the robot lacks.
        """
        opened = hand.gripper_open if reading.gripper_open is None else reading.gripper_open
        opened ^= reading.events.count(Event.GRIPPER) % 2 == 1
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
        """(1, k) the command of a generator that comes nearest to what is wanted; ``hand`` is the one that it moves."""
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
        """(1, J) wanted of all joints, arms no further ahead of the measured ones than may be led by."""
        here = self.robot.joint_positions
        wanted = self._posture.clone()
        led = [hand for hand in self.hands if hand.arm and not hand.by_joints]
        for hand in led:
            wanted[:, hand.arm] = here[:, hand.arm] + towards_pose(self.robot, hand.arm, hand.led)
        others = {*range(wanted.shape[1])}.difference(
            *(hand.arm for hand in led), *(hand.fingers for hand in self.hands)
        )
        rest = sorted(others)
        way = wanted[:, rest] - here[:, rest]
        if rest:
            wanted[:, rest] = here[:, rest] + way * (_JOINT_LEAD / way.abs().amax(1, keepdim=True)).clamp(max=1.0)
        return wanted

    def _pose_at(self, hand: Hand, positions: Tensor) -> Tensor:
        """(1, 7) the end effector's pose, were the joints at ``positions`` (1, J)."""
        return self._tree.frame_pose(self._tree.forward(self.robot.root_pose, positions), hand.frame)

    def _base_pose(self) -> Tensor:
        return self.robot.frame_pose(self.robot.spec.base_link).clone()


def _driven(robot: Robot, patterns: Sequence[str]) -> list[int]:
    """Return indices of the joints of those names that are moved by actuators of their own."""
    driven = {*driven_joints(robot.spec)}
    return [joint for joint in robot.find_joints(*patterns) if joint in driven] if patterns else []


def _shortened(displacement: Tensor) -> Tensor:
    """(1, 6) metres and radians, each no longer than may be led by."""
    parts = displacement.view(1, 2, 3)
    leads = torch.tensor(_LEADS, device=parts.device).view(1, 2, 1)
    lengths = torch.linalg.vector_norm(parts, dim=-1, keepdim=True)
    return (parts * (leads / lengths.clamp_min(1e-9)).clamp(max=1.0)).view(1, 6)


_BASE = ("forward", "left", "turn")


@dataclass(frozen=True)
class _Part:
    """A stretch of the action."""

    generator: MotionGenerator
    robot: str
    base: tuple[int, ...] | None
    """The components of a base that it takes, by place; None where it moves none."""
    frame: str | None
    """Of the end effector that it moves first; None where it moves none."""


class Driver:
    """Drives the robots of one environment by readings.

    A twist moves the pose that is wanted of one end effector; a pose is that pose; joint values are followed by joint
    spaces, and by their hand's pose in all others. Components of the action called forward, left and turn are a base's,
    and a base that drives takes the poses that are wanted along. What is not driven holds still. ``Event.NEXT`` goes on
    to the next end effector, of the same robot or another.

    Args:
        environment: with a single environment.

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
        """What can be moved by poses and grips, by the name of its robot, and where that has several by theirs too."""
        choices: dict[str, str] = {}
        for name, body in self._bodies.items():
            own = {name if len(body.hands) == 1 else f"{name} {hand.frame}": hand for hand in body.hands}
            self.hands |= own
            choices |= dict.fromkeys(own or ([name] if name in based else []), name)
        self._robot_of = choices
        self.choices = tuple(choices)
        """Names of what can be driven, one after the other: end effectors with their robots' bases, or bases alone."""
        if not self.choices:
            lost = [name for name, robot in robots.items() if robot.spec.articulation.joints]
            raise ConfigurationError(
                f"no device can drive {', '.join(map(repr, lost or robots))}: the action space moves no end effector "
                "and no base; choose another, such as --action locomotion for a walking robot"
            )
        self.active = self.choices[0]
        """Name of what readings drive."""

    @property
    def hand(self) -> Hand | None:
        """The end effector that readings drive."""
        return self.hands.get(self.active)

    def restart(self) -> None:
        """Everything holds where it is, grippers open: an episode has begun."""
        for body in self._bodies.values():
            body.hold()

    def act(self, reading: Reading) -> Tensor:
        """(1, A) the action that does what is asked for.

        Raises:
            UnknownNameError, ConfigurationError: joint values of other joints than the robot's, or of a robot without
                end effector.
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
        """Which hands rest away from what is asked of them, for it is out of reach, and by how much; empty for none.

        A hand that rests so is looked at by a search, which takes as long as several steps.
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
