"""The collision shapes of a scene as kernels take them."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportGeneralTypeIssues=false
# Warp's arrays and structs carry their types at run time.

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from orbit_core.interfaces import TERRAIN, SceneLayout
from orbit_core.plugin_kit.meshes import hull_of, triangles
from orbit_core.scene import (
    Box,
    Capsule,
    Cylinder,
    Fluid,
    Geometry,
    HeightField,
    Mesh,
    MeshCollision,
    ObjectSpec,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_matter.bodies import free_links
from orbit_matter.contact import STILL
from orbit_matter.fields import bounds_of, closed_surface, has_hollows
from orbit_matter.fluid.extent import is_mappable
from orbit_matter.surfaces import BOX, CAPSULE, CYLINDER, HEIGHT_FIELD, MESH, PLANE, SPHERE, Shapes
from orbit_matter.union import outer_surface

_Rows = list[tuple[Shape, int]]
_Place = tuple[int, int]
_Form = tuple[int, tuple[float, float, float], float, int, tuple[int, int, int]]

CURVED = 24.0
"""Spacings of the longest side of a convex object of which liquids meet the curvature and the edges. Half-spaces behind
the nearest points of a ball press on it as if it were larger: by 30 % at a radius of 1.5 spacings, 9 % at 3 and, by the
same layer, 3 % at 12, whose map takes two seconds of a core."""
PIECES = 2
"""Convex pieces of a link that liquids meet one by one at most; more of them can be the walls of a hollow."""
_ENDLESS = 1e6
"""Metres; the reach of what is near everything."""

_STILL_FREE = 0.012
"""m/s of a free body below which friction is less than whole: half as much again as it takes of one in a substep of
0.84 ms, in which that of a body at rest would else turn round."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface that liquids meet as it is, and not as the half-space behind its nearest point."""

    mesh: Mesh
    """Closed surface."""
    bounds: npt.NDArray[np.floating]
    """(2, 3) m, lowest and highest corner of a box around what liquids may be in."""

    @classmethod
    def of(cls, mesh: Mesh) -> Surface:
        """Return a mesh that liquids may be in, and around all of it."""
        return cls(mesh, np.array([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], float))


