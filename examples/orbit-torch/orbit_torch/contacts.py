"""Which shapes may touch, where they do, and which contacts a query counts.

Shapes touch as balls do: a ball, a capsule's two ends, a box's corners and the middles of its edges, each against the
whole surface of the other shape. What crosses elsewhere passes: the build report says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.interfaces import (
    BACKGROUND,
    TERRAIN,
    Approximation,
    EntityLayout,
    RayHits,
    SceneLayout,
    UnsupportedCapabilityError,
)
from orbit_core.plugin_kit.engines import contact_signs
from orbit_core.scene import Box, Capsule, Shape
from orbit_torch.geometry import SOLIDS, balls, distance, meet
from orbit_torch.rotations import apply, matrix, multiply

_MOST = 512
"""Pairs of a ball and a shape; it has nothing that finds near ones cheaply."""


@dataclass
class Touch:
    """Where the C candidate contacts are: of balls against surfaces."""

    points: Tensor
    """(N, C, 3) world position."""
    normals: Tensor
    """(N, C, 3) out of the surface."""
    gaps: Tensor
    """(N, C) metres, negative where they overlap."""

    def nearest(self, count: int) -> tuple[Touch, Tensor]:
        """Of each environment that many candidates, and which they are (N, count), in order."""
        which = self.gaps.topk(min(count, self.gaps.shape[1]), largest=False, sorted=False).indices.sort(1).values
        vectors = which[..., None].expand(-1, -1, 3)
        near = Touch(self.points.gather(1, vectors), self.normals.gather(1, vectors), self.gaps.gather(1, which))
        return near, which


class Contacts:
    """The shapes of a scene; a link of index L, the number of links, stands for the terrain."""

    def __init__(self, layout: SceneLayout) -> None:
        ground = len(layout.links)
        self._shapes = [(ground, shape) for shape in layout.scene.terrain]
        self._shapes += [(link, shape) for link, each in enumerate(layout.links) for shape in each.collisions]
        for link, shape in self._shapes:
            if not isinstance(shape.geometry, SOLIDS):
                name = "the terrain" if link == ground else f"link '{layout.links[link].name}'"
                kind = type(shape.geometry).__name__.lower()
                raise UnsupportedCapabilityError(f"backend 'torch' has no {kind}s, as {name} has: use a box or capsule")
        self.link_of_shape = torch.tensor([link for link, _ in self._shapes], dtype=torch.int64)
        self.friction = torch.tensor([shape.material.dynamic_friction for _, shape in self._shapes]).double()
        """(S,) coefficient of each shape."""
        self._pairs = [
            (one, other)
            for one, (first, _) in enumerate(self._shapes)
            for other, (second, _) in enumerate(self._shapes)
            if first != ground and may_touch(layout, first, second)
        ]
        counts = [len(self._balls(one, other)[0]) for one, other in self._pairs]
        self.shapes = (
            torch.tensor(self._pairs, dtype=torch.int64)
            .view(-1, 2)
            .repeat_interleave(torch.tensor(counts, dtype=torch.int64), 0)
        )
        """(C, 2) shape that has the ball, shape that has the surface."""
        if len(self.shapes) > _MOST:
            raise UnsupportedCapabilityError(
                f"backend 'torch' compares everything with everything, and {len(self.shapes)} pairs of shapes' parts "
                f"are more than {_MOST}: take fewer bodies, or another backend"
            )
        self.links = self.link_of_shape[self.shapes] if self._shapes else torch.zeros(0, 2, dtype=torch.int64)
        """(C, 2) their links."""
        pairs = [(one, TERRAIN if other == ground else other) for one, other in self.links.tolist()]
        self.counted = contact_signs(layout.contact_queries, pairs)
        """(K, C) what the force on the ball counts for in each query: 1, -1 or 0."""

    def _balls(self, one: int, other: int) -> tuple[Tensor, float]:
        return balls(self._shapes[one][1].geometry, self._shapes[other][1].geometry)

    def report(self, layout: SceneLayout) -> Iterator[Approximation]:
        """A line for each pair of shapes whose edges do not meet."""
        for one, other in self._pairs:
            (first, shape), (second, surface) = self._shapes[one], self._shapes[other]
            if (
                one < other
                and isinstance(shape.geometry, Box | Capsule)
                and isinstance(surface.geometry, Box | Capsule)
            ):
                names = [layout.links[link].name if link < len(layout.links) else "terrain" for link in (first, second)]
                yield Approximation(
                    " and ".join(names),
                    "contact",
                    "at corners, ends and middles of edges",
                    "the example knows no edges",
                )

    def find(self, poses: Tensor) -> Touch:
        """The candidates, from link poses (N, L, 7)."""
        placed = [self._placed(poses, link, shape) for link, shape in self._shapes]
        points, normals, gaps = [poses.new_zeros(len(poses), 0, 3)], [poses.new_zeros(len(poses), 0, 3)], []
        gaps.append(poses.new_zeros(len(poses), 0))
        for one, other in self._pairs:
            centers, radius = self._balls(one, other)
            position, rotation = placed[one]
            centers = position[:, None] + apply(rotation[:, None], centers)
            position, rotation = placed[other]
            local = apply(rotation.mT[:, None], centers - position[:, None])
            gap, normal = distance(self._shapes[other][1].geometry, local)
            normal = apply(rotation[:, None], normal)
            points.append(centers - radius * normal)
            normals.append(normal)
            gaps.append(gap - radius)
        return Touch(torch.cat(points, 1), torch.cat(normals, 1), torch.cat(gaps, 1))

    def cast(self, poses: Tensor, origins: Tensor, directions: Tensor, reach: float) -> RayHits:
        """Meet rays (n, R, 3) with all shapes, from link poses (n, L, 7)."""
        nearest = torch.full(origins.shape[:2], torch.inf, dtype=torch.float64)
        normals, links = torch.zeros_like(origins), torch.full(origins.shape[:2], BACKGROUND)
        for link, shape in self._shapes:
            position, rotation = self._placed(poses, link, shape)
            back = rotation.mT[:, None]
            start, along = apply(back, origins - position[:, None]), apply(back, directions)
            far = meet(shape.geometry, start, along)
            closer = (far < nearest) & (far <= reach)
            _, normal = distance(shape.geometry, start + far.nan_to_num(posinf=0.0)[..., None] * along)
            nearest = torch.where(closer, far, nearest)
            normals = torch.where(closer[..., None], apply(rotation[:, None], normal), normals)
            links = torch.where(closer, TERRAIN if link == poses.shape[1] else link, links)
        return RayHits(nearest.float(), normals.float(), links)

    @staticmethod
    def _placed(poses: Tensor, link: int, shape: Shape) -> tuple[Tensor, Tensor]:
        """Position (N, 3) and rotation (N, 3, 3) of a shape in the world."""
        position = poses.new_tensor(shape.pose.position).expand(len(poses), 3)
        q = poses.new_tensor(shape.pose.orientation).expand(len(poses), 4)
        if link < poses.shape[1]:
            pose = poses[:, link]
            position, q = pose[:, :3] + apply(matrix(pose[:, 3:]), position), multiply(pose[:, 3:], q)
        return position, matrix(q)


def may_touch(layout: SceneLayout, one: int, other: int) -> bool:
    """Whether two links, or a link and the terrain, may collide."""
    if other == len(layout.links):
        return not _still(layout, one)
    if one == other or (_still(layout, one) and _still(layout, other)):
        return False
    entity = _entity(layout, one)
    if entity is not _entity(layout, other):
        return True
    articulation = entity.spec.articulation
    names = {articulation.link_names[one - entity.links.start], articulation.link_names[other - entity.links.start]}
    apart = (*articulation.joined_links, *articulation.collision_exclusions)
    return articulation.self_collisions and names not in [set(pair) for pair in apart]


def _entity(layout: SceneLayout, link: int) -> EntityLayout:
    return layout.entities[int(layout.entity_of_link[link])]


def _still(layout: SceneLayout, link: int) -> bool:
    entity = _entity(layout, link)
    return entity.spec.fixed_base and link == entity.root_link
