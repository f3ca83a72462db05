"""The mount of a sensor: a link, and the sensor's pose in it."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import is_mask
from orbit_core.dynamics.transforms import pose_multiply, quat_rotate
from orbit_core.interfaces import Engine, EntityLayout, SceneLayout, UnknownNameError, find_name
from orbit_core.scene import END_EFFECTOR, Frame, Pose, RobotSpec


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
        found = _find_frame(self.entity, frame, sensor)
        offset = found.pose if pose is None else found.pose @ pose
        self.link = self.entity.links.start + self.entity.spec.articulation.link_names.index(found.link)
        self._engine = engine
        self._offset = None if offset == Pose() else pose_tensor(offset, engine.device)

    def pose(self, env_ids: Tensor | None = None) -> Tensor:
        """(n, 7) in the environment's frame, a copy; of all environments where they are given by mask."""
        link = self._of_link(self._engine.link_poses, env_ids)
        return link if self._offset is None else pose_multiply(link, self._offset)

    def velocity(self, env_ids: Tensor | None = None) -> Tensor:
        """(n, 6) of the frame's origin, linear then angular, world axes, a copy."""
        velocity = self._of_link(self._engine.link_velocities, env_ids)
        if self._offset is None:
            return velocity
        arm = quat_rotate(self._of_link(self._engine.link_poses, env_ids)[:, 3:], self._offset[:3])
        angular = velocity[:, 3:]
        return torch.cat((velocity[:, :3] + torch.linalg.cross(angular, arm), angular), -1)

    def _of_link(self, state: Tensor, env_ids: Tensor | None) -> Tensor:
        all_or_none = env_ids is None or is_mask(env_ids)
        return state[:, self.link].clone() if all_or_none else state[env_ids, self.link]


def find_entity(layout: SceneLayout, name: str, sensor: str) -> EntityLayout:
    """The entity that a sensor names.

    Raises:
        UnknownNameError: the scene has none of that name.
    """
    return layout.entities[find_name(name, [e.name for e in layout.entities], "entity", f"sensor '{sensor}'")]


def pose_tensor(pose: Pose, device: torch.device) -> Tensor:
    """(7,) position and quaternion."""
    return torch.tensor((*pose.position, *pose.orientation), dtype=torch.float32, device=device)


def _find_frame(entity: EntityLayout, name: str, sensor: str) -> Frame:
    articulation = entity.spec.articulation
    if name == END_EFFECTOR and isinstance(entity.spec, RobotSpec) and entity.spec.end_effectors:
        name = entity.spec.end_effector.frame
    try:
        return articulation.frame(name)
    except KeyError:
        known = (*articulation.link_names, *(frame.name for frame in articulation.frames))
        raise UnknownNameError("frame", name, known, f"sensor '{sensor}'") from None
