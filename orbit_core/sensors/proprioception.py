"""Sensors of a body's own motion: joint encoders, tracked frames, inertial units, force-torque sensors."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import is_mask, take_rows, write_rows
from orbit_core.dynamics.transforms import (
    pose_inverse,
    pose_multiply,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
)
from orbit_core.interfaces import Engine, EntityLayout, SceneLayout, UnknownNameError, find_name, match_names
from orbit_core.scene import (
    END_EFFECTOR,
    ForceTorqueSpec,
    Frame,
    FrameSensorSpec,
    ImuSpec,
    JointSensorSpec,
    Pose,
    RobotSpec,
)
from orbit_core.sensors.timed import AveragingSensor, SensorContext, TimedSensor, Values


class Mount:
    """A frame fixed to a link of an entity, in all environments."""

    def __init__(
        self, engine: Engine, layout: SceneLayout, entity: str, frame: str, sensor: str, pose: Pose | None = None
    ) -> None:
        """Resolve the frame; ``pose`` is that of the sensor in it.

        Raises:
            UnknownNameError: the scene has no such entity, or the entity no such link or frame.
        """
        self.entity = find_entity(layout, entity, sensor)
        """Entity that carries the sensor."""
        found = _find_frame(self.entity, frame, sensor)
        offset = found.pose if pose is None else found.pose @ pose
        self.link = self.entity.links.start + self.entity.spec.articulation.link_names.index(found.link)
        """Index of the link in (N, L, ...) tensors."""
        self._engine = engine
        # Sensors at the link's own frame, the common case, skip one product per read.
        self._offset = None if offset == Pose() else pose_tensor(offset, engine.device)

    def pose(self, env_ids: Tensor | None = None) -> Tensor:
        """Return (n, 7) in the environment's frame, a copy; of all environments where they are given by mask."""
        link = self._of_link(self._engine.link_poses, env_ids)
        return link if self._offset is None else pose_multiply(link, self._offset)

    def velocity(self, env_ids: Tensor | None = None) -> Tensor:
        """Return (n, 6) of the frame's origin, linear then angular, world axes, a copy."""
        velocity = self._of_link(self._engine.link_velocities, env_ids)
        if self._offset is None:
            return velocity
        # Velocity of a point that is fixed to the link: v + omega x arm.
        arm = quat_rotate(self._of_link(self._engine.link_poses, env_ids)[:, 3:], self._offset[:3])
        angular = velocity[:, 3:]
        return torch.cat((velocity[:, :3] + torch.linalg.cross(angular, arm), angular), -1)

    def _of_link(self, state: Tensor, env_ids: Tensor | None) -> Tensor:
        # Under a mask all rows are computed, since their number must not depend on values.
        all_or_none = env_ids is None or is_mask(env_ids)
        return state[:, self.link].clone() if all_or_none else state[env_ids, self.link]


def find_entity(layout: SceneLayout, name: str, sensor: str) -> EntityLayout:
    """Return the entity that a sensor names.

    Raises:
        UnknownNameError: the scene has none of that name.
    """
    return layout.entities[find_name(name, [e.name for e in layout.entities], "entity", f"sensor '{sensor}'")]


def pose_tensor(pose: Pose, device: torch.device) -> Tensor:
    """Return (7,) position and quaternion."""
    return torch.tensor((*pose.position, *pose.orientation), dtype=torch.float32, device=device)


def _find_frame(entity: EntityLayout, name: str, sensor: str) -> Frame:
    articulation = entity.spec.articulation
    # The placeholder is for scenes that are built before their robot is known.
    if name == END_EFFECTOR and isinstance(entity.spec, RobotSpec) and entity.spec.end_effectors:
        name = entity.spec.end_effector.frame
    try:
        return articulation.frame(name)
    except KeyError:
        known = (*articulation.link_names, *(frame.name for frame in articulation.frames))
        raise UnknownNameError("frame", name, known, f"sensor '{sensor}'") from None


class JointSensor(TimedSensor):
    """Positions and velocities of an entity's joints. Noise goes on both, in their own units."""

    noisy = ("positions", "velocities")

    def __init__(self, spec: JointSensorSpec, context: SensorContext) -> None:
        super().__init__(spec, context)
        entity = find_entity(context.layout, spec.entity, spec.name)
        names = entity.spec.articulation.joint_names
        joints = match_names(spec.joints, names, "joint", f"sensor '{spec.name}'")
        self.joint_names = tuple(names[joint] for joint in joints)
        """Names of the joints of the columns, in the articulation's order."""
        self._joints = torch.tensor(joints, dtype=torch.int64, device=self.device) + entity.joints.start

    @property
    def positions(self) -> Tensor:
        """Positions (N, joints), rad or m."""
        return self._read("positions")

    @property
    def velocities(self) -> Tensor:
        """Velocities (N, joints), rad/s or m/s."""
        return self._read("velocities")

    def _measure(self, env_ids: Tensor | None) -> Values:
        positions = self.engine.joint_positions.index_select(1, self._joints)
        velocities = self.engine.joint_velocities.index_select(1, self._joints)
        return {"positions": take_rows(positions, env_ids), "velocities": take_rows(velocities, env_ids)}


