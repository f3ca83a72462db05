"""Rays and the surfaces that they meet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orbit_conformance.bodies import fixed, scene
from orbit_conformance.raytracing import NOTHING, Array, Hits, steady, trace
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import BACKGROUND, TERRAIN, Capability
from orbit_core.scene import Box, Capsule, Cylinder, HeightField, Mesh, MeshCollision, Plane, Pose, Shape, Sphere
from orbit_core.scene.shapes import Geometry

GROUND = Shape(Plane(), name="ground")
# Length of the rays in metres.
_REACH = 20.0
# Angle in radians between a ray and those beside it, which tell whether it passes an edge.
_BESIDE = 2e-3
# Cosine of the angle by which the surface may turn between them.
_ALIKE = 0.98


def primitives() -> list[tuple[Geometry, Pose]]:
    """One solid of each kind, side by side, each with another orientation."""
    return [
        (Box((0.3, 0.2, 0.15)), Pose.from_euler(0.4, -0.3, 0.9, (1.0, 0.0, 0.5))),
        (Sphere(0.3), Pose((0.0, 1.0, 0.4))),
        (Cylinder(0.2, 0.3), Pose.from_euler(1.0, 0.5, 0.2, (-1.0, 0.0, 0.6))),
        (Capsule(0.15, 0.25), Pose.from_euler(-0.7, 0.8, 0.0, (0.0, -1.0, 0.5))),
    ]


def octahedron(collision: MeshCollision, radius: float = 0.4) -> Mesh:
    """Six corners on the axes, eight faces."""
    corners = radius * np.concatenate((np.eye(3), -np.eye(3)))
    upper = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2)]
    lower = [(b, a, 5) for a, b, _ in upper]
    return Mesh(corners, np.array(upper + lower), collision)


def bowl(radius: float = 0.5, depth: float = 0.3, sides: int = 8) -> Mesh:
    """A hollow pyramid open at the top: what a convex hull would close. Seen from above its faces look inwards."""
    angles = np.arange(sides) * 2.0 * np.pi / sides
    rim = np.stack((radius * np.cos(angles), radius * np.sin(angles), np.full(sides, depth)), axis=1)
    bottom = len(rim)
    faces = np.array([(bottom, i, (i + 1) % sides) for i in range(sides)])
    return Mesh(np.concatenate((rim, np.zeros((1, 3)))), faces, MeshCollision.TRIANGLES)


def ridges() -> HeightField:
    """Slopes that bend along lines of y alone: however its cells are split into triangles, the surface is the same."""
    heights = np.array([0.1, 0.1, 0.5, 0.3, 0.3, 0.0, 0.2, 0.4, 0.1])
    rise = np.linspace(0.0, 0.3, 3)
    return HeightField(heights[None] + rise[:, None], (4.0, 3.0))


@dataclass(frozen=True)
class _Rays:
    origins: Array
    directions: Array


def _rays(count: int, above: bool) -> _Rays:
    """Rays from all around, or from above, through the middle of the scene; they are the same at each call."""
    random = np.random.default_rng(0)
    origins = random.normal(size=(count, 3))
    origins[:, 2] = np.abs(origins[:, 2]) + (2.0 if above else 0.0)
    # On a sphere outside of all things: no ray starts within a solid, where engines differ.
    origins *= 4.0 / np.linalg.norm(origins, axis=1, keepdims=True)
    targets = random.uniform((-1.4, -1.4, 0.0), (1.4, 1.4, 0.9), size=(count, 3))
    directions = targets - origins
    return _Rays(origins, directions / np.linalg.norm(directions, axis=1, keepdims=True))


def _truth(things: Sequence[tuple[Geometry, Pose]], rays: _Rays) -> tuple[Hits, np.ndarray]:
    """Return the hits of the rays, and a mask of rays that pass no edge."""
    # Four neighbours around each ray: an edge between them makes the hit a matter of rounding.
    aside: Array = np.cross(rays.directions, np.array([0.0, 0.0, 1.0]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    shifts = (aside, -aside, np.cross(rays.directions, aside), np.cross(aside, rays.directions))
    hits = trace(things, rays.origins, rays.directions)
    beside = [trace(things, rays.origins, rays.directions + _BESIDE * shift) for shift in shifts]
    return hits, steady(hits, beside, _ALIKE)


def _measure(
    trial: Trial, solids: Sequence[tuple[Geometry, Pose]], ground: Shape, count: int, above: bool = False
) -> Mapping[str, float]:
    """Errors of rays on solids that are fixed objects on a ground, in two environments."""
    objects = [fixed(f"thing{i}", geometry, pose) for i, (geometry, pose) in enumerate(solids)]
    world = trial.world(scene(*objects, terrain=(ground,)), num_envs=2)
    rays = _rays(count, above)
    truth, sure = _truth([*solids, (ground.geometry, ground.pose)], rays)

    def sent(values: Array) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=world.device).expand(2, -1, 3)

    found = world.engine.cast_rays(sent(rays.origins), sent(rays.directions), _REACH)
    links = np.append(np.arange(len(solids)), TERRAIN)[truth.things]
    links[(truth.things == NOTHING) | (truth.distances > _REACH)] = BACKGROUND
    met = sure & (links != BACKGROUND)
    with np.errstate(invalid="ignore"):  # infinite, both
        errors = np.abs(found.distances.double().cpu().numpy() - truth.distances)[:, met]
    # Rounding may leave a cosine a little above one.
    cosines = (found.normals.double().cpu().numpy() * truth.normals).sum(-1)[:, met].clip(-1.0, 1.0)
    return {
        "distance": float(errors.max()),
        "normal": float(np.arccos(cosines).max()),
        "thing": float((found.links.cpu().numpy() != links)[:, sure].mean()),
    }


def _on_primitives(trial: Trial) -> Mapping[str, float]:
    return _measure(trial, primitives(), GROUND, 1500)


def _on_convex_meshes(trial: Trial) -> Mapping[str, float]:
    pose = Pose.from_euler(0.3, 0.5, 0.1, (0.2, -0.1, 0.6))
    return _measure(trial, [(octahedron(MeshCollision.CONVEX_HULL), pose)], GROUND, 1000)


def _on_triangle_meshes(trial: Trial) -> Mapping[str, float]:
    pose = Pose.from_euler(0.2, -0.1, 0.3, (0.1, 0.2, 0.3))
    return _measure(trial, [(bowl(), pose)], GROUND, 1000, above=True)


def _on_height_fields(trial: Trial) -> Mapping[str, float]:
    return _measure(trial, [], Shape(ridges(), name="ground"), 600, above=True)


def _scenario(
    name: str, question: str, run: Callable[[Trial], Mapping[str, float]], need: Capability | None
) -> Scenario:
    judged = (Capability.RAY_CASTS, *((need,) if need else ()))
    return Scenario(
        name=name,
        group="Sensors",
        question=question,
        truth="intersections in closed form, in double precision; rays that pass within 2 mrad of an edge left out",
        source="Ericson, Real-Time Collision Detection (2005), section 5.3; Moeller and Trumbore, Fast, minimum "
        "storage ray/triangle intersection, J. Graphics Tools 2 (1997)",
        run=run,
        needs=judged,
        judges=judged,
        time_steps=(),
        metrics=(
            Metric(
                name="distance",
                unit="m",
                tolerance=5e-5,
                meaning="largest error of a distance",
                looser_because="single precision rounds the squares of metres",
            ),
            Metric(
                name="normal",
                unit="rad",
                tolerance=8e-4,
                meaning="largest angle between a normal and the true",
                looser_because="cosines in single precision hide angles below 3.5e-4",
            ),
            Metric(name="thing", unit="", tolerance=0.0, meaning="part of the rays that name another thing, or none"),
        ),
    )


SCENARIOS = (
    _scenario(
        "rays_on_primitives", "Do rays measure a box, a ball, a cylinder, a capsule and a plane right?",
        _on_primitives, None,
    ),
    _scenario(
        "rays_on_convex_meshes", "Do rays measure a convex mesh right?",
        _on_convex_meshes, Capability.CONVEX_MESHES,
    ),
    _scenario(
        "rays_in_triangle_meshes", "Do rays enter a hollow mesh and meet its inside?",
        _on_triangle_meshes, Capability.TRIANGLE_MESHES,
    ),
    _scenario(
        "rays_on_height_fields", "Do rays measure terrain right?",
        _on_height_fields, Capability.HEIGHT_FIELDS,
    ),
)  # fmt: skip
