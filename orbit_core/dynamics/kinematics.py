"""Batched kinematics of articulations: link poses and velocities from joint states, and geometric Jacobians.

Everything is in world axes. Twists and Jacobian rows are linear velocity of a point, then angular velocity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.transforms import pose_multiply, quat_from_matrix, quat_rotate, quat_to_matrix
from orbit_core.interfaces import UnknownNameError
from orbit_core.scene import Articulation, Joint, JointType

BoolArray = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]


def parent_links(articulation: Articulation) -> list[int]:
    """Return the parent's index of each link (L,); the root's is -1."""
    index = {name: i for i, name in enumerate(articulation.link_names)}
    parents = [-1] * len(index)
    for joint in articulation.joints:
        parents[index[joint.child]] = index[joint.parent]
    return parents


def child_links(articulation: Articulation) -> list[int]:
    """Return the link that each movable joint (J,) moves."""
    index = {name: i for i, name in enumerate(articulation.link_names)}
    return [index[joint.child] for joint in articulation.movable_joints]


def link_ancestry(articulation: Articulation) -> BoolArray:
    """Return a mask (L, L): True where the column's link is on the path from the root to the row's, ends included."""
    parents = parent_links(articulation)
    ancestry = np.eye(len(parents), dtype=bool)
    for link, parent in enumerate(parents):
        if parent >= 0:  # links stand in topological order, so the parent's row is complete
            ancestry[link] |= ancestry[parent]
    return ancestry


def joint_ancestry(articulation: Articulation) -> BoolArray:
    """Return a mask (L, J): True where the column's movable joint moves the row's link."""
    return link_ancestry(articulation)[:, child_links(articulation)]


class PointJacobian:
    """The geometric Jacobian of a point on one link, from link poses that are already known.

    A rotated vector is linear in the products of the quaternion's components, so one matrix product takes the poses
    of the joints' child links to all axes and origins at once: few kernel launches for any number of joints.
    Columns of joints that do not move the link are zero. A mimic joint has its own column, as if it were free; see
    :func:`mimic_matrix`.

    Args:
        articulation: the description.
        link: index of the link that carries the point.
        joints: indices of the movable joints that give the columns.
        device: where poses live.
        dtype: of the poses.
    """

    def __init__(
        self,
        articulation: Articulation,
        link: int,
        joints: Sequence[int],
        device: torch.device,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        children = child_links(articulation)
        moves = joint_ancestry(articulation)[link]
        movable = articulation.movable_joints
        self._links = torch.tensor([children[j] for j in joints], dtype=torch.int64, device=device)
        # Arms without prismatic joints save a third of the product.
        self._prismatic = any(moves[j] and movable[j].type is JointType.PRISMATIC for j in joints)
        constants = np.zeros((len(joints), 16, 9 if self._prismatic else 6))
        for column, index in enumerate(joints):
            # A column of zeros for a joint beyond the link, so that the Jacobian keeps the shape that was asked for.
            if not moves[index]:
                continue
            axis, origin = _axis_in_child(movable[index]), np.asarray(movable[index].child_pose.position)
            if movable[index].type is JointType.PRISMATIC:
                constants[column, :, 6:] = _rotated(axis)
            else:
                constants[column, :, :3], constants[column, :, 3:6] = _rotated(axis), _rotated(origin)
        self._constants = torch.as_tensor(constants, dtype=dtype, device=device)

    def __call__(self, link_poses: Tensor, point: Tensor) -> Tensor:
        """(N, 6, k) at ``point`` (N, 3) for link poses (N, L, 7) of the articulation, all in one frame."""
        poses = link_poses.transpose(0, 1).index_select(0, self._links)
        rotations = poses[..., 3:]
        products = (rotations.unsqueeze(-1) * rotations.unsqueeze(-2)).flatten(-2)
        vectors = torch.bmm(products, self._constants)
        axes = vectors[..., :3]
        linear = torch.linalg.cross(axes, point - poses[..., :3] - vectors[..., 3:6])
        if self._prismatic:
            linear = linear + vectors[..., 6:]
        return torch.cat((linear, axes), -1).permute(1, 2, 0)


class FixedFrame:
    """A frame at a constant pose in a link: its world pose from the link's, by two matrix products.

    Args:
        offset: position and quaternion (w, x, y, z) of the frame in the link.
        device: where poses live.
    """

    def __init__(self, offset: Sequence[float], device: torch.device) -> None:
        position, (w, x, y, z) = np.asarray(offset[:3], dtype=np.float64), offset[3:]
        # A row (link's quaternion) times this matrix is the product of the two quaternions.
        right = [[w, x, y, z], [-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]]
        self._position = torch.as_tensor(_rotated(position), dtype=torch.float32, device=device)
        # Single precision, as poses are: a product with doubles would convert them in every step.
        self._rotation = torch.tensor(right, dtype=torch.float32, device=device)
        # copysign needs a tensor; a constant is made once and not at each call.
        self._one = torch.ones(1, device=device)
        # Views of the last link pose: most engines return the same tensor at each read, and on few numbers a view costs
        # as much as a product.
        self._viewed: Tensor | None = None
        self._origin = self._link = self._column = self._row = self._one

    def __call__(self, link_pose: Tensor, position: Tensor | None = None) -> Tensor:
        """Return the frame's poses (N, 7), w >= 0.

        Args:
            link_pose: (N, 7) poses of the link.
            position: (N, 3) what :meth:`position` gave for them, if it was called before.
        """
        self._view(link_pose)
        position = self.position(link_pose) if position is None else position
        rotation = self._link @ self._rotation
        sign = torch.copysign(self._one, rotation[:, :1])
        return torch.cat((position, rotation * sign), 1)

    def position(self, link_pose: Tensor) -> Tensor:
        """(N, 3) of the frame's origin alone, at a third of the operations of the pose."""
        self._view(link_pose)
        return torch.addmm(self._origin, (self._column * self._row).flatten(1), self._position)

    def _view(self, link_pose: Tensor) -> None:
        if link_pose is not self._viewed:
            self._viewed, self._origin, self._link = link_pose, link_pose[:, :3], link_pose[:, 3:]
            self._column, self._row = self._link.unsqueeze(-1), self._link.unsqueeze(-2)


