"""Rays against shapes of known distance. 1e-4 m."""

from __future__ import annotations

import pytest
import torch

from orbit_conformance.bodies import WEIGHTLESS, cube, index, scene, yaw_quaternion
from orbit_conformance.contract.fixtures import MakeEngine, Needs, assert_near
from orbit_core.interfaces import BACKGROUND, TERRAIN, Capability

TOLERANCE = {"rtol": 0, "atol": 1e-4}


@pytest.fixture(autouse=True)
def rays_needed(needs: Needs) -> None:
    needs(Capability.RAY_CASTS)


def test_beyond_the_greatest_distance_there_is_nothing(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(cube()))
    origins, down = torch.tensor([[[0.5, 0.0, 2.0]]]), torch.tensor([[[0.0, 0.0, -1.0]]])
    # Just short of the ground, and just beyond.
    near, far = engine.cast_rays(origins, down, 1.9), engine.cast_rays(origins, down, 2.1)
    assert near.distances.isinf().all()
    assert near.links.tolist() == [[BACKGROUND]]
    assert near.normals.abs().max() == 0
    assert far.distances[0, 0] == pytest.approx(2.0, abs=1e-4)


def test_rays_see_what_was_just_written_in_their_own_environment(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(cube(half=0.1), gravity=WEIGHTLESS), num_envs=3)
    poses = torch.tensor([[0.0, 0.0, z, *yaw_quaternion(0.3)] for z in (0.5, 1.0, 1.5)])
    engine.write_root_state(0, poses, None)
    before = engine.link_poses.clone()
    origins, down = torch.tensor([0.0, 0.0, 3.0]).expand(2, 1, 3), torch.tensor([0.0, 0.0, -1.0]).expand(2, 1, 3)
    # Results come in the order of the environments asked for.
    hits = engine.cast_rays(origins, down, 10.0, index(2, 0))
    assert_near(hits.distances[:, 0], torch.tensor([1.4, 2.4]), **TOLERANCE)
    assert torch.equal(engine.link_poses, before)


def test_rays_tell_the_terrain_from_things_and_from_nothing(make_engine: MakeEngine) -> None:
    """One meets the cube, one the ground next to it, one goes up."""
    engine = make_engine(scene(cube(half=0.1), gravity=WEIGHTLESS))
    origins = torch.tensor([[[0.0, 0.0, 2.0], [0.5, 0.0, 2.0], [0.5, 0.0, 2.0]]])
    directions = torch.tensor([[[0.0, 0.0, -1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
    assert engine.cast_rays(origins, directions, 10.0).links.tolist() == [[0, TERRAIN, BACKGROUND]]


def test_casting_rays_changes_nothing(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.DETERMINISTIC)
    looking, blind = make_engine(scene(cube())), make_engine(scene(cube()))
    for _ in range(10):
        looking.step(3)
        looking.cast_rays(torch.tensor([[[0.0, 0.0, 2.0]]]), torch.tensor([[[0.0, 0.0, -1.0]]]), 5.0)
        blind.step(3)
    assert torch.equal(looking.link_poses, blind.link_poses)


def test_rays_leave_what_carries_them_in_each_environment_by_itself(make_engine: MakeEngine) -> None:
    """Cubes that overlap, each environment's turned by another angle, under a grid of rays that is wider."""
    engine = make_engine(scene(cube("a", half=0.1), cube("b", half=0.1), gravity=WEIGHTLESS), num_envs=3)
    for entity, height in ((0, 0.5), (1, 0.6)):
        poses = torch.tensor([[0.0, 0.0, height, *yaw_quaternion(0.2 * number)] for number in range(3)])
        engine.write_root_state(entity, poses, None)
    # Wider than the cubes: rays past them and through both are in one call.
    place = torch.linspace(-0.2, 0.2, 12)
    x, y = torch.meshgrid(place, place, indexing="ij")
    origins = torch.stack((x, y, torch.full_like(x, 2.0)), -1).view(1, -1, 3).expand(3, -1, 3).contiguous()
    down = torch.tensor([0.0, 0.0, -1.0]).expand_as(origins).contiguous()
    hits = engine.cast_rays_past(origins, down, 5.0, range(2))
    assert (hits.links == TERRAIN).all()
    assert_near(hits.distances, torch.full_like(hits.distances, 2.0), **TOLERANCE)


def test_rays_meet_what_is_nearest_behind_what_carries_them_wherever_that_goes(make_engine: MakeEngine) -> None:
    """The carrying cube moves above another; engines that number ray hits may find the two in any order."""
    engine = make_engine(scene(cube("own", half=0.1), cube("other", half=0.1), gravity=WEIGHTLESS))
    origins = torch.tensor([[[0.0, 0.0, 2.0], [0.0, 0.5, 2.0]]])
    down = torch.tensor([0.0, 0.0, -1.0]).expand_as(origins).contiguous()
    for number in range(12):
        aside = 0.5 * (number % 2)
        for entity, place in ((0, (0.0, aside, 1.0 + 0.05 * number)), (1, (0.0, 0.5 - aside, 0.3))):
            pose = torch.tensor([[*place, 1.0, 0.0, 0.0, 0.0]])
            engine.write_root_state(entity, pose, None)
        engine.step(1)
        below = engine.cast_rays_past(origins, down, 5.0, range(1))
        expected = [[TERRAIN, 1], [1, TERRAIN]][number % 2]
        assert below.links.tolist() == [expected]
        both = torch.tensor([[1.6 if link == 1 else 2.0 for link in expected]])
        assert_near(below.distances, both, **TOLERANCE)
