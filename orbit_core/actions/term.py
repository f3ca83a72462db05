"""Action terms: the parts of which a task composes its action, each a motion generator's configuration."""

from __future__ import annotations

import dataclasses
import math
import numbers
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from orbit_core.actions.base import MotionGenerator
from orbit_core.actions.embodiment import driven_joints, joint_commands
from orbit_core.configuration import TypeChecker
from orbit_core.interfaces import ConfigurationError, Robot, match_names
from orbit_core.scene import RobotSpec

_CHECKER = TypeChecker()


@dataclass(frozen=True, kw_only=True)
class ActionTerm(ABC):
    """Configuration of a motion generator: its robot, its joints, and the settings that a subclass adds.

    Raises:
        ArgumentError: a field is not what its annotation says, or NaN.
        ConfigurationError: a number means nothing: it is below what its field takes, or infinite.
    """

    name: ClassVar[str]
    """The motion generator's name in the registry."""
    unwanted_gains: ClassVar[tuple[str, ...]] = ()
    """Gains of an actuator that would work against the commands: they are zero on the joints of the term."""
    above_zero: ClassVar[tuple[str, ...]] = ()
    """Fields that are refused where they are zero or less."""
    none_below_zero: ClassVar[tuple[str, ...]] = ()
    """Fields that are refused where they are less than zero."""
    unbounded: ClassVar[tuple[str, ...]] = ()
    """Fields that infinity means something in: no limit. Everywhere else it is refused."""

    robot: str = "robot"
    """Name of a robot of the scene that acts in the task."""
    joints: tuple[str, ...] | None = None
    """Regular expressions over joint names (full match); None takes the generator's own choice."""

    def __post_init__(self) -> None:
        _CHECKER.check(self, type(self).__name__)
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            # Fields with one number per joint are checked element by element.
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, numbers.Real):
                    self._check_number(field.name, float(number))

    def _check_number(self, field: str, value: float) -> None:
        wanted = ""
        if field in self.above_zero and value <= 0.0:
            wanted = "a number above zero"
        elif field in self.none_below_zero and value < 0.0:
            wanted = "a number not below zero"
        elif math.isinf(value) and field not in self.unbounded:
            wanted = "a finite number"
        if wanted:
            raise ConfigurationError(f"{type(self).__name__}: {field} is {value:g}: give {wanted}")

    @abstractmethod
    def build(self, name: str, robot: Robot) -> MotionGenerator:
        """The motion generator.

        Args:
            name: of the term, and of the generator as a node.
            robot: that moves, in its world.
        """

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        """Regular expressions over the names of the joints that move where ``joints`` is None.

        Raises:
            ConfigurationError: the robot lacks what the generator moves.
        """
        return joint_commands(spec).joints

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        """Return the name of each component of the command; usually that of its joint."""
        return tuple(spec.articulation.joint_names[joint] for joint in self.joint_indices(spec, name))

    @property
    def reference(self) -> str:
        """The frame that the command's components are expressed in."""
        return "each joint's own axis, as the robot's model defines it"

    def joint_indices(self, spec: RobotSpec, name: str) -> list[int]:
        """Indices of the joints that move. Joints that follow another move with it, and are left out.

        Args:
            spec: of the robot.
            name: of the term, for messages.

        Raises:
            UnknownNameError: an expression matches no joint.
            ConfigurationError: the robot lacks what the generator moves; a joint has no actuator; or all that match
                follow other joints.
        """
        try:
            patterns = self.default_joints(spec) if self.joints is None else self.joints
        except ConfigurationError as error:
            raise ConfigurationError(f"action term '{name}': {error}") from None
        where = f"robot '{spec.name}', for action term '{name}'"
        articulation = spec.articulation
        matched = match_names(patterns, articulation.joint_names, "joint", where)
        # A mimic joint has no command: the engine moves it with its leader.
        joints = [joint for joint in matched if articulation.movable_joints[joint].mimic is None]
        if not joints:
            raise ConfigurationError(f"no joint moves freely in {where}: name joints that follow no other")
        # A term on a passive joint would move nothing, without an error.
        for joint in {*joints}.difference(driven_joints(spec)):
            raise ConfigurationError(
                f"joint '{articulation.joint_names[joint]}' of {where}, has no actuator that could move it: leave it "
                "out of the term, or give the robot an actuator for it"
            )
        return joints


class ActionTerms:
    """The action terms of a task by name, in the order of the action's components: ``ActionTerms(arm=..., hand=...)``.

    An instance is a frozen dataclass with one field a term, so that what is inside can be set by its path. Where the
    terms are known beforehand, a dataclass of one's own with a field a term does as well. A term that is None is
    switched off.
    """

    def __new__(cls, **terms: ActionTerm | None) -> Any:
        if cls is ActionTerms:
            fields = [(name, type(term) | None, dataclasses.field(default=None)) for name, term in terms.items()]
            # A class per set of terms, so that paths such as `actions.arm.scale` are checked like any field.
            cls = dataclasses.make_dataclass(cls.__name__, fields, bases=(cls,), frozen=True)
        return object.__new__(cls)
