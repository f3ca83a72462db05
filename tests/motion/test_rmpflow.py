"""The hand goes around obstacles; distances to obstacles, and the balls that stand for a robot."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_assets.objects import cabinet
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.scene import Box, Capsule, Cylinder, ObjectSpec, Pose, Scene, Shape, Sphere, single_link
from orbit_core.scene.shapes import Geometry
from orbit_core.world import simulate
from orbit_motion import RmpFlow, RmpFlowConfig
from orbit_motion.full_ik import FullIk
from orbit_motion.obstacles import Obstacles, _surface, collision_spheres
from orbit_motion.rmpflow import Barrier
from tests.motion.servo_world import BACKENDS, ENGINES, held

GEOMETRIES: tuple[Geometry, ...] = (Sphere(0.08), Box((0.05, 0.05, 0.15)), Capsule(0.05, 0.1), Cylinder(0.06, 0.1))


def obstacle(index: int, geometry: Geometry) -> ObjectSpec:
    body = single_link(f"obstacle{index}", Shape(geometry), 1.0, np.eye(3))
    pose = Pose((0.6, 0.2 * index - 0.3, 0.4), (0.8, 0.0, 0.6, 0.0))
    return ObjectSpec(name=f"obstacle{index}", articulation=body, fixed_base=True, pose=pose)


OBSTACLES = tuple(obstacle(index, geometry) for index, geometry in enumerate(GEOMETRIES))


def test_distances_and_directions_are_those_of_the_shapes() -> None:
    world = simulate(Scene(objects=OBSTACLES), 2, BACKENDS[0])
    obstacles = Obstacles(world, None)
    assert obstacles.count == 5  # with the ground
    points = torch.tensor([0.6, 0.0, 0.4]) + 0.3 * torch.randn(2, 50, 3, generator=torch.Generator().manual_seed(0))
    distances, away = obstacles.distances(points)
    # Going a distance back along the direction, one stands on the surface, from both sides of it.
    surface = points.unsqueeze(2) - distances.unsqueeze(-1) * away
    for column in range(5):
        again, _ = obstacles.distances(surface[:, :, column])
        assert again[:, :, column].abs().max() < 1e-5
    torch.testing.assert_close(away.norm(dim=-1), torch.ones(2, 50, 5), atol=1e-5, rtol=0.0)
    ground = (away[..., 2] == 1.0).all(0).all(0).nonzero().flatten()
    torch.testing.assert_close(distances[:, :, ground[-1]], points[..., 2])
    with pytest.raises(UnknownNameError, match=r"obstacle9.*did you mean 'obstacle"):
        Obstacles(world, ("obstacle9",))
    world.close()


def test_balls_cover_the_robots_shapes() -> None:
    articulation = catalogue_robot("franka_panda").articulation
    balls = collision_spheres(articulation)
    for index, link in enumerate(articulation.links):
        for shape in link.collisions:
            points = _surface(shape) @ shape.pose.rotation_matrix().T + np.asarray(shape.pose.position)
            own = balls.links == index
            gaps = np.linalg.norm(points[:, None] - balls.centers[own], axis=-1) - balls.radii[own]
            assert gaps.min(1).max() < 1e-6
    assert balls.radii.max() < 0.13
    assert len(balls.radii) < 80


def test_what_comes_nearer_slows_down_with_the_distance_and_keeps_its_energy() -> None:
    barrier = Barrier(weight=0.3, range=0.05, speed=0.1, margin=0.0035, push=0.1)
    distance, speed = torch.tensor([0.04, 0.04, 0.04]).double(), torch.tensor([-0.5, -0.1, 0.1]).double()
    energies, dt = [], 2e-5
    for _ in range(8000):
        inertia, force = barrier(distance, speed)
        # Of G = weight w u, of which M is twice, and w x'^4 is what a geodesic conserves.
        energies.append((inertia * speed.square())[:2])
        speed = speed + dt * torch.where(inertia > 0.0, force / inertia.clamp_min(1e-12), 0.0)
        distance = distance + dt * speed
    assert distance[0] < 0.02
    assert (distance[:2] > 0.0035).all()  # so far no potential has pushed
    torch.testing.assert_close(energies[-1], energies[0], rtol=1e-2, atol=0.0)
    assert speed[2] == pytest.approx(0.1)  # what leaves feels nothing
    inertia, force = barrier(torch.tensor([0.00175, 0.06]), torch.zeros(2))
    torch.testing.assert_close(force, torch.tensor([0.1, 0.0]))
    assert (inertia == 0.0).all()  # at rest


def test_drawers_are_no_obstacles_unless_named() -> None:
    world = simulate(Scene(objects=(cabinet(pose=Pose((1.0, 0.0, 0.5))),)), 1, BACKENDS[0])
    assert 1 < Obstacles(world, None).count < Obstacles(world, ("cabinet", "terrain")).count
    world.close()


@pytest.mark.parametrize("backend", ENGINES)
def test_the_hand_arrives_and_touches_nothing(backend: str) -> None:
    count = 12
    arm = held(RmpFlowConfig(), backend, num_envs=count, physics_dt=0.01, objects=OBSTACLES[:3])
    generator, robot = arm.generator, arm.robot
    assert isinstance(generator, RmpFlow)
    random = torch.Generator().manual_seed(0)

    def anywhere(low: tuple[float, ...], high: tuple[float, ...], rotation: tuple[float, ...]) -> torch.Tensor:
        share = torch.rand(count, 3, generator=random)
        positions = torch.tensor(low) + share * (torch.tensor(high) - torch.tensor(low))
        return torch.cat((positions, torch.tensor(rotation).expand(count, 4)), 1)

    for thing in arm.world.objects.values():
        thing.set_root_pose(anywhere((0.35, -0.45, 0.15), (0.7, 0.45, 0.6), (1.0, 0.0, 0.0, 0.0)))
    goal = anywhere((0.35, -0.35, 0.2), (0.65, 0.35, 0.55), (0.0, 1.0, 0.0, 0.0))
    possible = generator.clearance() > 0.03
    start = robot.joint_positions.clone()
    tree = KinematicTree(robot.spec.articulation)
    solver = FullIk(tree, generator.frame, generator.joints, robot.position_limits, robot.home_positions)
    there = start.clone()
    there[:, generator.joints] = solver.solve(goal, start).positions
    robot.set_joint_state(there)
    possible &= generator.clearance() > 0.03
    robot.set_joint_state(start)
    command, least = generator.encode(goal, torch.ones(count, dtype=torch.bool)), torch.full((count,), torch.inf)
    for _ in range(50):
        arm.run(command, 4)
        least = torch.minimum(least, generator.clearance())
    missing = (arm.hand()[:, :3] - goal[:, :3]).norm(dim=1)
    assert possible.sum() >= 3
    assert (least[possible] > 0.0).all()
    assert (missing[possible] < 0.02).float().mean() >= 0.8
    arm.world.close()


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="give a range above the margin"):
        held(RmpFlowConfig(range=0.003), BACKENDS[0])
    with pytest.raises(UnknownNameError, match="cube"):
        held(RmpFlowConfig(obstacles=("cube",)), BACKENDS[0])
