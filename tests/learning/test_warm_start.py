"""A policy to begin a training with: it acts at first as it did where it was learned, however more is shown now."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from orbit_assets.terrain import Rough, TerrainGrid
from orbit_core.envs import Environment, PpoSettings, make
from orbit_core.interfaces import ConfigurationError
from orbit_learn.learners import library_names, trainer_type
from orbit_learn.policy import load_policy
from orbit_learn.pretrained import policy_path
from orbit_learn.rsl_rl import started_from
from orbit_learn.trainer import Progress

WALKER = "velocity_flat_go2"
SMALL = TerrainGrid(kinds=(Rough(),), levels=2, cell_size=4.0)


def rough(robot: str = "unitree_go2") -> Environment:
    env = make("Velocity-Rough", 3, "mujoco", robot=robot, terrain=SMALL, seed=0)
    env.reset()
    return env


def settings(*sizes: int) -> PpoSettings:
    return PpoSettings(steps_per_iteration=4, hidden_sizes=sizes, start=WALKER, initial_std=0.1)


def test_a_walker_of_the_plane_walks_on_terrain_as_it_did_until_it_learns(tmp_path: Path) -> None:
    """Half a radian was its unit of action, one radian is the terrain's; 187 heights weigh nothing."""
    env, walker = rough(), load_policy(policy_path(WALKER))
    for _ in range(5):
        env.step(0.2 * torch.randn(3, 12))
    seen = env.observe()["policy"]
    flat = seen[:, :48].clone()
    flat[:, 36:48] *= 2.0
    expected = 0.5 * walker.module(flat)
    for actor in (
        started_from(walker, env),
        trainer_type("rsl-rl")(env, settings(256, 128, 64), tmp_path, 0).actor(),
    ):
        changed = seen.clone()
        changed[:, 48:] += 1.0
        # What begins also says what was clipped there.
        torch.testing.assert_close(actor.module(changed).clamp(-0.5, 0.5), expected, atol=2e-3, rtol=0.0)
    heights = started_from(walker, env).module.mean[48:]
    torch.testing.assert_close(heights, env.observe()["policy"][:, 48:].mean(0))
    env.close()


def test_the_critic_learns_first_and_what_is_seen_no_more_shifts_the_actor(tmp_path: Path) -> None:
    """Reach shows what its policy saw, nothing else: the actor does the same until its turn to learn has come."""
    env = make("Reach", 4, "mujoco", seed=0)
    first = PpoSettings(steps_per_iteration=4, start="reach", initial_std=0.1, critic_first=2)
    trainer = trainer_type("rsl-rl")(env, first, tmp_path, 0)
    env.reset()
    seen = env.observe()["policy"].clone()
    begun, done, rates = trainer.actor().module(seen), list[torch.Tensor](), list[float]()

    def told(progress: Progress) -> None:
        done.append(trainer.actor().module(seen))
        rates.append(trainer._runner.alg.learning_rate)  # pyright: ignore[reportAttributeAccessIssue]

    trainer.learn(3, told)
    assert torch.equal(done[0], begun)
    assert torch.equal(done[1], begun)
    # An actor that explores by a tenth begins to learn at a tenth of the rate.
    assert rates[:2] == [first.learning_rate, 0.1 * first.learning_rate]
    assert not torch.equal(done[2], begun)
    env.close()


def test_what_the_policy_knew_keeps_its_statistics_and_what_is_new_finds_its_own(tmp_path: Path) -> None:
    """An untrained critic has a few iterations alone unless told otherwise; the walker acts then as it did at first."""
    env = rough()
    trainer = trainer_type("rsl-rl")(env, settings(256, 128, 64), tmp_path, 0)
    before = trainer.actor().module
    seen = env.observe()["policy"].clone()
    trainer.learn(2, lambda progress: None)
    after = trainer.actor().module
    assert torch.equal(after.mean[:48], before.mean[:48])
    assert torch.equal(after.std[:48], before.std[:48])
    assert not torch.isclose(after.std[48:], before.std[48:], rtol=1e-3).any()
    assert torch.equal(after(seen), before(seen))
    assert settings(256, 128, 64).iterations_of_critic > 1
    assert PpoSettings().iterations_of_critic == 0
    env.close()


def test_layers_of_other_sizes_robots_and_libraries_are_refused(tmp_path: Path) -> None:
    env = rough()
    with pytest.raises(ConfigurationError, match=r"give --ppo hidden_sizes=\[256,128,64\]"):
        trainer_type("rsl-rl")(env, settings(64, 64), tmp_path, 0)
    for library in set(library_names()) - {"rsl-rl", "distill"}:
        with pytest.raises(ConfigurationError, match="begins with no policy"):
            trainer_type(library)(env, settings(256, 128, 64), tmp_path, 0)
        with pytest.raises(ConfigurationError, match="lets no critic learn alone"):
            trainer_type(library)(env, PpoSettings(critic_first=1), tmp_path, 0)
    env.close()
    other = rough("unitree_a1")
    with pytest.raises(ConfigurationError, match="learned with robot 'unitree_go2', not with 'unitree_a1'"):
        started_from(load_policy(policy_path(WALKER)), other)
    other.close()
