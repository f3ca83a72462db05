"""How bodies move, batched over environments (N) and in double precision.

R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapters 2, 3 and 5; everything is in world axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from orbit_core.scene import Articulation, Joint, JointType
from orbit_torch.rotations import apply, cross, matrix, multiply, turn


@dataclass
class Body:
    """What a link weighs, and what is done to it."""

    mass: Tensor
    """(N, 1)"""
    center: Tensor
    """(N, 3) in the link's frame."""
    inertia: Tensor
    """(N, 3, 3) about the centre, in the link's axes."""
    force: Tensor
    """(N, 3) at the centre, gravity with it."""
    torque: Tensor
    """(N, 3)"""


def step_free_body(body: Body, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Next pose (N, 7) and velocity (N, 6) of a link's origin: momentum is kept, rotation follows a midpoint rule."""
    position, q = pose[:, :3], pose[:, 3:]
    rotation = matrix(q)
    arm = apply(rotation, body.center)
    spin, center = velocity[:, 3:], position + arm
    speed = velocity[:, :3] + cross(spin, arm)
    momentum = apply(rotation, apply(body.inertia, apply(rotation.mT, spin)))

    def spin_at(q: Tensor, momentum: Tensor) -> Tensor:
        rotation = matrix(q)
        return apply(rotation, torch.linalg.solve(body.inertia, apply(rotation.mT, momentum)))

    halfway = multiply(turn(0.5 * dt * spin), q)
    middle = spin_at(halfway, momentum + 0.5 * dt * body.torque)
    q = multiply(turn(dt * middle), q)
    q = q / q.norm(dim=-1, keepdim=True)
    acceleration = body.force / body.mass
    center = center + dt * speed + 0.5 * dt**2 * acceleration
    speed = speed + dt * acceleration
    spin, arm = spin_at(q, momentum + dt * body.torque), apply(matrix(q), body.center)
    return torch.cat((center - arm, q), -1), torch.cat((speed - cross(spin, arm), spin), -1)


@dataclass
class Motion:
    """Of a link: pose, velocities, accelerations where joints do not accelerate, Jacobians (N, J, 3)."""

    q: Tensor
    position: Tensor
    speed: Tensor
    spin: Tensor
    acceleration: Tensor
    turning: Tensor
    linear: Tensor
    angular: Tensor

    def moved(self, arm: Tensor) -> Motion:
        """The same of the point that lies at ``arm``, world axes, from the origin."""
        centripetal = cross(self.spin, cross(self.spin, arm))
        return Motion(
            self.q, self.position + arm, self.speed + cross(self.spin, arm), self.spin,
            self.acceleration + cross(self.turning, arm) + centripetal, self.turning,
            self.linear + cross(self.angular, arm[:, None]), self.angular,
        )  # fmt: skip


class Chain:
    """An articulation whose root stands still."""

    def __init__(self, articulation: Articulation, armature: Tensor) -> None:
        self._armature = torch.diag(armature)
        names = articulation.link_names
        numbers = {joint.name: number for number, joint in enumerate(articulation.movable_joints)}
        self._joints = [
            (names.index(joint.parent), _Hinge.of(joint, numbers.get(joint.name))) for joint in articulation.joints
        ]

    def motions(self, root: Tensor, positions: Tensor, velocities: Tensor) -> list[Motion]:
        """Of every link, from the root's pose (N, 7) and the joints (N, J)."""
        zero, flat = torch.zeros_like(root[:, :3]), torch.zeros(*positions.shape, 3, dtype=root.dtype)
        found = [Motion(root[:, 3:], root[:, :3], zero, zero, zero, zero, flat, flat)]
        for parent, hinge in self._joints:
            found.append(_child(found[parent], hinge, positions, velocities))
        return found

    def equation(
        self, bodies: list[Body], root: Tensor, positions: Tensor, velocities: Tensor
    ) -> tuple[Tensor, Tensor, list[Motion]]:
        """Mass (N, J, J) and bias (N, J) of the equation of motion ``M a + bias = efforts``, and the links' motion."""
        motions = self.motions(root, positions, velocities)
        mass, bias = self._armature.expand(len(root), -1, -1), torch.zeros_like(positions)
        for body, link in zip(bodies[1:], motions[1:], strict=True):
            rotation = matrix(link.q)
            center = link.moved(apply(rotation, body.center))
            inertia = rotation @ body.inertia @ rotation.mT
            force = body.mass * center.acceleration - body.force
            torque = apply(inertia, link.turning) + cross(link.spin, apply(inertia, link.spin)) - body.torque
            linear, angular = center.linear, center.angular
            mass = mass + body.mass[..., None] * linear @ linear.mT + angular @ inertia @ angular.mT
            bias = bias + apply(linear, force) + apply(angular, torque)
        return mass, bias, motions

    def step(
        self, bodies: list[Body], root: Tensor, positions: Tensor, velocities: Tensor, efforts: Tensor, dt: float
    ) -> tuple[Tensor, Tensor]:
        """Next positions and velocities (N, J), by the classical Runge-Kutta method."""

        def slope(p: Tensor, v: Tensor) -> Tensor:
            mass, bias, _ = self.equation(bodies, root, p, v)
            return torch.cat((v, torch.linalg.solve(mass, efforts - bias)), 1)

        state = torch.cat((positions, velocities), 1)
        first = slope(*state.chunk(2, 1))
        second = slope(*(state + 0.5 * dt * first).chunk(2, 1))
        third = slope(*(state + 0.5 * dt * second).chunk(2, 1))
        last = slope(*(state + dt * third).chunk(2, 1))
        positions, velocities = (state + dt / 6.0 * (first + 2.0 * (second + third) + last)).chunk(2, 1)
        return positions, velocities


@dataclass(frozen=True)
class _Hinge:
    """A joint's numbers as tensors."""

    number: int | None
    """Among the movable joints; None of a fixed joint."""
    slides: bool
    axis: Tensor
    before: tuple[Tensor, Tensor]
    """Position (3,) and quaternion (4,) of the joint's frame in the parent."""
    after: tuple[Tensor, Tensor]
    """Of the child in the joint's frame."""

    @staticmethod
    def of(joint: Joint, number: int | None) -> _Hinge:
        before, after = (
            tuple(torch.tensor(part, dtype=torch.float64) for part in (pose.position, pose.orientation))
            for pose in (joint.parent_pose, joint.child_pose.inverse())
        )
        axis = torch.tensor(joint.axis, dtype=torch.float64)
        return _Hinge(number, joint.type is JointType.PRISMATIC, axis, before, after)


def _child(parent: Motion, hinge: _Hinge, positions: Tensor, velocities: Tensor) -> Motion:
    """A link's motion from its parent's and from the joints' positions and velocities (N, J)."""
    (before, turned), (after, back) = hinge.before, hinge.after
    q = multiply(parent.q, turned)
    moved = parent.moved(apply(matrix(parent.q), before))
    if hinge.number is not None:
        at = hinge.number
        moved, q = _jointed(moved, q, hinge, positions[:, at, None], velocities[:, at, None])
    moved = moved.moved(apply(matrix(q), after))
    moved.q = multiply(q, back)
    return moved


def _jointed(frame: Motion, q: Tensor, hinge: _Hinge, position: Tensor, velocity: Tensor) -> tuple[Motion, Tensor]:
    """A joint's frame, turned by q, after the joint has moved it by position (N, 1)."""
    world_axis = apply(matrix(q), hinge.axis)
    column = torch.zeros_like(frame.linear)
    column[:, hinge.number] = world_axis
    if hinge.slides:
        moved = frame.moved(position * world_axis)
        moved.speed = moved.speed + velocity * world_axis
        moved.acceleration = moved.acceleration + 2.0 * cross(moved.spin, velocity * world_axis)
        moved.linear = moved.linear + column
    else:
        moved, q = replace(frame), multiply(q, turn(position * hinge.axis))
        moved.turning = moved.turning + cross(moved.spin, velocity * world_axis)
        moved.spin = moved.spin + velocity * world_axis
        moved.angular = moved.angular + column
    return moved, q
