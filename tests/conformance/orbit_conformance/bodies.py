"""Small scenes with known answers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_assets.mass_properties import shapes_mass_properties
from orbit_assets.objects import box, cylinder, mesh_object, sphere
from orbit_core.interfaces import Engine, World
from orbit_core.scene import (
    ActuatorConfig,
    Articulation,
    Box,
    Joint,
    JointType,
    Link,
    Mesh,
    Mimic,
    ObjectSpec,
    PhysicsMaterial,
    Plane,
    Pose,
    RobotSpec,
    Scene,
    SensorSpec,
    Shape,
    Sphere,
    single_link,
)
from orbit_core.scene.shapes import Geometry
from orbit_core.sensors import ContactSensor

G = 9.81
WEIGHTLESS = (0.0, 0.0, 0.0)
SMOOTH = PhysicsMaterial(static_friction=0.0, dynamic_friction=0.0, torsional_friction=0.0, rolling_friction=0.0)


def cube(
    name: str = "cube",
    half: float = 0.05,
    mass: float = 1.0,
    pose: Pose | None = None,
    material: PhysicsMaterial | None = None,
    center_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> ObjectSpec:
    """A free box that stands on the ground at the origin by default."""
    shape = Shape(Box((half, half, half)), material=material or PhysicsMaterial())
    inertia = np.eye(3) * mass * (2 * half) ** 2 / 6
    pose = pose or Pose((0.0, 0.0, half))
    return ObjectSpec(name=name, articulation=single_link(name, shape, mass, inertia, center_of_mass), pose=pose)


def ball(
    name: str = "ball", radius: float = 0.05, mass: float = 1.0, height: float = 1.0, **material: Any
) -> ObjectSpec:
    """A free ball whose centre is at ``height``."""
    shape = Shape(Sphere(radius), material=PhysicsMaterial(**material))
    articulation = single_link("ball", shape, mass, np.eye(3) * 0.4 * mass * radius**2)
    return ObjectSpec(name="ball", articulation=articulation, pose=Pose((0.0, 0.0, height)))


def fixed(name: str, geometry: Geometry, pose: Pose, material: PhysicsMaterial | None = None) -> ObjectSpec:
    """An immovable thing."""
    articulation = single_link(name, Shape(geometry, material=material or PhysicsMaterial()), 1.0, np.eye(3))
    return ObjectSpec(name=name, articulation=articulation, pose=pose, fixed_base=True)


def body(name: str, mass: float = 1.0, com: tuple[float, float, float] = (0.0, 0.0, 0.0), inertia: float = 0.1) -> Link:
    """A link without shapes."""
    return Link(name, mass, com, np.eye(3) * inertia)


def rotor(*, inertia: float = 0.5, actuators: tuple[ActuatorConfig, ...] = (), **joint: Any) -> RobotSpec:
    """A robot with one joint about z between a fixed base and a balanced link: ``(inertia + armature) a = effort``."""
    links = (body("base"), body("rotor", inertia=inertia))
    joints = (Joint("spin", JointType.CONTINUOUS, "base", "rotor", **joint),)
    return RobotSpec(
        name="rotor", articulation=Articulation("rotor", links, joints), fixed_base=True, actuators=actuators
    )


def slider(*, mass: float = 2.0, actuators: tuple[ActuatorConfig, ...] = (), **joint: Any) -> RobotSpec:
    """A robot with one joint along x: ``mass a = effort``."""
    links = (body("base"), body("carriage", mass))
    joints = (Joint("slide", JointType.PRISMATIC, "base", "carriage", axis=(1.0, 0.0, 0.0), **joint),)
    return RobotSpec(
        name="slider", articulation=Articulation("slider", links, joints), fixed_base=True, actuators=actuators
    )


def pendulum(
    *,
    length: float = 0.5,
    links: int = 2,
    gravity_compensation: bool = False,
    home: float = 0.0,
    actuators: tuple[ActuatorConfig, ...] = (),
    base: Pose | None = None,
) -> RobotSpec:
    """A chain about y: each link 1 kg at half its length along its own x, the next hinge at its end.

    With the joints at zero the chain is along x.
    """  # fmt: skip
    bodies = [body("base")] + [body(f"link{i}", 1.0, (length / 2, 0.0, 0.0), 0.01) for i in range(links)]
    joints = [
        Joint(
            f"hinge{i}", JointType.CONTINUOUS, bodies[i].name, bodies[i + 1].name, axis=(0.0, 1.0, 0.0),
            parent_pose=Pose((length if i else 0.0, 0.0, 0.0)),
        )
        for i in range(links)
    ]  # fmt: skip
    return RobotSpec(
        name="pendulum", articulation=Articulation("pendulum", tuple(bodies), tuple(joints)), fixed_base=True,
        gravity_compensation=gravity_compensation, home={"hinge0": home}, actuators=actuators,
        pose=base or Pose((0.0, 0.0, 2.0)),
    )  # fmt: skip


def tree() -> RobotSpec:
    """Two arms of two links each, numbered breadth first: left, right, left's tip, right's tip."""
    names = ("trunk", "left", "right", "left_tip", "right_tip")
    joints = tuple(
        Joint(
            f"{child}_joint", JointType.REVOLUTE, parent, child, parent_pose=Pose(position), axis=(0.0, 0.0, 1.0),
            lower_limit=-3.0, upper_limit=3.0,
        )
        for child, parent, position in (
            ("left", "trunk", (0.0, 0.1, 0.0)), ("right", "trunk", (0.0, -0.1, 0.0)),
            ("left_tip", "left", (0.3, 0.0, 0.0)), ("right_tip", "right", (0.4, 0.0, 0.0)),
        )
    )  # fmt: skip
    articulation = Articulation("tree", tuple(body(name) for name in names), joints)
    return RobotSpec(name="tree", articulation=articulation, fixed_base=True, pose=Pose((0.0, 0.0, 1.0)))


def geared(multiplier: float, offset: float, actuators: tuple[ActuatorConfig, ...] = ()) -> RobotSpec:
    """Two balanced rotors; the second mimics the first."""
    links = (body("base"), body("first"), body("second"))
    joints = (
        Joint("leader", JointType.CONTINUOUS, "base", "first"),
        Joint("follower", JointType.CONTINUOUS, "base", "second", mimic=Mimic("leader", multiplier, offset)),
    )
    return RobotSpec(
        name="geared", articulation=Articulation("geared", links, joints), fixed_base=True, actuators=actuators
    )


def scene(
    *entities: RobotSpec | ObjectSpec,
    sensors: tuple[SensorSpec, ...] = (),
    gravity: tuple[float, float, float] = (0.0, 0.0, -G),
    terrain: tuple[Shape, ...] = (Shape(Plane(), name="ground"),),
    dt: float = 0.005,
) -> Scene:
    """A scene of robots and objects, in their order; on flat ground unless another terrain is given."""
    robots = tuple(entity for entity in entities if isinstance(entity, RobotSpec))
    objects = tuple(entity for entity in entities if isinstance(entity, ObjectSpec))
    return Scene(robots=robots, objects=objects, sensors=sensors, gravity=gravity, terrain=terrain, physics_dt=dt)


def slope(angle: float, material: PhysicsMaterial) -> Shape:
    """A plane that falls towards +x."""
    return Shape(Plane(), Pose.from_axis_angle((0.0, 1.0, 0.0), angle), material, name="slope")


def on_slope(angle: float, height: float) -> Pose:
    """The pose of a thing that stands ``height`` above a slope through the origin."""
    turned = Pose.from_axis_angle((0.0, 1.0, 0.0), angle)
    return turned @ Pose((0.0, 0.0, height))


def index(*numbers: int) -> Tensor:
    """(n,) int64 indices of environments, links or joints."""
    return torch.tensor(numbers, dtype=torch.int64)


def seconds(engine: Engine, duration: float) -> int:
    """The number of physics steps in ``duration`` (s)."""
    return round(duration / engine.layout.scene.physics_dt)


def yaw_quaternion(angle: float) -> list[float]:
    """The quaternion (w, x, y, z) of a turn by ``angle`` radians about z."""
    return [math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)]


# Parts that scenarios of contact share: solids of every shape, smooth ground, poses and contact forces.

# Half the width and the full height of every standing solid, in metres. The frames lie in the middle.
RADIUS, HEIGHT = 0.05, 0.05
_SPACING = 0.4
# Level ground without friction: the solids on it bring their own friction and restitution.
SMOOTH_GROUND = (Shape(Plane(), material=SMOOTH, name="ground"),)


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
    # Faces are wound outwards, which engines take for the direction of normals.
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
    # Inertia of the real shape: a tripod that turns tests friction, not the inertia.
    unit = shapes_mass_properties(feet, 1.0)
    inertia = unit.inertia * mass / unit.mass
    link = Link("tripod", mass, unit.center_of_mass, inertia, feet, feet)
    return ObjectSpec(name="tripod", articulation=Articulation("tripod", (link,)), pose=pose)
