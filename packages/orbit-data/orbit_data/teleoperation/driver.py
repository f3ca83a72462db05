"""From readings of a device to actions, whatever motion generators the action is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.actions.reach import PoseFollower
from orbit_core.interfaces import ConfigurationError, Robot
from orbit_data.teleoperation.body import Body, Hand
from orbit_data.teleoperation.device import Event, Reading

if TYPE_CHECKING:
    from orbit_core.actions import MotionGenerator
    from orbit_core.envs.environment import Environment
    from orbit_core.scene import EndEffector

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
