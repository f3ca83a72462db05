"""Contact: who may touch whom, which coefficient a pair takes, which surfaces collide.

How right its forces, friction and rebounds are, scenarios ask.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_assets.joint_models import BALL, compound
from orbit_conformance.bodies import WEIGHTLESS, G, ball, cube, fixed, index, scene
from orbit_conformance.contract.fixtures import MakeEngine, Needs, assert_near
from orbit_core.interfaces import TERRAIN, Capability, Engine
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import (
    Articulation,
    Box,
    Compliance,
    ContactSensorSpec,
    Cylinder,
    Geometry,
    HeightField,
    Joint,
    JointType,
    Link,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Pose,
    RobotSpec,
    Shape,
    Sphere,
)


def contact(entity: str = "cube", filters: tuple[str, ...] = ()) -> tuple[ContactSensorSpec]:
    return (ContactSensorSpec(name="contact", entity=entity, filters=filters),)


def test_force_is_zero_after_a_reset_until_the_next_step(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.CONTACT_FORCES)
    engine = make_engine(scene(cube(), sensors=contact()), num_envs=2)
    engine.step(100)
    engine.reset(index(1))
    assert engine.contact_forces[1].abs().max() == 0
    assert engine.contact_forces[0, 0, 2] > 5
    engine.step(100)
    assert engine.contact_forces[1, 0, 2] == pytest.approx(G, rel=0.01)


def material(friction: float) -> PhysicsMaterial:
    return PhysicsMaterial(static_friction=friction, dynamic_friction=friction)


def friction_felt(engine: Engine) -> Tensor:
    """Coefficient from how far a cube slides that is pushed off at 1 m/s: ``v^2 / (2 mu g)``."""
    # Settle on the ground before the push.
    engine.step(20)
    before = engine.link_poses[:, 0, 0].clone()
    engine.write_root_state(0, None, torch.tensor([[1.0, 0, 0, 0, 0, 0]] * engine.num_envs))
    engine.step(250)
    return 1 / (2 * G * (engine.link_poses[:, 0, 0] - before))


@pytest.mark.parametrize(("one", "other"), [(0.0, 0.5), (0.5, 0.0), (0.5, 0.2)])
def test_a_pair_takes_the_larger_friction(make_engine: MakeEngine, needs: Needs, one: float, other: float) -> None:
    """5 %."""
    needs(Capability.FRICTION)
    engine = make_engine(scene(cube(material=material(one)), terrain=(Shape(Plane(), material=material(other)),)))
    assert friction_felt(engine)[0] == pytest.approx(0.5, rel=0.05)


def test_compliant_contact_gives_way(make_engine: MakeEngine, needs: Needs) -> None:
    """A resting ball sinks by ``m g / k``; 10 %."""
    needs(Capability.COMPLIANT_CONTACT)
    soft = PhysicsMaterial(compliance=Compliance(1000.0, 100.0))
    shape = ball(height=0.05)
    link = shape.articulation.root
    link = dataclasses.replace(link, collisions=(Shape(Sphere(0.05), material=soft),))
    soft_ball = dataclasses.replace(shape, articulation=Articulation("ball", (link,)))
    engine = make_engine(scene(soft_ball))
    engine.step(400)
    assert 0.05 - engine.link_poses[0, 0, 2].item() == pytest.approx(G / 1000.0, rel=0.1)


def test_convex_meshes_collide(make_engine: MakeEngine, needs: Needs) -> None:
    """A tetrahedron's face rests on the ground within 1 mm."""
    needs(Capability.CONVEX_MESHES)
    corners = 0.1 * np.array([[0, 0, 1], [0.94, 0, -0.33], [-0.47, 0.82, -0.33], [-0.47, -0.82, -0.33]])
    mesh = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]))
    solid = cube("solid", pose=Pose((0.0, 0.0, 0.04)))
    link = dataclasses.replace(solid.articulation.root, collisions=(Shape(mesh),))
    engine = make_engine(scene(dataclasses.replace(solid, articulation=Articulation("solid", (link,)))))
    engine.step(300)
    assert engine.link_poses[0, 0, 2] == pytest.approx(0.033, abs=1e-3)


