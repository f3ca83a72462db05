"""Inverse kinematics as quadratic programs: weighted tasks in order of priority, within limits of position and speed.

Manipulability, the distance of a posture from singular ones, may be one of the tasks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import CommandMode, JointTarget, speed_limited_lead
from orbit_core.actions.differential_ik import PoseTermConfig, bounded_targets
from orbit_core.actions.ik import PoseFollower, steadying
from orbit_core.dynamics.linear import solve_spd
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import joint_limits

# Small quadratic programs, batched, by a fixed number of iterations that a captured step can hold ---------------------

_RELAXATION = 1.6
_PROXIMAL = 1e-6
# How much harder equations are held than inequalities.
_EQUAL = 1e3


def solve_qp(
    quadratic: Tensor, linear: Tensor, matrix: Tensor, lower: Tensor, upper: Tensor, iterations: int = 60
) -> Tensor:
    """(N, n) x that minimises ``x^T P x / 2 + q^T x`` where ``lower <= A x <= upper``.

    The alternating direction method of multipliers as in OSQP (Stellato et al., OSQP: An Operator Splitting Solver for
    Quadratic Programs, Mathematical Programming Computation 12, 2020, algorithm 1), all programs at once. What it gives
    after ``iterations`` meets the bounds up to what has not converged: clip what must not exceed them.

    Args:
        quadratic: P (N, n, n), symmetric and positive semidefinite.
        linear: q (N, n).
        matrix: A (N, m, n).
        lower: (N, m), -inf where there is none.
        upper: (N, m), inf where there is none; an equation has the same bound twice.
        iterations: of the method.
    """
    count = quadratic.shape[-1]
    size = quadratic.diagonal(dim1=1, dim2=2).mean(1, keepdim=True).clamp_min(1e-9)
    steps = torch.where(lower == upper, _EQUAL, 1.0) * size
    identity = torch.eye(count, device=quadratic.device, dtype=quadratic.dtype)
    system = quadratic + _PROXIMAL * size.unsqueeze(-1) * identity + matrix.mT @ (steps.unsqueeze(-1) * matrix)
    inverse = solve_spd(system, identity.expand_as(system))
    x, z, y = torch.zeros_like(linear), torch.zeros_like(lower), torch.zeros_like(lower)
    for _ in range(iterations):
        right = _PROXIMAL * size * x - linear + _times(matrix.mT, steps * z - y)
        guess = _times(inverse, right)
        x = _RELAXATION * guess + (1.0 - _RELAXATION) * x
        moved = _RELAXATION * _times(matrix, guess) + (1.0 - _RELAXATION) * z
        z = torch.clamp(moved + y / steps, lower, upper)
        y = y + steps * (moved - z)
    return x


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return torch.bmm(matrix, vector.unsqueeze(-1)).squeeze(-1)


# Regularisation of J J^T in singular postures.
_REGULAR = 1e-6


def manipulability(jacobian: Tensor) -> Tensor:
    """Compute ``sqrt(det(J J^T))`` (N,) of Jacobians (N, 6, k).

    Yoshikawa, Manipulability of Robotic Mechanisms, International Journal of Robotics Research 4(2), 1985.
    """
    return torch.linalg.det(jacobian @ jacobian.mT).clamp_min(0.0).sqrt()


def manipulability_gradient(jacobian: Tensor) -> Tensor:
    """Compute the gradient (N, k) of the manipulability's logarithm by the joints, for a chain of joints in order.

    ``d log w / dq_i = tr(J^+ dJ/dq_i)``, and with columns ``(v_j, w_j)`` of the geometric Jacobian a turn about axis i
    carries the axes and points behind it along: ``dv_j = w_min(i,j) x v_max(i,j)``, and ``dw_j = w_i x w_j`` for i < j.
    """
    identity = torch.eye(6, device=jacobian.device, dtype=jacobian.dtype)
    inverse = jacobian.mT @ solve_spd(
        jacobian @ jacobian.mT + _REGULAR * identity, identity.expand(len(jacobian), 6, 6)
    )
    linear, angular = jacobian[:, :3].mT, jacobian[:, 3:].mT
    crossed = torch.linalg.cross(angular.unsqueeze(2), linear.unsqueeze(1))  # (N, i, j, 3): w_i x v_j
    count = linear.shape[1]
    before = torch.triu(torch.ones(count, count, device=jacobian.device)).view(1, count, count, 1)
    # Only joints behind axis i turn with it.
    turning = torch.linalg.cross(angular.unsqueeze(2), angular.unsqueeze(1)) * before
    moving = crossed * before + crossed.transpose(1, 2) * (1.0 - before)
    change = torch.cat((moving, turning), -1)
    return (change * inverse.unsqueeze(1)).sum((2, 3))


# Share of the distance to a limit that a joint may cover in a step (Faverjon and Tournassoud, 1987).
_LIMIT_SHARE = 0.5


class Priority(Enum):
    """Part of a pose that has priority where not all of it can be reached."""

    NONE = "none"
    """None: all six components share the error, by their weights."""
    POSITION = "position"
    """The position is kept, and the rotation as far as it can be."""
    ROTATION = "rotation"
    """The rotation is kept, and the position as far as it can be."""


@dataclass(frozen=True, kw_only=True)
class PrioritizedIkConfig(PoseTermConfig):
    """A command is a pose of the hand, or its change, which the joints follow within all limits.

    Each step solves, in order of priority, ``min |W (J d - e)|^2 + lambda^2 |d|^2`` for the joints' displacement d,
    where ``|d_i|`` is at most the lead at which the joint's drive keeps to its velocity limit
    (:func:`~orbit_core.actions.base.speed_limited_lead`), and half the distance to a position limit, and the tasks
    before are kept (Kanoun, Lamiraux and Wieber, Kinematic Control of Redundant Manipulators: Generalizing the Task-
    Priority Framework to Inequality Task, IEEE Transactions on Robotics 27(4), 2011). Last comes the posture: home, and
    where ``manipulability_gain`` is above zero away from singular poses, up the gradient of Yoshikawa's manipulability.
    """

    name: ClassVar[str] = "qp_ik"
    above_zero: ClassVar[tuple[str, ...]] = (*PoseTermConfig.above_zero, "damping", "max_joint_step", "speed")
    none_below_zero: ClassVar[tuple[str, ...]] = ("posture_gain", "manipulability_gain", "weights")
    unbounded: ClassVar[tuple[str, ...]] = (*PoseTermConfig.unbounded, "max_joint_step")

    weights: tuple[float, ...] = (1.0, 1.0, 1.0, 0.5, 0.5, 0.5)
    """Weights of x, y, z (1/m) and of the rotation vector's components (1/rad)."""
    priority: Priority = Priority.NONE
    """Part of the pose that is solved for first."""
    damping: float = 0.05
    """Damping lambda."""
    posture_gain: float = 0.1
    """Share of the way home that joints move in a step in the null space of the hand."""
    manipulability_gain: float = 0.0
    """rad^2 or m^2: step of the joints up the gradient of the manipulability's logarithm."""
    speed: float = 1.0
    """Share of the joints' velocity limits that is used."""
    max_joint_step: float = 0.3
    """rad or m by which targets may lead measured positions."""

    def build(self, name: str, robot: Robot) -> PrioritizedIk:
        return PrioritizedIk(name, robot, self)


