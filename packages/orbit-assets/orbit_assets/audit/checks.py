"""Findings of an audit, and the checks of joints and links: limits, masses, inertias, collision shapes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from orbit_assets.decomposition import touching_links
from orbit_assets.mass_properties import mass_properties
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    Geometry,
    Joint,
    JointType,
    Link,
    Mesh,
    MeshCollision,
    Shape,
    Sphere,
)
from orbit_core.scene.articulation import principal_axes

# Kinematics, mass matrix, extents and volumes of one description in double precision, to compare others with.
# :mod:`orbit_core.dynamics` computes the same in batches for control. This module shares no code with it, nor with a
# reader, so that a fault in either shows.

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Posture:
    """A description at one set of joint positions, its root at the origin.

    ``links`` and ``frames`` hold poses (4, 4) by name, in the root's frame. ``axes`` and ``origins`` (3,) are those of
    each movable joint, in the root's frame too.
    """

    links: Mapping[str, FloatArray]
    frames: Mapping[str, FloatArray]
    axes: Mapping[str, FloatArray]
    origins: Mapping[str, FloatArray]


def posture(articulation: Articulation, positions: Mapping[str, float]) -> Posture:
    """Compute the poses of links, frames and joint axes at joint positions.

    Followers are placed by ``positions``, not by their leaders. Links must be in topological order.

    Args:
        articulation: the description.
        positions: of movable joints by name (m, rad); zero where not named.
    """
    links = {articulation.root.name: np.eye(4)}
    axes: dict[str, FloatArray] = {}
    origins: dict[str, FloatArray] = {}
    for joint in articulation.joints:
        before = links[joint.parent] @ joint.parent_pose.matrix()
        links[joint.child] = before @ _motion(joint, positions.get(joint.name, 0.0)) @ _inverse(joint)
        if joint.movable:
            axes[joint.name] = before[:3, :3] @ np.asarray(joint.axis, dtype=float)
            origins[joint.name] = before[:3, 3]
    frames = {frame.name: links[frame.link] @ frame.pose.matrix() for frame in articulation.frames}
    return Posture(links, frames, axes, origins)


def mass_matrix(articulation: Articulation, at: Posture) -> FloatArray:
    """Return the mass matrix (J, J) of the movable joints, in their order, the root held and followers free; with
    armature.

    The sum over links of ``m Jv^T Jv + Jw^T R I R^T Jw`` (Siciliano et al., Robotics, 2009, eq. 7.32).
    """
    joints = articulation.movable_joints
    above = _ancestors(articulation)
    matrix = np.diag([float(joint.armature) for joint in joints])
    for link in articulation.links:
        pose = at.links[link.name]
        center = pose[:3, :3] @ np.asarray(link.center_of_mass) + pose[:3, 3]
        linear, angular = np.zeros((3, len(joints))), np.zeros((3, len(joints)))
        for index, joint in enumerate(joints):
            # Joints that are not between the link and the root do not move it: their columns stay zero.
            if joint.name not in above[link.name]:
                continue
            axis = at.axes[joint.name]
            if joint.type is JointType.PRISMATIC:
                linear[:, index] = axis
            else:
                linear[:, index] = np.cross(axis, center - at.origins[joint.name])
                angular[:, index] = axis
        turned = pose[:3, :3] @ link.inertia @ pose[:3, :3].T
        matrix += link.mass * linear.T @ linear + angular.T @ turned @ angular
    return matrix


def _ancestors(articulation: Articulation) -> dict[str, frozenset[str]]:
    """Return for each link the names of the movable joints between it and the root."""
    found = {articulation.root.name: frozenset[str]()}
    for joint in articulation.joints:
        own = frozenset([joint.name]) if joint.movable else frozenset[str]()
        found[joint.child] = found[joint.parent] | own
    return found


def _motion(joint: Joint, position: float) -> FloatArray:
    """Return the motion (4, 4) of the joint at a position: a shift along its axis, or Rodrigues' rotation about it."""
    result = np.eye(4)
    axis = np.asarray(joint.axis, dtype=float)
    if joint.type is JointType.PRISMATIC:
        result[:3, 3] = position * axis
    elif joint.movable:
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        result[:3, :3] += np.sin(position) * cross + (1.0 - np.cos(position)) * cross @ cross
    return result