@pytest.mark.parametrize("lower", ["box", "cylinder", "hull", "triangles"])
def test_solids_rest_on_the_surface_of_what_is_below_them(lower: str, make_engine: MakeEngine, needs: Needs) -> None:
    """A box, a ball, a cylinder and a hull stand within 0.5 mm of their height on a plate of each kind."""
    needs(Capability.CONVEX_MESHES, *((Capability.TRIANGLE_MESHES,) if lower == "triangles" else ()))
    flat, low = (0.15, 0.15, 0.05), (0.025, 0.025, 0.025)
    plates: dict[str, Geometry] = {
        "box": Box(flat),
        "cylinder": Cylinder(0.15, 0.05),
        "hull": _block(flat),
        "triangles": dataclasses.replace(_block(flat), collision=MeshCollision.TRIANGLES),
    }
    solids: tuple[Geometry, ...] = (Box(low), Sphere(0.025), Cylinder(0.025, 0.025), _block(low))
    things = []
    for number, geometry in enumerate(solids):
        place = 0.5 * number
        solid = cube(f"solid{number}", pose=Pose((place, 0.0, 0.525)))
        link = dataclasses.replace(solid.articulation.root, mass=0.2, collisions=(Shape(geometry),))
        things.append(dataclasses.replace(solid, articulation=Articulation("solid", (link,))))
        things.append(fixed(f"plate{number}", plates[lower], Pose((place, 0.0, 0.45))))
    engine = make_engine(scene(*things))
    engine.step(200)
    assert engine.link_poses[0, ::2, 2].tolist() == pytest.approx([0.525] * 4, abs=5e-4)


def _block(half: tuple[float, float, float]) -> Mesh:
    """A mesh of a box."""
    surface = triangles(Box(half))
    return Mesh(surface.vertices, surface.faces)


def tray(half: float, height: float) -> Mesh:
    """An open box with its floor at z = 0, seen from inside."""
    corners = [
        (x, y, z) for z in (0.0, height) for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))
    ]
    faces = [(0, 1, 2), (0, 2, 3)]
    for i in range(4):
        j = (i + 1) % 4
        faces += [(i, i + 4, j + 4), (i, j + 4, j)]
    return Mesh(np.array(corners), np.array(faces), MeshCollision.TRIANGLES)


def test_static_triangle_meshes_may_be_hollow(make_engine: MakeEngine, needs: Needs) -> None:
    """A ball rolls into the middle of a tray's floor and its wall, not onto the hull; 2 mm."""
    needs(Capability.TRIANGLE_MESHES)
    basin = fixed("tray", tray(0.2, 0.3), Pose((1.0, 0.0, 0.5)))
    engine = make_engine(scene(ball(), basin))
    engine.write_root_state(
        0, torch.tensor([[1.0, 0.01, 0.7, 1.0, 0, 0, 0]]), torch.tensor([[0.3, 0.0, 0.0, 0.0, 0.0, 0.0]])
    )
    engine.step(100)
    assert engine.link_poses[0, 0, 2] == pytest.approx(0.55, abs=2e-3)
    furthest = 0.0
    for _ in range(50):
        engine.step(5)
        furthest = max(furthest, engine.link_poses[0, 0, 0].item())
    assert furthest == pytest.approx(1.15, abs=2e-3)


def test_height_fields_collide_where_their_heights_say(make_engine: MakeEngine, needs: Needs) -> None:
    """Balls on the two halves of a step: rows run along y, columns along x; 2 mm."""
    needs(Capability.HEIGHT_FIELDS)
    heights = np.zeros((21, 41))
    # Rows and columns of different number and height, so that swapped axes show.
    heights[:, 25:] = 0.3  # x > 0.5
    heights[:5] = -0.2  # y < -0.5
    field = Shape(HeightField(heights, (4.0, 2.0)), Pose((0.0, 0.0, 0.1)))
    engine = make_engine(scene(ball(radius=0.05), terrain=(field,)), num_envs=3)
    pose = torch.tensor([[-1.0, 0.5, 0.2], [1.5, 0.5, 0.5], [1.5, -0.9, 0.0]])
    engine.write_root_state(0, torch.cat((pose, torch.tensor([[1.0, 0, 0, 0]] * 3)), -1), None)
    engine.step(300)
    assert_near(engine.link_poses[:, 0, 2], torch.tensor([0.15, 0.45, -0.05]), rtol=0, atol=2e-3)


def test_environments_do_not_touch(make_engine: MakeEngine) -> None:
    """Bodies of different environments pass through each other: each falls as if it were alone."""
    # Engines keep environments in one world, at one place: nothing but filters keeps them apart.
    alone = make_engine(scene(cube(pose=Pose((0.0, 0.0, 1.0)))))
    many = make_engine(scene(cube(pose=Pose((0.0, 0.0, 1.0)))), num_envs=5)
    for engine in (alone, many):
        engine.step(150)
    assert_near(many.link_poses, alone.link_poses.expand(5, 1, 7), rtol=0, atol=1e-6)


