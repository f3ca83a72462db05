"""Objects, robots and markers as views of an engine's state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import (
    EFFORTS,
    POSITIONS,
    VELOCITIES,
    Bounds,
    as_floats,
    check_numbers,
    check_shape,
    columns_chosen,
)
from orbit_core.dynamics.indexing import RowSelector, columns_of, write_block, write_rows
from orbit_core.dynamics.kinematics import FixedFrame, PointJacobian
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import ConfigurationError, EntityLayout, JointTarget, Marker, Robot, UnknownNameError
from orbit_core.scene import ActiveModel, Frame, MarkerSpec, ObjectSpec, Pose, RobotSpec
from orbit_core.world.object_parameters import ObjectParameters
from orbit_core.world.state import WorldParts


class _View:
    """Some columns of a state tensor of the engine, read once per version of the world's clock.

    A property that hits the cache costs one Python call; a read through the engine costs five.
    """

    __slots__ = ("_columns", "_whole", "tensor", "version")

    tensor: Tensor
    """(N, columns, ...) at ``version``."""

    def __init__(self, columns: int | slice) -> None:
        self._columns = columns
        self._whole: Tensor | None = None
        self.version = -1

    def take(self, whole: Tensor, version: int) -> None:
        """Take the columns of a tensor (N, ...); slices it only if the engine returned another tensor than before."""
        # Most engines return the same tensor at each read; slicing it once saves a torch operation per read.
        if whole is not self._whole:
            self._whole, self.tensor = whole, whole[:, self._columns]
        self.version = version


@dataclass(frozen=True)
class _FrameHandle:
    """A frame resolved to its link's index within the entity, and its constant pose there; None at the link itself."""

    link: int
    link_pose: _View
    offset: Tensor | None
    """(3,) position in the link."""
    pose_of: FixedFrame | None