def _inverse(joint: Joint) -> FloatArray:
    return joint.child_pose.inverse().matrix()


# Enough points that the hull of a sphere is within 3 % of its radius, and few enough for quick hulls.
_ON_SPHERE, _ON_CIRCLE = 96, 24


def shape_points(shape: Shape) -> FloatArray:
    """Return points (P, 3) in the link's frame whose hull is the shape's, round ones sampled; none of ground and
    terrain.
    """
    return shape.pose.transform(_points(shape.geometry))


def bounds(shapes: Iterable[Shape]) -> FloatArray | None:
    """Return the least and the greatest corner (2, 3) of all shapes in the link's frame; ``None`` where nothing has
    extent.
    """
    clouds = [cloud for shape in shapes if len(cloud := shape_points(shape))]
    if not clouds:
        return None
    points = np.concatenate(clouds)
    return np.stack([points.min(0), points.max(0)])


def colliding_volume(shape: Shape) -> float:
    """Return the volume (m^3) that collides: of a mesh's hull if it collides as that; sheets and terrain have none."""
    from scipy.spatial import QhullError
    from trimesh.convex import convex_hull

    geometry = shape.geometry
    try:
        if isinstance(geometry, Mesh) and geometry.collision is MeshCollision.CONVEX_HULL:
            return float(convex_hull(np.asarray(geometry.vertices, dtype=np.float64)).volume)
        return mass_properties(geometry, density=1.0).mass
    except (AssetError, QhullError):
        return 0.0


def _points(geometry: Geometry) -> FloatArray:
    match geometry:
        case Box(half_extents=half):
            return np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * half
        case Sphere(radius=radius):
            return radius * _SPHERE
        case Capsule(radius=radius, half_length=half):
            return np.concatenate([radius * _SPHERE + (0.0, 0.0, side * half) for side in (-1.0, 1.0)])
        case Cylinder(radius=radius, half_length=half):
            return np.concatenate([_CIRCLE * (radius, radius, side * half) for side in (-1.0, 1.0)])
        case Mesh(vertices=vertices):
            return np.asarray(vertices, dtype=np.float64)
        case _:
            return np.zeros((0, 3))


def _sphere() -> FloatArray:
    """Return points spread evenly on the unit sphere (a Fibonacci lattice), and those on its axes."""
    index = np.arange(_ON_SPHERE) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / _ON_SPHERE), np.pi * (1 + 5**0.5) * index
    spread = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    return np.concatenate([spread, np.eye(3), -np.eye(3)])


def _circle() -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, _ON_CIRCLE, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)


_SPHERE, _CIRCLE = _sphere(), _circle()


class Severity(Enum):
    """Importance of a finding."""

    FAULT = "fault"
    """The simulation would be wrong."""
    WARNING = "warning"
    """Unlike real machines, or likely to surprise; look at it."""
    NOTE = "note"
    """What was changed or left out, or what the file does not say."""


@dataclass(frozen=True)
class Finding:
    """One thing that an audit found, with its figures and, where there is one, the remedy."""

    severity: Severity
    """Fault, warning or note."""
    element: str
    """The link, joint or pair, or ``"model"``."""
    text: str
    """Sentence with figures."""


# A sentence with more names is not read.
_SHOWN = 6


def names_in_short(names: Iterable[str]) -> str:
    """Return names with commas, the first six and how many follow."""
    listed = list(names)
    more = f" and {len(listed) - _SHOWN} more" if len(listed) > _SHOWN else ""
    return ", ".join(listed[:_SHOWN]) + more


# A revolute joint beyond two turns is nearly always one whose limits are in degrees.

_TURNS = 4.0 * math.pi


def check_joints(articulation: Articulation) -> Iterator[Finding]:
    """Yield findings on the movable joints, alike ones together; followers need no limits of effort."""
    joints = articulation.movable_joints
    free = [joint for joint in joints if joint.mimic is None]
    for severity, text, group, holds in _CHECKS:
        names = [joint.name for joint in (free if group == "free" else joints) if holds(joint)]
        if names:
            yield Finding(severity, names_in_short(names), text)
    if free and not any(joint.armature for joint in free):
        text = "no joint has armature (the motors' reflected inertia, which steadies contact): add it by edit_joints"
        yield Finding(Severity.NOTE, "model", text)


