"""SAC and TD3: what a batch holds, what critics expect, and trainings that rise, resume and leave a policy behind."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.envs import Environment, ObservationGroup, ObservationTerm, OffPolicySettings
from orbit_core.interfaces import ArgumentError, ConfigurationError, UnknownNameError
from orbit_core.mdp import common
from orbit_learn.learners import library_for, trainer_type
from orbit_learn.off_policy import OffPolicyTrainer, TransitionBuffer
from orbit_learn.policy import PolicyActor
from orbit_learn.training import read_checkpoint
from orbit_tasks.reach import Reach
from tests.learning.test_training import Alive, Blind, learn, reach

BACKEND = default_backend()


@dataclass
class Joints(ObservationGroup):
    positions: ObservationTerm | None = ObservationTerm(common.joint_positions)


@dataclass
class JointsAndHand(Joints):
    hand: ObservationTerm | None = ObservationTerm(common.hand_pose)


@dataclass
class SeesMore:
    policy: Joints = field(default_factory=Joints)
    critic: JointsAndHand = field(default_factory=JointsAndHand)


SHORT = OffPolicySettings(
    iterations=6, steps_per_iteration=25, updates_per_step=1, hidden_sizes=(64, 64), critic_sizes=(64, 64),
    discount=0.9, learning_rate=2e-3,
)  # fmt: skip


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """As the command line has it: networks of this size gain nothing from more."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def test_a_transition_ends_with_its_episode_and_weighs_the_future_by_its_length() -> None:
    """Every transition of a ring that wrapped, against sums by hand."""
    count, steps, horizon, discount = 3, 23, 4, 0.9
    device = torch.device("cpu")
    buffer = TransitionBuffer(30, count, (1, 1, 1), horizon, device)  # ten steps of each environment
    ended = torch.rand(steps, count) < 0.3
    terminated = ended & (torch.rand(steps, count) < 0.5)
    reward = torch.rand(steps, count)
    # Each number names its step and environment; a hundredth more is what follows it.
    number = torch.arange(steps)[:, None] * 10.0 + torch.arange(count)
    for step in range(steps):
        seen = number[step, :, None]
        rows = (seen, seen + 0.5, -seen, seen + 0.01, seen + 0.51)
        buffer.add(rows, reward[step], terminated[step], ended[step])
    begun = set()
    for batch in (buffer.sample(200, discount) for _ in range(3)):
        for row in range(200):
            step, environment = divmod(round(batch.observation[row].item()), 10)
            begun.add(step)
            total, weight, last = 0.0, 1.0, step
            for last in range(step, step + horizon):
                total += weight * reward[last, environment].item()
                weight *= discount
                if ended[last, environment]:
                    break
            assert batch.reward[row].item() == pytest.approx(total, abs=1e-5)
            expected = 0.0 if terminated[last, environment] else weight
            assert batch.discount[row].item() == pytest.approx(expected, abs=1e-6)
            assert batch.next_observation[row].item() == pytest.approx(10 * last + environment + 0.01, abs=1e-4)
            assert batch.state[row].item() == batch.observation[row].item() + 0.5 == 0.5 - batch.action[row].item()
    assert begun == set(range(13, 20))  # the newest three steps have no whole horizon after them


@pytest.mark.parametrize("algorithm", ["sac", "td3"])
def test_a_short_training_improves_the_return(algorithm: str, tmp_path: Path) -> None:
    environment = reach(32)
    made = OffPolicyTrainer(environment, replace(SHORT, algorithm=algorithm), tmp_path, 0)
    curve = learn(made, SHORT.iterations)
    assert curve[-1].env_steps == (SHORT.iterations * 25 + SHORT.warm_up - 1) * 32
    assert curve[-1].episode_return > curve[0].episode_return + 0.1
    assert 0.0 < curve[-1].loss < 1.0
    observation = environment.observe()["policy"]
    expected = torch.tanh(made._actor.unclipped(observation))  # pyright: ignore[reportArgumentType]
    torch.testing.assert_close(PolicyActor(environment, tmp_path).act(), expected, atol=1e-5, rtol=1e-5)
    environment.close()


def test_sac_learns_to_reach(tmp_path: Path) -> None:
    """Ask for half of what 32,000 steps bring: the hand comes from half a metre to a tenth."""
    environment = Environment(Reach(episode_length=1.0), 32, BACKEND)
    settings = replace(SHORT, iterations=40, updates_per_step=2, discount=0.95, learning_rate=1e-3)
    curve = learn(OffPolicyTrainer(environment, settings, tmp_path, 0), settings.iterations)
    begin, end = (sum(p.metrics["position_error_m"] for p in part) / 5 for part in (curve[:5], curve[-5:]))
    assert end < 0.5 * begin
    assert curve[-1].episode_return > curve[0].episode_return
    environment.close()