class Colliders:
    """Shapes of each kind of environment: those of links first, then the terrain's.

    For liquids the convex pieces of a link that are more than PIECES count as one, and a height field with hollows as a
    closed mesh where a map holds it: as shapes of their own, after all others, which only liquids meet.
    """

    def __init__(self, layout: SceneLayout, device: wp.Device) -> None:
        self._device = device
        self._meshes: list[wp.Mesh] = []
        """Kept, for the kernels know them by number alone."""
        self._heights: list[np.ndarray] = []
        kinds = [_shapes_of(variant) for variant in layout.variants]
        # Liquids of a scene have one spacing.
        spacings = [spec.spacing for spec in layout.scene.deformables if isinstance(spec, Fluid)]
        of_liquids = [united(shapes) | enclosed(shapes, spacings[0]) if spacings else {} for shapes in kinds]
        rows = [shapes + list(found) for shapes, found in zip(kinds, of_liquids, strict=True)]
        self._free = set(free_links(layout))
        self.count = max(1, *(len(shapes) for shapes in rows))
        """S, the most shapes that any kind of environment has; at least 1, as kernels need an array."""
        self.kinds = len(kinds)
        """K, the number of kinds of environment, which differ in their objects' variants."""
        self.links = np.full((self.kinds, self.count), TERRAIN, np.int64)
        """(K, S) link of each shape, or TERRAIN."""
        self.friction = np.zeros((self.kinds, self.count), np.float32)
        """(K, S) coefficient of dynamic friction of each shape's material."""
        self.surfaces: dict[_Place, Surface] = {}
        """By kind of environment and number of the shape: hollow ones, and convex ones of objects that are no boxes."""
        forms = {(k, s): self._form(own) for k, shapes in enumerate(rows) for s, (own, _) in enumerate(shapes)}
        dry = {(k, s) for k, shapes in enumerate(kinds) for s in range(len(shapes))}
        wet = set(forms) - {(k, s) for k, found in enumerate(of_liquids) for pieces in found.values() for s in pieces}
        # A robot has tens of hulls, whose maps would take many seconds at each start.
        ranges = [entity.links for entity in layout.entities if isinstance(entity.spec, ObjectSpec)]
        objects = {link for each in ranges for link in range(each.start, each.stop)}
        for k, s in wet if spacings else ():
            geometry, link = rows[k][s][0].geometry, rows[k][s][1]
            if isinstance(geometry, Mesh) and geometry.collision is not MeshCollision.CONVEX_HULL:
                # Beneath a height field there is no liquid.
                replaced = [kinds[k][piece][0].geometry for piece in of_liquids[k].get(rows[k][s], ())]
                boxes = [bounds_of(each) for each in replaced if isinstance(each, HeightField)]
                self.surfaces[k, s] = Surface(geometry, boxes[0]) if boxes else Surface.of(geometry)
            elif link in objects and (curved := convex_surface(geometry)) is not None:
                surface = Surface.of(curved)
                # What is larger is flat for a kernel's reach, and its map costs with its area.
                if np.ptp(surface.bounds, axis=0).max() <= CURVED * spacings[0]:
                    self.surfaces[k, s] = surface
        terrain = len(layout.links)
        self.shapes = self._assembled(rows, forms, dry, terrain)
        """:class:`~orbit_matter.surfaces.Shapes` for kernels."""
        self.wet = self.shapes if wet == dry else self._assembled(rows, forms, wet, terrain)
        """The same as liquids meet them."""

    def _assembled(self, rows: list[_Rows], forms: dict[_Place, _Form], chosen: set[_Place], terrain: int) -> Any:
        """Return the chosen shapes as kernels take them; the others are near nothing."""
        shape = (self.kinds, self.count)
        form, grid = np.full(shape, int(SPHERE), np.int32), np.zeros((*shape, 3), np.int32)
        link, mesh = np.full(shape, terrain, np.int32), np.zeros(shape, np.uint64)
        pose, size = np.zeros((*shape, 7), np.float32), np.zeros((*shape, 3), np.float32)
        pose[..., 6] = 1.0
        still = np.full(shape, float(STILL), np.float32)
        # What is not chosen, and where a kind has fewer shapes, is near nothing: a ball of less than no radius.
        reach, size[..., 0] = np.full(shape, -_ENDLESS, np.float32), -_ENDLESS
        for place, found in forms.items():
            own, number = rows[place[0]][place[1]]
            if place in chosen:
                form[place], size[place], reach[place], mesh[place], grid[place] = found
            pose[place] = _transform(own.pose)
            self.links[place] = number
            still[place] = _STILL_FREE if number in self._free else float(STILL)
            link[place] = terrain if number == TERRAIN else number
            self.friction[place] = own.material.dynamic_friction
        made = Shapes()
        with wp.ScopedDevice(self._device):
            made.kind, made.link = wp.array(form, dtype=int), wp.array(link, dtype=int)
            made.pose = wp.array(pose, dtype=wp.transform)
            made.size, made.reach = wp.array(size, dtype=wp.vec3), wp.array(reach, dtype=float)
            made.still = wp.array(still, dtype=float)
            made.mesh, made.rows = wp.array(mesh, dtype=wp.uint64), wp.array(grid, dtype=wp.vec3i)
            heights = np.concatenate([np.zeros(1, np.float32), *self._heights])
            made.heights = wp.array(heights, dtype=float)
        return made

    def _form(self, shape: Shape) -> _Form:
        """Kind, size, reach, mesh and place among the height fields."""
        match shape.geometry:
            case Box(half_extents=half):
                return int(BOX), half, float(np.linalg.norm(half)), 0, (0, 0, 0)
            case Sphere(radius=r):
                return int(SPHERE), (r, 0.0, 0.0), r, 0, (0, 0, 0)
            case Capsule(radius=r, half_length=h):
                return int(CAPSULE), (r, h, 0.0), r + h, 0, (0, 0, 0)
            case Cylinder(radius=r, half_length=h):
                return int(CYLINDER), (r, h, 0.0), float(np.hypot(r, h)), 0, (0, 0, 0)
            case Plane():
                return int(PLANE), (0.0, 0.0, 0.0), _ENDLESS, 0, (0, 0, 0)
            case HeightField(heights=heights, size=(x, y)):
                # All height fields share one array, whose first number is a filler that keeps it from being empty.
                start = 1 + sum(len(each) for each in self._heights)
                self._heights.append(np.asarray(heights, np.float32).ravel())
                return int(HEIGHT_FIELD), (x, y, 0.0), _ENDLESS, 0, (start, *heights.shape)
            case Mesh() as mesh:
                reach = float(np.linalg.norm(mesh.vertices, axis=1).max())
                x, y, z = np.abs(mesh.vertices).max(axis=0)
                return int(MESH), (float(x), float(y), float(z)), reach, self._mesh(mesh), (0, 0, 0)

    def _mesh(self, mesh: Mesh) -> int:
        if mesh.collision is MeshCollision.CONVEX_HULL:
            # As the engines collide with it: a concave mesh would be met inside its own hull.
            mesh = hull_of(mesh)
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
        with wp.ScopedDevice(self._device):
            points, indices = wp.array(vertices, dtype=wp.vec3), wp.array(faces.ravel(), dtype=int)
            self._meshes.append(wp.Mesh(points=points, indices=indices))
        return int(self._meshes[-1].id)


