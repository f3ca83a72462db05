"""Checks of a scene's data: types of all fields, ranges of numbers, surfaces and deformables."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.configuration import TypeChecker, wrong_value
from orbit_core.interfaces.errors import MAX_DISTANCE, MAX_SPEED, ArgumentError
from orbit_core.plugin_kit.closed_surfaces import winding_numbers
from orbit_core.scene import (
    AmbientLight,
    Box,
    CameraSpec,
    Capsule,
    Cloth,
    Compliance,
    Cylinder,
    DeformableSpec,
    DirectionalLight,
    Fluid,
    HeightField,
    Joint,
    Link,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Pose,
    Region,
    Rope,
    Scene,
    Shape,
    Sky,
    SoftBody,
    Sphere,
)
from orbit_core.scene.scene import MAX_DIRECTIONAL_LIGHTS

# A mesh whose points spread less than this in a direction, relative to their widest, has no extent there.
_FLAT = 1e-6
# Largest difference of a quaternion's length from 1; written ones have few digits.
_UNIT = 1e-3
# Least area of a triangle, over the mean of its mesh.
_LEAST_AREA = 1e-6
# Least volume of a solid, over that of the box around it.
_LEAST_VOLUME = 1e-4
# Part of a solid's volume that its surface may enclose twice, and the samples along each axis that tell it.
_MOST_TWICE, _SAMPLES = 0.01, 32
# The same along x and y for a surface of one piece.
_LINES = 10
# Spacing of a liquid's particles, over the shortest edge of its box.
_WIDEST_SPACING = 2.0
_MOST_PARTICLES = 1_000_000
# Largest coefficient of a material or a deformable, stiffness of a contact in N/m, and damping, friction or armature of
# a joint in their units.
_LARGEST = 1e12
# Shortest length in metres, and least stiffness and density: engines divide by them.
_LEAST = 1e-9
# N/m of a membrane: a thousandth of a soap film's, below which its strains overflow single precision.
_SOFTEST = 1e-3


@dataclasses.dataclass(frozen=True)
class _Range:
    """Numbers from ``least`` to ``most`` that a field takes, one or several."""

    least: float
    most: float
    unit: str = ""

    def check(self, value: Any, where: str) -> None:
        for number in value if isinstance(value, tuple) else np.ravel(value).tolist():
            if not self.least <= number <= self.most:
                raise wrong_value(where, number, f"{self.least:g} to {self.most:g} {self.unit}".rstrip())


_LENGTH = _Range(_LEAST, MAX_DISTANCE, "m")
_PLACE = _Range(-MAX_DISTANCE, MAX_DISTANCE, "m")
_SHARE = _Range(0.0, 1.0)
_NOT_NEGATIVE = _Range(0.0, _LARGEST)
_POSITIVE = _Range(1e-12, _LARGEST)
_FRICTION = _Range(0.0, 1e6)
_LIMIT = _Range(0.0, math.inf)
# Brightness of a light, in pictures' full brightness.
_BRIGHT = _Range(0.0, 1e3)
_PIXELS = _Range(1, 2**15, "pixels")
_RANGES: Mapping[type, Mapping[str, _Range]] = {
    Pose: {"position": _PLACE},
    PhysicsMaterial: {
        **dict.fromkeys(("static_friction", "dynamic_friction", "torsional_friction", "rolling_friction"), _FRICTION),
        "restitution": _SHARE,
    },
    Compliance: {"stiffness": _Range(_LEAST, _LARGEST, "N/m"), "damping": _Range(0.0, _LARGEST, "N s/m")},
    Box: {"half_extents": _LENGTH},
    Sphere: {"radius": _LENGTH},
    Capsule: {"radius": _LENGTH, "half_length": _Range(0.0, MAX_DISTANCE, "m")},
    Cylinder: {"radius": _LENGTH, "half_length": _LENGTH},
    Shape: {"color": _SHARE},
    Joint: {
        "axis": _Range(-_LARGEST, _LARGEST),
        "rest_position": _Range(-MAX_DISTANCE, MAX_DISTANCE),
        **dict.fromkeys(("damping", "friction", "armature", "stiffness"), _NOT_NEGATIVE),
        **dict.fromkeys(("effort_limit", "velocity_limit"), _LIMIT),
    },
    # Beyond these, single precision holds little of what a link touches, and no square of its inertia.
    Link: {"mass": _Range(0.0, 1e9, "kg"), "center_of_mass": _PLACE, "inertia": _Range(-1e15, 1e15, "kg m^2")},
    CameraSpec: {"width": _PIXELS, "height": _PIXELS, "vertical_fov": _Range(1e-3, math.pi - 1e-3, "rad")},
    AmbientLight: {"color": _BRIGHT},
    DirectionalLight: {"direction": _Range(-1e3, 1e3), "color": _BRIGHT, "intensity": _BRIGHT},
    Sky: {"above": _SHARE, "below": _SHARE},
    Region: {"half_extents": _LENGTH},
    Cloth: {
        **dict.fromkeys(("area_density", "thickness"), _POSITIVE),
        "membrane_stiffness": _Range(_SOFTEST, _LARGEST, "N/m"),
        **dict.fromkeys(("bending_stiffness", "damping", "friction"), _NOT_NEGATIVE),
    },
    Rope: {
        **dict.fromkeys(("linear_density", "axial_stiffness", "radius"), _POSITIVE),
        **dict.fromkeys(("bending_stiffness", "damping", "friction"), _NOT_NEGATIVE),
    },
    SoftBody: {
        **dict.fromkeys(("density", "youngs_modulus"), _POSITIVE),
        **dict.fromkeys(("damping", "friction"), _NOT_NEGATIVE),
    },
    Fluid: {"density": _POSITIVE, "spacing": _POSITIVE, "viscosity": _NOT_NEGATIVE},
    Scene: {"gravity": _Range(-MAX_SPEED, MAX_SPEED, "m/s^2"), "physics_dt": _Range(1e-7, 1.0, "s")},
}


def check_data(thing: object, where: str) -> None:
    """Check a dataclass of a scene: the types of its fields, and the ranges of its numbers.

    Args:
        thing: a scene, or a part of one.
        where: its name, for the message.

    Raises:
        ArgumentError: names the field, by its path from ``where``, its value and what it takes.
    """
    _SCENES.check(thing, where)


def _check_ranges(thing: Any, where: str) -> None:
    for name, numbers in _RANGES[type(thing)].items():
        numbers.check(getattr(thing, name), f"{where}.{name}")


# Parts of scenes -----------------------------------------------------------------------------------------------------


def _check_pose(pose: Pose, where: str) -> None:
    _check_ranges(pose, where)
    if not abs(math.hypot(*pose.orientation) - 1.0) < _UNIT:
        raise wrong_value(f"{where}.orientation", pose.orientation, "a quaternion (w, x, y, z) of length 1")


def _check_joint(joint: Joint, where: str) -> None:
    _check_ranges(joint, where)
    if joint.lower_limit == math.inf or joint.upper_limit == -math.inf:
        limits = joint.lower_limit, joint.upper_limit
        raise wrong_value(f"{where}'s limits", limits, "the lowest position and the highest")


def _check_camera(camera: CameraSpec, where: str) -> None:
    _check_ranges(camera, where)
    if not 0.0 < camera.near < camera.far:
        raise ArgumentError(f"{where} sees from near {camera.near} to far {camera.far} m: give 0 < near < far")


def _check_link(link: Link, where: str) -> None:
    if np.shape(link.inertia) != (3, 3):
        raise ArgumentError(f"{where}.inertia has shape {np.shape(link.inertia)}: give (3, 3)")
    _check_ranges(link, where)
    check_hulls(link.collisions, f"{where}.collisions")


def _check_directional_light(light: DirectionalLight, where: str) -> None:
    _check_ranges(light, where)
    if math.hypot(*light.direction) < _UNIT:
        raise wrong_value(f"{where}.direction", light.direction, "the direction of travel, a vector that is not zero")


def _check_scene(scene: Scene, where: str) -> None:
    _check_ranges(scene, where)
    check_hulls(scene.terrain, f"{where}.terrain")
    count = len(scene.directional_lights)
    if count > MAX_DIRECTIONAL_LIGHTS:
        raise ArgumentError(f"{where}.lights has {count} directional lights: give {MAX_DIRECTIONAL_LIGHTS} at most")


# Surfaces ------------------------------------------------------------------------------------------------------------


def check_mesh(mesh: Mesh, where: str) -> None:
    """Hold a mesh to finite points and to triangles of points that it has, not all on one line.

    Args:
        mesh: the mesh.
        where: its name, for the message.

    Raises:
        ArgumentError: it has no triangle, a point that is not finite or beyond 1e6 m, a triangle of a point that it
            lacks, or no area.
    """
    vertices, faces = mesh.vertices, mesh.faces
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.issubdtype(vertices.dtype, np.floating):
        raise ArgumentError(f"{where}.vertices are {vertices.dtype} of shape {vertices.shape}: give floats (V, 3)")
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise ArgumentError(f"{where}.faces are {faces.dtype} of shape {faces.shape}: give whole numbers (F, 3)")
    if len(faces) == 0 or len(vertices) < 3:
        raise ArgumentError(f"{where} has {len(vertices)} vertices and {len(faces)} triangles: give it a surface")
    # A comparison with NaN is false, so that this finds NaN as well as numbers beyond the bounds.
    if not (vertices.min() >= -MAX_DISTANCE and vertices.max() <= MAX_DISTANCE):
        raise ArgumentError(f"{where} has a vertex that is not finite, or beyond {MAX_DISTANCE:g} m: correct it")
    if faces.min() < 0 or faces.max() >= len(vertices):
        culprit = int(faces.min() if faces.min() < 0 else faces.max())
        raise ArgumentError(
            f"{where} has a triangle of vertex {culprit}, and vertices 0 to {len(vertices) - 1}: correct its faces"
        )
    if extents(mesh.vertices) < 2:
        raise ArgumentError(f"{where} has all its vertices on one line: give it a surface")


def check_hulls(shapes: Iterable[Shape], where: str) -> None:
    """Hold meshes that collide as their convex hulls to hulls with a volume, and those with a field to be closed.

    Args:
        shapes: what collides; meshes among it have passed :func:`check_mesh`.
        where: the name of the shapes, for the message.

    Raises:
        ArgumentError: all points of a mesh lie in one plane, or a mesh that collides by distances is not closed.
    """
    for index, shape in enumerate(shapes):
        mesh, culprit = shape.geometry, f"{where}[{repr(shape.name) if shape.name else index}].geometry"
        if not isinstance(mesh, Mesh) or mesh.collision is MeshCollision.TRIANGLES:
            continue
        if extents(mesh.vertices) < 3:
            raise ArgumentError(
                f"{culprit} is flat, so that its convex hull has no volume: give it thickness, or make it a thin box"
            )
        if mesh.collision is MeshCollision.SIGNED_DISTANCE and not _closed(mesh):
            raise ArgumentError(
                f"{culprit} is not closed, so that distances to it have no sign: close its surface, or have it collide "
                "otherwise"
            )


def check_height_field(field: HeightField, where: str) -> None:
    """Hold a height field to finite heights on at least two rows and columns, and a size above zero.

    Args:
        field: the height field.
        where: its name, for the message.

    Raises:
        ArgumentError: it is none.
    """
    heights = field.heights
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise ArgumentError(f"{where}.heights have shape {heights.shape}: give at least two rows and two columns")
    if not (heights.min() >= -MAX_DISTANCE and heights.max() <= MAX_DISTANCE):
        raise ArgumentError(f"{where}.heights hold one that is not finite, or beyond {MAX_DISTANCE:g} m: correct it")
    if not all(1e-9 <= length <= MAX_DISTANCE for length in field.size):
        raise wrong_value(f"{where}.size", field.size, f"lengths of 1e-09 to {MAX_DISTANCE:g} m")


def _closed(mesh: Mesh) -> bool:
    """Return True if each edge of a face is an edge of exactly one other face, in the other direction."""
    edges = np.stack((mesh.faces, np.roll(mesh.faces, -1, axis=1)), -1).reshape(-1, 2)
    there, back = (np.unique(each, axis=0) for each in (edges, edges[:, ::-1]))
    return len(there) == len(edges) and np.array_equal(there, back)


def extents(points: npt.ArrayLike) -> int:
    """Return the number of directions, 0 to 3, in which points (V, 3) spread."""
    vertices = np.asarray(points, dtype=np.float64)
    centred = vertices - vertices.mean(axis=0)
    spreads = np.sqrt(np.maximum(np.linalg.eigvalsh(centred.T @ centred / len(centred)), 0.0))
    return int((spreads > max(_FLAT * spreads[-1], 1e-12)).sum())


# Deformables ---------------------------------------------------------------------------------------------------------


def check_deformable(spec: DeformableSpec, where: str) -> None:
    """Check the numbers of a deformable, its shape and its particles.

    Args:
        spec: the deformable.
        where: its name, for the message.

    Raises:
        ArgumentError: names the field, its value and what it takes.
    """
    if not spec.name.strip():
        raise ArgumentError(f"{where} has no name: give it one, under which the world holds it")
    _check_ranges(spec, where)
    if isinstance(spec, Fluid):
        _check_box(spec, where)
    if isinstance(spec, Cloth | SoftBody):
        # Poisson's ratio of an isotropic solid is at most 0.5, that of a sheet at most 1.
        most = 1.0 if isinstance(spec, Cloth) else 0.5
        if not -1.0 < spec.poissons_ratio < most:
            raise wrong_value(f"{where}.poissons_ratio", spec.poissons_ratio, f"more than -1 and less than {most:g}")
    if isinstance(spec, Rope) and (np.ndim(spec.points) != 2 or np.shape(spec.points)[1] != 3):
        raise ArgumentError(f"{where}.points has shape {np.shape(spec.points)}: give (particles, 3)")
    if isinstance(spec, Rope) and len(spec.points) < 2:
        raise ArgumentError(f"{where}.points has {len(spec.points)} particles: give two or more")
    count = len(spec.rest_positions)
    if count > _MOST_PARTICLES:
        raise ArgumentError(f"{where} has {count} particles: give {_MOST_PARTICLES} at most")
    if not (np.abs(spec.rest_positions) <= MAX_DISTANCE).all():
        raise ArgumentError(f"{where} has particles that are not finite, or beyond {MAX_DISTANCE:g} m: move them")
    if isinstance(spec, Cloth | Rope):
        _check_extent(spec, where)
    if isinstance(spec, Cloth | SoftBody):
        _check_triangles(spec, where)
    if isinstance(spec, SoftBody) and extents(spec.mesh.vertices) < 3:
        raise ArgumentError(f"{where}.mesh is flat and has no volume: give it a closed surface, or make it a Cloth")
    if isinstance(spec, SoftBody):
        _check_solid(spec, where)
    _check_particles(spec, count)


def _check_particles(spec: DeformableSpec, count: int) -> None:
    """Refuse key points that have no name, or another's, and what is of particles that are not there."""
    names = [point.name for point in spec.key_points]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ArgumentError(f"two key points of '{spec.name}' are named '{twice[0]}': give each its own name")
    for number, point in enumerate(spec.key_points):
        if not point.name.strip():
            raise ArgumentError(
                f"key point {number} of '{spec.name}' has no name: give it one, by which it is asked for"
            )
        if len(set(point.particles)) < len(point.particles):
            raise ArgumentError(
                f"key point '{point.name}' of '{spec.name}' names a particle twice: give it more weight"
            )
        if point.weights and abs(sum(point.weights) - 1.0) > 1e-3:
            raise ArgumentError(
                f"the weights of key point '{point.name}' of '{spec.name}' sum up to {sum(point.weights):g}: make it 1"
            )
    named = [(f"key point '{point.name}'", point.particles) for point in spec.key_points]
    named += [(f"attachment {number}", held.particles) for number, held in enumerate(spec.attachments)]
    for what, particles in named:
        if missing := [particle for particle in particles if not 0 <= particle < count]:
            raise ArgumentError(f"{what} of '{spec.name}' is of particle {missing[0]}: it has {count}, from 0 on")