class SimulatedObject(ObjectParameters):
    """An articulation in N environments of one engine."""

    def __init__(self, layout: EntityLayout, parts: WorldParts) -> None:
        super().__init__(layout, parts)
        self._frames: dict[str, _FrameHandle] = {}
        # Pose of each frame that was read, with its version of the clock
        self._frame_poses: dict[str, tuple[int, Tensor]] = {}
        # Position alone of each frame of which no more was read, likewise
        self._frame_positions: dict[str, tuple[int, Tensor]] = {}
        self._jacobians: dict[tuple[str, tuple[int, ...]], PointJacobian] = {}
        links, joints = layout.links, layout.joints
        self._root_pose, self._root_velocity = _View(layout.root_link), _View(layout.root_link)
        self._link_poses, self._link_velocities = _View(links), _View(links)
        self._positions, self._velocities, self._efforts = _View(joints), _View(joints), _View(joints)
        engine = parts.engine
        parameters = engine.layout.joint_parameters
        limits = [torch.as_tensor(array[joints]) for array in (parameters.lower_limit, parameters.upper_limit)]
        self._limits = torch.stack(limits, dim=-1).to(engine.device, torch.float32)
        self._home = torch.as_tensor(parameters.home[joints]).to(engine.device, torch.float32)

    @property
    def active_specs(self) -> tuple[ActiveModel, ...]:
        """Specifications of the object's active models."""
        return self.spec.active if isinstance(self.spec, ObjectSpec) else ()

    # Reading

    @property
    def root_pose(self) -> Tensor:
        # Repeated in each property instead of a helper: the call would cost as much as the look.
        view = self._root_pose
        if view.version != self._clock.version:
            view.take(self._engine.link_poses, self._clock.version)
        return view.tensor

    @property
    def root_velocity(self) -> Tensor:
        view = self._root_velocity
        if view.version != self._clock.version:
            view.take(self._engine.link_velocities, self._clock.version)
        return view.tensor

    @property
    def link_poses(self) -> Tensor:
        view = self._link_poses
        if view.version != self._clock.version:
            view.take(self._engine.link_poses, self._clock.version)
        return view.tensor

    @property
    def link_velocities(self) -> Tensor:
        view = self._link_velocities
        if view.version != self._clock.version:
            view.take(self._engine.link_velocities, self._clock.version)
        return view.tensor

    @property
    def joint_positions(self) -> Tensor:
        view = self._positions
        if view.version != self._clock.version:
            view.take(self._engine.joint_positions, self._clock.version)
        return view.tensor

    @property
    def joint_velocities(self) -> Tensor:
        view = self._velocities
        if view.version != self._clock.version:
            view.take(self._engine.joint_velocities, self._clock.version)
        return view.tensor

    @property
    def joint_efforts(self) -> Tensor:
        view = self._efforts
        if view.version != self._clock.version:
            view.take(self._engine.joint_efforts, self._clock.version)
        return view.tensor

    def frame_pose(self, name: str) -> Tensor:
        if not isinstance(name, str):
            self._frame(name)  # which refuses it
        version, pose = self._frame_poses.get(name, (-1, None))
        if pose is None or version != self._clock.version:
            frame = self._frame(name)
            frame.link_pose.take(self._engine.link_poses, self._clock.version)
            pose = frame.link_pose.tensor
            if frame.pose_of is not None:
                seen, position = self._frame_positions.get(name, (-1, None))
                pose = frame.pose_of(pose, position if seen == self._clock.version else None)
            self._frame_poses[name] = (self._clock.version, pose)
        return pose

    def frame_position(self, name: str) -> Tensor:
        frame, now = self._frame(name), self._clock.version
        # A pose of this state that was computed before holds the position already.
        if frame.pose_of is None or self._frame_poses.get(name, (-1,))[0] == now:
            return self.frame_pose(name)[:, :3]
        version, position = self._frame_positions.get(name, (-1, None))
        if position is None or version != now:
            frame.link_pose.take(self._engine.link_poses, now)
            position = frame.pose_of.position(frame.link_pose.tensor)
            self._frame_positions[name] = now, position
        return position

    def frame_velocity(self, name: str) -> Tensor:
        frame = self._frame(name)
        velocity = self._engine.link_velocities[:, self.layout.root_link + frame.link]
        if frame.offset is None:
            return velocity
        arm = quat_rotate(self._engine.link_poses[:, self.layout.root_link + frame.link, 3:], frame.offset)
        return torch.cat((velocity[:, :3] + torch.linalg.cross(velocity[:, 3:], arm), velocity[:, 3:]), -1)

    def jacobian(self, frame: str, joints: Sequence[int] | None = None) -> Tensor:
        columns = self._all_columns if joints is None else self._joint_columns(joints)
        link = self._frame(frame).link
        # Constants of the Jacobian are built once per frame and joints.
        jacobian = self._jacobians.get((frame, columns))
        if jacobian is None:
            jacobian = PointJacobian(self.spec.articulation, link, columns, self._engine.device)
            self._jacobians[frame, columns] = jacobian
        return jacobian(self.link_poses, self.frame_pose(frame)[:, :3])

    # Looking up

    @property
    def home_positions(self) -> Tensor:
        return self._home

    @property
    def position_limits(self) -> Tensor:
        return self._limits

    # Writing state

    def set_root_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        chosen = self._selector.select(env_ids)
        pose = chosen.poses(pose, f"root pose of '{self.name}'")
        self._engine.write_root_state(self.layout.index, pose, None, chosen.rows)
        self._clock.touch()

    def set_root_velocity(self, velocity: Tensor, env_ids: Tensor | None = None) -> None:
        chosen = self._selector.select(env_ids)
        velocity = chosen.values(velocity, (6,), f"root velocity of '{self.name}'", VELOCITIES)
        self._engine.write_root_state(self.layout.index, None, velocity, chosen.rows)
        self._clock.touch()

    def set_joint_state(
        self,
        positions: Tensor | None = None,
        velocities: Tensor | None = None,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        written = self._all_columns if joints is None else self._joint_columns(joints)
        chosen, shape = self._selector.select(env_ids), (len(written),)
        if positions is not None:
            positions = chosen.values(positions, shape, f"joint positions of '{self.name}'", POSITIONS)
        if velocities is not None:
            velocities = chosen.values(velocities, shape, f"joint velocities of '{self.name}'", VELOCITIES)
        indices, columns = self._all_joints, self.layout.joints
        # All joints include the followers already.
        if joints is not None:
            moved, positions, velocities = self._with_followers(list(written), positions, velocities, chosen.rows)
            indices = columns = indices[moved]
        self._engine.write_joint_state(indices, positions, velocities, chosen.rows)
        if positions is not None:
            # A drive would pull the joint back to its old target otherwise.
            write_block(self._actuators.position_targets, columns, positions, chosen.rows)
        self._clock.touch()

    def _with_followers(
        self, chosen: list[int], positions: Tensor | None, velocities: Tensor | None, rows: Tensor | None
    ) -> tuple[list[int], Tensor | None, Tensor | None]:
        """Mimic joints move with their leaders, so that a written state already satisfies the constraint."""
        joints = list(chosen)
        for index, joint in enumerate(self.joints):
            if joint.mimic is None or index in chosen:
                continue
            leader = self.joint_names.index(joint.mimic.joint)
            if leader not in chosen:
                continue
            column = chosen.index(leader)
            joints.append(index)
            if positions is not None:
                follower = joint.mimic.position(positions[:, column : column + 1])
                positions = torch.cat((positions, follower), -1)
            if velocities is not None:
                at = self._leader_positions(leader, column, positions, rows)
                velocities = torch.cat((velocities, joint.mimic.slope(at) * velocities[:, column : column + 1]), -1)
        return joints, positions, velocities

    def _leader_positions(self, leader: int, column: int, positions: Tensor | None, rows: Tensor | None) -> Tensor:
        """(n, 1): as written, else as they are."""
        if positions is not None:
            return positions[:, column : column + 1]
        current = self.joint_positions[:, leader : leader + 1]
        return current if rows is None or rows.dtype == torch.bool else current[rows]

    def _frame(self, name: str) -> _FrameHandle:
        handle = self._frames.get(name) if isinstance(name, str) else None
        if handle is None:
            articulation = self.spec.articulation
            try:
                frame = articulation.frame(name)
            except KeyError:
                known = [*self.link_names, *(frame.name for frame in articulation.frames)]
                raise UnknownNameError("frame", name, known, f"'{self.name}'") from None
            handle = self._frames[name] = self._resolved(frame)
        return handle

    def _resolved(self, frame: Frame) -> _FrameHandle:
        link, device = self.link_names.index(frame.link), self._engine.device
        link_pose = _View(self.layout.root_link + link)
        if frame.pose == Pose():
            return _FrameHandle(link, link_pose, None, None)
        offset = torch.tensor(frame.pose.position, dtype=torch.float32, device=device)
        pose_of = FixedFrame((*frame.pose.position, *frame.pose.orientation), device)
        return _FrameHandle(link, link_pose, offset, pose_of)


class SimulatedRobot(SimulatedObject, Robot):
    """An articulation whose actuators take commands."""

    @property
    def spec(self) -> RobotSpec:
        return self._spec

    def __init__(self, layout: EntityLayout, parts: WorldParts) -> None:
        assert isinstance(layout.spec, RobotSpec)  # the world makes robots of robots' layouts alone
        self._spec = layout.spec
        super().__init__(layout, parts)
        actuators, own = parts.actuators, (layout.joints, f"of '{self.name}'")
        self._targets = {
            JointTarget.POSITION: _Targets(actuators.position_targets, POSITIONS, "position targets", *own),
            JointTarget.VELOCITY: _Targets(actuators.velocity_targets, VELOCITIES, "velocity targets", *own),
            JointTarget.EFFORT: _Targets(actuators.effort_targets, EFFORTS, "effort targets", *own),
        }

    @property
    def motor_temperatures(self) -> Tensor:
        temperatures = self._actuators.temperatures()
        if temperatures is None:
            raise ConfigurationError(f"no motor of '{self.name}' has windings: give a DcMotor of its actuators some")
        return temperatures[:, self.layout.joints]

    def target_writer(
        self, target: JointTarget, joints: Sequence[int], checked: bool = True
    ) -> Callable[[Tensor], object]:
        return self._targets[target].writer(joints, checked)

    def set_position_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        self._targets[JointTarget.POSITION].write(targets, joints)

    def set_velocity_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        self._targets[JointTarget.VELOCITY].write(targets, joints)

    def set_effort_targets(self, efforts: Tensor, joints: Sequence[int] | None = None) -> None:
        self._targets[JointTarget.EFFORT].write(efforts, joints)


class _Targets:
    """A robot's columns of one of the actuators' buffers; columns that stand in a row are written through a view."""

    def __init__(self, buffer: Tensor, bounds: Bounds, what: str, joints: slice, whose: str) -> None:
        self._buffer = buffer[:, joints]
        self._bounds = bounds
        self._what = f"{what} {whose}"
        self._joints = f"joints {whose}"
        self._writers: dict[tuple[int, ...], Callable[[Tensor], object]] = {}

    def write(self, values: Tensor, joints: Sequence[int] | None) -> None:
        if joints is None:
            self._buffer.copy_(self._checked(values, self._buffer.shape[1]))
            return
        chosen = columns_chosen(joints, self._buffer.shape[1], self._joints)
        writer = self._writers.get(chosen)
        if writer is None:
            writer = self._writers[chosen] = self._unchecked(chosen)
        writer(self._checked(values, len(chosen)))

    def writer(self, joints: Sequence[int], checked: bool) -> Callable[[Tensor], object]:
        """Return a function that writes targets (N, k) of some joints, with or without a look at the numbers."""
        chosen = columns_chosen(joints, self._buffer.shape[1], self._joints)
        return partial(self.write, joints=chosen) if checked else self._unchecked(chosen)

    def _unchecked(self, chosen: tuple[int, ...]) -> Callable[[Tensor], object]:
        columns = columns_of(chosen, self._buffer.device)
        if isinstance(columns, slice):
            return self._buffer[:, columns].copy_
        return partial(self._buffer.index_copy_, 1, columns)

    def _checked(self, values: Tensor, count: int) -> Tensor:
        values = as_floats(values, self._buffer.device, self._what)
        check_shape(values, (len(self._buffer), count), self._what)
        check_numbers(values, self._bounds, self._what)
        return values


class SimulatedMarker(Marker):
    """A pose (N, 7) that viewers and videos draw."""

    def __init__(self, spec: MarkerSpec, poses: Tensor, selector: RowSelector) -> None:
        self.spec = spec
        """Description in the scene."""
        self._poses = poses
        self._selector = selector

    @property
    def pose(self) -> Tensor:
        return self._poses

    def set_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        chosen = self._selector.select(env_ids)
        write_rows(self._poses, chosen.poses(pose, f"pose of marker '{self.spec.name}'"), chosen.rows)


def identity_poses(num_envs: int, markers: int, device: torch.device) -> Tensor:
    """(N, M, 7) at each environment's origin."""
    poses = torch.zeros(num_envs, markers, 7, device=device)
    poses[..., 3] = 1.0
    return poses