def convex_surface(geometry: Geometry) -> Mesh | None:
    """Return the triangles of a convex shape that has curves or slanted edges; None for any other.

    Triangles within a curve are scaled to the volume of the shape.
    """
    match geometry:
        case Sphere(radius=r):
            volume = 4.0 / 3.0 * np.pi * r**3
        case Capsule(radius=r, half_length=h):
            volume = np.pi * r**2 * (2.0 * h + 4.0 / 3.0 * r)
        case Cylinder(radius=r, half_length=h):
            volume = np.pi * r**2 * 2.0 * h
        case Mesh(collision=MeshCollision.CONVEX_HULL):
            # Behind an edge the half-spaces of both faces overlap, and press twice.
            return hull_of(geometry)
        case _:
            return None
    made = triangles(geometry)
    return Mesh(np.asarray(made.vertices) * (volume / made.volume) ** (1.0 / 3.0), np.asarray(made.faces))


def _shapes_of(layout: SceneLayout) -> list[tuple[Shape, int]]:
    links = [(shape, n) for n, link in enumerate(layout.links) for shape in link.collisions]
    return links + [(shape, TERRAIN) for shape in layout.scene.terrain]


def united(shapes: _Rows) -> dict[tuple[Shape, int], list[int]]:
    """Return the union of the convex meshes of each link that has more than PIECES, and which of the shapes they are.

    Args:
        shapes: of one kind of environment, each with the number of its link.
    """
    found: dict[tuple[Shape, int], list[int]] = {}
    pieces: dict[int, list[int]] = {}
    for s, (own, number) in enumerate(shapes):
        if isinstance(own.geometry, Mesh) and own.geometry.collision is MeshCollision.CONVEX_HULL:
            pieces.setdefault(number, []).append(s)
    for number, chosen in pieces.items():
        if len(chosen) > PIECES:
            corners = [(own.pose, own.geometry) for own, _ in (shapes[s] for s in chosen)]
            vertices, faces = outer_surface([pose.transform(mesh.vertices) for pose, mesh in corners])
            surface = Mesh(vertices, faces, MeshCollision.TRIANGLES)
            found[Shape(surface, material=shapes[chosen[0]][0].material), number] = chosen
    return found


def enclosed(shapes: _Rows, spacing: float) -> dict[tuple[Shape, int], list[int]]:
    """Return each height field with hollows that a map holds as a closed mesh, and which of the shapes it is.

    Args:
        shapes: of one kind of environment, each with the number of its link.
        spacing: of the liquid's particles, m.
    """
    found: dict[tuple[Shape, int], list[int]] = {}
    for s, (own, number) in enumerate(shapes):
        field = own.geometry
        if isinstance(field, HeightField) and has_hollows(field, spacing) and is_mappable(bounds_of(field), spacing):
            shape = Shape(closed_surface(field, spacing), own.pose, material=own.material)
            found.setdefault((shape, number), []).append(s)
    return found


def _transform(pose: Pose) -> tuple[float, ...]:
    w, x, y, z = pose.orientation
    return (*pose.position, x, y, z, w)
