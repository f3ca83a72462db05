"""Base of motion generators: commands in [-1, 1] in, joint targets out, and the way back from a wanted pose."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from enum import Enum

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import ColumnView, columns_of, write_rows
from orbit_core.interfaces import JointTarget, Node, Port, Robot, World
from orbit_core.interfaces.layout import joint_limits


class MotionGenerator(Node):
    """Turns a command (N, command_size), each component in [-1, 1], into targets of some joints of a robot.

    Args:
        name: of the node.
        robot: that moves.
        joints: indices of the joints that the generator moves.
        command_size: number of components.
        targets: quantities that are commanded to the joints.
    """

    bounded: bool = False
    """True if the targets of every finite command are finite and within the joints' limits. An environment, which has
    checked its action, then writes them without another check."""

    def __init__(
        self, name: str, robot: Robot, joints: Sequence[int], command_size: int, targets: Sequence[JointTarget]
    ) -> None:
        self.name = name
        self.robot = robot
        self.joints = list(joints)
        self.command_size = command_size
        self.inputs = (Port("command", (command_size,)),)
        """Port of the command, (command_size,)."""
        self.outputs = tuple(Port(target.value, (len(self.joints),)) for target in targets)
        """One port for each quantity that is commanded, (k,) for k joints."""
        self.num_envs = robot.joint_positions.shape[0]
        """Number N of environments."""
        self.device = robot.joint_positions.device
        """Device of the robot's tensors."""
        # Split once, because clamping takes them as two tensors in every step.
        self.lower_limits, self.upper_limits = robot.position_limits[self.joints].unbind(-1)
        """Both limits (k,) of the joints' positions, rad or m; infinite where there is none."""
        # A slice where joints are adjacent: a view costs less than a gather.
        self._columns = columns_of(self.joints, self.device)
        self._position_view, self._velocity_view = ColumnView(self._columns), ColumnView(self._columns)

    def enter(self, world: World, step_dt: float) -> None:
        """Prepare for a world: read what the generator needs beyond its robot. Called once, before the first turn.

        Args:
            world: of the robot.
            step_dt: s from one command to the next.

        Raises:
            ConfigurationError: the generator's settings do not suit the world.
            UnsupportedCapabilityError: the world lacks what the generator needs.
        """

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

    def encode_posture(self, positions: Tensor, pose: Tensor, gripper_open: Tensor) -> Tensor:
        """Return the command of :meth:`encode` for a pose that is wanted at known positions (N, J) of all joints.

        Spaces of poses have no use for them.
        """
        return self.encode(pose, gripper_open)

    def share(self, pose: Tensor) -> Tensor:
        """(N, 1) in (0, 1]: of the way to a pose (N, 7), in each environment's frame, how much one command may ask for
        without turning aside from it. Where a command is a pose, all of it."""
        return torch.ones(self.num_envs, 1, device=self.device)

    @property
    def position_range(self) -> Tensor:
        """(k, 2) rad or m: lowest and highest position of each joint that a command may ask for."""
        return torch.stack((self.lower_limits, self.upper_limits), 1)

    @property
    def affine(self) -> tuple[Tensor, Tensor] | None:
        """Offset and scale (k,) each, in rad or m, where position targets are ``offset + scale * command`` before
        limits; None where they are anything else."""
        return None

    @property
    def lead(self) -> Tensor | None:
        """(k,) rad or m by which a position target may lead the measured position, where the generator holds it to
        that; infinite for a joint that it does not hold."""
        return None

    @property
    def base_limits(self) -> Tensor | None:
        """(3,) m/s forward, m/s to the left, rad/s of a command of 1, if a command is the velocity of
        what carries the robot, in its own axes; None elsewhere. On two wheels the second is zero, and a command has no
        such component."""
        return None

    @property
    def positions(self) -> Tensor:
        """(N, k) measured positions of the generator's joints."""
        return self._position_view.read(self.robot.joint_positions)

    @property
    def velocities(self) -> Tensor:
        """(N, k) measured velocities of the generator's joints."""
        return self._velocity_view.read(self.robot.joint_velocities)


def speed_limited_lead(robot: Robot, joints: Sequence[int]) -> Tensor:
    """(k,) rad or m by which a position target may lead a joint, so that its drive never drives it too fast.

    ``velocity limit * damping / stiffness``: at the velocity limit the drive's effort,
    ``stiffness * lead - damping * velocity``, is zero. A drive with less damping may lead by
    ``effort limit / stiffness``, for less would take effort from it at standstill; its speed is then not held. Infinite
    for a joint without limits or without stiffness.
    """
    fastest, strongest = (joint_limits(robot.spec, name) for name in ("velocity_limit", "effort_limit"))
    leads = torch.full((len(robot.joints),), torch.inf, device=robot.home_positions.device)
    for group in robot.spec.actuators:
        for joint in robot.find_joints(*group.joints):
            if group.stiffness > 0.0:
                # A drive without damping has no speed at which its effort is zero.
                braking = fastest[joint] * group.damping if group.damping > 0.0 else 0.0
                leads[joint] = max(braking, strongest[joint]) / group.stiffness
    return leads[list(joints)]


class CommandMode(Enum):
    """Origin that a command is added to."""

    ABSOLUTE = "absolute"
    """Home, or zero: the same command always asks for the same."""
    RELATIVE = "relative"
    """What is measured: nothing winds up, and under a steady load zero commands creep."""
    INTEGRATED = "integrated"
    """What was asked for last, from what is measured at the beginning of an episode: nothing creeps."""


# Apart from the generators, since those of joints and of poses both integrate commands.
class LastTargets:
    """Return the last targets (N, *shape); the measured values in environments that have just begun.

    The measured state is taken at the first turn and not at the reset, for events may place the joints after it.
    """

    def __init__(self, num_envs: int, shape: tuple[int, ...], device: torch.device) -> None:
        self._targets = torch.zeros(num_envs, *shape, device=device)
        self._stale = torch.ones(num_envs, *(1 for _ in shape), dtype=torch.bool, device=device)

    def read(self, measured: Tensor) -> Tensor:
        """(N, *shape)"""
        return torch.where(self._stale, measured, self._targets)

    def parts(self) -> dict[str, Tensor]:
        """Return the arguments of :meth:`read_of`, for laws that are functions of tensors."""
        return {"targets": self._targets, "stale": self._stale}

    @staticmethod
    def read_of(parts: Mapping[str, Tensor], measured: Tensor) -> Tensor:
        """(N, *shape) of :meth:`parts`."""
        return torch.where(parts["stale"], measured, parts["targets"])

    def keep(self, targets: Tensor) -> None:
        """Remember what is asked for now."""
        self._targets.copy_(targets)
        self._stale.zero_()

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget what some environments were asked for."""
        write_rows(self._stale, True, env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        """Return the tensors of :meth:`orbit_core.interfaces.Node.memory`."""
        return {"targets": self._targets, "stale": self._stale}


class Actuate(Node):
    """Writes a motion generator's outputs to its joints."""

    def __init__(self, robot: Robot, generator: MotionGenerator) -> None:
        self.name = f"actuate_{generator.name}"
        """Name of the generator behind ``actuate_``."""
        self.inputs = generator.outputs
        """The generator's outputs."""
        self.robot = robot
        """Robot whose targets are written."""
        # Looked up once, so that a turn of the node only writes.
        self._writers = [
            (port.name, robot.target_writer(JointTarget(port.name), generator.joints)) for port in self.inputs
        ]

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        for name, write in self._writers:
            write(inputs[name])
        return {}
