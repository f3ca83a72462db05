"""Cloth and soft bodies: built, stepped, anchored, read, written, reset, and watched."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import torch

from orbit_bullet import BulletBackend, BulletConfig
from orbit_bullet.engine import BulletEngine
from orbit_bullet.tetrahedra import fill, volume_of
from orbit_core.interfaces import (
    ArgumentError,
    ClosedError,
    ConfigurationError,
    SceneLayout,
    ShapeError,
    SimulationError,
    UnknownNameError,
    UnsupportedCapabilityError,
)
from orbit_core.scene import Cloth, Mesh, ObjectSpec, Pose, Scene, Shape, SoftBody, Sphere, single_link
from orbit_core.world import simulate

Make = Callable[..., BulletEngine]


def sheet(count: int, size: float) -> Mesh:
    """A square net of count x count particles."""
    x = np.linspace(-size / 2, size / 2, count)
    vertices = np.stack((*np.meshgrid(x, x), np.zeros((count, count))), -1).reshape(-1, 3)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    lower = np.stack((corner, corner + 1, corner + count + 1), -1)
    upper = np.stack((corner, corner + count + 1, corner + count), -1)
    return Mesh(vertices, np.concatenate((lower, upper)))


def block(half: float) -> Mesh:
    """A cube whose faces have a vertex in the middle."""
    corners = np.array([[x, y, z] for x in (-half, half) for y in (-half, half) for z in (-half, half)])
    faces = []
    vertices = corners.tolist()
    for axis in range(3):
        for side in (-half, half):
            ring = corners[np.isclose(corners[:, axis], side)]
            normal = np.eye(3)[axis] * np.sign(side)
            ring = ring[np.argsort([_angle(point, axis) for point in ring])]
            middle = len(vertices)
            vertices.append((normal * half).tolist())
            for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
                face = [middle, *(int(np.flatnonzero((corners == p).all(1))[0]) for p in (a, b))]
                outwards = np.dot(np.cross(a - normal * half, b - normal * half), normal) > 0
                faces.append(face if outwards else face[::-1])
    return Mesh(np.array(vertices), np.array(faces))


def _angle(point: np.ndarray, axis: int) -> float:
    u, v = np.delete(point, axis)
    return float(np.arctan2(v, u))


CLOTH = Cloth("cloth", sheet(9, 0.4), 0.1 / 0.16, pose=Pose((0.0, 0.0, 0.5)), membrane_stiffness=46.2)
SOFT = SoftBody("block", block(0.1), 1000.0, pose=Pose((0.0, 0.0, 0.12)), youngs_modulus=1e5, poissons_ratio=0.3)


def scene(*deformables: Cloth | SoftBody, dt: float = 0.004) -> Scene:
    ball = single_link("ball", Shape(Sphere(0.15)), 1.0, np.eye(3) * 0.01)
    pillar = ObjectSpec(name="ball", articulation=ball, fixed_base=True, pose=Pose((0.0, 0.0, 0.2)))
    objects = (pillar,) if isinstance(deformables[0], Cloth) else ()
    return Scene(objects=objects, deformables=deformables, physics_dt=dt)


@pytest.fixture
def make() -> Iterator[Make]:
    made: list[BulletEngine] = []

    def build(asked: Scene, num_envs: int = 1, workers: int = 1) -> BulletEngine:
        engine = BulletBackend().create_engine(
            SceneLayout.of(asked), num_envs, torch.device("cpu"), BulletConfig(workers=workers)
        )
        assert isinstance(engine, BulletEngine)
        made.append(engine)
        return engine

    yield build
    for engine in made:
        engine.close()


def test_cloth_starts_at_rest_and_drapes_over_a_ball(make: Make) -> None:
    engine = make(scene(CLOTH), num_envs=2)
    rest = torch.tensor(CLOTH.pose.transform(CLOTH.mesh.vertices), dtype=torch.float32)
    torch.testing.assert_close(engine.particle_positions(0), rest.expand(2, -1, -1), rtol=0, atol=1e-5)
    assert engine.particle_velocities(0).abs().max() == 0
    for _ in range(30):
        engine.step(10)
    positions = engine.particle_positions(0)
    middle, corner = 40, 0
    assert positions[:, middle, 2] == pytest.approx(0.35, abs=0.01)
    assert (positions[:, corner, 2] < 0.3).all()
    assert (positions - torch.tensor([0.0, 0.0, 0.2])).norm(dim=-1).min() > 0.145


def test_velocities_are_of_the_last_step(make: Make) -> None:
    """Free fall: ``v = -g n h``, 1 %."""
    engine = make(scene(dataclasses.replace(CLOTH, pose=Pose((0.0, 0.0, 3.0)))))
    engine.step(50)
    assert engine.particle_velocities(0)[0, :, 2].mean() == pytest.approx(-9.81 * 0.2, rel=0.01)


def test_an_anchored_particle_stays_in_its_environment_and_over_a_reset(make: Make) -> None:
    engine = make(scene(CLOTH), num_envs=2)
    start = engine.particle_positions(0)[1, 0].clone()
    engine.anchor_particles(0, torch.tensor([0]), None, torch.tensor([1]))
    for _ in range(2):
        engine.step(100)
        torch.testing.assert_close(engine.particle_positions(0)[1, 0], start, rtol=0, atol=0.01)
        assert engine.particle_positions(0)[0, 0, 2] < 0.4
        engine.reset()


def test_a_reset_repeats_the_first_life(make: Make) -> None:
    engine = make(scene(CLOTH), num_envs=2)
    engine.step(60)
    first = engine.particle_positions(0).clone()
    engine.reset(torch.tensor([1]))
    assert engine.particle_velocities(0)[1].abs().max() == 0
    engine.step(60)
    torch.testing.assert_close(engine.particle_positions(0)[1], first[1], rtol=0, atol=1e-5)
    assert not torch.allclose(engine.particle_positions(0)[0], first[0], atol=1e-3)


def test_particles_are_written_at_rest(make: Make) -> None:
    engine = make(scene(CLOTH))
    positions = engine.particle_positions(0).clone() + torch.tensor([0.0, 0.0, 1.0])
    engine.step(5)
    engine.write_particles(0, positions, torch.zeros_like(positions))
    torch.testing.assert_close(engine.particle_positions(0), positions, rtol=0, atol=1e-5)
    engine.step(1)
    assert engine.particle_velocities(0)[0, :, 2].mean() == pytest.approx(-9.81 * 0.004, rel=0.02)
    with pytest.raises(UnsupportedCapabilityError, match="cannot set velocities of particles, as asked for 'cloth'"):
        engine.write_particles(0, positions, torch.ones_like(positions))


def test_a_surface_is_filled() -> None:
    nodes, cells = fill(SOFT.mesh, "block")
    assert np.array_equal(nodes[: len(SOFT.mesh.vertices)], SOFT.mesh.vertices)
    assert volume_of(nodes, cells) == pytest.approx(0.008, rel=1e-6)


def test_a_soft_block_comes_to_rest_on_the_ground(make: Make) -> None:
    """It sags under its weight by less than 5 % of its height."""
    engine = make(scene(SOFT, dt=0.001))
    for _ in range(10):
        engine.step(100)
    heights = engine.particle_positions(0)[0, :, 2]
    assert heights.min() == pytest.approx(0.0, abs=0.01)
    assert heights.max() == pytest.approx(0.2, abs=0.015)
    assert engine.particle_velocities(0).abs().max() < 0.1


@pytest.mark.parametrize(
    "deformable",
    [dataclasses.replace(CLOTH, membrane_stiffness=462.0), dataclasses.replace(SOFT, youngs_modulus=1e8)],
    ids=["cloth", "soft"],
)
def test_what_explicit_integration_cannot_hold_is_refused(make: Make, deformable: Cloth | SoftBody) -> None:
    with pytest.raises(ConfigurationError, match=rf"'{deformable.name}' is too stiff .* use at most 0\.00\d+ s"):
        make(scene(deformable))


def test_a_deformable_that_flies_apart_is_reported(make: Make) -> None:
    engine = make(scene(CLOTH), num_envs=3, workers=2)
    positions = engine.particle_positions(0)[:1].clone()
    positions[:, ::2] *= 40.0
    engine.write_particles(0, positions, torch.zeros_like(positions), torch.tensor([1]))
    with pytest.raises(SimulationError, match=r"environments 1 diverged"):
        engine.step(1)
    engine.reset(torch.tensor([1]))
    engine.step(5)
    assert engine.particle_positions(0).isfinite().all()


def test_snapshots_are_refused(make: Make) -> None:
    with pytest.raises(UnsupportedCapabilityError, match="velocities of particles"):
        make(scene(CLOTH)).save_state()


def test_cloth_is_a_thing_of_the_world_that_can_be_held_carried_and_released() -> None:
    start = scene(CLOTH)
    world = simulate(dataclasses.replace(start, objects=()), 2, "bullet", matter="native")
    try:
        cloth, second = world.deformables["cloth"], torch.tensor([1])
        rest = cloth.positions.clone()
        assert rest.shape == (2, 81, 3)
        cloth.anchor([0, 8], env_ids=second)
        world.step(100)
        torch.testing.assert_close(cloth.positions[1, [0, 8]], rest[1, [0, 8]], rtol=0, atol=0.01)
        assert cloth.positions[0, 0, 2] < 0.4
        cloth.release([0], env_ids=torch.tensor([False, True]))
        world.step(60)
        assert cloth.positions[1, 0, 2] < 0.45
        torch.testing.assert_close(cloth.positions[1, 8], rest[1, 8], rtol=0, atol=0.01)
        cloth.release(env_ids=second)
        world.reset()
        world.step(100)
        assert cloth.positions[:, 8, 2].max() < 0.4
        cloth.set_state(rest[:1] + 1.0, env_ids=torch.tensor([0]))
        torch.testing.assert_close(cloth.positions[0], rest[0] + 1.0, rtol=0, atol=1e-5)
        assert cloth.velocities[0].abs().max() == 0
        with pytest.raises(UnknownNameError, match="did you mean 'cloth'"):
            world.deformables["clot"]
        with pytest.raises(UnknownNameError, match="unknown robot or object 'ball'"):
            cloth.anchor([0], to=("ball", "ball"))
        with pytest.raises(ShapeError, match="particle positions of 'cloth'"):
            cloth.set_state(rest[:, :3])
        with pytest.raises(ArgumentError, match="points of 'cloth'"):
            cloth.anchor([81])
        with pytest.raises(UnsupportedCapabilityError, match="velocities of particles"):
            world.save_state()
    finally:
        world.close()
    with pytest.raises(ClosedError):
        _ = cloth.positions
