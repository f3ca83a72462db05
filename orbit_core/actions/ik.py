"""Differential inverse kinematics: the joint displacement that moves a frame by a small twist.

Sources: Buss, Introduction to Inverse Kinematics with Jacobian Transpose, Pseudoinverse and Damped Least Squares
Methods (2004); Nakamura and Hanafusa, Inverse Kinematic Solutions with Singularity Robustness for Robot Manipulator
Control (1986), for damped least squares; Maciejewski and Klein, Numerical Filtering for the Operation of Robotic
Manipulators through Kinematically Singular Configurations (1988), for damping that sets in near singularities."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import torch
from torch import Tensor

from orbit_core.actions.base import CommandMode, LastTargets, MotionGenerator
from orbit_core.actions.embodiment import end_effector_moved_by
from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.linear import solve_spd
from orbit_core.dynamics.transforms import (
    pose_error,
    pose_inverse,
    pose_multiply,
    quat_from_rotation_vector,
    quat_multiply,
)
from orbit_core.interfaces import Robot
from orbit_core.registry import Registry

_TOWARDS_POSE_DAMPING = 0.05
# rad/s or m/s of a joint that counts as resting
_RESTING = 0.05


class IkMethod(Enum):
    """Inversion of the Jacobian."""

    PSEUDO_INVERSE = "pseudo_inverse"
    """Exact and of least norm; unbounded at singularities."""
    DAMPED_LEAST_SQUARES = "damped_least_squares"
    """Trades accuracy for bounded joint motion everywhere; the fastest."""
    TRANSPOSE = "transpose"
    """A gradient step of the length that is best along its direction; never unstable, slow near the goal."""
    SVD_ADAPTIVE = "svd_adaptive"
    """Exact away from singularities, damped near them."""


def joint_delta(
    method: IkMethod, jacobian: Tensor, error: Tensor, damping: float = 0.05, singular_threshold: float = 0.1
) -> Tensor:
    """Joint displacement (N, k) for the displacement ``error`` (N, 6) of a frame with ``jacobian`` (N, 6, k).

    Args:
        method: how to invert.
        jacobian: linear rows, then angular.
        error: metres, then radians.
        damping: lambda of damped least squares; its largest value, at the singularity, if adaptive.
        singular_threshold: singular value below which adaptive damping sets in.
    """
    return _METHODS[method](jacobian, error, damping, singular_threshold)


def damped_least_squares(jacobian: Tensor, error: Tensor, damping: float, more: Tensor | None = None) -> Tensor:
    """``J^T (J J^T + lambda^2 I)^-1 e`` (N, k), by Cholesky's factors of the 6 x 6 matrices.

    ``more`` (N,) is added to lambda^2, such as :func:`steadying`.
    """
    transposed = jacobian.transpose(1, 2)
    regular = _scaled_identity(jacobian.shape[1], damping**2, jacobian.device)
    if more is not None:
        regular = regular + more[:, None, None] * _scaled_identity(jacobian.shape[1], 1.0, jacobian.device)
    # The 6 x 6 form: joints outnumber the twist's components, and its factors are cheaper.
    square = torch.baddbmm(regular, jacobian, transposed)
    return torch.bmm(transposed, solve_spd(square, error.unsqueeze(-1))).squeeze(-1)


def steadying(error: Tensor) -> Tensor:
    """(N,) m^2 of damping with which steps towards a goal that stays where it is settle, be it out of reach.

    Where the hand cannot go, what is left of the error e (N, 6) bends ``|e|^2 / 2`` by up to |e| L along the joints, L
    their distance from the hand, of which the Jacobian knows nothing: steps with a lambda^2 of less than half of that
    throw a stretched arm to and fro. It is the error's length times a metre, and goes with the error (as the damping of
    Chan and Lawrence, General Inverse Kinematics with the Error Damped Pseudoinverse, ICRA 1988, does).
    """
    return torch.linalg.vector_norm(error[:, :3], dim=1)


@functools.lru_cache(maxsize=64)
def _scaled_identity(size: int, scale: float, device: torch.device) -> Tensor:
    return scale * torch.eye(size, device=device)


def _damped_least_squares(jacobian: Tensor, error: Tensor, damping: float, _: float) -> Tensor:
    return damped_least_squares(jacobian, error, damping)


def _pseudo_inverse(jacobian: Tensor, error: Tensor, _: float, __: float) -> Tensor:
    return (torch.linalg.pinv(jacobian) @ error.unsqueeze(-1)).squeeze(-1)


def _transpose(jacobian: Tensor, error: Tensor, _: float, __: float) -> Tensor:
    gradient = (jacobian.transpose(1, 2) @ error.unsqueeze(-1)).squeeze(-1)
    effect = (jacobian @ gradient.unsqueeze(-1)).squeeze(-1)
    # The step that minimises the remaining error along the gradient.
    length = (error * effect).sum(-1, keepdim=True) / effect.square().sum(-1, keepdim=True).clamp_min(1e-12)
    return length * gradient


def _svd_adaptive(jacobian: Tensor, error: Tensor, damping: float, threshold: float) -> Tensor:
    left, values, right = torch.linalg.svd(jacobian, full_matrices=False)
    nearness = (1.0 - (values[:, -1:] / threshold).square()).clamp_min(0.0)
    # The floor keeps an exactly singular direction at rest where the damping is given as zero.
    inverse = values / (values.square() + nearness * damping**2).clamp_min(1e-12)
    along = (left.transpose(1, 2) @ error.unsqueeze(-1)).squeeze(-1)
    return (right.transpose(1, 2) @ (inverse * along).unsqueeze(-1)).squeeze(-1)


_METHODS = {
    IkMethod.PSEUDO_INVERSE: _pseudo_inverse,
    IkMethod.DAMPED_LEAST_SQUARES: _damped_least_squares,
    IkMethod.TRANSPOSE: _transpose,
    IkMethod.SVD_ADAPTIVE: _svd_adaptive,
}


def towards_pose(robot: Robot, joints: list[int], pose: Tensor) -> Tensor:
    """Displacement (N, k) of ``joints`` by one damped least-squares step from the measured state to ``pose`` (N, 7).

    Raises:
        ConfigurationError: the robot has no end effector.
    """
    frame = end_effector_moved_by(robot.spec, joints).frame
    error = pose_error(robot.frame_pose(frame), pose)
    return damped_least_squares(robot.jacobian(frame, joints), error, _TOWARDS_POSE_DAMPING)


COMPONENTS = ("x", "y", "z", "about x", "about y", "about z")


class PoseCommand:
    """Conversion between commands and poses of a robot's frame.

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
        # Shaped to divide position and rotation parts in one operation.
        self._leads = torch.tensor(leads, device=device).view(2, 1)
        self._home = _pose_at_home(robot, frame)
        self._last = LastTargets(robot.joint_positions.shape[0], (7,), device)
        # (N, 6) m and rad of the last relative command
        self._offset = torch.zeros(robot.joint_positions.shape[0], 6, device=device)

    def displacement(self, command: Tensor, kept: Tensor | None = None) -> Tensor:
        """(N, 6) m and rad, world axes, from the measured pose to the one that a command (N, 6) asks for.

        ``kept`` (N, 6, 6) projects on the directions that commands are about; along all others the measured pose is
        what is asked for.
        """
        offset = command * self._scale
        # Kept for `asked`, which an expert reads between two commands.
        if self._mode is CommandMode.RELATIVE:
            self._offset.copy_(offset)
            return offset
        measured = self._robot.frame_pose(self._frame)
        if self._mode is CommandMode.ABSOLUTE:
            wanted = pose_multiply(self._robot.root_pose, displaced(self._home, offset))
            error = _projected(kept, pose_error(measured, wanted))
            self._last.keep(wanted if kept is None else displaced(measured, error))
            return self._led(error)
        # The wanted pose is held near the measured one, so that a blocked hand does not wind up.
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
        """Return the tensors of :meth:`orbit_core.interfaces.Node.memory`."""
        return {"command": self._offset} if self._mode is CommandMode.RELATIVE else self._last.memory()

    def _led(self, displacement: Tensor) -> Tensor:
        parts = displacement.unflatten(-1, (2, 3))
        lengths = torch.linalg.vector_norm(parts, dim=-1, keepdim=True)
        return (parts * (self._leads / lengths.clamp_min(1e-9)).clamp(max=1.0)).flatten(-2)


