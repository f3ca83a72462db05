"""Bounding boxes of entities, in pictures and in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.transforms import pose_inverse, pose_multiply, quat_rotate, transform_points
from orbit_core.interfaces import SceneLayout, match_names
from orbit_core.scene import Box, CameraSpec, Capsule, Channel, Cylinder, HeightField, Mesh, Shape, Sphere
from orbit_core.scene.shapes import Geometry
from orbit_core.sensors import CameraSensor

# Bounds of drawn shapes: points, discs and balls whose hull has the same extent as the shape in all directions.

_Array = npt.NDArray[np.float64]
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
# Number of vertices up to which a mesh's hull is not computed, because it would save less than it costs.
_FEW = 32


@dataclass(frozen=True)
class Rounds:
    """Points, discs and balls of one shape: a point has no radius, a ball no axis."""

    centres: _Array
    """Centres (P, 3)."""
    radii: _Array
    """Radii (P,)."""
    axes: _Array
    """Unit normals (P, 3) of discs, zero for balls and points."""

    @property
    def reach(self) -> _Array:
        """Extent (P, 3) of each from its centre along x, y and z."""
        return self.radii[:, None] * np.sqrt(1.0 - self.axes**2)


@dataclass(frozen=True)
class ShapeBounds:
    """Bounds of all drawn shapes of the entities, for each of K kinds of environment, in their links' frames.

    If a kind has fewer than another, its first ones are repeated, which changes no least or greatest value.
    """

    centres: Tensor
    """Centres (K, P, 3)."""
    radii: Tensor
    """Radii (K, P)."""
    axes: Tensor
    """Unit normals (K, P, 3), as of :class:`Rounds`."""
    shapes: Tensor
    """Index (K, P) int64 of the shape that each belongs to."""
    links: Tensor
    """Index (K, P) int64 of the scene's link that each belongs to."""
    corners: Tensor
    """Corners (K, S, 8, 3) of the box around each shape, along the shape's own axes."""
    shape_links: Tensor
    """Index (K, S) int64 of each shape's link."""


def bounded_links(layout: SceneLayout) -> list[int]:
    """Return the links of the scene that have shapes with bounds: all shapes except planes."""
    return [n for n, link in enumerate(layout.links) if any(map(_bounded, link.visuals or link.collisions))]


def shape_bounds(layout: SceneLayout, device: torch.device) -> ShapeBounds:
    """Compute the bounds of all drawn shapes of the entities, without planes, which have none."""
    kinds = [_kind(variant) for variant in layout.variants]
    columns = list(zip(*kinds, strict=True))
    tensors = [torch.as_tensor(_padded(column), device=device) for column in columns]
    return ShapeBounds(*(t if t.dtype == torch.int64 else t.to(torch.float32) for t in tensors))


def _kind(layout: SceneLayout) -> tuple[npt.NDArray[np.generic], ...]:
    """Compute the fields of :class:`ShapeBounds` for one kind of environment."""
    drawn = [
        (shape, n)
        for n, link in enumerate(layout.links)
        for shape in link.visuals or link.collisions
        if _bounded(shape)
    ]
    parts = [_in_link(shape) for shape, _ in drawn]
    sizes = [len(part.radii) for part in parts]
    shape_links = np.array([link for _, link in drawn], dtype=np.int64)
    return (
        _joined([part.centres for part in parts], (0, 3)),
        _joined([part.radii for part in parts], (0,)),
        _joined([part.axes for part in parts], (0, 3)),
        np.repeat(np.arange(len(drawn)), sizes),
        np.repeat(shape_links, sizes),
        np.array([_box_corners(shape) for shape, _ in drawn]).reshape(-1, 8, 3),
        shape_links,
    )


def _joined(arrays: list[_Array], empty: tuple[int, ...]) -> _Array:
    return np.concatenate(arrays) if arrays else np.zeros(empty)


def _padded(arrays: tuple[npt.NDArray[np.generic], ...]) -> npt.NDArray[np.generic]:
    # The first row may be repeated because it changes neither least nor greatest values.
    most = max(len(array) for array in arrays)
    return np.stack([np.concatenate((array, np.repeat(array[:1], most - len(array), 0))) for array in arrays])


def _bounded(shape: Shape) -> bool:
    return isinstance(shape.geometry, Box | Sphere | Capsule | Cylinder | Mesh | HeightField)


def _in_link(shape: Shape) -> Rounds:
    own = _rounds(shape.geometry)
    return Rounds(shape.pose.transform(own.centres), own.radii, own.axes @ shape.pose.rotation_matrix().T)