def _check_box(fluid: Fluid, where: str) -> None:
    """Refuse a box that is none, or holds more particles than any solver takes."""
    for half in fluid.half_extents:
        if not 0.0 < half <= MAX_DISTANCE:
            raise wrong_value(
                f"{where}.half_extents", fluid.half_extents, f"three lengths above 0, {MAX_DISTANCE:g} m at most"
            )
        # One layer of particles would hold more than twice what the box does.
        if fluid.spacing > _WIDEST_SPACING * 2.0 * half:
            most = _WIDEST_SPACING * 2.0 * min(fluid.half_extents)
            raise wrong_value(
                f"{where}.spacing", fluid.spacing, f"{most:g} m at most, twice the shortest edge of its box"
            )
    count = math.prod(max(1.0, 2.0 * half / fluid.spacing) for half in fluid.half_extents)
    if count > _MOST_PARTICLES:
        raise ArgumentError(
            f"{where} has {count:.3g} particles at a spacing of {fluid.spacing:g} m: give {_MOST_PARTICLES} at most"
        )


def _check_triangles(thing: Cloth | SoftBody, where: str) -> None:
    """Refuse triangles that have no area or are there twice, and particles that nothing holds."""
    points, faces = thing.rest_positions, np.asarray(thing.mesh.faces)
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if flat := np.flatnonzero(areas < _LEAST_AREA * areas.mean()).tolist():
        raise ArgumentError(f"triangle {flat[0]} of {where}.mesh has no area: leave it out, or repair the mesh")
    _, counts = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    if (counts > 1).any():
        raise ArgumentError(f"{where}.mesh has a triangle twice, which would weigh and resist twice: leave one out")
    held = np.zeros(len(points), dtype=bool)
    held[faces] = True
    if not held.all():
        raise ArgumentError(f"particle {int(held.argmin())} of {where}.mesh is in no triangle: leave it out")


