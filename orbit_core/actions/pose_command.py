"""Commands that are poses of a frame, or displacements of it: (x, y, z, rotation vector)."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_core.actions.modes import CommandMode, LastTargets
from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import (
    pose_error,
    pose_inverse,
    pose_multiply,
    quat_from_rotation_vector,
    quat_multiply,
)
from orbit_core.interfaces import Robot

COMPONENTS = ("x", "y", "z", "about x", "about y", "about z")


class PoseCommand:
    """Where a command wants a frame of a robot, and the command for where it is wanted.

    Absolute: the pose in the robot's root frame, relative to the frame's pose at home, axes of the root. Relative: a
    displacement of the measured pose, in world axes. Integrated: a displacement of the last pose asked for, in world
    axes, which stays within a lead of the measured one.

    Args:
        robot: that moves.
        frame: of the robot.
        mode: what commands are added to.
        scales: m and rad of one unit.
        leads: m and rad by which the pose asked for may lead the measured one.
    """

    def __init__(
        self, robot: Robot, frame: str, mode: CommandMode, scales: tuple[float, float], leads: tuple[float, float]
    ) -> None:
        device = robot.joint_positions.device
        self._robot, self._frame, self._mode = robot, frame, mode
        self._scale = torch.tensor([scales[0]] * 3 + [scales[1]] * 3, device=device)
        self._leads = torch.tensor(leads, device=device).view(2, 1)
        self._home = _pose_at_home(robot, frame)
        self._last = LastTargets(robot.joint_positions.shape[0], (7,), device)
        self._offset = torch.zeros(robot.joint_positions.shape[0], 6, device=device)
        """(N, 6) m and rad of the last relative command."""

    def displacement(self, command: Tensor, kept: Tensor | None = None) -> Tensor:
        """(N, 6) m and rad, world axes, from the measured pose to the one that a command (N, 6) asks for.

        ``kept`` (N, 6, 6) projects on the directions that commands are about; along all others the measured pose is
        what is asked for.
        """
        offset = command * self._scale
        if self._mode is CommandMode.RELATIVE:
            self._offset.copy_(offset)
            return offset
        measured = self._robot.frame_pose(self._frame)
        if self._mode is CommandMode.ABSOLUTE:
            wanted = pose_multiply(self._robot.root_pose, displaced(self._home, offset))
            error = _projected(kept, pose_error(measured, wanted))
            self._last.keep(wanted if kept is None else displaced(measured, error))
            return self._led(error)
        led = self._led(_projected(kept, pose_error(measured, displaced(self._last.read(measured), offset))))
        self._last.keep(displaced(measured, led))
        return led

    def target(self, command: Tensor, kept: Tensor | None = None) -> Tensor:
        """(N, 7) the pose that a command asks for, :meth:`displacement`."""
        return displaced(self._robot.frame_pose(self._frame), self.displacement(command, kept))

    def asked(self) -> Tensor:
        """(N, 7) the pose that the last command asks for, of relative ones from where the frame is now."""
        measured = self._robot.frame_pose(self._frame)
        if self._mode is CommandMode.RELATIVE:
            return displaced(measured, self._offset)
        return self._last.read(measured)

    def encode(self, pose: Tensor) -> Tensor:
        """(N, 6) the command that comes nearest to a pose (N, 7)."""
        if self._mode is CommandMode.ABSOLUTE:
            local = pose_multiply(pose_inverse(self._robot.root_pose), pose)
            return (pose_error(self._home, local) / self._scale).clamp(-1.0, 1.0)
        measured = self._robot.frame_pose(self._frame)
        origin = measured if self._mode is CommandMode.RELATIVE else self._last.read(measured)
        parts = (pose_error(origin, pose) / self._scale).unflatten(-1, (2, 3))
        # Position and rotation each keep their direction where they are too far for one command.
        return (parts / parts.abs().amax(-1, keepdim=True).clamp_min(1.0)).flatten(-2)

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget what some environments were asked for."""
        self._last.reset(env_ids)
        write_rows(self._offset, 0.0, env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        """For :meth:`orbit_core.interfaces.Node.memory`."""
        return {"command": self._offset} if self._mode is CommandMode.RELATIVE else self._last.memory()

    def _led(self, displacement: Tensor) -> Tensor:
        parts = displacement.unflatten(-1, (2, 3))
        lengths = torch.linalg.vector_norm(parts, dim=-1, keepdim=True)
        return (parts * (self._leads / lengths.clamp_min(1e-9)).clamp(max=1.0)).flatten(-2)


def displaced(pose: Tensor, displacement: Tensor) -> Tensor:
    """(..., 7) a pose after a displacement (..., 6): metres, then a rotation vector, in its parent's axes."""
    rotation = quat_multiply(quat_from_rotation_vector(displacement[..., 3:]), pose[..., 3:])
    return torch.cat((pose[..., :3] + displacement[..., :3], rotation), -1)


def _projected(kept: Tensor | None, displacement: Tensor) -> Tensor:
    return displacement if kept is None else torch.bmm(kept, displacement.unsqueeze(-1)).squeeze(-1)


def _pose_at_home(robot: Robot, frame: str) -> Tensor:
    """(7,) of the frame in the robot's root frame, with the joints at home."""
    tree = KinematicTree(robot.spec.articulation, robot.home_positions.device)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], device=tree.device)
    return tree.frame_pose(tree.forward(root, robot.home_positions[None]), frame)[0]
