"""PPO of ORBIT's own: the same update as RSL-RL's, steps that may be recorded, and trainings that rise and resume."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.envs import Environment, PpoSettings
from orbit_learn.learners import trainer_type
from orbit_learn.off_policy import OffPolicyTrainer
from orbit_learn.policy import PolicyActor
from orbit_learn.ppo import PpoTrainer, Rollout, advantages_of
from orbit_learn.rsl_rl import RslRlTrainer
from orbit_learn.training import read_checkpoint
from orbit_tasks.reach import Reach
from tests.learning.test_off_policy import SeesMore
from tests.learning.test_training import learn, reach

BACKEND = default_backend()
SHORT = PpoSettings(iterations=2, steps_per_iteration=8, hidden_sizes=(32, 16), epochs=3, minibatches=4)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """As the command line has it: networks of this size gain nothing from more."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def collect(trainer: PpoTrainer) -> None:
    """Take an iteration's steps, and learn nothing."""
    trainer._update = lambda: None  # pyright: ignore[reportAttributeAccessIssue]
    trainer.iterate(0)


def as_in_rsl_rl(trainer: PpoTrainer, folder: Path) -> Any:
    """Return RSL-RL's algorithm with the trainer's weights, about to process the trainer's rollout."""
    made = RslRlTrainer(trainer.environment, trainer.settings, folder, 0)
    other: Any = made._runner.alg
    for theirs, ours in ((other.actor, trainer._actor), (other.critic, trainer._critic)):
        theirs.mlp.load_state_dict({n.removeprefix("layers."): w for n, w in ours.layers.state_dict().items()})
        # Any statistics will do, the same in both, and RSL-RL adds a hundredth to the deviation.
        mean, std = torch.linspace(-1.0, 1.0, len(ours.mean)), torch.linspace(0.5, 2.0, len(ours.mean))
        ours.mean.copy_(mean), ours.std.copy_(std + 0.01)
        theirs.obs_normalizer._mean.copy_(mean), theirs.obs_normalizer._std.copy_(std)
    return other


def process(other: Any, rollout: Rollout, last: Tensor) -> None:
    """Let RSL-RL process the steps of a rollout, whose actions it did not choose."""
    count = rollout.reward.shape[1]

    def observed(seen: Tensor) -> TensorDict:
        return TensorDict({"policy": seen}, batch_size=[count])

    for step in range(len(rollout.reward)):
        seen = observed(rollout.seen[step])
        other.act(seen)
        other.transition.actions = rollout.action[step]
        other.transition.actions_log_prob = other.actor.get_output_log_prob(rollout.action[step]).detach()
        other.process_env_step(seen, rollout.reward[step], rollout.ended[step], {"time_outs": rollout.late[step]})
    other.compute_returns(observed(last))


