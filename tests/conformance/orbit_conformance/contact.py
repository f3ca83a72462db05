"""What scenarios of contact share: solids of every kind of shape, smooth ground, where things are, what they feel."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from orbit_assets.mass_properties import shapes_mass_properties
from orbit_assets.objects import box, cylinder, mesh_object, sphere
from orbit_conformance.bodies import SMOOTH
from orbit_core.interfaces import World
from orbit_core.scene import Articulation, Link, Mesh, ObjectSpec, PhysicsMaterial, Plane, Pose, Shape, Sphere
from orbit_core.sensors import ContactSensor

RADIUS, HEIGHT = 0.05, 0.05
"""Half the width and the full height of every standing solid, in metres. The frames lie in the middle."""
_SPACING = 0.4
SMOOTH_GROUND = (Shape(Plane(), material=SMOOTH, name="ground"),)
"""Level ground without friction: the solids on it bring their own friction and restitution."""


def smooth_material(friction: float = 0.0, restitution: float = 0.0) -> PhysicsMaterial:
    """Sliding friction and restitution alone: nothing resists rolling or turning on the spot."""
    return PhysicsMaterial(friction, friction, 0.0, 0.0, restitution)


def standing_solids(material: PhysicsMaterial, ground: Pose | None = None, mass: float = 1.0) -> tuple[ObjectSpec, ...]:
    """A box, a cylinder on its end, a hexagonal prism (a mesh) and a tripod of three balls, which none can roll.

    They stand in a row along y on the plane z = 0 of the frame ``ground``.
    """
    poses = [(ground or Pose()) @ Pose((0.0, _SPACING * number, HEIGHT / 2)) for number in range(4)]
    return (
        box("box", (2 * RADIUS, 2 * RADIUS, HEIGHT), mass=mass, material=material, pose=poses[0]),
        cylinder("cylinder", RADIUS, HEIGHT, mass=mass, material=material, pose=poses[1]),
        mesh_object("prism", prism(6, RADIUS, HEIGHT), mass=mass, material=material, pose=poses[2]),
        _tripod(mass, material, poses[3]),
    )


def marble(name: str, radius: float, material: PhysicsMaterial, pose: Pose, mass: float = 1.0) -> ObjectSpec:
    """A solid ball."""
    return sphere(name, radius, mass=mass, material=material, pose=pose)


def block(name: str, side: float, material: PhysicsMaterial, pose: Pose, mass: float = 1.0) -> ObjectSpec:
    """A solid cube."""
    return box(name, (side, side, side), mass=mass, material=material, pose=pose)


def positions(world: World) -> Tensor:
    """A copy of the objects' positions (N, objects, 3)."""
    return torch.stack([thing.root_pose[:, :3] for thing in world.objects.values()], 1)


def velocities(world: World) -> Tensor:
    """A copy of the objects' velocities (N, objects, 6)."""
    return torch.stack([thing.root_velocity for thing in world.objects.values()], 1)


def contact_sensor(world: World, name: str) -> ContactSensor:
    """The sensor of that name."""
    sensor = world.sensors[name]
    assert isinstance(sensor, ContactSensor)
    return sensor


def prism(sides: int, radius: float, height: float) -> Mesh:
    """A regular prism about z, centred."""
    angles = 2 * math.pi * np.arange(sides) / sides
    ring = radius * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    low, high = (np.column_stack((ring, np.full(sides, z))) for z in (-height / 2, height / 2))
    faces = [(i, (i + 1) % sides, sides + i) for i in range(sides)]
    faces += [((i + 1) % sides, sides + (i + 1) % sides, sides + i) for i in range(sides)]
    faces += [(0, i + 1, i) for i in range(1, sides - 1)]
    faces += [(sides, sides + i, sides + i + 1) for i in range(1, sides - 1)]
    return Mesh(np.concatenate((low, high)), np.array(faces))


def _tripod(mass: float, material: PhysicsMaterial, pose: Pose) -> ObjectSpec:
    foot = 0.4 * RADIUS
    reach = RADIUS - foot
    feet = tuple(
        Shape(Sphere(foot), Pose((reach * math.cos(a), reach * math.sin(a), foot - HEIGHT / 2)), material)
        for a in (0.0, 2 * math.pi / 3, 4 * math.pi / 3)
    )
    unit = shapes_mass_properties(feet, 1.0)
    inertia = unit.inertia * mass / unit.mass
    link = Link("tripod", mass, unit.center_of_mass, inertia, feet, feet)
    return ObjectSpec(name="tripod", articulation=Articulation("tripod", (link,)), pose=pose)
