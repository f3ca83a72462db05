"""Liquids in hollow meshes, among many convex pieces and around curves: maps, what cups hold, what things displace."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import torch
import trimesh
import warp as wp

from orbit_assets.catalogue import robot
from orbit_core.interfaces import SceneLayout
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    Fluid,
    Link,
    Mesh,
    MeshCollision,
    ObjectSpec,
    Pose,
    Scene,
    Shape,
    Sphere,
)
from orbit_core.world import simulate
from orbit_matter.colliders import Colliders, Surface, united
from orbit_matter.fluid import maps
from orbit_matter.surfaces import Shapes, distance
from orbit_matter.union import outer_surface

SPACING, RADIUS = 0.01, 0.03
GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs the capability of a GPU")
SIDES = {"round": 48, "square": 4, "wedges": 12}


def _corners(kind: str, radius: float) -> npt.NDArray[np.float64]:
    """Return the (n, 2) corners of a cup, whose sides are a radius from its middle."""
    count = SIDES[kind]
    turn = 2.0 * math.pi * (np.arange(count) + 0.5) / count
    return radius / math.cos(math.pi / count) * np.stack((np.cos(turn), np.sin(turn)), axis=-1)


def _cup(kind: str, wall: float, height: float) -> tuple[Shape, ...]:
    """Return the shapes of a cup whose floor is at 0: a mesh, or a wedge for each side and one for the floor."""
    inner, outer = _corners(kind, RADIUS), _corners(kind, RADIUS + wall)
    if kind != "wedges":
        size = outer[0, 0] if kind == "square" else float(np.linalg.norm(outer[0]))
        hollow = inner[0, 0] if kind == "square" else float(np.linalg.norm(inner[0]))
        turn = 0.25 * math.pi if kind == "square" else 0.0
        size, hollow = (length * (math.sqrt(2.0) if kind == "square" else 1.0) for length in (size, hollow))
        profile = [[0.0, -wall], [size, -wall], [size, height], [hollow, height], [hollow, 0.0], [0.0, 0.0]]
        made = trimesh.creation.revolve(np.array(profile), sections=SIDES[kind])
        made.apply_transform(trimesh.transformations.rotation_matrix(turn, (0.0, 0.0, 1.0)))
        made.merge_vertices()
        made.fix_normals()
        return (Shape(Mesh(made.vertices, made.faces, MeshCollision.SIGNED_DISTANCE)),)
    rings = [np.stack((inner[k - 1], inner[k], outer[k - 1], outer[k])) for k in range(len(inner))]
    prisms = [(ring, 0.0, height) for ring in rings] + [(outer, -wall, 0.0)]
    return tuple(_hull([(*xy, z) for xy in ring for z in (low, high)]) for ring, low, high in prisms)


def _hull(points: list[tuple[float, ...]]) -> Shape:
    made = trimesh.Trimesh(np.array(points), process=False).convex_hull
    return Shape(Mesh(made.vertices, made.faces))


def _surface(kind: str, wall: float) -> Mesh:
    shapes = _cup(kind, wall, 0.1)
    if kind != "wedges":
        assert isinstance(shapes[0].geometry, Mesh)
        return shapes[0].geometry
    ((whole, _),) = united([(shape, 0) for shape in shapes])
    assert isinstance(whole.geometry, Mesh)
    return whole.geometry


class _Collider:
    """One surface, as maps take it."""

    kinds = count = 1

    def __init__(self, mesh: Mesh) -> None:
        self.surfaces = {(0, 0): Surface.of(mesh)}


@wp.kernel(enable_backward=False)
def look_up(
    m: maps.Maps, shapes: Shapes, at: wp.array[wp.vec3], pull: wp.vec3, planes: wp.array[wp.vec4],
    found: wp.array[maps.Given],
):  # fmt: skip
    i = wp.tid()
    near = distance(shapes, 0, 0, at[i], 0.05)
    planes[i] = near
    found[i] = maps.mapped(m, 0, at[i], wp.vec3(near[0], near[1], near[2]), near[3], pull)


def _looked_up(mesh: Mesh, points: npt.NDArray, pull: tuple[float, ...], device: str) -> tuple[npt.NDArray, ...]:
    """Return nearest walls (P, 4) and what the map gives (P, 7)."""
    with wp.ScopedDevice(device) as scope:
        made = maps.build(_Collider(mesh), SPACING, wp.get_device(device))  # pyright: ignore[reportArgumentType]
        own = wp.Mesh(wp.array(mesh.vertices, dtype=wp.vec3), wp.array(np.asarray(mesh.faces).ravel(), dtype=int))
        shapes = Shapes()
        shapes.kind, shapes.size = wp.full((1, 1), 6, dtype=int), wp.zeros((1, 1), dtype=wp.vec3)
        shapes.mesh = wp.array([[own.id]], dtype=wp.uint64)
        planes, found = wp.zeros(len(points), dtype=wp.vec4), wp.zeros(len(points), dtype=maps.Given)
        inputs = [made, shapes, wp.array(points, dtype=wp.vec3), wp.vec3(*pull), planes, found]
        wp.launch(look_up, len(points), inputs=inputs, device=scope)
        return planes.numpy(), found.numpy()


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=GPU)])
@pytest.mark.parametrize(("kind", "wall"), [("round", 0.003), ("round", 0.02), ("square", 0.003), ("wedges", 0.004)])
def test_maps_are_the_integrals_over_all_that_is_not_the_hollow(kind: str, wall: float, device: str) -> None:
    """Particles are a quarter to two spacings from the sides or the floor; a few are near both."""
    pull, turn = (0.5, -0.2, -9.81), 2.0 * math.pi * np.arange(SIDES[kind]) / SIDES[kind]
    normals = np.stack((np.cos(turn), np.sin(turn)), axis=-1)

    def depth(points: npt.NDArray) -> npt.NDArray:
        return np.minimum(RADIUS - (points[..., :2] @ normals.T).max(-1), points[..., 2])

    random = np.random.default_rng(0)
    points = random.uniform((-RADIUS, -RADIUS, 0.0), (RADIUS, RADIUS, 0.05), (400, 3))
    points = points[(depth(points) > 0.25 * SPACING) & (depth(points) < 2.0 * SPACING)][:50]
    planes, got = _looked_up(_surface(kind, wall), points, pull, device)
    if kind != "round":
        assert planes[:, 3] == pytest.approx(depth(points), abs=1e-6)
    slope, peak = maps.kernel_of(SPACING)
    line, reach = (np.arange(-22, 22) + 0.5) * 0.12 * SPACING, 2.6 * SPACING
    way = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    away = np.linalg.norm(way, axis=1)
    part = slope * np.maximum(0.0, 1.0 - away / reach) ** 3 * (0.12 * SPACING) ** 3
    packed = peak * np.maximum(0.0, 1.0 - (away / reach) ** 2) ** 4 * 0.12**3
    wanted = np.zeros((len(points), 7))
    for row, point in zip(wanted, points, strict=True):
        out = depth(point + way) < 0.0
        row[:3] = -(way[out] * part[out, None]).sum(0)
        row[3:6] = -(way[out] * (part[out] * (way[out] @ pull))[:, None]).sum(0)
        row[6] = packed[out].sum()
    error = np.abs(got - wanted)
    # A wall at the particle has 72/m of gradient, half of 9.8 m/s^2 and 0.5; most of the error is near corners.
    assert error[:, :3].mean() < 1.5
    assert error[:, 3:6].mean() < 0.15
    assert error[:, 6].mean() < 0.014
    assert abs((got - wanted)[:, 6].mean()) < 0.009


@pytest.mark.parametrize("kind", ["round", "square", "wedges"])
def test_points_on_the_axis_of_a_cup_are_outside_of_its_walls(kind: str) -> None:
    """Points there are as near to all sides."""
    points = np.column_stack((np.zeros((40, 2)), np.linspace(0.035, 0.095, 40)))
    planes, _ = _looked_up(_surface(kind, 0.003), points, (0.0, 0.0, -9.81), "cpu")
    assert planes[:, 3] == pytest.approx(RADIUS, abs=1e-6)


def test_the_surface_around_pieces_is_that_of_their_union() -> None:
    """Twelve wedges and a floor touch each other face to face; two more boxes overlap."""
    vertices, faces = outer_surface([shape.geometry.vertices for shape in _cup("wedges", 0.004, 0.1)])
    made = trimesh.Trimesh(vertices, faces)

    def area(radius: float) -> float:
        return 12.0 * radius**2 * math.tan(math.pi / 12.0)

    assert made.volume == pytest.approx((area(0.034) - area(0.03)) * 0.1 + area(0.034) * 0.004, rel=1e-6)
    around = 24.0 * math.tan(math.pi / 12.0)
    assert made.area == pytest.approx(around * (0.034 * 0.104 + 0.03 * 0.1) + 2.0 * area(0.034), rel=1e-6)
    first = trimesh.creation.box((0.04, 0.02, 0.02)).vertices
    vertices, faces = outer_surface([first, first + np.array([0.02, 0.01, 0.0]), first])
    assert trimesh.Trimesh(vertices, faces).volume == pytest.approx(0.02 * (2.0 * 0.04 * 0.02 - 0.02 * 0.01), rel=1e-6)


def _filled(kind: str, wall: float, layers: int) -> tuple[ObjectSpec, Fluid, float]:
    """Return a cup, a column of water in it, and how high this stands when it fills the cup."""
    corners = _corners(kind, RADIUS)
    x, y = corners.T
    area = 0.5 * float(np.abs(x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    half = RADIUS if kind == "square" else 0.02
    high = round(layers * SPACING * area / (2.0 * half) ** 2 / SPACING) * SPACING
    shapes = _cup(kind, wall, high + 0.05)
    link = Link("cup", 0.2, inertia=np.eye(3) * 1e-3, collisions=shapes)
    cup = ObjectSpec(name="cup", articulation=Articulation("cup", (link,)), fixed_base=True)
    water = Fluid("water", (half, half, 0.5 * high), 1000.0, Pose((0.0, 0.0, 0.5 * high)), spacing=SPACING)
    return cup, water, (2.0 * half) ** 2 * high / area


@pytest.mark.parametrize(("kind", "wall"), [("round", 0.003), ("round", 0.015), ("square", 0.003), ("wedges", 0.003)])
def test_cups_hold_what_is_in_them(kind: str, wall: float) -> None:
    """Five layers in a cup six particles wide, after a column fell; docs/measured/matter.md has them at rest."""
    cup, water, height = _filled(kind, wall, 5)
    world = simulate(Scene(objects=(cup,), deformables=(water,), terrain=()), 1, "mujoco", matter="orbit-matter")
    world.reset()
    found, forces, heights = world.deformables["water"], [], []
    for step in range(500):
        world.step()
        if step >= 400:
            forces.append(-float(found.contact_force("cup", "cup")[0, 2]))
            heights.append(2.0 * float(found.positions[0, :, 2].mean()))
    x = found.positions[0]
    assert (x[:, :2].abs() < RADIUS).all()
    assert (x[:, 2] > 0.0).all()
    weight = 1000.0 * 9.81 * len(x) * SPACING**3
    assert np.mean(forces) == pytest.approx(weight, rel=0.01)
    assert np.mean(heights) == pytest.approx(height, rel=0.08)
    assert not [each for each in world.engine.build_report if "hollow" in each.asked]
    world.close()


@pytest.mark.parametrize("kind", ["round", "wedges"])
def test_particles_within_a_thin_wall_come_out_on_the_nearer_side(kind: str) -> None:
    """Particles of 10 mm begin in a wall of 3 mm, 1 mm in from either side."""
    cup, water, _ = _filled(kind, 0.003, 1)
    world = simulate(Scene(objects=(cup,), deformables=(water,), terrain=()), 1, "mujoco", matter="orbit-matter")
    world.reset()
    matter = world.engine._matter
    x = matter.positions(0).clone()
    x[0] = torch.tensor([0.0, 0.0, 1.0]) + 0.1 * torch.arange(x.shape[1])[:, None]
    x[0, 0], x[0, 1] = torch.tensor([RADIUS + 0.001, 0.0, 0.03]), torch.tensor([-RADIUS - 0.002, 0.0, 0.03])
    matter.write(0, x, torch.zeros_like(x))
    for _ in range(6):
        world.step()
    found = matter.positions(0)[0]
    assert RADIUS - 0.02 < found[0, 0] < RADIUS - 0.001
    assert -RADIUS - 0.02 < found[1, 0] < -RADIUS - 0.004
    world.close()


@pytest.mark.parametrize("kind", ["round", "square", "wedges"])
def test_cups_that_move_and_tilt_lose_nothing(kind: str) -> None:
    """They go to and fro at up to 0.5 m/s and tilt by up to 20 degrees; their walls are 3 mm thick."""
    cup, water, _ = _filled(kind, 0.003, 3)
    scene = Scene(objects=(replace(cup, articulation=_taller(kind)),), deformables=(water,), terrain=())
    world = simulate(scene, 1, "mujoco", matter="orbit-matter")
    world.reset()
    matter, dt = world.engine._matter, scene.physics_dt

    def pose(time: float) -> torch.Tensor:
        half = 0.5 * math.radians(20.0) * math.sin(2.0 * math.pi * time / 1.1)
        way = 0.5 * 0.8 / (2.0 * math.pi) * math.sin(2.0 * math.pi * time / 0.8)
        return torch.tensor([[[way, 0.0, 0.0, math.cos(half), 0.0, math.sin(half), 0.0]]])

    settling = 100
    for step in range(settling + 200):
        times = [max(0.0, (step + more - settling) * dt) for more in (0, 1)]
        matter.step(pose(times[0]), pose(times[1]))
    w, y = (float(pose(times[1])[0, 0, k]) for k in (3, 5))
    turned = np.array([[1.0 - 2.0 * y * y, 0.0, 2.0 * w * y], [0.0, 1.0, 0.0], [-2.0 * w * y, 0.0, 1.0 - 2.0 * y * y]])
    x = (matter.positions(0)[0].numpy() - pose(times[1])[0, 0, :3].numpy()) @ turned
    assert (np.abs(x[:, :2]) < RADIUS).all()
    assert (x[:, 2] > 0.0).all()
    world.close()


def _taller(kind: str) -> Articulation:
    """Return a cup that nothing is spilled from."""
    link = Link("cup", 0.2, inertia=np.eye(3) * 1e-3, collisions=_cup(kind, 0.003, 0.25))
    return Articulation("cup", (link,))


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "hull"])
def test_objects_with_curves_displace_their_volume(kind: str) -> None:
    """Water is poured on a fixed thing; half-spaces behind nearest points pressed 25 % too little to 40 % too much."""
    half, side, depth = 0.015, 0.1, 0.09
    made = trimesh.creation.icosphere(subdivisions=1, radius=half)
    geometry, volume = {
        "sphere": (Sphere(half), 4.0 / 3.0 * math.pi * half**3),
        "capsule": (Capsule(half, half), (2.0 + 4.0 / 3.0) * math.pi * half**3),
        "cylinder": (Cylinder(half, half), 2.0 * math.pi * half**3),
        "hull": (Mesh(made.vertices, made.faces), float(made.volume)),
    }[kind]
    middle, size = 0.04, (0.5 * (side + SPACING), 0.5 * side)
    walls = [
        Shape(Box((size[0] + 0.005, size[0] + 0.005, 0.005)), Pose((0.0, 0.0, -0.005))),
        *(Shape(Box((0.005, size[1], 0.15)), Pose((sign * size[0], 0.0, 0.15))) for sign in (-1.0, 1.0)),
        *(Shape(Box((size[0] + 0.005, 0.005, 0.15)), Pose((0.0, sign * size[0], 0.15))) for sign in (-1.0, 1.0)),
    ]
    tank, thing = (
        ObjectSpec(name=name, articulation=Articulation(name, (link,)), pose=Pose((0.0, 0.0, z)), fixed_base=True)
        for name, z, link in (
            ("tank", 0.0, Link("tank", 1.0, inertia=np.eye(3) * 1e-3, collisions=tuple(walls))),
            ("thing", middle, Link("thing", 1.0, inertia=np.eye(3) * 1e-3, collisions=(Shape(geometry),))),
        )
    )
    water = Fluid("water", (0.5 * side, 0.5 * side, 0.5 * depth), pose=Pose((0.0, 0.0, middle + 0.035 + 0.5 * depth)))
    world = simulate(Scene(objects=(tank, thing), deformables=(water,), terrain=()), 1, "mujoco", matter="orbit-matter")
    world.step(round(1.2 / world.physics_dt))
    up = []
    for _ in range(round(0.8 / world.physics_dt)):
        world.step()
        up.append(float(world.deformables["water"].contact_force("thing", "thing")[0, 2]))
    world.close()
    assert np.mean(up) == pytest.approx(1000.0 * 9.81 * volume, rel=0.08)


def test_of_long_objects_and_of_robots_the_nearest_points_are_met() -> None:
    short, long = Shape(Cylinder(0.02, 0.1)), Shape(Cylinder(0.02, 0.2))
    objects = [
        ObjectSpec(
            name=f"rod_{n}",
            articulation=Articulation("rod", (Link("rod", 1.0, inertia=np.eye(3), collisions=(shape,)),)),
            pose=Pose((0.5 * n, 0.0, 1.0)),
        )
        for n, shape in enumerate((short, long))
    ]
    water = Fluid("water", (0.02, 0.02, 0.02), pose=Pose((0.0, 1.0, 0.5)))
    layout = SceneLayout.of(Scene(objects=tuple(objects), robots=(robot("franka_panda"),), deformables=(water,)))
    found = Colliders(layout, wp.get_device("cpu"))
    assert [int(found.links[place]) for place in found.surfaces] == [layout.entity("rod_0").links.start]
    dry = SceneLayout.of(Scene(objects=tuple(objects)))
    assert not Colliders(dry, wp.get_device("cpu")).surfaces