class PrioritizedIk(PoseFollower):
    """Six commands, :class:`PrioritizedIkConfig`."""

    def __init__(self, name: str, robot: Robot, config: PrioritizedIkConfig) -> None:
        super().__init__(name, robot, config.joint_indices(robot.spec, name), 6, (JointTarget.POSITION,))
        if len(config.weights) != 6:
            raise ConfigurationError(f"action term '{name}': weights are {config.weights}: give six numbers")
        if config.speed > 1.0:
            raise ConfigurationError(f"action term '{name}': speed is {config.speed:g}: give a share of at most 1")
        self.config = config
        """Settings, as the action term gives them."""
        self.frame = config.frame_of(robot)
        self._pose = config.pose_command(robot)
        self._weights = torch.tensor(config.weights, device=self.device)
        self._home = robot.home_positions[self.joints]
        speeds = joint_limits(robot.spec, "velocity_limit")[self.joints]
        self._fastest = torch.as_tensor(speeds, dtype=torch.float32, device=self.device)
        self._step_limit = config.speed * speed_limited_lead(robot, self.joints)
        # Cost (k,) of moving each joint, in the null space of the hand.
        self._costs = torch.ones(len(self.joints), device=self.device)
        position, rotation = slice(0, 3), slice(3, 6)
        orders = {Priority.NONE: (slice(0, 6),), Priority.POSITION: (position, rotation)}
        self._levels = orders.get(config.priority, (rotation, position))

    def enter(self, world: World, step_dt: float) -> None:
        # A joint without stiffness is driven by velocities: its lead is a velocity times the step.
        steps = self.config.speed * self._fastest * step_dt
        self._step_limit = torch.where(self._step_limit.isfinite(), self._step_limit, steps)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        delta = self.solve(self._pose.displacement(inputs["command"]))
        return {JointTarget.POSITION: bounded_targets(self, delta, self.config.max_joint_step)}

    def solve(self, error: Tensor) -> Tensor:
        """Compute joint displacements (N, k) for a displacement (N, 6) of the frame, m and rad, world axes."""
        jacobian = self.jacobian()
        low, high = self.bounds()
        identity = torch.eye(jacobian.shape[2], device=self.device).expand(self.num_envs, -1, -1)
        damping = self.config.damping**2 * torch.diag_embed(self._costs).expand_as(identity)
        if self.config.mode is not CommandMode.RELATIVE:
            damping = damping + steadying(self._weights**2 * error)[:, None, None] * torch.diag_embed(self._costs)
        rows, lower, upper = identity, low, high
        delta = torch.zeros_like(low)
        for level in self._levels:
            weighted = jacobian[:, level] * self._weights[level].unsqueeze(-1)
            wanted = error[:, level] * self._weights[level]
            linear = -torch.bmm(weighted.mT, wanted.unsqueeze(-1)).squeeze(-1)
            delta = solve_qp(weighted.mT @ weighted + damping, linear, rows, lower, upper)
            # The result of this level becomes an equality of all further ones.
            kept = torch.bmm(jacobian[:, level], delta.unsqueeze(-1)).squeeze(-1)
            rows = torch.cat((rows, jacobian[:, level]), 1)
            lower, upper = torch.cat((lower, kept), 1), torch.cat((upper, kept), 1)
        posture = self.posture(jacobian)
        if posture is not None:
            costs = torch.diag_embed(self._costs).expand_as(identity)
            # The quadratic programs hold the bounds within the solver's tolerance only.
            delta = solve_qp(costs, -self._costs * posture, rows, lower, upper)
        return torch.clamp(delta, low, high)

    def jacobian(self) -> Tensor:
        """Return the Jacobian (N, 6, k) of the frame."""
        return self.robot.jacobian(self.frame, self.joints)

    def bounds(self) -> tuple[Tensor, Tensor]:
        """Return the least and the greatest displacement (N, k) in one step."""
        positions = self.positions
        below, above = (_LIMIT_SHARE * (limits - positions) for limits in (self.lower_limits, self.upper_limits))
        # A joint outside its limits may stay where it is, so that there always is a solution.
        low = torch.maximum(below, -self._step_limit).clamp_max(0.0)
        return low, torch.minimum(above, self._step_limit).clamp_min(0.0)

    def posture(self, jacobian: Tensor) -> Tensor | None:
        """Return displacements (N, k) towards a preferred posture, or None."""
        if not self.config.posture_gain and not self.config.manipulability_gain:
            return None
        home = self.config.posture_gain * (self._home - self.positions)
        if not self.config.manipulability_gain:
            return home
        return home + self.config.manipulability_gain * manipulability_gradient(jacobian)

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._pose.encode(pose)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._pose.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return self._pose.memory()