def _check_solid(solid: SoftBody, where: str) -> None:
    """Check that a solid's surface is closed and faces outwards, and that its elements have a size."""
    if solid.resolution is not None:
        _LENGTH.check(solid.resolution, f"{where}.resolution")
    faces = np.asarray(solid.mesh.faces)
    if not _closed(solid.mesh):
        edges = np.stack((faces, np.roll(faces, -1, axis=1)), -1).reshape(-1, 2)
        directed, counts = np.unique(edges, axis=0, return_counts=True)
        single = {(a, b) for a, b in directed[counts == 1].tolist()}
        a, b = next(
            edge for edge in edges.tolist() if (edge[0], edge[1]) not in single or (edge[1], edge[0]) not in single
        )
        raise ArgumentError(
            f"{where}.mesh is not closed at the edge of vertices {a} and {b}, which is not that of two triangles that "
            "wind the same way: close the surface, merge vertices at one place, or turn triangles over"
        )
    _check_pieces(solid, where)
    share = solid.volume / float(np.prod(np.ptp(solid.rest_positions, axis=0)))
    if share < _LEAST_VOLUME:
        fault = "is inside out" if share < -_LEAST_VOLUME else "encloses hardly any volume"
        raise ArgumentError(
            f"{where}.mesh {fault}: have its triangles wind counter-clockwise as seen from outside, or make it a Cloth"
        )


