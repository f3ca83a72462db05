"""Separation of objects that physics has pressed into each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from orbit_assets.decomposition import Convex, convex_shape, distance
from orbit_core.interfaces.layout import home_positions
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Entity, HeightField, Mesh, MeshCollision, Plane, Pose, Scene, Shape
from orbit_core.scene.pose import FloatArray

# Metres: the deepest overlap that an engine's contact leaves; what overlaps further was placed so.
_DEEPEST = 0.005
# Metres to which the way out of an overlap is found.
_EXACT = 1e-6
# Ways out of an overlap: up, or aside. Nothing is moved down, where it may have no room.
_WAYS = np.array(((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)))
# A way out of one overlap may lead into another.
_SWEEPS = 4


@dataclass
class _Body:
    """Collision geometry of one entity or of the terrain, in the environment's frame."""

    convex: list[Convex]
    bounds: FloatArray
    """(shapes, 2, 3) least and greatest corner of each shape."""
    moved: FloatArray
    """(3,) m by which it was moved."""

    @classmethod
    def of(cls, shapes: Iterator[Convex]) -> _Body:
        convex = list(shapes)
        return cls(convex, np.array([shape.bounds() for shape in convex]).reshape(-1, 2, 3), np.zeros(3))

    def move(self, by: FloatArray) -> None:
        self.convex = [replace(shape, points=shape.points + by) for shape in self.convex]
        self.bounds = self.bounds + by
        self.moved = self.moved + by


def separated(scene: Scene) -> Scene:
    """Move free objects out of what they are pressed into: up or aside, by up to 5 mm, whichever way is shorter.

    At rest every engine leaves bodies some hundredths of a millimetre to a millimetre deep in each other. Deeper
    overlaps stay, for :func:`orbit_scenes.certify.certify` to report.
    """
    bodies = [_Body.of(_entity_shapes(entity)) for entity in scene.entities]
    free = [len(scene.robots) + number for number, each in enumerate(scene.objects) if each.is_free_body]
    # From the ground upwards: what is moved up takes along what is on it.
    free.sort(key=lambda index: scene.entities[index].pose.position[2])
    rank = {index: place for place, index in enumerate(free)}
    ground = _Body.of(shape for each in scene.terrain for shape in _shapes(each, Pose()))
    levels = [each.pose for each in scene.terrain if isinstance(each.geometry, Plane)]
    for _ in range(_SWEEPS):
        changed = False
        for index in free:
            others = [body for other, body in enumerate(bodies) if rank.get(other, -1) < rank[index]]
            changed |= _leave_planes(bodies[index], levels)
            for other in (ground, *others):
                changed |= _leave(bodies[index], other)
        if not changed:
            break
    moved = {scene.entities[index].name: bodies[index].moved for index in free}
    return replace(
        scene,
        objects=tuple(
            replace(each, pose=_shifted(each.pose, moved[each.name])) if each.name in moved else each
            for each in scene.objects
        ),
    )


def _shifted(pose: Pose, by: FloatArray) -> Pose:
    x, y, z = (float(value) for value in np.asarray(pose.position) + by)
    return Pose((x, y, z), pose.orientation)


def _entity_shapes(entity: Entity) -> Iterator[Convex]:
    articulation = entity.articulation
    positions = home_positions(entity)
    poses = link_poses(articulation, dict(zip(articulation.joint_names, positions, strict=True)))
    for link in articulation.links:
        for shape in link.collisions:
            yield from _shapes(shape, entity.pose @ poses[link.name])


def _shapes(shape: Shape, place: Pose) -> Iterator[Convex]:
    """Yield a shape as convex ones: a surface of triangles one by one."""
    geometry = shape.geometry
    if isinstance(geometry, HeightField) or (
        isinstance(geometry, Mesh) and geometry.collision is not MeshCollision.CONVEX_HULL
    ):
        surface = triangles(geometry)
        for corners in (place @ shape.pose).transform(surface.vertices)[surface.faces]:
            yield Convex(corners)
    elif (convex := convex_shape(shape, place)) is not None:
        yield convex


def _leave_planes(body: _Body, planes: list[Pose]) -> bool:
    """Move a body out of infinite planes, along their normals."""
    changed = False
    for plane in planes:
        normal = plane.rotation_matrix()[:, 2]
        depths = [float(normal @ (plane.position - shape.support(-normal))) + shape.radius for shape in body.convex]
        if _EXACT < max(depths, default=0.0) <= _DEEPEST:
            body.move(max(depths) * normal)
            changed = True
    return changed


def _leave(body: _Body, other: _Body) -> bool:
    """Move a body out of another one, by the shortest way that parts all their shapes."""
    if not len(body.bounds) or not len(other.bounds):
        return False
    near = _pairs(body, other, 0.0)
    if not any(distance(body.convex[i], other.convex[j]) <= 0.0 for i, j in near):
        return False
    # All shapes that may meet on the way out.
    reached = _pairs(body, other, _DEEPEST)
    ways = [(length, way) for way in _WAYS if (length := _way_out(body, other, reached, way)) is not None]
    if not ways:
        return False
    length, way = min(ways, key=lambda each: each[0])
    body.move(length * way)
    return True


def _way_out(body: _Body, other: _Body, pairs: list[tuple[int, int]], way: FloatArray) -> float | None:
    """Return the metres along a direction after which no pair of shapes overlaps; None where 5 mm do not suffice."""

    def overlap(length: float) -> bool:
        return any(
            distance(replace(body.convex[i], points=body.convex[i].points + length * way), other.convex[j]) <= 0.0
            for i, j in pairs
        )

    low, high = 0.0, _DEEPEST
    if overlap(high):
        return None
    while high - low > _EXACT:
        middle = (low + high) / 2.0
        low, high = (middle, high) if overlap(middle) else (low, middle)
    return high


def _pairs(body: _Body, other: _Body, reach: float) -> list[tuple[int, int]]:
    """Return the pairs of shapes whose boxes along the axes come within ``reach`` m."""
    low, high = body.bounds[:, None, 0] - reach, body.bounds[:, None, 1] + reach
    near = ((low < other.bounds[None, :, 1]) & (other.bounds[None, :, 0] < high)).all(-1)
    return [(int(i), int(j)) for i, j in np.argwhere(near)]