def _box_corners(shape: Shape) -> _Array:
    own = _rounds(shape.geometry)
    low, high = (own.centres - own.reach).min(0), (own.centres + own.reach).max(0)
    return shape.pose.transform(np.where(_CORNERS < 0.0, low, high))


def _rounds(geometry: Geometry) -> Rounds:
    """Return the points, discs and balls of a shape in its own frame."""
    match geometry:
        case Box():
            return _points(_CORNERS * geometry.half_extents)
        case Sphere():
            return Rounds(np.zeros((1, 3)), np.array([geometry.radius]), np.zeros((1, 3)))
        case Capsule():
            return Rounds(_ends(geometry.half_length), np.full(2, geometry.radius), np.zeros((2, 3)))
        case Cylinder():
            return Rounds(_ends(geometry.half_length), np.full(2, geometry.radius), np.array([(0.0, 0.0, 1.0)] * 2))
        case Mesh():
            return _points(_hull_points(geometry))
        case HeightField():
            rows, columns = geometry.heights.shape
            x, y = (0.5 * size for size in geometry.size)
            grid_y, grid_x = np.meshgrid(np.linspace(-y, y, rows), np.linspace(-x, x, columns), indexing="ij")
            return _points(np.stack((grid_x, grid_y, geometry.heights.astype(np.float64)), -1).reshape(-1, 3))
    raise AssertionError("a plane has no bounds")


def _points(points: _Array) -> Rounds:
    return Rounds(points, np.zeros(len(points)), np.zeros((len(points), 3)))


def _ends(half_length: float) -> _Array:
    return np.array([(0.0, 0.0, -half_length), (0.0, 0.0, half_length)])


@lru_cache(maxsize=1024)
def _hull_points(mesh: Mesh) -> _Array:
    """Return the vertices of a mesh's hull: a detailed mesh has a hundred times as many."""
    points = np.asarray(mesh.vertices, dtype=np.float64)[np.unique(mesh.faces)]
    if len(points) <= _FEW:
        return points
    try:
        from scipy.spatial import ConvexHull, QhullError
    except ImportError:  # an optional package: without it all vertices give the same boxes, but take longer
        return points
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # a flat mesh has no hull with a volume
        return points


@dataclass(frozen=True)
class BoundingBoxes2d:
    """Boxes of E entities in the pictures of N environments.

    A box is (left, top, right, bottom) in pixels from the image's top left corner, where the pixel in column c and row
    r reaches from c to c + 1 and from r to r + 1. An entity outside of the picture has a box of zeros.
    """

    names: tuple[str, ...]
    """Names (E,) of the entities."""
    semantic_labels: tuple[str, ...]
    """Labels (E,) of each entity's root link."""
    tight: Tensor
    """Boxes (N, E, 4) around the pixels that show the entity; occlusion and the image's edge make them smaller."""
    visible: Tensor
    """Whether (N, E) any pixel shows the entity."""
    pixels: Tensor
    """Number (N, E) of pixels that show it, int64."""
    loose: Tensor
    """Boxes (N, E, 4) around the projection of the whole entity, without occlusion, cut off at the image's edge.

    Exact for boxes, balls, capsules, cylinders and meshes in front of the camera's near plane; of a shape that reaches
    through that plane, the part in front of it of the box around the shape.
    """
    in_view: Tensor
    """Whether (N, E) the loose box and the image overlap."""
    visible_share: Tensor
    """Share (N, E) in [0, 1]: the tight box's area over that of the loose box before the image's edge cuts it.

    It is 1, except for the rounding to whole pixels, if the entity's whole outline is visible. It compares boxes and
    not outlines: an object that covers the middle of an entity, and leaves its ends free, has no effect.
    """


@dataclass(frozen=True)
class BoundingBoxes3d:
    """Oriented boxes of B entities, or links, in N environments."""

    names: tuple[str, ...]
    """Names (B,) of the entities, or "entity/link" of links."""
    semantic_labels: tuple[str, ...]
    """Labels (B,) of the root links, or of the links."""
    poses: Tensor
    """Poses (N, B, 7): the box's centre, and the orientation of the entity's root link, or of the link."""
    half_extents: Tensor
    """Half extents (N, B, 3) in metres along the box's own axes."""

    @property
    def corners(self) -> Tensor:
        """Corners (N, B, 8, 3) from (-, -, -) to (+, +, +), z changing fastest."""
        number, place = (torch.arange(n, device=self.poses.device) for n in (8, 3))
        signs = ((number[:, None] >> (2 - place)) & 1) * 2.0 - 1.0
        return transform_points(self.poses[..., None, :], signs * self.half_extents[..., None, :])