def folding_arm(self_collisions: bool, exclusions: tuple[tuple[str, str], ...] = ()) -> RobotSpec:
    """Three bars, hinged end to end, each overlapping the next; the third can fold onto the first."""

    def bar(name: str) -> Link:
        shape = Shape(Box((0.15, 0.02, 0.02)), Pose((0.15, 0.0, 0.0)))
        return Link(name, 1.0, (0.15, 0.0, 0.0), np.eye(3) * 0.01, (shape,), (shape,))

    joints = tuple(
        Joint(f"j{i}", JointType.CONTINUOUS, f"bar{i}", f"bar{i + 1}", Pose((0.3, 0.0, 0.0))) for i in range(2)
    )
    articulation = Articulation("arm", tuple(bar(f"bar{i}") for i in range(3)), joints, (), self_collisions, exclusions)
    return RobotSpec(name="arm", articulation=articulation, fixed_base=True, pose=Pose((0.0, 0.0, 1.0)))


@pytest.mark.parametrize(
    ("self_collisions", "exclusions", "touches"),
    [(True, (), True), (False, (), False), (True, (("bar2", "bar0"),), False)],
)
def test_who_may_touch_within_an_articulation(
    make_engine: MakeEngine, needs: Needs, self_collisions: bool, exclusions: tuple[tuple[str, str], ...], touches: bool
) -> None:
    """Neighbours never touch; others only where asked and not excluded. What overlaps is pushed apart."""
    if self_collisions:
        needs(Capability.SELF_COLLISIONS)
    engine = make_engine(scene(folding_arm(self_collisions, exclusions), gravity=WEIGHTLESS, terrain=()))
    engine.step(2)
    assert_near(engine.joint_positions, torch.zeros(1, 2), atol=1e-5)
    # An equilateral fold: the end of the third bar is inside the first.
    angle = 2 * math.pi / 3
    engine.write_joint_state(index(0, 1), torch.tensor([[angle, angle]]), None)
    engine.step(2)
    assert ((engine.joint_positions - angle).abs().max() > 1e-5) == touches


def test_links_that_a_compound_joint_connects_never_touch(make_engine: MakeEngine, needs: Needs) -> None:
    """The links overlap next to their hip, with links without mass and shapes between them."""
    needs(Capability.SELF_COLLISIONS, Capability.MASSLESS_LINKS)
    pelvis = Link("pelvis", 5.0, inertia=np.eye(3) * 0.02, collisions=(Shape(Sphere(0.1)),))
    aside = Shape(Sphere(0.1), Pose((0.05, 0.0, 0.0)))
    thigh = Link("thigh", 1.0, inertia=np.eye(3) * 0.004, collisions=(aside,))
    between, joints = compound(Joint("hip", JointType.CONTINUOUS, "pelvis", "thigh", Pose((0.0, 0.0, -0.05))), BALL)
    articulation = Articulation("walker", (pelvis, *between, thigh), joints, self_collisions=True)
    engine = make_engine(scene(RobotSpec(name="walker", articulation=articulation), gravity=WEIGHTLESS, terrain=()))
    engine.step(5)
    assert_near(engine.joint_velocities, torch.zeros(1, 3), atol=1e-6)


def test_an_articulation_without_self_collisions_still_meets_others(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.CONTACT_FORCES)
    block = fixed("block", Box((0.05, 0.05, 0.05)), Pose((0.45, 0.06, 1.0)))  # the middle bar alone
    engine = make_engine(scene(folding_arm(False), block, sensors=contact("arm", ("block",)), gravity=WEIGHTLESS))
    engine.step(2)
    forces = engine.contact_forces[0].reshape(3, 2, 3)
    assert forces[1, 0, 1] < -1
    assert_near(forces[1:, 0], forces[1:, 1])
    assert forces[0].abs().max() == 0


def test_a_fixed_thing_stops_a_falling_one(make_engine: MakeEngine) -> None:
    table = fixed("table", Box((0.5, 0.5, 0.02)), Pose((0.0, 0.0, 0.48)))
    engine = make_engine(scene(cube(pose=Pose((0.2, 0.1, 0.56))), table))
    engine.step(200)
    assert engine.link_poses[0, 0, 2] == pytest.approx(0.55, abs=1e-3)


def test_friction_per_environment(make_engine: MakeEngine, needs: Needs) -> None:
    """Set on the cube, then on the terrain; the pair takes the larger; 5 %."""
    needs(Capability.RANDOMIZE_FRICTION)
    engine = make_engine(
        scene(cube(material=material(0.1)), terrain=(Shape(Plane(), material=material(0.1)),)), num_envs=4
    )
    engine.set_friction(index(0), torch.tensor([[0.5], [0.3]]), index(1, 2))
    engine.set_friction(index(TERRAIN), torch.tensor([[0.6]]), index(3))
    engine.reset()
    assert_near(friction_felt(engine), torch.tensor([0.1, 0.5, 0.3, 0.6]), rtol=0.05, atol=0)