# Files without a home pose start at zero, as simulators do.
def home_of(articulation: Articulation) -> dict[str, float]:
    """Return positions by joint: the file's home, else zero or the nearest limit; followers after their leaders."""
    named = dict(articulation.home)
    home = {
        joint.name: min(max(named.get(joint.name, 0.0), joint.lower_limit), joint.upper_limit)
        for joint in articulation.movable_joints
    }
    for joint in articulation.movable_joints:
        if joint.mimic is not None and joint.mimic.joint in home:
            home[joint.name] = float(joint.mimic.position(home[joint.mimic.joint]))
    return home


def check_touching(articulation: Articulation) -> Iterator[Finding]:
    """Yield pairs of links whose hulls touch at home although nothing keeps them from colliding with each other."""
    touching = [f"{first} with {second}" for first, second in touching_links(articulation, home_of(articulation))]
    if not touching:
        return
    acts = articulation.self_collisions
    remedy = (
        "exclude these pairs, or give another home" if acts else "exclude them before self_collisions is switched on"
    )
    severity = Severity.WARNING if acts else Severity.NOTE
    yield Finding(severity, names_in_short(touching), f"links touch at home that no joint connects: {remedy}")


def _endless(joint: Joint) -> bool:
    return joint.type is not JointType.CONTINUOUS and not np.isfinite(joint.upper_limit - joint.lower_limit)


def _turns_far(joint: Joint) -> bool:
    span = joint.upper_limit - joint.lower_limit
    return joint.type is JointType.REVOLUTE and math.isfinite(span) and span > _TURNS


_CHECKS: tuple[tuple[Severity, str, str, Callable[[Joint], bool]], ...] = (
    (Severity.WARNING, "slides or turns without limits: give it a lower and an upper one", "all", _endless),
    (
        Severity.WARNING,
        "turns by more than two whole turns within its limits: are they in degrees?",
        "all",
        _turns_far,
    ),
    (
        Severity.WARNING,
        "cannot move: its lower limit is its upper one; make it fixed if that is meant",
        "all",
        lambda joint: joint.lower_limit == joint.upper_limit,
    ),
    (
        Severity.WARNING,
        "has an effort limit of 0: no motor moves it",
        "free",
        lambda joint: joint.effort_limit == 0,
    ),
    (
        Severity.WARNING,
        "has a velocity limit of 0: give the motor's",
        "free",
        lambda joint: joint.velocity_limit == 0,
    ),
    (
        Severity.NOTE,
        "has no effort limit: give the motor's by edit_joints, or in the actuator group",
        "free",
        lambda joint: math.isinf(joint.effort_limit),
    ),
    (
        Severity.NOTE,
        "has no velocity limit: give the motor's by edit_joints, or in the actuator group",
        "free",
        lambda joint: math.isinf(joint.velocity_limit),
    ),
)


# Densities (kg/m^3) of a link's shapes taken as solid: stiff foam, and beyond tungsten.
_LIGHTEST, _HEAVIEST = 20.0, 25_000.0
# Share of the bounding box's diagonal by which a centre of mass may be outside the box.
_OUTSIDE = 0.1
# Share of a solid box's least moment.
_TOO_SMALL = 0.01
# Ratio of colliding to visible volumes, or of lengths of their bounding boxes.
_UNLIKE = 1.5


@dataclass(frozen=True, eq=False)
class Body:
    """A link's mass properties and the size of its shapes. Lengths in metres, moments in kg m^2 ascending."""

    name: str
    """Name of the link."""
    mass: float
    """kg."""
    moments: tuple[float, float, float]
    """Principal moments about the centre of mass, kg m^2."""
    size: tuple[float, float, float] | None
    """Of the bounding box of all shapes in the link's axes."""
    density: float | None
    """kg/m^3 over the volume of the visible shapes, of the colliding ones where none is seen."""
    collision_volume: float
    """m^3 of all colliding shapes, overlaps counted twice."""
    visual_volume: float
    """m^3 of all visible shapes, overlaps counted twice."""