def least(values: Tensor, groups: Tensor, count: int) -> Tensor:
    """Compute the least of ``values`` (N, P, k) in each group (N, P): (N, count, k), infinite in empty groups.

    Does not wait for the GPU, and sizes do not depend on values.
    """
    found = torch.full((len(values), count, values.shape[-1]), torch.inf, device=values.device)
    return found.scatter_reduce_(1, groups[..., None].expand_as(values), values, "amin")


def pixel_boxes(instances: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Compute boxes (N, count, 4) around the pixels of each instance, and the numbers (N, count) of pixels.

    Args:
        instances: indices (N, H, W, 1) of the instance that each pixel shows; negative for none.
        count: number of instances.
    """
    height, width = instances.shape[1:3]
    column = torch.arange(width, device=instances.device, dtype=torch.float32).repeat(height)
    row = torch.arange(height, device=instances.device, dtype=torch.float32).repeat_interleave(width)
    # Negated right and bottom sides, so that one minimum finds all four.
    sides = torch.stack((column, row, -(column + 1), -(row + 1)), -1).expand(len(instances), -1, -1)
    shown = instances.flatten(1).to(torch.int64)
    shown = torch.where(shown < 0, count, shown)  # pixels without an instance form an extra group, dropped below
    boxes = _upright(least(sides, shown, count + 1)[:, :count])
    pixels = torch.zeros(len(shown), count + 1, dtype=torch.int64, device=shown.device)
    return boxes, pixels.scatter_add_(1, shown, torch.ones_like(shown))[:, :count]


def projected_boxes(slopes: Tensor, groups: Tensor, count: int, intrinsics: Tensor) -> Tensor:
    """Compute boxes (N, count, 4) in pixels, not cut off, from ``slopes``; zeros for groups that are not seen.

    Args:
        slopes: left, top, right and bottom (N, P, 4) as x / depth and y / depth, y downwards; left and top infinite,
            and right and bottom minus infinite, where nothing is seen.
        groups: index (N, P) of each slope's group, int64.
        count: number of groups.
        intrinsics: intrinsic matrix (3, 3) of the camera in pixels.
    """
    scale = torch.stack((intrinsics[0, 0], intrinsics[1, 1])).repeat(2)
    offset = torch.stack((intrinsics[0, 2], intrinsics[1, 2])).repeat(2)
    sides = slopes * scale + offset
    return _upright(least(torch.cat((sides[..., :2], -sides[..., 2:]), -1), groups, count))


def cut_off(boxes: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Cut boxes (N, E, 4) off at the image's edge, zero beyond it, and return whether anything is left (N, E)."""
    cut = torch.stack((boxes[..., 0::2].clamp(0.0, width), boxes[..., 1::2].clamp(0.0, height)), -1).flatten(-2)
    in_view = area(cut) > 0.0
    return torch.where(in_view[..., None], cut, 0.0), in_view


def area(boxes: Tensor) -> Tensor:
    """Compute the areas (N, E) of boxes (N, E, 4)."""
    return (boxes[..., 2] - boxes[..., 0]) * (boxes[..., 3] - boxes[..., 1])


def _upright(sides: Tensor) -> Tensor:
    """Convert (left, top, -right, -bottom) to boxes, zeros where these are infinite."""
    boxes = torch.cat((sides[..., :2], -sides[..., 2:]), -1)
    return torch.where(sides.isfinite().all(-1, keepdim=True), boxes, 0.0)


def round_slopes(centres: Tensor, radii: Tensor, axes: Tensor) -> Tensor:
    """Compute left, top, right and bottom (..., 4) of points, discs and balls as x / depth and y / depth, y downwards.

    A plane through the camera that touches an ellipsoid ``c + A u, |u| <= 1`` has a normal m with ``(m c)^2 =
    |m A|^2``, a quadratic in the plane's slope: the dual quadric of Hartley and Zisserman, Multiple View Geometry, 2nd
    ed., section 8.3. Valid in front of the camera's centre.

    Args:
        centres: centres (..., 3) in the camera's frame, -z forward and y up.
        radii: radii (...,), zero for points.
        axes: unit normals (..., 3) of discs, zero for balls and points.
    """
    depth, normal = -centres[..., 2:], -axes[..., 2:]
    across = torch.stack((centres[..., 0], -centres[..., 1]), -1)
    tilt = torch.stack((axes[..., 0], -axes[..., 1]), -1)
    square = (radii * radii)[..., None]
    leading = depth**2 - square * (1.0 - normal**2)
    middle = across * depth + square * tilt * normal
    # The discriminant is written so that a point has exactly none: rounding would widen it by the root of 1e-7.
    turned = (depth * tilt - across * normal) ** 2
    spread = square * (depth**2 + across**2 - turned) - square**2 * (1.0 - tilt**2 - normal**2)
    root = spread.clamp_min(0.0).sqrt()
    return torch.cat((middle - root, middle + root), -1) / leading


def clipped_slopes(corners: Tensor, near: float) -> Tensor:
    """Compute :func:`round_slopes` (..., 24, 4) of the parts of boxes in front of a plane, infinite where none.

    Args:
        corners: corners (..., 8, 3) of the boxes in the camera's frame, z changing fastest.
        near: the plane's depth in metres.
    """
    first, second = _edges(corners)
    low, high = -first[..., 2:] - near, -second[..., 2:] - near
    share = low / torch.where(low == high, 1.0, low - high)  # edges parallel to the plane are never cut
    crossing = first + share * (second - first)
    ends = torch.cat((torch.where(low < 0.0, crossing, first), torch.where(high < 0.0, crossing, second)), -2)
    seen = (low >= 0.0) | (high >= 0.0)
    seen = torch.cat((seen, seen), -2)
    slopes = torch.stack((ends[..., 0], -ends[..., 1]), -1) / (-ends[..., 2:]).clamp_min(0.5 * near)
    return torch.cat((torch.where(seen, slopes, torch.inf), torch.where(seen, slopes, -torch.inf)), -1)


def _edges(corners: Tensor) -> tuple[Tensor, Tensor]:
    """Return both ends (..., 12, 3) of a box's edges."""
    x, y, z = (corners.unflatten(-2, (2, 2, 2)).unbind(axis) for axis in (-4, -3, -2))
    first, second = (torch.cat([along[end].flatten(-3, -2) for along in (x, y, z)], -2) for end in (0, 1))
    return first, second


@dataclass(frozen=True)
class _Subjects:
    """Entities or links (B) whose boxes are requested."""

    names: tuple[str, ...]
    semantic_labels: tuple[str, ...]
    frames: Tensor
    """Links (B,) int64 whose frames the boxes have: an entity's root link, or the link itself."""
    entities: Tensor
    """Entities (B,) int64."""


class CameraBoxes:
    """Bounding boxes of entities and links as a camera saw them, in all environments at once.

    Only drawn shapes count: visual shapes, or collision shapes of a link without visual ones. Planes are infinite and
    do not count.

    Args:
        camera: camera whose pictures are annotated.
    """

    def __init__(self, camera: CameraSensor) -> None:
        layout, device = camera.layout, camera.device
        bounds = shape_bounds(layout, device)
        kind = torch.arange(camera.num_envs, device=device) % len(layout.variants)
        self._centres, self._radii, self._axes = bounds.centres[kind], bounds.radii[kind], bounds.axes[kind]
        self._links, self._shapes = bounds.links[kind], bounds.shapes[kind]
        self._corners, self._shape_links = bounds.corners[kind], bounds.shape_links[kind]
        roots = [layout.entities[entity].root_link for entity in layout.entity_of_link]
        self._root_of_link = torch.tensor(roots, dtype=torch.int64, device=device)
        self._each_link = torch.arange(len(roots), device=device)
        self._camera = camera
        self._chosen: dict[tuple[tuple[str, ...], bool], _Subjects] = {}

    def in_pictures(self, entities: Sequence[str] = (".*",)) -> BoundingBoxes2d:
        """Return boxes in the pictures: tight around the pixels that show an entity, and loose around all of it.

        Args:
            entities: regular expressions over the names of entities (full match).

        Raises:
            ConfigurationError: the camera has no instance channel.
            UnknownNameError: one of ``entities`` matches no entity that has a shape.
        """
        camera, spec = self._camera, self._camera.spec
        assert isinstance(spec, CameraSpec)
        instances = camera.image(Channel.INSTANCE)
        subjects = self._subjects(tuple(entities), of_links=False)
        tight, pixels = pixel_boxes(instances, len(camera.layout.entities))
        tight, pixels = tight.index_select(1, subjects.entities), pixels.index_select(1, subjects.entities)
        slopes, owners = self._outlines(camera.pose, camera.link_poses, spec.near)
        whole = projected_boxes(slopes, owners, len(self._each_link), camera.intrinsics)
        whole = whole.index_select(1, subjects.frames)
        loose, in_view = cut_off(whole, spec.width, spec.height)
        # Areas below a pixel's millionth are those of entities without extent.
        share = (area(tight) / area(whole).clamp_min(1e-6)).clamp_max(1.0)
        names = subjects.names, subjects.semantic_labels
        return BoundingBoxes2d(*names, tight, pixels > 0, pixels, loose, in_view, share)

    def in_space(
        self, entities: Sequence[str] = (".*",), *, of_links: bool = False, in_camera_frame: bool = False
    ) -> BoundingBoxes3d:
        """Return oriented boxes around entities at the time of the pictures, whether the camera saw them or not.

        Args:
            entities: regular expressions over the names of entities (full match).
            of_links: a box for each link that has a shape, instead of one for each entity.
            in_camera_frame: in the camera's frame (-z forward, y up), instead of the environment's.

        Raises:
            UnknownNameError: one of ``entities`` matches no entity that has a shape.
        """
        link_poses = self._camera.link_poses
        if in_camera_frame:
            link_poses = pose_multiply(pose_inverse(self._camera.pose)[:, None], link_poses)
        subjects = self._subjects(tuple(entities), of_links)
        frame_of_link = self._each_link if of_links else self._root_of_link
        local = pose_multiply(pose_inverse(link_poses.index_select(1, frame_of_link)), link_poses)
        low, high = self._reach(local, frame_of_link[self._links])
        low, high = low.index_select(1, subjects.frames), high.index_select(1, subjects.frames)
        frames = link_poses.index_select(1, subjects.frames)
        poses = torch.cat((transform_points(frames, 0.5 * (low + high)), frames[..., 3:]), -1)
        return BoundingBoxes3d(subjects.names, subjects.semantic_labels, poses, 0.5 * (high - low))

    def _reach(self, link_poses: Tensor, groups: Tensor) -> tuple[Tensor, Tensor]:
        """Compute the least and greatest coordinates (N, L, 3) of each group of points, discs and balls."""
        poses = _rows(link_poses, self._links)
        centres, axes = transform_points(poses, self._centres), quat_rotate(poses[..., 3:], self._axes)
        reach = self._radii[..., None] * (1.0 - axes**2).clamp_min(0.0).sqrt()
        count = len(self._each_link)
        return least(centres - reach, groups, count), -least(-centres - reach, groups, count)

    def _outlines(self, camera_pose: Tensor, link_poses: Tensor, near: float) -> tuple[Tensor, Tensor]:
        """Compute the slopes (N, P + 24 S, 4) that bound all shapes, and the root link (N, P + 24 S) above each."""
        seen = pose_multiply(pose_inverse(camera_pose)[:, None], link_poses)
        # Shapes in front of the near plane are exact; of others the part of their box in front of it counts.
        corners = transform_points(_rows(seen, self._shape_links)[:, :, None], self._corners)
        in_front = (-corners[..., 2] >= near).all(-1)
        poses = _rows(seen, self._links)
        centres, axes = transform_points(poses, self._centres), quat_rotate(poses[..., 3:], self._axes)
        whole = _kept(round_slopes(centres, self._radii, axes), in_front.gather(1, self._shapes))
        cut = _kept(clipped_slopes(corners, near), ~in_front[..., None]).flatten(1, 2)
        ends = self._root_of_link[self._shape_links].repeat_interleave(24, 1)
        return torch.cat((whole, cut), 1), torch.cat((self._root_of_link[self._links], ends), 1)

    def _subjects(self, entities: tuple[str, ...], of_links: bool) -> _Subjects:
        key = (entities, of_links)  # names are matched once, not at every picture
        if key not in self._chosen:
            self._chosen[key] = self._choose(*key)
        return self._chosen[key]

    def _choose(self, patterns: tuple[str, ...], of_links: bool) -> _Subjects:
        layout, device = self._camera.layout, self._each_link.device
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
    """Return the poses (N, P, 7) of links (N, P)."""
    return poses.gather(1, links[..., None].expand(-1, -1, 7))


def _kept(slopes: Tensor, seen: Tensor) -> Tensor:
    """Return slopes (..., 4) that bound nothing where not ``seen`` (...)."""
    low = torch.where(seen[..., None], slopes[..., :2], torch.inf)
    return torch.cat((low, torch.where(seen[..., None], slopes[..., 2:], -torch.inf)), -1)
