"""Episodes that begin on the expert's way."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from torch import nn

from orbit_core.backends import default_backend
from orbit_core.envs import PpoSettings, make
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp.common import hand_pose
from orbit_learn.cli.train import TrainSettings, for_training, train
from orbit_learn.ends import EpisodeTally
from orbit_learn.rsl_rl import imitate_expert
from orbit_tasks.lift import Lift

NUM_ENVS = 4


def lift(share: float) -> Lift:
    return Lift(episode_length=3.0, action="joint_position_relative", expert_starts=share)


def test_a_share_of_episodes_begins_on_the_experts_way() -> None:
    """By index and by mask alike; they hold what the expert held, have the time left that it had, and do not count."""
    plain, closed = (make(lift(0.5), NUM_ENVS, default_backend()) for _ in range(2))
    closed._closed = CapturedStep(closed, compile=False, whole=True)
    generator = torch.Generator().manual_seed(0)
    tally, began, held = EpisodeTally(plain.device), 0, 0
    plain.reset(seed=3), closed.reset(seed=3)
    for step in range(30):
        action = 2.0 * torch.rand(NUM_ENVS, plain.action_size, generator=generator) - 1.0
        for each in (plain, closed):  # whose last step this is
            each.state.episode_step[step % NUM_ENVS] = each.max_episode_steps - 1
        mine, its = plain.step(action), closed.step(action)
        torch.testing.assert_close(its[0], mine[0], rtol=0.0, atol=0.0)
        tally.add(mine[4], NUM_ENVS)
        if "final" in mine[4]:
            assert plain.starts is not None
            there = plain.starts.began_there[mine[4]["final"].env_ids]
            steps = plain.state.episode_step[mine[4]["final"].env_ids]
            height = plain.world.objects["cube"].root_pose[mine[4]["final"].env_ids, 2]
            began += int(there.sum())
            held += int((height[there] > 0.06).sum())
            assert not steps[~there].any()
            assert not (height[~there] > 0.06).any()
    assert 6 < began < 24
    assert 0 < held < began
    assert 6 < tally.read()[2] < 24
    plain.close(), closed.close()


def test_deformables_begin_where_the_expert_had_them() -> None:
    """Blocks off the table are in the hand and stay there, put there by index in a reset and by mask in a step."""
    environment = make("Soft-Lifting", 2, default_backend(), action="ik_relative", expert_starts=1.0)
    environment._closed = CapturedStep(environment, compile=False, whole=True)
    block, action, apart = environment.world.deformables["block"], torch.zeros(2, 7), []
    action[:, -1] = -1.0  # closed
    environment.reset(seed=0)
    for step in range(12):
        height, hand = block.positions.mean(1)[:, 2], hand_pose(environment)[:, 2]
        apart.extend((height - hand)[height > 0.1].abs().tolist())
        if step % 2:
            environment.state.episode_step.fill_(environment.max_episode_steps - 1)  # whose last step this is
        environment.step(action)
    assert apart
    assert max(apart) < 0.02
    environment.close()


def test_shares_and_tasks_that_cannot_be() -> None:
    with pytest.raises(ConfigurationError, match=r"share of episodes, between 0 and 1, not 1.5"):
        make("Reach", 2, default_backend(), expert_starts=1.5)
    with pytest.raises(ConfigurationError, match="no scripted expert"):
        make("Ant", 2, default_backend(), expert_starts=0.5)
    with pytest.raises(ConfigurationError, match="reached the goal in none of 2; leave expert_starts out"):
        make("Lift", 2, default_backend(), expert_starts=0.5, episode_length=0.2)


def test_a_training_sets_what_the_task_says_for_it_unless_told_otherwise() -> None:
    settings = for_training(TrainSettings(task="Stack", fields={"action": "joint_position"}))
    assert settings.fields == {"expert_starts": 0.5, "action": "joint_position"}
    assert for_training(TrainSettings(task="Reach")).fields == {}


def test_a_training_ends_well_whose_every_episode_began_on_the_experts_way(tmp_path: Path) -> None:
    settings = {"num_envs": 4, "backend": default_backend(), "iterations": 1, "output": tmp_path / "out"}
    fields = {"expert_starts": 1.0, "episode_length": 1.6}
    ppo = ("steps_per_iteration=81", "imitation_steps=2")
    folder = train(TrainSettings(task="Reach", action="ik_relative", fields=fields, ppo=ppo, **settings))
    (line,) = map(json.loads, (folder / "curve.jsonl").read_text().splitlines())
    assert line["success_rate"] is None
    assert line["metrics"]["expert_start"] > 0.0


def test_what_the_expert_saw_and_did_is_imitated() -> None:
    environment = make("Reach", 4, default_backend(), expert_starts=0.5, action="ik_relative", episode_length=2.0)
    assert environment.starts is not None
    seen, done = environment.starts.seen, environment.starts.done
    assert seen.shape == (len(done), environment.observation_size)
    network = nn.Sequential(nn.Linear(seen.shape[1], 32), nn.ELU(), nn.Linear(32, done.shape[1]))
    settings = PpoSettings(imitation_steps=100, learning_rate=3e-3, normalize_observations=False)
    assert imitate_expert(environment, network, nn.Identity(), settings) < 0.3 * done.square().mean()
    environment.close()
    plain = make("Reach", 2, default_backend())
    with pytest.raises(ConfigurationError, match=r"imitation_steps=100 needs what an expert saw and did"):
        imitate_expert(plain, network, nn.Identity(), settings)
    plain.close()