class KinematicTree:
    """Kinematics of one articulation, fixed or floating alike: the root's pose and velocity are inputs.

    L links and J movable joints, in the articulation's order. Mimic joints count as free: give them their positions.

    Args:
        articulation: the description.
        device: where tensors live.
        dtype: of the tensors that are given and returned; float64 where rounding must not count.
    """

    def __init__(
        self, articulation: Articulation, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32
    ) -> None:
        self.articulation = articulation
        self.device = torch.device(device)
        self.dtype = dtype
        joints = articulation.movable_joints
        revolute = [float(joint.type is not JointType.PRISMATIC) for joint in joints]
        self._parents = parent_links(articulation)
        self._children = torch.tensor(child_links(articulation), dtype=torch.int64, device=self.device)
        self._moves = self._tensor(joint_ancestry(articulation))
        self._revolute = self._tensor(revolute).view(-1, 1)
        self._axes = self._tensor([_axis_in_child(joint) for joint in joints]).view(-1, 3)
        self._origins = self._tensor([joint.child_pose.position for joint in joints]).view(-1, 3)
        constant, varying = _local_transforms(articulation)
        self._constant, self._varying = self._tensor(constant), self._tensor(varying)
        places = np.zeros((len(joints), len(self._parents)))
        places[range(len(joints)), child_links(articulation)] = 1.0
        self._places, self._last_row = self._tensor(places), self._tensor([[[0.0, 0.0, 0.0, 1.0]]])
        self._frames: dict[str, tuple[int, Tensor]] = {}
        self._jacobians: dict[str, PointJacobian] = {}

    def forward(self, root_pose: Tensor, joint_positions: Tensor) -> Tensor:
        """Return link poses (N, L, 7), w >= 0, from the root link's pose (N, 7) and joint positions (N, J).

        Each joint's transform is ``C0 + sin(q) C1 + (1 - cos(q)) C2 + q C3`` with constant matrices (Rodrigues'
        formula), so that all of them are made at once and only the products down the tree are a loop.
        """
        upper = torch.cat((quat_to_matrix(root_pose[:, 3:]), root_pose[:, :3, None]), 2)
        q = joint_positions
        terms = torch.stack((torch.sin(q), 1.0 - torch.cos(q), q), -1)
        moved = torch.einsum("njt,jtab->njab", terms, self._varying)
        local = self._constant + torch.einsum("jl,njab->nlab", self._places, moved)
        transforms = [torch.cat((upper, self._last_row.expand(root_pose.shape[0], 1, 4)), 1)]
        # The only loop: a parent's transform must be known before its children's.
        for link in range(1, len(self._parents)):
            transforms.append(transforms[self._parents[link]] @ local[:, link])
        stacked = torch.stack(transforms, 1)
        return torch.cat((stacked[..., :3, 3], quat_from_matrix(stacked[..., :3, :3])), -1)

    def motion_subspaces(self, link_poses: Tensor, origin: Tensor) -> Tensor:
        """Return the twists (N, J, 6) that unit joint velocities give the body point now at ``origin`` (N, 3).

        Twists about one common point may be added.
        """
        children = link_poses[:, self._children]
        axes = quat_rotate(children[..., 3:], self._axes)
        points = children[..., :3] + quat_rotate(children[..., 3:], self._origins)
        angular = axes * self._revolute
        linear = torch.linalg.cross(points - origin[:, None], angular) + (axes - angular)
        return torch.cat((linear, angular), -1)

    def link_velocities(self, link_poses: Tensor, root_velocity: Tensor, joint_velocities: Tensor) -> Tensor:
        """Return velocities (N, L, 6) of the link frames' origins.

        Args:
            link_poses: (N, L, 7).
            root_velocity: (N, 6).
            joint_velocities: (N, J) rad/s or m/s.
        """
        origin = link_poses[:, 0, :3]
        joint_twists = self.motion_subspaces(link_poses, origin) * joint_velocities[..., None]
        twists = root_velocity[:, None] + self._moves @ joint_twists
        linear, angular = twists[..., :3], twists[..., 3:]
        return torch.cat((linear + torch.linalg.cross(angular, link_poses[..., :3] - origin[:, None]), angular), -1)

    def frame_pose(self, link_poses: Tensor, frame: str) -> Tensor:
        """Return (N, 7) of a link or named frame.

        Raises:
            UnknownNameError: no link or frame has that name.
        """
        link, offset = self._frame(frame)
        return pose_multiply(link_poses[:, link], offset)

    def jacobian(self, link_poses: Tensor, frame: str, floating_base: bool = False) -> Tensor:
        """Return the geometric Jacobian of a link or named frame.

        The base's columns are for the linear velocity of the root frame's origin, then its angular velocity, both in
        world axes.

        Args:
            link_poses: (N, L, 7).
            frame: name of the link or frame.
            floating_base: whether the base's six columns come first.

        Returns:
            (N, 6, J), or (N, 6, 6 + J) with a floating base.

        Raises:
            UnknownNameError: no link or frame has that name.
        """
        # Made on first use: most of the frames of a robot are never asked for a Jacobian.
        if frame not in self._jacobians:
            columns = range(len(self.articulation.movable_joints))
            self._jacobians[frame] = PointJacobian(
                self.articulation, self._frame(frame)[0], columns, self.device, self.dtype
            )
        point = self.frame_pose(link_poses, frame)[:, :3]
        joints = self._jacobians[frame](link_poses, point)
        return torch.cat((_base_columns(point - link_poses[:, 0, :3]), joints), -1) if floating_base else joints

    def frame_drift(self, link_poses: Tensor, joint_velocities: Tensor, frame: str) -> Tensor:
        """Return (N, 6) :meth:`point_drifts` of the origin of a link or named frame.

        Raises:
            UnknownNameError: no link or frame has that name.
        """
        link = torch.full((1,), self._frame(frame)[0], dtype=torch.int64, device=self.device)
        points = self.frame_pose(link_poses, frame)[:, None, :3]
        return self.point_drifts(link_poses, joint_velocities, link, points).squeeze(1)

    def point_drifts(self, link_poses: Tensor, joint_velocities: Tensor, links: Tensor, points: Tensor) -> Tensor:
        """Return accelerations (N, S, 6) of links' points while no joint accelerates, ``dJ/dt v``; the root is at rest.

        Linear of the point, then angular of its link, world axes. Featherstone, Rigid Body Dynamics Algorithms, 2008,
        section 2.10: velocity products, and the part of a moving point beyond its body's spatial acceleration.

        Args:
            link_poses: (N, L, 7).
            joint_velocities: (N, J).
            links: (S,) int64 that carry the points.
            points: (N, S, 3) world.
        """
        twists, drifts = self.link_drifts(link_poses, joint_velocities)
        arms = points - link_poses[:, :1, :3]
        return drift_at(twists[:, links], drifts[:, links], arms)

    def link_drifts(self, link_poses: Tensor, joint_velocities: Tensor) -> tuple[Tensor, Tensor]:
        """Return twist (N, L, 6) and, while no joint accelerates, spatial acceleration (N, L, 6) of all links.

        Both about the root's origin, of which :func:`drift_at` makes the acceleration of a point; the root is at rest.
        """
        joint_twists = self.motion_subspaces(link_poses, link_poses[:, 0, :3]) * joint_velocities[..., None]
        twists = self._moves @ joint_twists
        return twists, self._moves @ cross_motion(twists[:, self._children], joint_twists)

    def _frame(self, name: str) -> tuple[int, Tensor]:
        if name not in self._frames:
            try:
                frame = self.articulation.frame(name)
            except KeyError:
                known = [*self.articulation.link_names, *(other.name for other in self.articulation.frames)]
                raise UnknownNameError("frame", name, known, f"'{self.articulation.name}'") from None
            offset = self._tensor((*frame.pose.position, *frame.pose.orientation))
            self._frames[name] = (self.articulation.link_names.index(frame.link), offset)
        return self._frames[name]

    def _tensor(self, values: object) -> Tensor:
        return torch.as_tensor(np.asarray(values, dtype=np.float64), dtype=self.dtype, device=self.device)