@dataclass(frozen=True, eq=False)
class IkSolution:
    """Positions (N, k), what is missing to the pose in m and rad (N,), and whether it is reached (N,)."""

    positions: Tensor
    """(N, k) rad or m, within the joints' limits."""
    position_error: Tensor
    """(N,) m between the frame and the wanted pose."""
    rotation_error: Tensor
    """(N,) rad."""
    converged: Tensor
    """(N,) bool: both errors are within their tolerances."""


class PoseSearch(Protocol):
    """Inverse kinematics to convergence, such as :class:`orbit_motion.full_ik.FullIk`."""

    def solve(self, pose: Tensor, positions: Tensor) -> IkSolution:
        """Return the joint positions nearest to ``positions`` (N, J) that bring the frame to a pose (N, 7)."""
        ...


@functools.cache
def pose_searches() -> Registry[Callable[..., PoseSearch]]:
    """Return constructors of pose searches, from the entry-point group ``orbit.pose_searches``; the first is used."""
    return Registry("search for poses", "orbit.pose_searches")


class PoseFollower(MotionGenerator):
    """A generator whose commands ask for poses of a frame."""

    frame: str
    """Name of the frame that moves."""
    _pose: PoseCommand

    def asked(self) -> Tensor:
        """(N, 7) the pose of the frame that was last asked for, in each environment's frame."""
        return self._pose.asked()

    def out_of_reach(self) -> Tensor:
        """(N, 2) m and rad by which the nearest pose that the joints can take misses :meth:`asked`.

        Zero where it can be reached, to 1e-4 m and 1e-3 rad, within the joints' limits and from where the other joints
        are; everywhere, where no distribution with a search is installed. The search costs a step nothing: it runs
        whenever this is called. Obstacles do not count.
        """
        with torch.inference_mode():
            local = pose_multiply(pose_inverse(self.robot.root_pose), self.asked())
            if self._search is None:
                return local.new_zeros(len(local), 2)
            found = self._search.solve(local, self.robot.joint_positions)
            missing = torch.stack((found.position_error, found.rotation_error), 1)
            return torch.where(found.converged.unsqueeze(1), 0.0, missing)

    def resting_off(self) -> Tensor:
        """(N,) bool: whether the frame rests by a centimetre or 0.1 rad and more away from :meth:`asked`."""
        with torch.inference_mode():
            off = pose_error(self.robot.frame_pose(self.frame), self.asked())
            far = (off[:, :3].norm(dim=1) > 0.01) | (off[:, 3:].norm(dim=1) > 0.1)
            return far & (self.velocities.abs().amax(1) < _RESTING)

    def reach_problem(self, env: int = 0) -> str:
        """Return the result of :meth:`out_of_reach` for one environment in words; empty if it reaches the pose."""
        metres, radians = self.out_of_reach()[env].tolist()
        if not metres and not radians:
            return ""
        return (
            f"'{self.name}': the pose asked of '{self.frame}' of robot '{self.robot.name}' is out of reach by "
            f"{metres:.3f} m and {radians:.2f} rad"
        )

    @functools.cached_property
    def _search(self) -> PoseSearch | None:
        searches = pose_searches()
        if not searches.names:
            return None
        tree, robot = KinematicTree(self.robot.spec.articulation, self.device), self.robot
        make = searches.get(searches.names[0])
        return make(tree, self.frame, self.joints, robot.position_limits, robot.home_positions)


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
