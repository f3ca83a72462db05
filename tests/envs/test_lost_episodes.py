"""Environments that diverge begin anew and are counted where that is asked for; others go on as they would have."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from orbit_core.envs import Environment, PpoSettings, make
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.interfaces import SimulationError
from orbit_learn.learners import trainer_type
from orbit_learn.training import Training


def break_one(env: Environment, which: int) -> None:
    broken = torch.zeros(1, 6)
    broken[0, 0] = torch.nan
    env.world.engine.write_root_state(0, None, broken, torch.tensor([which]))
    env.world.clock.touch()


def walkers(backend: str, **more: object) -> Environment:
    env = make("Velocity-Flat", 4, backend, robot="unitree_go2", seed=0, curriculum_enabled=True, **more)
    env.reset()
    return env


@pytest.mark.parametrize(("backend", "captured"), [("mujoco", False), ("mujoco", True), ("bullet", False)])
def test_a_diverged_environment_begins_anew_and_the_others_go_on(backend: str, captured: bool) -> None:
    env, other = walkers(backend, reset_diverged=True), walkers(backend)
    if captured:
        env._closed = CapturedStep(env, compile=False, whole=False)
    assert env.lost is not None
    well = torch.tensor([True, False, True, True])
    env.state.difficulty[:] = other.state.difficulty[:] = 0.5
    for step in range(5):
        if step == 3:
            break_one(env, 1)
        action = torch.full((4, 12), 0.1 * step)
        observation, reward, terminated, truncated, info = env.step(action)
        expected = other.step(action)
        torch.testing.assert_close(reward[well], expected[1][well])
        torch.testing.assert_close(observation["policy"][well], expected[0]["policy"][well])
        assert observation["policy"].isfinite().all()
        assert truncated.tolist() == [False, step == 3, False, False]
        assert not terminated.any()
        if step == 3:
            assert reward[1] == 0.0
            assert not info["final"].success.any()
            assert info["final"].env_ids.tolist() == [1]
    assert env.lost.count == 1
    assert env.state.episode_step.tolist() == [5, 1, 5, 5]
    assert (env.state.difficulty == 0.5).all(), "no curriculum learns from an episode that diverged"
    env.close()
    other.close()


def test_without_it_the_step_raises() -> None:
    env = walkers("mujoco")
    env.step(torch.zeros(4, 12))
    break_one(env, 2)
    with pytest.raises(SimulationError, match="environments 2 diverged"):
        env.step(torch.zeros(4, 12))
    env.close()


@pytest.mark.parametrize("broken", [1, 4])
def test_a_training_goes_on_counts_them_and_says_so_unless_they_are_many(tmp_path: Path, broken: int) -> None:
    env = walkers("mujoco", reset_diverged=True)
    trainer = trainer_type("rsl-rl")(env, PpoSettings(steps_per_iteration=4, hidden_sizes=(8,)), tmp_path, 0)
    advance, steps = env.advance, iter(range(100))

    def sabotaged() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        if next(steps) == 5:
            for which in range(broken):
                break_one(env, which)
        return advance()

    env.advance = sabotaged
    counts: list[int] = []
    training = Training(trainer, "Velocity-Flat", {})
    if broken > 3:
        with pytest.raises(SimulationError, match="4 of 4 environments diverged in one iteration, where 3 may"):
            training.run(3, 10, lambda progress: counts.append(progress.diverged))
    else:
        with pytest.warns(RuntimeWarning, match="1 of 4 environments diverged and began new episodes"):
            training.run(3, 10, lambda progress: counts.append(progress.diverged))
        assert counts == [0, 1, 1]
    env.close()
