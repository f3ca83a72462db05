"""Poses and velocities of all links from those of the roots and joints: PhysX packs no more in bulk.

Double precision, so that what is rounded to single at the end does not depend on the number of environments. A joint's
transform is linear in (1, cos, sin) of its angle and in its displacement; constants are computed once.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import SceneLayout
from orbit_core.scene import Joint, JointType, Pose


class Kinematics:
    """Kinematics of every environment at once."""

    def __init__(self, layout: SceneLayout) -> None:
        links, joints = len(layout.links), len(layout.joints)
        parents = np.full(links, -1)
        incoming: dict[int, tuple[Joint, int | None]] = {}
        for entity in layout.entities:
            names = entity.spec.articulation.link_names
            numbers = iter(range(entity.joints.start, entity.joints.stop))
            for joint in entity.spec.articulation.joints:
                child = entity.links.start + names.index(joint.child)
                parents[child] = entity.links.start + names.index(joint.parent)
                incoming[child] = joint, next(numbers) if joint.movable else None
        self._roots = torch.tensor([entity.root_link for entity in layout.entities], dtype=torch.int64)
        self._root_of_link = torch.as_tensor(layout.entity_of_link)
        self._set_constants(incoming, parents, links, joints)
        self._levels = _levels(parents)
        self._above = torch.as_tensor(np.maximum(parents, 0))
        self._below = torch.from_numpy(_moved_by(parents))

    def _set_constants(
        self, incoming: dict[int, tuple[Joint, int | None]], parents: np.ndarray, links: int, joints: int
    ) -> None:
        rotation, position = np.zeros((2, links, 4)), np.zeros((4, links, 3))
        rotation[0, :, 0] = 1.0
        angle_of_link, shift_of_link = np.zeros((links, joints)), np.zeros((links, joints))
        axes, anchors, child_of_joint = np.zeros((joints, 3)), np.zeros((joints, 3)), np.zeros(joints, np.int64)
        revolute = np.zeros(joints)
        for child, (joint, number) in incoming.items():
            fixed = joint.child_pose.inverse()
            axis = np.asarray(joint.axis) / np.linalg.norm(joint.axis)
            before, after = joint.parent_pose, np.asarray(fixed.position)
            start, turned = before.orientation, (0.0, *axis)
            rotation[0, child] = _multiply(start, fixed.orientation)
            if joint.type is JointType.REVOLUTE or joint.type is JointType.CONTINUOUS:
                rotation[1, child] = _multiply(_multiply(start, turned), fixed.orientation)
            # Along the axis nothing turns; the rest of the offset turns with the cosine, and its perpendicular with the
            # sine.
            along = axis * (axis @ after)
            matrix = before.rotation_matrix()
            position[0, child] = before.position + matrix @ along
            position[1, child] = matrix @ (after - along)
            position[2, child] = matrix @ np.cross(axis, after)
            position[3, child] = matrix @ axis
            if number is not None:
                prismatic = joint.type is JointType.PRISMATIC
                (shift_of_link if prismatic else angle_of_link)[child, number] = 1.0
                revolute[number] = 0.0 if prismatic else 1.0
                # The joint's axis and anchor do not move with the joint, so they are fixed in the child link too.
                axes[number] = Pose((0.0, 0.0, 0.0), joint.child_pose.orientation).transform(axis)
                anchors[number] = joint.child_pose.position
                child_of_joint[number] = child
        ancestors = np.zeros((links, joints))
        for link in range(links):
            above = link
            while above >= 0:
                ancestors[link, child_of_joint == above] = 1.0
                above = parents[above]
        self._cosine_part, self._sine_part = torch.from_numpy(rotation)
        self._offsets = torch.from_numpy(position)
        self._angle_joint, self._shift_joint = _selector(angle_of_link), _selector(shift_of_link)
        self._axes, self._anchors = torch.from_numpy(axes), torch.from_numpy(anchors)
        self._child_of_joint = torch.from_numpy(child_of_joint)
        self._ancestors, self._revolute = torch.from_numpy(ancestors), torch.from_numpy(revolute)[:, None]

    def poses(self, roots: Tensor, joint_positions: Tensor) -> Tensor:
        """(N, L, 7) of root poses (N, E, 7) and joint positions (N, J)."""
        poses = roots.new_zeros(len(roots), len(self._above), 7)
        poses[:, self._roots] = roots
        if not self._levels:
            return poses
        # A column of zeros for links without a joint of that kind, so that one gather serves all.
        padded = torch.cat((joint_positions, joint_positions.new_zeros(len(roots), 1)), -1)
        angles, shifts = padded[:, self._angle_joint, None], padded[:, self._shift_joint, None]
        # Of half the angle, which quaternions need; those of the whole follow from these by products.
        half_cosine, half_sine = (0.5 * angles).cos(), (0.5 * angles).sin()
        rotations = half_cosine * self._cosine_part + half_sine * self._sine_part
        constant, with_cosine, with_sine, with_shift = self._offsets
        cosine, sine = half_cosine.square() - half_sine.square(), 2.0 * half_sine * half_cosine
        positions = constant + cosine * with_cosine + sine * with_sine + shifts * with_shift
        turns = poses[..., 3:]
        for level, parents in self._levels:
            turns[:, level] = multiply(turns[:, parents], rotations[:, level])
        # Each link adds its offset, in its parent's axes, to all below it.
        poses[..., :3] = roots[:, self._root_of_link, :3] + self._below @ rotate(turns[:, self._above], positions)
        return poses

    def velocities(self, poses: Tensor, root_velocities: Tensor, joint_velocities: Tensor) -> Tensor:
        """(N, L, 6), linear of each link's origin, then angular, of poses (N, L, 7) and root velocities (N, E, 6)."""
        positions = poses[..., :3]
        roots = root_velocities[:, self._root_of_link]
        spins = roots[..., 3:]
        arms = positions - positions[:, self._roots][:, self._root_of_link]
        linear = roots[..., :3] + torch.linalg.cross(spins, arms)
        if len(self._axes):
            children = poses[:, self._child_of_joint]
            rates = rotate(children[..., 3:], self._axes.expand(len(poses), -1, -1)) * joint_velocities[..., None]
            points = children[..., :3] + rotate(children[..., 3:], self._anchors.expand(len(poses), -1, -1))
            # A turn about an axis through a point is a spin and a push at the origin: these add up over the joints
            # above a link in one product.
            turning = rates * self._revolute
            pushes = rates - turning - torch.linalg.cross(turning, points)
            joint_spins, sums = torch.split(self._ancestors @ torch.cat((turning, pushes), -1), 3, -1)
            linear = linear + sums + torch.linalg.cross(joint_spins, positions)
            spins = spins + joint_spins
        return torch.cat((linear, spins), -1)


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """Vectors (..., 3) turned by unit quaternions (..., 4)."""
    u = q[..., 1:]
    t = 2.0 * torch.linalg.cross(u, v)
    return v + q[..., :1] * t + torch.linalg.cross(u, t)


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """The rotation ``b`` followed by ``a``: (..., 4)."""
    u, v = a[..., 1:], b[..., 1:]
    w = a[..., :1] * b[..., :1] - (u * v).sum(-1, keepdim=True)
    return torch.cat((w, a[..., :1] * v + b[..., :1] * u + torch.linalg.cross(u, v)), -1)


