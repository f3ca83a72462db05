"""Stack and Stack-Pyramid: a block on another, rewards along the way, settings."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from orbit_conformance.task_audit import coverage
from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_core.sensors import CameraSensor
from orbit_learn.pretrained import policy_fields
from orbit_tasks import stack_pyramid as tasks
from orbit_tasks.mdp import picking, tabletop
from tests.tasks.experts import episode

N = 4
UNCHECKED = {"premises.standing": None, "premises.apart": None}
"""Starts are not simulated when an environment is built."""


def test_the_expert_puts_a_block_on_another() -> None:
    environment, success = episode("Stack", "mujoco", 2)
    heights = environment.world.objects["orange"].root_pose[:, 2]
    environment.close()
    assert success.all()
    torch.testing.assert_close(heights, torch.full_like(heights, 1.5 * tasks.SIZE), atol=2e-3, rtol=0.0)


def test_what_the_expert_teaches_by_the_state_alone_puts_a_block_on_another() -> None:
    environment, success = episode("Stack", "mujoco", 3, teaches=True, action="ik_relative", episode_length=6.0)
    environment.close()
    assert success.all()


@pytest.fixture(scope="module")
def stack() -> Iterator[Environment]:
    environment = make("Stack", N, "mujoco", seed=0)
    yield environment
    environment.close()


def _put(environment: Environment, ways: torch.Tensor) -> None:
    """The block so far (N, 3) from its place."""
    task, world = environment.task, environment.world
    assert isinstance(task, tasks.Stack)
    pose = world.objects["orange"].root_pose.clone()
    pose[:, :3] = tasks.places(environment)[:, 0] + ways
    world.objects["orange"].set_root_pose(pose)


def test_rewards_grow_the_nearer_the_block_is_to_its_place(stack: Environment) -> None:
    stack.reset(seed=0)
    heights = torch.tensor([0.3, 0.1, 0.02, 0.0])
    _put(stack, torch.stack((torch.zeros(N), torch.zeros(N), heights), dim=1))
    assert torch.equal(stack.task.success(stack), heights == 0.0)
    track = tasks.tracking(stack, 0.3)
    assert (track.diff() > 0.0).all()
    assert tasks.letting_go(stack).tolist() == [0.0, 0.0, 0.0, 1.0]


def test_a_block_in_the_hand_is_not_put_down(stack: Environment) -> None:
    stack.reset(seed=0)
    hand = common.hand_pose(stack)
    _put(stack, hand[:, :3] - tasks.places(stack)[:, 0])
    assert not tasks.put_down(stack).any()
    assert (tasks.reaching(stack) > 0.99).all()


def test_blocks_are_seen_as_they_are_turned_against_the_hand_by_less_than_a_quarter(stack: Environment) -> None:
    stack.reset(seed=0)
    task, world = stack.task, stack.world
    assert isinstance(task, tasks.Stack)
    turns = torch.tensor([0.2, 0.2 + 0.5 * torch.pi, -0.3, torch.pi - 0.3])
    pose = world.objects["orange"].root_pose.clone()
    pose[:, 3:] = common.turned(common.turn_facing_down(common.hand_pose(stack)[:, 3:]) + turns)
    world.objects["orange"].set_root_pose(pose)
    torch.testing.assert_close(
        tabletop.piece_turns(stack)[:, 1], torch.tensor([0.2, 0.2, -0.3, -0.3]), atol=1e-4, rtol=0.0
    )


def test_a_block_off_the_table_ends_the_episode(stack: Environment) -> None:
    stack.reset(seed=0)
    _put(stack, torch.tensor([[0.0, 0.0, -0.2]]).expand(N, 3))
    assert tabletop.dropped(stack).all()


def test_blocks_start_apart() -> None:
    environment = make("Stack-Pyramid", 32, "mujoco", seed=3)
    positions = tabletop.piece_poses(environment)[..., :2]
    apart = torch.cdist(positions, positions) + torch.eye(6)
    environment.close()
    assert apart.min() > 2**0.5 * tasks.SIZE


def test_more_blocks_than_there_are_is_refused_by_name() -> None:
    with pytest.raises(ConfigurationError, match="field 'blocks' of task Stack must be 2 to 3"):
        make("Stack", 1, "mujoco", blocks=4)


@pytest.mark.parametrize("backend", ["mujoco", "sapien"])
def test_a_semantic_camera_tells_the_blocks_by_their_colours(backend: str) -> None:
    environment = make("Stack-Pyramid", 2, backend, seed=0, observations="semantic")
    observation, _ = environment.reset(seed=0)
    labels = observation["policy"]["front_labels"]
    camera = environment.world.sensors["front"]
    assert isinstance(camera, CameraSensor)
    colors = {name for pyramid in tasks.COLORS for name in pyramid}
    for row in labels:
        seen = {camera.semantic_labels[index] for index in row.unique().tolist() if index >= 0}
        assert len(colors & seen) >= 4  # the arm may hide a block or two
    assert set(observation) == {"policy", "critic", "teacher"}
    environment.close()


def test_the_palm_keeps_off_what_stands_higher_along_the_fingers() -> None:
    """Where it would meet that, the hand is turned by a quarter; not for what is farther, lower, or beside it."""
    hand = torch.cat((torch.zeros(4, 3), common.facing_down(torch.full((4,), 0.1))), dim=1)
    others = torch.tensor([[0.03, 0.115, 0.05], [0.03, 0.2, 0.05], [0.03, 0.115, 0.0], [0.115, 0.03, 0.05]])
    turned = common.turn_facing_down(picking.beside(hand, others)[:, 3:])
    torch.testing.assert_close(common.wrapped(turned), torch.tensor([0.1 - 0.5 * torch.pi, 0.1, 0.1, 0.1]))


def test_two_blocks_start_anywhere_apart_and_turned_by_any_angle() -> None:
    environment = make("Stack", 64, "mujoco", seed=0, **UNCHECKED)
    starts = []
    for _ in range(4):
        environment.reset()
        starts.append(torch.stack([environment.world.objects[name].root_pose for name in ("red", "orange")], dim=1))
    (low, high), places = common.workspace(environment.world), torch.cat(starts)
    assert (places[:, 0, :2] - places[:, 1, :2]).norm(dim=1).min() > tasks.APART
    for block in range(2):
        covered = coverage("block", places[:, block])
        assert covered.area > 0.5 * (high[0] - low[0] - 0.075) * (high[1] - low[1] - 0.05)
        assert covered.yaw > 0.9
    environment.close()


def test_the_kept_policy_starts_where_it_was_learned_to() -> None:
    assert policy_fields("stack")["starts"] == tasks.CORNERS
    environment = make("Stack", 64, "mujoco", seed=0, **UNCHECKED, **policy_fields("stack"))
    starts = []
    for _ in range(8):
        environment.reset()
        starts.append(environment.world.objects["orange"].root_pose.clone())
    assert coverage("block", torch.cat(starts)).area < 0.02
    environment.close()


@pytest.mark.parametrize(
    ("task", "starts", "told"),
    [
        ("Stack", "somewhere", "give 'anywhere' or 'corners'"),
        ("Stack-Pyramid", "anywhere", "room for two blocks, not 6"),
    ],
)
def test_starts_that_do_not_suit_are_refused(task: str, starts: str, told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        make(task, 1, "mujoco", starts=starts)