class FrameSensor(TimedSensor):
    """Pose and velocity of a link or named frame, in the environment's frame or seen from another frame.

    Seen from a frame that moves, the velocity is that of an observer who moves with it, in its axes. Noise goes on the
    position (m), the orientation (a rotation vector in rad) and the velocity.
    """

    noisy = ("velocity",)

    def __init__(self, spec: FrameSensorSpec, context: SensorContext) -> None:
        super().__init__(spec, context)
        place = (context.engine, context.layout, spec.entity)
        self._frame = Mount(*place, spec.frame, spec.name)
        self._reference = None if spec.relative_to is None else Mount(*place, spec.relative_to, spec.name)

    @property
    def pose(self) -> Tensor:
        """Pose (N, 7) of the frame."""
        return self._read("pose")

    @property
    def velocity(self) -> Tensor:
        """Linear, then angular velocity (N, 6)."""
        return self._read("velocity")

    def _measure(self, env_ids: Tensor | None) -> Values:
        pose, velocity = self._frame.pose(env_ids), self._frame.velocity(env_ids)
        if self._reference is None:
            return {"pose": pose, "velocity": velocity}
        base, base_velocity = self._reference.pose(env_ids), self._reference.velocity(env_ids)
        # The observer turns as well: its rotation carries the frame along.
        relative = velocity - base_velocity
        carried = torch.linalg.cross(base_velocity[:, 3:], pose[:, :3] - base[:, :3])
        seen = torch.stack((relative[:, :3] - carried, relative[:, 3:]), 1)
        seen = quat_rotate_inverse(base[:, None, 3:], seen).flatten(1)
        return {"pose": pose_multiply(pose_inverse(base), pose), "velocity": seen}

    def _corrupt(self, values: Values, env_ids: Tensor | None) -> None:
        super()._corrupt(values, env_ids)
        pose, noise = values["pose"], self._noise("pose", (6,), env_ids)
        # Noise on the four components would change the length of the quaternion.
        orientation = quat_multiply(quat_from_rotation_vector(noise[:, 3:]), pose[:, 3:])
        orientation = torch.where(orientation[:, :1] < 0, -orientation, orientation)
        values["pose"] = torch.cat((pose[:, :3] + noise[:, :3], orientation), -1)


class ImuSensor(AveragingSensor):
    """Angular velocity and proper acceleration of a frame, in its own axes.

    The acceleration is the change of the frame origin's velocity over the sensor's period (without a rate: over the
    world's step), divided by it, less gravity: at rest it points up with 9.81 m/s^2. A state written between steps is
    no acceleration, if the world announces its steps. After a reset, until the environment has stepped, the velocity
    counts as constant. Noise goes on both values, in their own units.
    """

    noisy = ("angular_velocity", "linear_acceleration")
    scheduled = (*AveragingSensor.scheduled, "_before_known")

    def __init__(self, spec: ImuSpec, context: SensorContext) -> None:
        super().__init__(spec, context, (3,))
        self._mount = Mount(context.engine, context.layout, spec.entity, spec.frame, spec.name)
        self._context = context
        # (N, 3) velocity at the end of the last chunk
        self._before = torch.zeros(self.num_envs, 3, device=self.device)
        self._before_known = False

    @property
    def angular_velocity(self) -> Tensor:
        """Angular velocity (N, 3), rad/s."""
        return self._read("angular_velocity")

    @property
    def linear_acceleration(self) -> Tensor:
        """Linear acceleration (N, 3), m/s^2."""
        return self._read("linear_acceleration")

    def begin_step(self) -> None:
        super().begin_step()
        self._before.copy_(self._mount.velocity()[:, :3])
        self._before_known = True

    def _forget(self, env_ids: Tensor | None) -> None:
        super()._forget(env_ids)
        if env_ids is None:
            self._before_known = False
        elif self._before_known:
            write_rows(self._before, self._mount.velocity(env_ids)[:, :3], env_ids)

    def save_state(self) -> dict[str, Any]:
        return super().save_state() | {"before": self._before.clone()}

    def load_state(self, state: dict[str, Any]) -> None:
        super().load_state(state)
        self._before.copy_(state["before"])

    def _integrate(self, steps: int) -> Tensor:
        velocity = self._mount.velocity()[:, :3]
        # Without a velocity before there is no acceleration to report after a reset.
        change = velocity - self._before if self._before_known else torch.zeros_like(velocity)
        self._before.copy_(velocity)
        self._before_known = True
        return change / self.physics_dt

    def _measure(self, env_ids: Tensor | None) -> Values:
        orientation = self._mount.pose(env_ids)[:, 3:]
        # An accelerometer measures the support, not the fall: gravity is subtracted.
        gravity = take_rows(self._context.gravity, env_ids)
        angular = self._mount.velocity(env_ids)[:, 3:]
        both = torch.stack((angular, self._mean(env_ids) - gravity), 1)
        both = quat_rotate_inverse(orientation[:, None], both)
        return {"angular_velocity": both[:, 0], "linear_acceleration": both[:, 1]}


class ForceTorqueSensor(TimedSensor):
    """The wrench that a link receives from its parent, about the link frame's origin, in the link's axes.

    Of the last physics step before the measurement. Noise goes on force and torque, in their own units.
    """

    noisy = ("wrench",)

    def __init__(self, spec: ForceTorqueSpec, context: SensorContext) -> None:
        super().__init__(spec, context)
        entity = context.layout.entity(spec.entity)
        names = entity.spec.articulation.link_names
        link = entity.links.start + find_name(spec.link, names, "link", f"sensor '{spec.name}'")
        self._column = context.layout.wrench_links.index(link)

    @property
    def wrench(self) -> Tensor:
        """Force in N, then torque in N m (N, 6)."""
        return self._read("wrench")

    @property
    def force(self) -> Tensor:
        """Force (N, 3), newtons."""
        return self.wrench[:, :3]

    @property
    def torque(self) -> Tensor:
        """Torque (N, 3), newton metres."""
        return self.wrench[:, 3:]

    def _measure(self, env_ids: Tensor | None) -> Values:
        return {"wrench": take_rows(self.engine.joint_wrenches[:, self._column].clone(), env_ids)}