@pytest.mark.parametrize("algorithm", ["sac", "td3"])
def test_stable_baselines_learns_plays_and_resumes(algorithm: str, tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3", reason="library 'sb3' is not installed: pip install 'orbit-learn[sb3]'")
    from orbit_learn.sb3_off_policy import Sb3OffPolicyTrainer

    environment = reach(8)
    settings = replace(SHORT, algorithm=algorithm, steps_per_iteration=30, learning_rate=3e-3)
    assert trainer_type("sb3", algorithm) is Sb3OffPolicyTrainer
    made = Sb3OffPolicyTrainer(environment, settings, tmp_path, 0)
    before = {name: value.clone() for name, value in made._model.policy.actor.state_dict().items()}  # pyright: ignore
    curve = learn(made, 3)
    assert [progress.env_steps for progress in curve] == [240, 480, 720]
    after = made._model.policy.actor.state_dict()  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]
    assert any(not torch.equal(before[name], after[name]) for name in before)
    seen = environment.observe()["policy"]
    expected, _ = made._model.predict(made._environment.normalize_obs(seen.numpy()), deterministic=True)  # pyright: ignore
    played = PolicyActor(environment, tmp_path).act()
    torch.testing.assert_close(played, torch.as_tensor(expected), atol=1e-5, rtol=1e-5)
    again = Sb3OffPolicyTrainer(environment, settings, tmp_path, 1)
    again.restore(read_checkpoint(tmp_path / "checkpoint_2.safetensors", "sb3"), 2)
    torch.testing.assert_close(again.actor().module(seen), played, atol=1e-6, rtol=1e-6)
    environment.close()


@pytest.mark.parametrize("algorithm", ["sac", "td3"])
def test_a_time_out_is_not_the_end(algorithm: str, tmp_path: Path) -> None:
    """A tenth a step at discount 0.9 is worth 1 for ever; 0.41 at most where the limit of 5 steps is the end."""
    environment = Environment(Reach(observations=Blind(), rewards=Alive(), episode_length=0.1), 8, BACKEND)
    settings = replace(SHORT, algorithm=algorithm, hidden_sizes=(32,), critic_sizes=(32,), target_rate=0.1)
    # Entropy must not count, or the worth would be that of acting at random.
    made = OffPolicyTrainer(environment, replace(settings, temperature=1e-6, updates_per_step=4), tmp_path, 0)
    learn(made, SHORT.iterations)
    with torch.no_grad():
        worth = made._judged(made._critic, environment.observe()["policy"], torch.zeros(8, environment.action_size))
    assert worth.mean().item() == pytest.approx(1.0, abs=0.15)
    environment.close()


def test_a_training_resumes_where_it_ended(tmp_path: Path) -> None:
    environment = reach(4)
    settings = replace(SHORT, steps_per_iteration=4)
    learn(made := OffPolicyTrainer(environment, settings, tmp_path, 0), 2)
    again = OffPolicyTrainer(environment, settings, tmp_path, 0)
    again.restore(read_checkpoint(tmp_path / "checkpoint_1.safetensors", "orbit"), 1)
    for before, after in zip(made._critic.parameters(), again._critic.parameters(), strict=True):
        assert torch.equal(before, after)
    assert again._log_temperature.item() == made._log_temperature.item() != pytest.approx(-4.6052, abs=1e-4)
    curve = learn(OffPolicyTrainer(environment, settings, tmp_path, 0), 3, resume=True)
    assert [progress.iteration for progress in curve] == [2]
    environment.close()


def test_a_critic_may_see_more_than_the_policy(tmp_path: Path) -> None:
    environment = Environment(Reach(observations=SeesMore(), episode_length=0.5), 4, BACKEND)
    made = OffPolicyTrainer(environment, replace(SHORT, steps_per_iteration=4), tmp_path, 0)
    learn(made, 1)
    whole = environment.observation["critic"].size + environment.action_size
    assert made._critic.critics[0][0].in_features == whole > environment.observation["policy"].size  # pyright: ignore
    environment.close()


def test_the_command_line_finds_the_library_of_an_algorithm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["train", "Reach", "--backend", BACKEND, "--num-envs", "2", "--set", "episode_length=0.1"]
    words += ["--iterations", "1", "--output", str(tmp_path / "training"), "--algorithm"]
    assert main([*words, "sca"]) == 2
    assert "unknown algorithm 'sca'" in capsys.readouterr().err
    assert main([*words, "sac", "--library", "skrl"]) == 2
    assert "library 'skrl' takes no --algorithm" in capsys.readouterr().err
    assert main([*words, "sac", "--off-policy", "horizont=3"]) == 2
    assert "horizon" in capsys.readouterr().err
    assert main([*words, "sac", "--off-policy", "noise=[0.1,0.2]"]) == 2
    assert "algorithm 'sac' has no noise, a setting of td3" in capsys.readouterr().err
    assert main([*words, "sac", "--off-policy", "steps_per_iteration=4", "--off-policy", "batch_size=8"]) == 0
    record = json.loads((tmp_path / "training" / "training.json").read_text())
    assert (record["library"], record["algorithm"]["batch_size"]) == ("orbit", 8)
    exported = tmp_path / "exported"
    assert main(["export", str(tmp_path / "training"), "--output", str(exported)]) == 0
    played = ["play", str(exported / "policy.onnx"), "--backend", BACKEND, "--set", "episode_length=0.1"]
    assert main([*played, "--episodes", "2"]) == 0
    assert (library_for(None), library_for("ppo"), library_for("act")) == ("rsl-rl", "rsl-rl", "imitation")


def test_settings_out_of_their_range_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="sac"):
        OffPolicySettings(algorithm="sacc")
    wrong_settings: tuple[dict[str, Any], ...] = (
        {"horizon": 0}, {"updates_per_step": 0}, {"batch_size": -1}, {"learning_rate": 0.0}, {"target_rate": 1.5},
        {"discount": 1.1}, {"noise": (0.4, 0.1)}, {"critic_sizes": ()}, {"temperature": float("nan")},
    )  # fmt: skip
    for wrong in wrong_settings:
        with pytest.raises(ArgumentError, match=next(iter(wrong))):
            OffPolicySettings(**wrong)
    with pytest.raises((ValueError, ConfigurationError)):
        OffPolicySettings(hidden_sizes=(0,))