def drift_at(twist: Tensor, spatial: Tensor, arm: Tensor) -> Tensor:
    """Return the acceleration (..., 6) of a point of a body: linear, then angular of the body.

    Of its body's twist and spatial acceleration (..., 6) about the root's origin.

    Args:
        twist: (..., 6) of the body about the root's origin.
        spatial: (..., 6) spatial acceleration of the body about the root's origin.
        arm: (..., 3) from the root's origin to the point.
    """
    angular = twist[..., 3:]
    velocity = twist[..., :3] + torch.linalg.cross(angular, arm)
    linear = spatial[..., :3] + torch.linalg.cross(spatial[..., 3:], arm) + torch.linalg.cross(angular, velocity)
    return torch.cat((linear, spatial[..., 3:]), -1)


def cross_motion(twist: Tensor, motion: Tensor) -> Tensor:
    """Return rate of change (..., 6) of ``motion`` as it is carried along by ``twist``."""
    linear, angular = twist[..., :3], twist[..., 3:]
    along = torch.linalg.cross(angular, motion[..., :3]) + torch.linalg.cross(linear, motion[..., 3:])
    return torch.cat((along, torch.linalg.cross(angular, motion[..., 3:])), -1)


def mimic_matrix(articulation: Articulation) -> FloatArray:
    """Return (J, J): joint velocities when only leaders are free, from all velocities; a follower's column is zero.

    A law with higher powers counts by its slope where the leader is at zero.
    ``jacobian @ mimic_matrix`` folds the followers' columns into their leaders'.
    """
    names = articulation.joint_names
    matrix = np.eye(len(names))
    for index, joint in enumerate(articulation.movable_joints):
        if joint.mimic is not None:
            matrix[index, index] = 0.0
            # A follower moves with its leader, and its own velocity does not count.
            matrix[index, names.index(joint.mimic.joint)] = joint.mimic.slope(0.0)
    return matrix


