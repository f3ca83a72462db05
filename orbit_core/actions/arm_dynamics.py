"""The equation of motion of the joints that a generator moves, the base and all other joints held.

``M(q) a + bias(q, v) = efforts``, from the robot's description alone (:mod:`orbit_core.dynamics.rigid_body`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.linear import solve_spd
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.interfaces import Robot
from orbit_core.interfaces.layout import joint_constants

_GRAVITY = (0.0, 0.0, -9.81)
# Share of the dry friction that is compensated; s after which the wanted motion counts; and rad/s or m/s of it at which
# all of that share is
_FRICTION_SHARE, _FRICTION_TIME, _FRICTION_SPEED = 0.95, 0.02, 0.02


@dataclass(frozen=True, eq=False)
class ArmState:
    """Positions, velocities and bias (N, k), and the mass matrix (N, k, k), of the joints that move; and all poses.

    The bias are the efforts that leave the joints without acceleration: gravity, Coriolis and centrifugal forces, and
    the mechanism's own damping.
    """

    poses: Tensor
    """(N, L, 7) of all links."""
    speeds: Tensor
    """(N, J) of all joints."""
    positions: Tensor
    """(N, k) rad or m."""
    velocities: Tensor
    """(N, k) rad/s or m/s."""
    mass: Tensor
    """(N, k, k) kg m^2 or kg."""
    bias: Tensor
    """(N, k) N m or N."""

    def efforts(self, accelerations: Tensor) -> Tensor:
        """(N, k) that accelerate the joints by (N, k)."""
        return torch.baddbmm(self.bias.unsqueeze(-1), self.mass, accelerations.unsqueeze(-1)).squeeze(-1)

    def accelerations(self, efforts: Tensor) -> Tensor:
        """(N, k) under efforts (N, k)."""
        return solve_spd(self.mass, (efforts - self.bias).unsqueeze(-1)).squeeze(-1)


class ArmDynamics:
    """Makes the equation of motion of a robot's state.

    Where the robot's own controller compensates gravity, gravity is no part of the bias.

    Args:
        robot: that moves.
        joints: indices of the joints that move.
        physics_dt: s. The mechanism's own damping d is integrated at the end of each step, which so shows the inertia
            ``M + physics_dt d``; zero leaves it out.
        gravity: m/s^2, world axes.
    """

    def __init__(
        self, robot: Robot, joints: Sequence[int], physics_dt: float = 0.0, gravity: Sequence[float] = _GRAVITY
    ) -> None:
        spec, device = robot.spec, robot.joint_positions.device
        damping = joint_constants(spec, "damping")
        armature = joint_constants(spec, "armature") + physics_dt * damping
        friction = _FRICTION_SHARE * torch.as_tensor(joint_constants(spec, "friction"))[list(joints)]
        self._friction = friction.float().to(device) if bool(friction.any()) else None
        gravity = (0.0, 0.0, 0.0) if spec.gravity_compensation else gravity
        self.robot = robot
        self.model = RigidBodyModel(spec.articulation, True, device, armature=armature.tolist(), gravity=gravity)
        """Dynamics of the whole robot, from which the moving joints are taken."""
        self._joints = torch.tensor(list(joints), dtype=torch.int64, device=device)
        self._damping = torch.as_tensor(damping, dtype=torch.float32, device=device)[self._joints]

    def against_friction(self, state: ArmState, wanted: Tensor, efforts: Tensor) -> Tensor:
        """(N, k) the efforts and what overcomes the joints' dry friction where they shall accelerate by ``wanted``.

        ``0.95 friction sat((v + T a) / v_0)``, the friction along the motion that is wanted (Olsson et al., Friction
        Models and Friction Compensation, European Journal of Control 4(3), 1998): never more than the friction itself,
        so that it drives nothing by itself.
        """
        if self._friction is None:
            return efforts
        soon = (state.velocities + _FRICTION_TIME * wanted) * (1.0 / _FRICTION_SPEED)
        return efforts + self._friction * torch.clamp(soon, -1.0, 1.0)

    def measured(self) -> dict[str, Tensor]:
        """Return the present arguments of :meth:`state_of`."""
        robot = self.robot
        return {"poses": robot.link_poses, "positions": robot.joint_positions, "velocities": robot.joint_velocities}

    def state(self) -> ArmState:
        """Return the present state."""
        return self.state_of(**self.measured())

    def state_of(self, poses: Tensor, positions: Tensor, velocities: Tensor) -> ArmState:
        """Return the state of link poses (N, L, 7), and positions and velocities (N, J) of all joints."""
        joints = self._joints
        moving = velocities.index_select(1, joints)
        # The base counts as fixed: its motion is not in the joints' equation.
        at_rest = velocities.new_zeros((velocities.shape[0], 6))
        mass, bias = self.model.equation_of_motion(poses, at_rest, velocities)
        mass, bias = mass.index_select(1, joints).index_select(2, joints), bias.index_select(1, joints)
        bias = torch.addcmul(bias, self._damping, moving)
        return ArmState(poses, velocities, positions.index_select(1, joints), moving, mass, bias)

    def drift(self, state: ArmState, frame: str) -> Tensor:
        """(N, 6) acceleration of a frame while no joint accelerates."""
        return self.model.kinematics.frame_drift(state.poses, state.speeds, frame)