def measure_body(link: Link) -> Body:
    """Measure one link."""
    box = bounds((*link.collisions, *link.visuals))
    low, middle, high = (float(moment) for moment in principal_axes(link.inertia)[0])
    visual = solid_volume(link.visuals)
    solid = visual or solid_volume(link.collisions)
    return Body(
        link.name,
        link.mass,
        (low, middle, high),
        None if box is None else _triple(box[1] - box[0]),
        link.mass / solid if solid > 0 else None,
        sum(map(colliding_volume, link.collisions)),
        visual,
    )


def solid_volume(shapes: Iterable[Shape]) -> float:
    """Return the sum of the shapes' volumes in m^3; sheets and terrain have none, open meshes count as their hulls."""
    total = 0.0
    for shape in shapes:
        try:
            total += mass_properties(shape.geometry, density=1.0).mass
        # An open or flat mesh has no volume: it adds nothing.
        except AssetError:
            continue
    return total


def check_body(link: Link, body: Body) -> Iterator[Finding]:
    """Yield findings on one link of a description without fixed joints. A root without mass is a fixed base."""
    if link.mass > 0:
        yield from _check_density(body)
        yield from _check_inertia(link, body)
    yield from _check_shapes(link, body)


def _check_density(body: Body) -> Iterator[Finding]:
    if body.density is not None and not _LIGHTEST <= body.density <= _HEAVIEST:
        said = f"{body.mass:.4g} kg over shapes of {body.mass / body.density:.3g} m^3 is {body.density:.3g} kg/m^3"
        yield Finding(Severity.WARNING, body.name, f"{said}: check its mass, or its meshes' scale")


def _check_inertia(link: Link, body: Body) -> Iterator[Finding]:
    box = bounds((*link.collisions, *link.visuals))
    if box is None:
        return
    diagonal = float(np.linalg.norm(box[1] - box[0]))
    center = np.asarray(link.center_of_mass)
    outside = float(np.linalg.norm(np.maximum(np.maximum(box[0] - center, center - box[1]), 0.0)))
    if outside > _OUTSIDE * diagonal:
        yield Finding(
            Severity.WARNING, link.name, f"its centre of mass lies {outside:.3g} m outside its shapes: check the origin"
        )
    # A mass within a box has at most the moment that it would have in the corner farthest from its centre.
    farthest = _farthest(box, center)
    most = link.mass * farthest**2
    largest = body.moments[2]
    if largest > most:
        severity = Severity.FAULT if largest > 10.0 * most else Severity.WARNING
        text = (
            f"its largest principal moment, {largest:.3g} kg m^2, is more than {link.mass:.3g} kg within its shapes "
            f"can have ({most:.3g}): check its units and axes"
        )
        yield Finding(severity, link.name, text)
    half = np.sort((box[1] - box[0]) / 2.0)
    least = link.mass * float(half[0] ** 2 + half[1] ** 2) / 3.0
    if body.moments[0] < _TOO_SMALL * least:
        text = f"its least principal moment, {body.moments[0]:.3g} kg m^2, is less than 1/100 of"
        yield Finding(Severity.WARNING, link.name, f"{text} a solid box of its size ({least:.3g}): check its units")


def _check_shapes(link: Link, body: Body) -> Iterator[Finding]:
    collided, seen = bounds(link.collisions), bounds(link.visuals)
    if seen is not None and collided is None:
        yield Finding(Severity.NOTE, link.name, "is seen but collides with nothing")
    if seen is None or collided is None:
        return
    if body.visual_volume > 0 and body.collision_volume > _UNLIKE * body.visual_volume:
        ratio = body.collision_volume / body.visual_volume
        text = f"what collides has {ratio:.1f} times the volume of what is seen: its hull closes hollows"
        yield Finding(Severity.WARNING, link.name, f"{text}; give it convex parts")
    beyond = float(np.maximum(seen[0] - collided[0], collided[1] - seen[1]).max())
    if beyond > (_UNLIKE - 1.0) * float((seen[1] - seen[0]).max()):
        text = f"what collides reaches {beyond:.3g} m beyond what is seen: check its origin and scale"
        yield Finding(Severity.WARNING, link.name, text)


def _farthest(box: FloatArray, point: FloatArray) -> float:
    """Return the distance from a point to the box's farthest corner."""
    return float(np.linalg.norm(np.maximum(np.abs(box[0] - point), np.abs(box[1] - point))))


def _triple(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return (x, y, z)
