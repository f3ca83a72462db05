"""Objects as views of the engine's flat state tensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from orbit_core.actuators import Actuators
from orbit_core.dynamics.arguments import (
    EFFORTS,
    FRICTIONS,
    GAINS,
    MASSES,
    MOVING_MASSES,
    NO_MASS,
    POSITIONS,
    VELOCITIES,
    check_numbers,
    columns_chosen,
)
from orbit_core.dynamics.indexing import Masking, write_block
from orbit_core.dynamics.kinematics import FixedFrame, PointJacobian
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import Capability, Engine, EntityLayout, Object, UnknownNameError
from orbit_core.scene import ActiveModel, Entity, Frame, ObjectSpec, Pose
from orbit_core.world.clock import Clock


class _Columns:
    """A view of some columns of an engine's tensor, made anew only when the engine hands out another tensor."""

    def __init__(self, columns: int | slice) -> None:
        self._columns = columns
        self._whole: Tensor | None = None

    def of(self, whole: Tensor) -> Tensor:
        if whole is not self._whole:
            self._whole, self._view = whole, whole[:, self._columns]
        return self._view


@dataclass(frozen=True)
class _FrameHandle:
    """A frame resolved to its link's index within the entity, and its constant pose there; None at the link itself."""

    link: int
    link_pose: _Columns
    offset: Tensor | None
    """(3,) position in the link."""
    pose_of: FixedFrame | None


def _nothing_required(capability: Capability, culprit: str) -> None:
    """What no world has made knows of no backend that it could name."""