def _check_pieces(solid: SoftBody, where: str) -> None:
    """Refuse a closed piece of a surface that is inside out, and not the wall of a cavity in another piece."""
    points, faces = solid.rest_positions, np.asarray(solid.mesh.faces)
    piece, lowest = np.arange(len(faces)), np.full(len(points), len(faces))
    while True:
        # Each triangle takes the lowest number among those that it shares a vertex with, until none changes.
        np.minimum.at(lowest, faces, piece[:, None])
        joined = lowest[faces].min(axis=1)
        if (joined == piece).all():
            break
        piece = joined
    corners = points[faces]
    volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    numbers = np.unique(piece)
    boxes = {n: (corners[piece == n].min(axis=(0, 1)), corners[piece == n].max(axis=(0, 1))) for n in numbers.tolist()}
    outer = [n for n in boxes if volumes[piece == n].sum() > 0.0]
    for number, (low, high) in boxes.items():
        around = any((boxes[n][0] <= low).all() and (boxes[n][1] >= high).all() for n in outer)
        if outer and number not in outer and not around:
            raise ArgumentError(
                f"{where}.mesh has a piece that is inside out, at triangle {int(number)}: have its triangles wind "
                "counter-clockwise as seen from outside"
            )
    _check_counted_once(solid, where, len(numbers))


