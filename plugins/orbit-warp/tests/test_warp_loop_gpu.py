"""On a GPU a training's iteration is recorded: policy, step and storing as one graph each step, the update as one."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from orbit_core.envs import PpoSettings, make
from orbit_core.envs.environment import Environment

pytest.importorskip("orbit_learn", reason="capability 'learning' is not installed: pip install orbit-learn")
from orbit_learn.ppo import PpoTrainer

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs the capability of a GPU")
TASKS = ["Lift", "Velocity-Flat"]
SETTINGS = PpoSettings(steps_per_iteration=8, hidden_sizes=(64, 32), epochs=2)
KEPT = ("seen", "action", "mean", "reward", "ended", "late")


def environment_of(task: str) -> Environment:
    settings = {"deterministic": True}
    return make(task, 64, "warp", device="cuda", seed=3, episode_length=0.4, settings=settings)


def trainer_of(task: str, folder: Path, settings: PpoSettings = SETTINGS) -> PpoTrainer:
    return PpoTrainer(environment_of(task), settings, folder, 0)


@pytest.mark.parametrize("task", TASKS)
def test_recorded_steps_by_a_policy_are_the_same_steps(task: str, tmp_path: Path) -> None:
    """Compare what four rollouts without an update keep with the same steps called one by one."""
    plain, other = trainer_of(task, tmp_path / "plain"), trainer_of(task, tmp_path / "other")
    plain.environment._closed = None
    other._actor.load_state_dict(plain._actor.state_dict())
    for trainer in (plain, other):
        trainer._update = lambda: None  # pyright: ignore[reportAttributeAccessIssue]
        trainer.environment.state.episode_step[:] = torch.arange(64, device="cuda") % 7
    ends = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # that the step could not be recorded is one
        for _ in range(4):
            for trainer in (plain, other):
                torch.manual_seed(1)
                trainer.iterate(0)
            for name in KEPT:
                mine, its = getattr(plain._rollout, name), getattr(other._rollout, name)
                torch.testing.assert_close(its, mine, rtol=1e-3, atol=1e-3, msg=name)
            ends += int(plain._rollout.ended.sum())
            assert other.tally.read() == pytest.approx(plain.tally.read(), rel=1e-3, abs=1e-3, nan_ok=True)
    assert ends >= 64
    assert other._loop._composed is not None
    plain.environment.close(), other.environment.close()


@pytest.mark.parametrize("task", TASKS)
def test_nothing_in_an_iteration_waits(task: str, tmp_path: Path) -> None:
    trainer = trainer_of(task, tmp_path)
    for iteration in range(6):  # which trace and record
        trainer.iterate(iteration)
    assert trainer._update._graph is not None
    torch.cuda.set_sync_debug_mode("error")
    try:
        for iteration in range(4):
            trainer.iterate(iteration)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    numbers = trainer.numbers()
    assert all(value == value for value in numbers.values())
    assert trainer.tally.read()[2] > 0
    trainer.environment.close()


@pytest.mark.parametrize("precision", ["float32", "tf32", "bfloat16"])
def test_a_recorded_update_is_the_same_update(precision: str, tmp_path: Path) -> None:
    """Compare the graph's sixth update with one in Python, from one rollout and the same weights and moments."""
    trainer = trainer_of("Lift", tmp_path, replace(SETTINGS, precision=precision))
    for iteration in range(5):
        trainer.iterate(iteration)
    assert trainer._update._graph is not None
    other = trainer_of("Lift", tmp_path / "other", replace(SETTINGS, precision=precision))
    other.load(trainer.state())
    for name in KEPT:
        getattr(other._rollout, name).copy_(getattr(trainer._rollout, name))
    other._rollout.state.copy_(trainer._rollout.state)
    other._loop.take(trainer._loop.observation), other._order.copy_(trainer._order)
    before = torch.nn.utils.parameters_to_vector(trainer._actor.parameters()).detach().clone()
    trainer._update(), other._learn()
    mine, its = (torch.nn.utils.parameters_to_vector(t._actor.parameters()).detach() for t in (other, trainer))
    assert (mine - before).norm() > 0.0
    assert (mine - its).norm() < 0.02 * (mine - before).norm()
    assert trainer.numbers()["rate"] == pytest.approx(other.numbers()["rate"], rel=1e-5)
    trainer.environment.close(), other.environment.close()