class SimulatedObject(Object):
    """An articulation in N environments of one engine."""

    def __init__(
        self, layout: EntityLayout, engine: Engine, actuators: Actuators, clock: Clock, masking: Masking
    ) -> None:
        self.layout = layout
        self.name = layout.name
        self.link_names = layout.spec.articulation.link_names
        self.joint_names = layout.spec.articulation.joint_names
        self._engine = engine
        self._actuators = actuators
        self._clock = clock
        self._masking = masking
        self.require: Callable[[Capability, str], None] = _nothing_required
        """Refuses, naming backends, what the backend lacks that a call for this object needs."""
        self.write_wrenches = engine.set_wrenches
        """What :meth:`set_wrenches` hands them to."""
        self._frames: dict[str, _FrameHandle] = {}
        self._frame_poses: dict[str, tuple[int, Tensor]] = {}
        self._jacobians: dict[tuple[str, tuple[int, ...]], PointJacobian] = {}
        links, joints = layout.links, layout.joints
        self._root_pose, self._root_velocity = _Columns(layout.root_link), _Columns(layout.root_link)
        self._link_poses, self._link_velocities = _Columns(links), _Columns(links)
        self._positions, self._velocities, self._efforts = _Columns(joints), _Columns(joints), _Columns(joints)
        self._all_columns = tuple(range(len(self.joint_names)))
        self._all_joints = torch.arange(joints.start, joints.stop, device=engine.device)
        parameters = engine.layout.joint_parameters
        limits = torch.stack(
            [torch.as_tensor(a[layout.joints]) for a in (parameters.lower_limit, parameters.upper_limit)], dim=-1
        )
        self._limits = limits.to(engine.device, torch.float32)
        self._home = torch.as_tensor(parameters.home[layout.joints]).to(engine.device, torch.float32)

    @property
    def spec(self) -> Entity:
        return self.layout.spec

    @property
    def active_specs(self) -> tuple[ActiveModel, ...]:
        """Its active models, as data."""
        return self.spec.active if isinstance(self.spec, ObjectSpec) else ()

    # Reading

    @property
    def root_pose(self) -> Tensor:
        return self._root_pose.of(self._engine.link_poses)

    @property
    def root_velocity(self) -> Tensor:
        return self._root_velocity.of(self._engine.link_velocities)

    @property
    def link_poses(self) -> Tensor:
        return self._link_poses.of(self._engine.link_poses)

    @property
    def link_velocities(self) -> Tensor:
        return self._link_velocities.of(self._engine.link_velocities)

    @property
    def joint_positions(self) -> Tensor:
        return self._positions.of(self._engine.joint_positions)

    @property
    def joint_velocities(self) -> Tensor:
        return self._velocities.of(self._engine.joint_velocities)

    @property
    def joint_efforts(self) -> Tensor:
        return self._efforts.of(self._engine.joint_efforts)

    def frame_pose(self, name: str) -> Tensor:
        if not isinstance(name, str):
            self._frame(name)  # which refuses it
        version, pose = self._frame_poses.get(name, (-1, None))
        if pose is None or version != self._clock.version:
            frame = self._frame(name)
            pose = frame.link_pose.of(self._engine.link_poses)
            if frame.pose_of is not None:
                pose = frame.pose_of(pose)
            self._frame_poses[name] = (self._clock.version, pose)
        return pose

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
        chosen = self._masking.choose(env_ids)
        pose = chosen.poses(pose, f"root pose of '{self.name}'")
        self._engine.write_root_state(self.layout.index, pose, None, chosen.rows)
        self._clock.touch()

    def set_root_velocity(self, velocity: Tensor, env_ids: Tensor | None = None) -> None:
        chosen = self._masking.choose(env_ids)
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
        chosen, shape = self._masking.choose(env_ids), (len(written),)
        if positions is not None:
            positions = chosen.values(positions, shape, f"joint positions of '{self.name}'", POSITIONS)
        if velocities is not None:
            velocities = chosen.values(velocities, shape, f"joint velocities of '{self.name}'", VELOCITIES)
        indices, columns = self._all_joints, self.layout.joints
        if joints is not None:
            moved, positions, velocities = self._with_followers(list(written), positions, velocities, chosen.rows)
            indices = columns = indices[moved]
        self._engine.write_joint_state(indices, positions, velocities, chosen.rows)
        if positions is not None:
            write_block(self._actuators.position_targets, columns, positions, chosen.rows)
        self._clock.touch()

    # Parameters per environment; they outlast resets

    @cached_property
    def nominal_masses(self) -> Tensor:
        """(N, links) in kg, of the scene; what :meth:`set_masses` sets does not change them."""
        kinds = [variant.entities[self.layout.index].spec.articulation for variant in self._engine.layout.variants]
        masses = torch.tensor([[link.mass for link in kind.links] for kind in kinds], device=self._engine.device)
        return masses[torch.arange(self._engine.num_envs, device=self._engine.device) % len(kinds)]

    @cached_property
    def _massive(self) -> Tensor:
        """(links,) bool: which have mass in the scene; the root of a fixed base may have none."""
        links = self.spec.articulation.links
        return torch.tensor([link.mass > 0.0 for link in links], device=self._engine.device)

    @cached_property
    def _weightless(self) -> frozenset[int]:
        """Links without mass: the root of a fixed base, and those between the simple joints of a compound one."""
        return frozenset(index for index, link in enumerate(self.spec.articulation.links) if link.mass == 0.0)

    @cached_property
    def nominal_gains(self) -> Mapping[int, tuple[float, float]]:
        """Stiffness and damping in the scene, by joint, of those that have an actuator."""
        gains: dict[int, tuple[float, float]] = {}
        for group in self.spec.actuators:
            for joint in self.find_joints(*group.joints):
                gains[joint] = (group.stiffness, group.damping)
        return gains

    def set_masses(self, masses: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        """Masses (n, k) in kg of some links; inertias scale with them. Links without mass keep to none.

        Raises:
            ArgumentError: among others, a link that has mass in the scene is given none, or one that moves without any.
            UnsupportedCapabilityError: the engine cannot.
        """
        indices, chosen = self._link_indices(links), self._masking.choose(env_ids)
        what = f"masses of '{self.name}'"
        masses = chosen.values(masses, (len(indices),), what, MASSES)
        if chosen.seen:
            check_numbers(masses[:, self._massive[indices - self.layout.root_link]], MOVING_MASSES, what, chosen.rows)
        if self._weightless:
            kept = [column for column, link in enumerate(self._links_named(links)) if link not in self._weightless]
            if chosen.seen:
                moving = [c for c, link in enumerate(self._links_named(links)) if link and link in self._weightless]
                check_numbers(masses[:, moving], NO_MASS, f"{what} without any", chosen.rows)
            indices, masses = indices[kept], masses[:, kept]
        self._engine.set_masses(indices, masses, chosen.rows)

    def set_centers_of_mass(
        self, centers: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None
    ) -> None:
        """Centres of mass (n, k, 3) of some links, in their own frames.

        Raises:
            UnsupportedCapabilityError: the engine cannot.
        """
        indices, chosen = self._link_indices(links), self._masking.choose(env_ids)
        centers = chosen.values(centers, (len(indices), 3), f"centres of mass of '{self.name}'", POSITIONS)
        self._engine.set_centers_of_mass(indices, centers, chosen.rows)

    def set_friction(
        self, coefficients: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None
    ) -> None:
        """Friction (n, k), static and dynamic alike, of all shapes of some links.

        Raises:
            UnsupportedCapabilityError: the engine cannot.
        """
        indices, chosen = self._link_indices(links), self._masking.choose(env_ids)
        coefficients = chosen.values(coefficients, (len(indices),), f"friction of '{self.name}'", FRICTIONS)
        self._engine.set_friction(indices, coefficients, chosen.rows)

    def set_wrenches(self, wrenches: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        """Force at the centre of mass and torque, (n, k, 6), world axes, on some links until set again or reset.

        Raises:
            UnsupportedCapabilityError: the engine cannot.
        """
        indices, chosen = self._link_indices(links), self._masking.choose(env_ids)
        wrenches = chosen.values(wrenches, (len(indices), 6), f"wrenches of '{self.name}'", EFFORTS)
        self.write_wrenches(indices, wrenches, chosen.rows)
        self._clock.touch()

    def set_gains(
        self,
        stiffness: Tensor,
        damping: Tensor,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """Stiffness and damping (n, k) of the actuators of some joints, implicit and explicit alike.

        Raises:
            UnsupportedCapabilityError: the engine cannot.
            ConfigurationError: a joint has no actuator.
        """
        columns = self._all_columns if joints is None else self._joint_columns(joints)
        chosen, shape = self._masking.choose(env_ids), (len(columns),)
        stiffness = chosen.values(stiffness, shape, f"stiffness of '{self.name}'", GAINS)
        damping = chosen.values(damping, shape, f"damping of '{self.name}'", GAINS)
        start = self.layout.joints.start
        self._actuators.set_gains([start + joint for joint in columns], stiffness, damping, chosen.rows)

    def set_joint_parameters(
        self,
        damping: Tensor | None = None,
        friction: Tensor | None = None,
        armature: Tensor | None = None,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """Damping, Coulomb friction and armature (n, k) of some joints themselves; None leaves one as it is.

        Raises:
            UnsupportedCapabilityError: the engine cannot; names the backends that can.
        """
        self.require(Capability.RANDOMIZE_JOINTS, f"joint parameters of '{self.name}'")
        columns = self._all_columns if joints is None else self._joint_columns(joints)
        chosen, shape = self._masking.choose(env_ids), (len(columns),)

        def checked(value: Tensor | None, what: str) -> Tensor | None:
            return None if value is None else chosen.values(value, shape, f"{what} of joints of '{self.name}'", GAINS)

        values = checked(damping, "damping"), checked(friction, "friction"), checked(armature, "armature")
        self._engine.set_joint_parameters(self._all_joints[list(columns)], *values, chosen.rows)

    def _joint_columns(self, joints: Sequence[int]) -> tuple[int, ...]:
        return columns_chosen(joints, len(self.joint_names), f"joints of '{self.name}'")

    def _links_named(self, links: Sequence[int] | None) -> Sequence[int]:
        count = len(self.link_names)
        return range(count) if links is None else columns_chosen(links, count, f"links of '{self.name}'")

    def _link_indices(self, links: Sequence[int] | None) -> Tensor:
        return (
            torch.tensor(self._links_named(links), dtype=torch.int64, device=self._engine.device)
            + self.layout.root_link
        )

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
        link_pose = _Columns(self.layout.root_link + link)
        if frame.pose == Pose():
            return _FrameHandle(link, link_pose, None, None)
        offset = torch.tensor(frame.pose.position, dtype=torch.float32, device=device)
        pose_of = FixedFrame((*frame.pose.position, *frame.pose.orientation), device)
        return _FrameHandle(link, link_pose, offset, pose_of)