def _multiply(a: npt.ArrayLike, b: npt.ArrayLike) -> np.ndarray:
    one, other = torch.tensor(np.array([a, b]), dtype=torch.float64)
    return multiply(one, other).numpy()


def _selector(joint_of_link: np.ndarray) -> Tensor:
    """(L,) the joint of each link, or the number of joints where none."""
    links, joints = joint_of_link.shape
    chosen = joint_of_link.argmax(-1) if joints else np.zeros(links, np.int64)
    return torch.as_tensor(np.where(joint_of_link.any(-1), chosen, joints))


def _levels(parents: np.ndarray) -> list[tuple[Tensor, Tensor]]:
    """Links by their distance from the root, with their parents; roots left out."""
    depth = np.zeros(len(parents), np.int64)
    for link, parent in enumerate(parents):  # parents come first
        depth[link] = depth[parent] + 1 if parent >= 0 else 0
    levels = [np.flatnonzero(depth == level) for level in range(1, depth.max(initial=0) + 1)]
    return [(torch.as_tensor(level), torch.as_tensor(parents[level])) for level in levels]


def _moved_by(parents: np.ndarray) -> np.ndarray:
    """(L, L) one where the second link is the first or above it, and no root."""
    moved = np.zeros((len(parents), len(parents)))
    for link, parent in enumerate(parents):  # parents come first
        if parent >= 0:
            moved[link] = moved[parent]
            moved[link, link] = 1.0
    return moved
