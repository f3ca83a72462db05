"""The scene's equation of motion in generalised velocities: those of all joints, then six of each free body.

A free body's six are the linear velocity of its centre of mass and its angular velocity, world axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.interfaces import EntityLayout, SceneLayout
from orbit_core.plugin_kit.engines import velocity_at
from orbit_torch.dynamics import Body, Chain, Motion
from orbit_torch.rotations import apply, cross, matrix, turn
from orbit_torch.rotations import multiply as compose


@dataclass
class Equation:
    """``mass @ acceleration = force``, and how links move with the D generalised velocities."""

    mass: Tensor
    """(N, D, D)"""
    force: Tensor
    """(N, D) of gravity, wrenches and what turning brings; commands are not in it."""
    velocity: Tensor
    """(N, D)"""
    linear: Tensor
    """(N, L + 1, D, 3) velocity of each link's origin per generalised velocity; the last is the terrain's, none."""
    angular: Tensor
    """(N, L + 1, D, 3)"""

    def point_jacobian(self, links: Tensor, arms: Tensor) -> Tensor:
        """(N, C, 3, D) of points of links (N, C) at ``arms`` (N, C, 3), world axes, from the links' origins."""
        rows = torch.arange(len(links))[:, None]
        return (self.linear[rows, links] + cross(self.angular[rows, links], arms[:, :, None])).mT


class System:
    """Which generalised velocities are whose."""

    def __init__(self, layout: SceneLayout, chains: dict[int, Chain]) -> None:
        self._chains = chains
        self._links = len(layout.links)
        self.size = len(layout.joints)
        self.columns: list[slice] = []
        """Of each entity."""
        for entity in layout.entities:
            if entity.spec.fixed_base:
                self.columns.append(entity.joints)
            else:
                self.columns.append(slice(self.size, self.size + 6))
                self.size += 6
        self._entities = layout.entities

    def equation(
        self, bodies: list[Body], poses: Tensor, velocities: Tensor, positions: Tensor, rates: Tensor
    ) -> Equation:
        """At this state: link poses (N, L, 7) and velocities (N, L, 6), joints' positions and rates (N, J)."""
        count, size = len(poses), self.size
        mass, force = poses.new_zeros(count, size, size), poses.new_zeros(count, size)
        linear, angular = poses.new_zeros(2, count, self._links + 1, size, 3)
        found = Equation(
            mass, force, torch.cat((rates, poses.new_zeros(count, size - rates.shape[1])), 1), linear, angular
        )
        for entity, columns in zip(self._entities, self.columns, strict=True):
            own, root = bodies[entity.links], entity.root_link
            if not entity.spec.fixed_base:
                self._add_free(found, own[0], root, columns, poses[:, root], velocities[:, root])
            elif columns.start < columns.stop:
                chain, state = self._chains[entity.index], (positions[:, columns], rates[:, columns])
                mass, bias, motions = chain.equation(own, poses[:, root], *state)
                found.mass[:, columns, columns], found.force[:, columns] = mass, -bias
                self._add_links(found, entity, columns, motions)
        return found

    @staticmethod
    def _add_links(found: Equation, entity: EntityLayout, columns: slice, motions: list[Motion]) -> None:
        for link, motion in enumerate(motions, entity.links.start):
            found.linear[:, link, columns], found.angular[:, link, columns] = motion.linear, motion.angular

    @staticmethod
    def _add_free(found: Equation, body: Body, link: int, columns: slice, pose: Tensor, velocity: Tensor) -> None:
        push, spin = slice(columns.start, columns.start + 3), slice(columns.start + 3, columns.stop)
        rotation = matrix(pose[:, 3:])
        inertia = rotation @ body.inertia @ rotation.mT
        arm, omega = apply(rotation, body.center), velocity[:, 3:]
        unit = torch.eye(3, dtype=pose.dtype)
        found.mass[:, push, push] = body.mass[..., None] * unit
        found.mass[:, spin, spin] = inertia
        found.force[:, push] = body.force
        found.force[:, spin] = body.torque - cross(omega, apply(inertia, omega))
        found.velocity[:, columns] = velocity_at(velocity, arm)
        found.linear[:, link, push] = found.angular[:, link, spin] = unit
        found.linear[:, link, spin] = cross(unit, -arm[:, None])


def move_free_body(body: Body, pose: Tensor, speeds: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Pose (N, 7) and velocity (N, 6) of a link's origin after it has gone on with generalised velocities (N, 6)."""
    center = pose[:, :3] + apply(matrix(pose[:, 3:]), body.center) + dt * speeds[:, :3]
    q = compose(turn(dt * speeds[:, 3:]), pose[:, 3:])
    q = q / q.norm(dim=-1, keepdim=True)
    arm = apply(matrix(q), body.center)
    return torch.cat((center - arm, q), -1), velocity_at(speeds, -arm)