def _axis_in_child(joint: Joint) -> FloatArray:
    # A joint's own motion leaves its axis where it is, so the axis is constant in the child link.
    return joint.child_pose.rotation_matrix() @ np.asarray(joint.axis)


def _rotated(vector: FloatArray) -> FloatArray:
    """Return (16, 3): what the 16 products of a unit quaternion's components are multiplied with to rotate ``vector``.

    From ``R(w, u) = (w^2 - u.u) I + 2 u u^T + 2 w [u]``, [u] the matrix of the cross product.
    """
    # Rows and columns are the quaternion's components, w first.
    result = np.zeros((4, 4, 3))
    result[0, 0] = vector
    for i, unit in enumerate(np.eye(3), start=1):
        result[0, i] = 2.0 * np.cross(unit, vector)
        result[i, 1:] = 2.0 * vector[:, None] * unit
        result[i, i] -= vector
    return result.reshape(16, 3)


def _base_columns(arm: Tensor) -> Tensor:
    """Return (N, 6, 6): twist of the point at ``arm`` (N, 3) from the base's origin, per unit of the base's twist."""
    columns = torch.eye(6, dtype=arm.dtype, device=arm.device).repeat(arm.shape[0], 1, 1)
    x, y, z = arm.unbind(-1)
    columns[:, 0, 4], columns[:, 0, 5] = z, -y
    columns[:, 1, 3], columns[:, 1, 5] = -z, x
    columns[:, 2, 3], columns[:, 2, 4] = y, -x
    return columns


def _local_transforms(articulation: Articulation) -> tuple[FloatArray, FloatArray]:
    """Return the transform of each link in its parent: a constant (L, 4, 4), and the joints' factors (J, 3, 4, 4)."""
    index = {name: i for i, name in enumerate(articulation.link_names)}
    constant = np.tile(np.eye(4), (len(index), 1, 1))
    varying = np.zeros((len(articulation.movable_joints), 3, 4, 4))
    for joint in articulation.joints:
        constant[index[joint.child]] = (joint.parent_pose @ joint.child_pose.inverse()).matrix()
    for row, joint in enumerate(articulation.movable_joints):
        before, after = joint.parent_pose.matrix(), joint.child_pose.inverse().matrix()
        motion = np.zeros((4, 4))
        if joint.type is JointType.PRISMATIC:
            motion[:3, 3] = joint.axis
            varying[row, 2] = before @ motion @ after
        else:
            motion[:3, :3] = np.cross(np.eye(3), joint.axis)  # the rows make the matrix of v -> axis x v
            varying[row, 0] = before @ motion @ after
            varying[row, 1] = before @ motion @ motion @ after
    return constant, varying