def _check_counted_once(solid: SoftBody, where: str, pieces: int) -> None:
    """Refuse pieces that overlap, and one that crosses itself: their volume would weigh otherwise than it is stiff."""
    low, extent = solid.rest_positions.min(axis=0), np.ptp(solid.rest_positions, axis=0)
    # Each line of points looks at all triangles, and few surfaces cross themselves.
    lines = _SAMPLES if pieces > 1 else _LINES
    axes = [low[k] + extent[k] * (np.arange(n) + 0.5) / n for k, n in enumerate((lines, lines, _SAMPLES))]
    winding = winding_numbers(axes, solid.rest_positions, np.asarray(solid.mesh.faces))
    volume = max(int((winding > 0).sum()), 1)
    twice, inverted = (float(np.maximum(each, 0).sum() / volume) for each in (winding - 1, -winding))
    if pieces == 1 and max(twice, inverted) > _MOST_TWICE:
        raise ArgumentError(
            f"{where}.mesh crosses itself: {100.0 * max(twice, inverted):.0f} % of its volume is enclosed twice or "
            "inside out; repair the mesh"
        )
    if twice > _MOST_TWICE:
        raise ArgumentError(
            f"{where}.mesh is of pieces that overlap, which would weigh {100.0 * twice:.0f} % too much: unite them "
            "into one surface, or turn the wall of a cavity inside out"
        )


