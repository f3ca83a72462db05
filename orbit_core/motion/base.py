"""What every motion generator is: commands in [-1, 1] in, joint targets out, and the way back from a wanted pose."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from enum import Enum

from torch import Tensor

from orbit_core.dynamics.indexing import columns_of
from orbit_core.interfaces import ConfigurationError, Node, Port, Robot
from orbit_core.scene import EndEffector


class JointTarget(Enum):
    """What a joint is told; the value names the port that carries it, (N, k) for k joints."""

    POSITION = "position_targets"
    VELOCITY = "velocity_targets"
    EFFORT = "effort_targets"


class MotionGenerator(Node):
    """Turns a command (N, command_size), each component in [-1, 1], into targets of some joints of a robot.

    Args:
        name: of the node.
        robot: that moves.
        joints: indices of the joints that the generator moves.
        command_size: number of components.
        targets: what the joints are told.
    """

    def __init__(
        self, name: str, robot: Robot, joints: Sequence[int], command_size: int, targets: Sequence[JointTarget]
    ) -> None:
        self.name = name
        self.robot = robot
        self.joints = list(joints)
        self.command_size = command_size
        self.inputs = (Port("command", (command_size,)),)
        self.outputs = tuple(Port(target.value, (len(self.joints),)) for target in targets)
        self.num_envs = robot.joint_positions.shape[0]
        self.device = robot.joint_positions.device
        self.lower_limits, self.upper_limits = robot.position_limits[self.joints].unbind(-1)
        self._columns = columns_of(self.joints, self.device)

    @abstractmethod
    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        """The command (N, command_size) that comes nearest to a wish; the inverse of what the generator does.

        Args:
            pose: (N, 7) wanted of the end effector's frame, in each environment's frame. Joint spaces take one damped
                least-squares step towards it, so lead it in short steps.
            gripper_open: (N,) bool.

        Raises:
            ConfigurationError: the robot has no end effector.
        """

    @property
    def positions(self) -> Tensor:
        """(N, k) measured positions of the generator's joints."""
        return self.robot.joint_positions[:, self._columns]

    @property
    def velocities(self) -> Tensor:
        """(N, k) measured velocities of the generator's joints."""
        return self.robot.joint_velocities[:, self._columns]


def end_effector_of(robot: Robot) -> EndEffector:
    """The robot's first end effector.

    Raises:
        ConfigurationError: it has none.
    """
    if not robot.spec.end_effectors:
        raise ConfigurationError(f"robot '{robot.name}' has no end effector: choose an action space of its joints")
    return robot.spec.end_effector


def is_arm(robot: Robot) -> bool:
    """Whether the robot is there for its end effector; a robot with feet is there to walk."""
    return bool(robot.spec.end_effectors) and not robot.spec.feet


def driven_joints(robot: Robot) -> list[int]:
    """Indices of the joints that have an actuator and do not follow another joint."""
    driven = {joint for group in robot.spec.actuators for joint in robot.find_joints(*group.joints)}
    return sorted(joint for joint in driven if robot.joints[joint].mimic is None)


def chosen_joints(robot: Robot, patterns: Sequence[str] | None) -> list[int]:
    """Indices of the joints that match; if None, of the arm's, or of all that are driven if the robot is no arm."""
    if patterns is not None:
        return robot.find_joints(*patterns)
    return robot.find_joints(*robot.spec.end_effector.arm_joints) if is_arm(robot) else driven_joints(robot)
