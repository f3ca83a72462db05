"""The boxes of a scene's entities, from pictures and poses."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import pose_inverse, pose_multiply, quat_rotate, transform_points
from orbit_core.interfaces import SceneLayout, match_names
from orbit_core.scene import CameraSpec
from orbit_core.sensors.boxes import (
    BoundingBoxes2d,
    BoundingBoxes3d,
    area,
    cut_off,
    least,
    pixel_boxes,
    projected_boxes,
)
from orbit_core.sensors.outlines import clipped_slopes, round_slopes
from orbit_core.sensors.shape_bounds import bounded_links, shape_bounds


@dataclass(frozen=True)
class _Subjects:
    """What boxes are asked for: B entities or links."""

    names: tuple[str, ...]
    semantic_labels: tuple[str, ...]
    frames: Tensor
    """(B,) int64: the link in whose frame each stands, an entity's root link or the link itself."""
    entities: Tensor
    """(B,) int64"""


class EntityBoxes:
    """Finds the boxes of entities and links that have shapes, in all environments at once.

    Only what is drawn counts: visual shapes, or collision shapes of a link that has no visual ones; planes, which have
    no bounds, do not.
    """

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device) -> None:
        bounds = shape_bounds(layout, device)
        kind = torch.arange(num_envs, device=device) % len(layout.variants)
        self._centres, self._radii, self._axes = bounds.centres[kind], bounds.radii[kind], bounds.axes[kind]
        self._links, self._shapes = bounds.links[kind], bounds.shapes[kind]
        self._corners, self._shape_links = bounds.corners[kind], bounds.shape_links[kind]
        roots = [layout.entities[entity].root_link for entity in layout.entity_of_link]
        self._root_of_link = torch.tensor(roots, dtype=torch.int64, device=device)
        self._each_link = torch.arange(len(roots), device=device)
        self._layout = layout
        self._chosen: dict[tuple[tuple[str, ...], bool], _Subjects] = {}

    def in_pictures(
        self, entities: tuple[str, ...], camera: CameraSpec, intrinsics: Tensor, camera_pose: Tensor,
        link_poses: Tensor, instances: Tensor,
    ) -> BoundingBoxes2d:  # fmt: skip
        """Boxes in the pictures ``instances`` (N, H, W, 1) of a camera, taken when the links stood at ``link_poses``.

        Raises:
            UnknownNameError: one of ``entities``, regular expressions over names, matches no entity with a shape.
        """
        subjects = self._subjects(entities, of_links=False)
        tight, pixels = pixel_boxes(instances, len(self._layout.entities))
        tight, pixels = tight.index_select(1, subjects.entities), pixels.index_select(1, subjects.entities)
        slopes, owners = self._outlines(camera_pose, link_poses, camera.near)
        whole = projected_boxes(slopes, owners, len(self._each_link), intrinsics).index_select(1, subjects.frames)
        loose, in_view = cut_off(whole, camera.width, camera.height)
        share = (area(tight) / area(whole).clamp_min(1e-6)).clamp_max(1.0)
        names = subjects.names, subjects.semantic_labels
        return BoundingBoxes2d(*names, tight, pixels > 0, pixels, loose, in_view, share)

    def in_space(self, entities: tuple[str, ...], link_poses: Tensor, of_links: bool) -> BoundingBoxes3d:
        """Oriented boxes of entities, or of each of their links, in the frame that ``link_poses`` (N, L, 7) are in.

        Raises:
            UnknownNameError: one of ``entities``, regular expressions over names, matches no entity with a shape.
        """
        subjects = self._subjects(entities, of_links)
        frame_of_link = self._each_link if of_links else self._root_of_link
        local = pose_multiply(pose_inverse(link_poses.index_select(1, frame_of_link)), link_poses)
        low, high = self._reach(local, frame_of_link[self._links])
        low, high = low.index_select(1, subjects.frames), high.index_select(1, subjects.frames)
        frames = link_poses.index_select(1, subjects.frames)
        poses = torch.cat((transform_points(frames, 0.5 * (low + high)), frames[..., 3:]), -1)
        return BoundingBoxes3d(subjects.names, subjects.semantic_labels, poses, 0.5 * (high - low))

    def _reach(self, link_poses: Tensor, groups: Tensor) -> tuple[Tensor, Tensor]:
        """Least and greatest coordinates (N, L, 3) of each group of points, discs and balls."""
        poses = _rows(link_poses, self._links)
        centres, axes = transform_points(poses, self._centres), quat_rotate(poses[..., 3:], self._axes)
        reach = self._radii[..., None] * (1.0 - axes**2).clamp_min(0.0).sqrt()
        count = len(self._each_link)
        return least(centres - reach, groups, count), -least(-centres - reach, groups, count)

    def _outlines(self, camera_pose: Tensor, link_poses: Tensor, near: float) -> tuple[Tensor, Tensor]:
        """Slopes (N, P + 24 S, 4) of all that bounds the shapes, and the root link (N, P + 24 S) above each."""
        seen = pose_multiply(pose_inverse(camera_pose)[:, None], link_poses)
        corners = transform_points(_rows(seen, self._shape_links)[:, :, None], self._corners)
        in_front = (-corners[..., 2] >= near).all(-1)
        poses = _rows(seen, self._links)
        centres, axes = transform_points(poses, self._centres), quat_rotate(poses[..., 3:], self._axes)
        whole = _kept(round_slopes(centres, self._radii, axes), in_front.gather(1, self._shapes))
        cut = _kept(clipped_slopes(corners, near), ~in_front[..., None]).flatten(1, 2)
        ends = self._root_of_link[self._shape_links].repeat_interleave(24, 1)
        return torch.cat((whole, cut), 1), torch.cat((self._root_of_link[self._links], ends), 1)

    def _subjects(self, entities: tuple[str, ...], of_links: bool) -> _Subjects:
        key = (tuple(entities), of_links)
        if key not in self._chosen:
            self._chosen[key] = self._choose(*key)
        return self._chosen[key]

    def _choose(self, patterns: tuple[str, ...], of_links: bool) -> _Subjects:
        layout, device = self._layout, self._each_link.device
        shaped = bounded_links(layout)
        owners = list(dict.fromkeys(layout.entities[layout.entity_of_link[link]] for link in shaped))
        chosen = [owners[n] for n in match_names(patterns, [owner.name for owner in owners], "entity", "the picture")]
        if of_links:
            frames = [link for owner in chosen for link in range(owner.links.start, owner.links.stop) if link in shaped]
        else:
            frames = [owner.root_link for owner in chosen]
        entities = [int(layout.entity_of_link[link]) for link in frames]
        names = (
            f"{layout.entities[entity].name}/{layout.links[link].name}" if of_links else layout.entities[entity].name
            for link, entity in zip(frames, entities, strict=True)
        )
        labels = (layout.semantic_labels[layout.semantic_of_link[link]] for link in frames)
        indices = (torch.tensor(rows, dtype=torch.int64, device=device) for rows in (frames, entities))
        return _Subjects(tuple(names), tuple(labels), *indices)


def _rows(poses: Tensor, links: Tensor) -> Tensor:
    """Poses (N, P, 7) of links (N, P)."""
    return poses.gather(1, links[..., None].expand(-1, -1, 7))


def _kept(slopes: Tensor, seen: Tensor) -> Tensor:
    """Slopes (..., 4) that bound nothing where not ``seen`` (...)."""
    low = torch.where(seen[..., None], slopes[..., :2], torch.inf)
    return torch.cat((low, torch.where(seen[..., None], slopes[..., 2:], -torch.inf)), -1)