def _check_extent(spec: Cloth | Rope, where: str) -> None:
    """Refuse what is thicker than it is long: its particles would meet everything that is near."""
    extent = float(np.ptp(spec.rest_positions, axis=0).max())
    if isinstance(spec, Rope):
        lengths = np.linalg.norm(np.diff(spec.rest_positions, axis=0), axis=1)
        extent = float(lengths.sum())
        if (same := np.flatnonzero(~(lengths > 0.0))).size:
            raise ArgumentError(
                f"particles {same[0]} and {same[0] + 1} of {where}.points are at one place: leave one of them out"
            )
    if extent <= 0.0:
        raise ArgumentError(f"{where} has all of its particles at one place: give it a size")
    name = "thickness" if isinstance(spec, Cloth) else "radius"
    if getattr(spec, name) > extent:
        raise wrong_value(f"{where}.{name}", getattr(spec, name), f"{extent:g} m at most, which is its own length")


def check_attachments(scene: Scene) -> None:
    """Refuse attachments to what the scene lacks, and deformables of one name.

    Raises:
        ArgumentError: names the deformable and the entity or link.
    """
    links = {entity.name: entity.articulation.link_names for entity in scene.entities}
    names = [spec.name for spec in scene.deformables]
    if len(set(names)) < len(names):
        raise ArgumentError(f"two deformables share a name, of {', '.join(names)}: give each its own")
    for spec in scene.deformables:
        held_particles = [particle for held in spec.attachments for particle in set(held.particles)]
        if twice := [particle for particle in held_particles if held_particles.count(particle) > 1]:
            raise ArgumentError(
                f"two attachments of '{spec.name}' hold particle {twice[0]}: leave it to one, which alone can hold it"
            )
        if spec.name in links:
            raise ArgumentError(f"deformable '{spec.name}' has the name of a robot or an object: give it its own")
        for number, held in enumerate(spec.attachments):
            if not held.particles:
                raise ArgumentError(
                    f"attachment {number} of '{spec.name}' holds no particles: name some, or leave it out"
                )
            if held.entity is None and held.link is not None:
                raise ArgumentError(
                    f"attachment {number} of '{spec.name}' is to link '{held.link}' of no entity: name the entity too"
                )
            if held.entity is None:
                continue
            if held.link is None and held.entity in links:
                raise ArgumentError(
                    f"attachment {number} of '{spec.name}' is to no link of '{held.entity}': name one of "
                    f"{', '.join(links[held.entity])}"
                )
            if held.entity not in links:
                raise ArgumentError(f"an attachment of '{spec.name}' is to '{held.entity}': the scene has {[*links]}")
            if held.link not in links[held.entity]:
                raise ArgumentError(
                    f"an attachment of '{spec.name}' is to link '{held.link}' of '{held.entity}', which has "
                    f"{', '.join(links[held.entity])}"
                )


_SCENES = TypeChecker(
    dict.fromkeys(_RANGES, _check_ranges)
    | {
        Pose: _check_pose,
        Joint: _check_joint,
        CameraSpec: _check_camera,
        Link: _check_link,
        DirectionalLight: _check_directional_light,
        Scene: _check_scene,
        Mesh: check_mesh,
        HeightField: check_height_field,
        Cloth: check_deformable,
        Rope: check_deformable,
        SoftBody: check_deformable,
        Fluid: check_deformable,
    }
)