@pytest.mark.parametrize(("iteration", "changes"), [(1, {}), (2, {}), (1, {"clip_value": False})])
def test_an_update_is_that_of_rsl_rl(
    iteration: int, changes: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the same weights, rollout and order of samples: losses, rate, weights and statistics after the update."""
    environment = reach(16)
    trainer = PpoTrainer(environment, replace(SHORT, **changes), tmp_path / "ours", 0)
    update = trainer._update
    other = as_in_rsl_rl(trainer, tmp_path / "theirs")
    # Episodes of several ages, so that some end within the rollout; making the other trainer has begun new ones.
    environment.state.episode_step.copy_(torch.arange(16) + 8)
    before = [weight.detach().clone() for weight in trainer._actor.parameters()]
    order = torch.randperm(len(trainer._order), generator=torch.Generator().manual_seed(3))

    def ordered(*_: Any, out: Tensor | None = None, **__: Any) -> Tensor:
        return order.clone() if out is None else out.copy_(order)

    monkeypatch.setattr(torch, "randperm", ordered)
    for _ in range(iteration):
        collect(trainer)
        rollout, last = trainer._rollout, trainer._loop.observation["policy"]
        assert rollout.late.any()
        process(other, rollout, last)  # pyright: ignore[reportArgumentType] - the group is one tensor
        torch.testing.assert_close(other.storage.distribution_params[0], rollout.mean, atol=1e-5, rtol=1e-5)
        losses = other.update()
        update()
        numbers = trainer.numbers()
        for name in ("value", "surrogate", "entropy"):
            assert numbers[name] == pytest.approx(losses[name], rel=1e-4, abs=1e-6)
        assert numbers["rate"] == pytest.approx(other.learning_rate, rel=1e-5)
    for ours, theirs, old in zip(trainer._actor.parameters(), other.actor.mlp.parameters(), before, strict=True):
        assert (ours - theirs).norm() < 1e-3 * (ours - old).norm()
    for ours, theirs in zip(trainer._critic.parameters(), other.critic.mlp.parameters(), strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(trainer._log_std.detach(), other.actor.distribution.log_std_param.detach())
    torch.testing.assert_close(trainer._actor.mean, other.actor.obs_normalizer.mean, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(trainer._actor.std, other.actor.obs_normalizer.std + 0.01, atol=1e-5, rtol=1e-4)
    environment.close()


def test_advantages_are_those_of_the_definition() -> None:
    """Sums of discounted errors up to each episode's end, with time-outs valued by the state before them."""
    steps, count, discount, decay = 12, 5, 0.9, 0.8
    rollout = Rollout(steps, count, (1, 1, 1), torch.device("cpu"))
    generator = torch.Generator().manual_seed(0)
    rollout.reward.copy_(torch.rand(steps, count, generator=generator))
    rollout.ended.copy_(torch.rand(steps, count, generator=generator) < 0.3)
    rollout.late.copy_(rollout.ended & (torch.rand(steps, count, generator=generator) < 0.5))
    value = torch.rand(steps + 1, count, generator=generator)
    found = advantages_of(rollout, value, discount, decay)
    for first in range(steps):
        for environment in range(count):
            total = 0.0
            for step in range(first, steps):
                ended, late = rollout.ended[step, environment], rollout.late[step, environment]
                now, after = value[step, environment], value[step + 1, environment]
                error = rollout.reward[step, environment] - now + discount * (now * late if ended else after)
                total += (discount * decay) ** (step - first) * error.item()
                if ended:
                    break
            assert found[first, environment].item() == pytest.approx(total, abs=1e-5)


def test_a_short_training_improves_the_return_and_leaves_a_policy(tmp_path: Path) -> None:
    environment = reach(32)
    settings = replace(SHORT, iterations=10, steps_per_iteration=25, hidden_sizes=(64, 64), discount=0.9, epochs=5)
    trainer = PpoTrainer(environment, settings, tmp_path, 0)
    curve = learn(trainer, settings.iterations)
    assert curve[-1].env_steps == settings.iterations * 25 * 32
    assert curve[-1].episode_return > curve[0].episode_return + 0.05
    observation = environment.observe()["policy"]
    expected = trainer._actor.unclipped(observation).clamp(-1.0, 1.0)  # pyright: ignore[reportArgumentType]
    torch.testing.assert_close(PolicyActor(environment, tmp_path).act(), expected, atol=1e-5, rtol=1e-5)
    environment.close()


def test_a_training_resumes_where_it_ended(tmp_path: Path) -> None:
    """Weights, rate and the optimiser's moments: the next update is the one that the first trainer would have made."""
    environment = reach(4)
    learn(made := PpoTrainer(environment, SHORT, tmp_path, 0), 2)
    again = PpoTrainer(environment, replace(SHORT, learning_rate=0.1), tmp_path, 0)
    again.restore(read_checkpoint(tmp_path / "checkpoint_1.safetensors", "orbit"), 1)
    assert again._rate.item() == made._rate.item()
    for name in ("seen", "state", "action", "mean", "reward", "ended", "late"):
        getattr(again._rollout, name).copy_(getattr(made._rollout, name))
    again._order.copy_(made._order), again._loop.take(made._loop.observation)
    for each in (made, again):
        each._update()
    for ours, theirs in zip(made._actor.parameters(), again._actor.parameters(), strict=True):
        assert torch.equal(ours, theirs)
    assert torch.equal(made._moments["policy"].std, again._moments["policy"].std)
    curve = learn(PpoTrainer(environment, SHORT, tmp_path, 0), 3, resume=True)
    assert [progress.iteration for progress in curve] == [2]
    environment.close()


def test_a_critic_may_see_more_than_the_policy(tmp_path: Path) -> None:
    environment = Environment(Reach(observations=SeesMore(), episode_length=0.5), 4, BACKEND)
    made = PpoTrainer(environment, SHORT, tmp_path, 0)
    learn(made, 1)
    sizes = {name: environment.observation[name].size for name in ("policy", "critic")}
    assert len(made._critic.mean) == sizes["critic"] > sizes["policy"] == len(made._actor.mean)
    assert not torch.equal(made._critic.mean, torch.zeros(sizes["critic"]))
    environment.close()


def test_numbers_may_be_narrower_than_float32(tmp_path: Path) -> None:
    """An update in bfloat16 moves the weights about as one in float32."""
    environment = reach(8)
    moved: list[Tensor] = []
    for precision in ("float32", "bfloat16"):
        made = PpoTrainer(environment, replace(SHORT, precision=precision), tmp_path / precision, 0)
        before = torch.nn.utils.parameters_to_vector(made._actor.parameters()).detach()
        made.iterate(0)
        moved.append(torch.nn.utils.parameters_to_vector(made._actor.parameters()).detach() - before)
    assert not torch.equal(*moved)
    assert torch.nn.functional.cosine_similarity(*moved, dim=0) > 0.8
    environment.close()


def test_the_command_line_takes_the_tasks_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["train", "Reach", "--backend", BACKEND, "--num-envs", "2", "--set", "episode_length=0.1"]
    words += ["--iterations", "1", "--output", str(tmp_path / "training"), "--algorithm", "ppo", "--library"]
    assert main([*words, "sb3", "--ppo", "precision=tf32"]) == 2
    assert "library 'sb3' has no precision=tf32: use --library orbit" in capsys.readouterr().err
    assert main([*words, "orbit", "--off-policy", "horizon=3"]) == 2
    assert "takes no --off-policy" in capsys.readouterr().err
    assert main([*words, "orbit", "--ppo", "imitation_steps=3"]) == 2
    assert "use --library rsl-rl" in capsys.readouterr().err
    assert main([*words, "orbit", "--ppo", "steps_per_iteration=1"]) == 2
    assert "fewer than minibatches=4" in capsys.readouterr().err
    assert main([*words, "orbit", "--ppo", "steps_per_iteration=4"]) == 0
    record = json.loads((tmp_path / "training" / "training.json").read_text())
    assert (record["library"], record["ppo"]["initial_std"]) == ("orbit", 0.3)  # which is Reach's, and not the default
    exported = tmp_path / "exported"
    assert main(["export", str(tmp_path / "training"), "--output", str(exported)]) == 0
    played = ["play", str(exported / "policy.onnx"), "--backend", BACKEND, "--set", "episode_length=0.1"]
    assert main([*played, "--episodes", "2"]) == 0
    assert trainer_type("orbit", "ppo") is PpoTrainer
    assert trainer_type("orbit", "sac") is trainer_type("orbit") is OffPolicyTrainer
