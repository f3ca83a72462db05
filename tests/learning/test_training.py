"""Training for real, with every library: returns rise, time-outs are no failures, policies outlive their training."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.envs import Environment, ObservationGroup, ObservationTerm, PpoSettings, RewardTerm
from orbit_core.interfaces import ConfigurationError, StorageError, UnknownNameError
from orbit_core.mdp import common
from orbit_learn.learners import library_names, trainer_type
from orbit_learn.policy import PolicyActor, load_policy
from orbit_learn.trackers import TrackioLog
from orbit_learn.trainer import Progress, Trainer
from orbit_learn.training import Training, check_new, read_checkpoint
from orbit_tasks.reach import Reach
from tests.faults import no_file_beyond

BACKEND = default_backend()
STEPS = 25
PPO_LIBRARIES = [name for name in library_names() if name not in ("orbit", "distill", "imitation")]
SHORT = PpoSettings(iterations=12, steps_per_iteration=STEPS, hidden_sizes=(64, 64), discount=0.9)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """As the command line has it: networks of this size gain nothing from more."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@dataclass
class Height:
    """Twice the height of the hand, in metres, a second."""

    height: RewardTerm | None = RewardTerm(lambda env: common.hand_pose(env)[:, 2], 2.0)


@dataclass
class Alive:
    """A tenth a step, whatever happens."""

    alive: RewardTerm | None = RewardTerm(lambda env: torch.ones(env.num_envs, device=env.device), 5.0)


@dataclass
class Nothing(ObservationGroup):
    one: ObservationTerm | None = ObservationTerm(lambda env: torch.ones(env.num_envs, 1))


@dataclass
class Blind:
    """The same number always, so that the worth of a state is the worth of all."""

    policy: Nothing = field(default_factory=Nothing)


def reach(num_envs: int) -> Environment:
    return Environment(Reach(rewards=Height(), episode_length=0.5), num_envs, BACKEND)


def trainer(library: str, environment: Environment, folder: Path, settings: PpoSettings = SHORT) -> Trainer:
    return trainer_type(library)(environment, settings, folder, 0)


def learn(trainer: Trainer, iterations: int = SHORT.iterations, resume: bool = False) -> list[Progress]:
    curve: list[Progress] = []
    Training(trainer, "Reach", {}).run(iterations, 100, curve.append, resume)
    return curve


def seen_by_rsl_rl(observation: Tensor) -> Any:
    from tensordict import TensorDict

    return TensorDict({"policy": observation}, batch_size=[len(observation)])


def seen_by_sb3(made: Any, observation: Tensor) -> Tensor:
    return torch.as_tensor(made._environment.normalize_obs(observation.numpy())).float()


def seen_by_skrl(made: Any, observation: Tensor) -> dict[str, Tensor]:
    return {"observations": made._agent._observation_preprocessor(observation)}


VALUES: dict[str, Callable[[Any, Tensor], Tensor]] = {
    "rsl-rl": lambda made, seen: made._runner.alg.critic(seen_by_rsl_rl(seen)),
    "sb3": lambda made, seen: made._model.policy.predict_values(seen_by_sb3(made, seen)),
    "skrl": lambda made, seen: made._agent.value.act(seen_by_skrl(made, seen))[0],
    "rl-games": lambda made, seen: made._agent.get_values({"obs": seen}),
    "torchrl": lambda made, seen: made.critic.module(seen),
}
"""What each library's own critic expects."""
MEANS: dict[str, Callable[[Any, Tensor], Tensor]] = {
    "rsl-rl": lambda made, seen: made._runner.get_inference_policy()(seen_by_rsl_rl(seen)),
    "sb3": lambda made, seen: made._model.policy.get_distribution(seen_by_sb3(made, seen)).mode(),
    "skrl": lambda made, seen: made._agent.policy.act(seen_by_skrl(made, seen))[1]["mean_actions"],
    "rl-games": lambda made, seen: made._agent.get_action_values({"obs": seen})["mus"],
    "torchrl": lambda made, seen: made.policy.get_dist(seen_by_rsl_rl(seen)).mean,
}
"""What each library's own actor does without exploring."""


@pytest.mark.parametrize("library", PPO_LIBRARIES)
def test_a_short_training_improves_the_return(library: str, tmp_path: Path) -> None:
    """12 iterations with 32 environments lift the hand by 10 cm on average over half a second, at least."""
    environment = reach(32)
    made = trainer(library, environment, tmp_path)
    curve = learn(made)
    assert curve[-1].iteration == SHORT.iterations - 1
    assert curve[-1].env_steps == SHORT.iterations * STEPS * 32
    assert curve[-1].episode_return > curve[0].episode_return + 0.1
    assert list(tmp_path.rglob("events.out.tfevents.*"))
    last = json.loads((tmp_path / "curve.jsonl").read_text().splitlines()[-1])
    assert library == "sb3" or 0.0 < last["metrics"]["position_error_m"] < 2.0

    # Its file acts as the library's own networks do, normalisation included.
    observation = environment.observe()["policy"]
    with torch.no_grad():
        expected = MEANS[library](made, observation).clamp(-1.0, 1.0)
    torch.testing.assert_close(PolicyActor(environment, tmp_path).act(), expected, atol=1e-5, rtol=1e-5)
    environment.close()


def test_exploration_does_not_grow_beyond_the_range_of_actions(tmp_path: Path) -> None:
    environment = reach(2)
    made = trainer("rsl-rl", environment, tmp_path)
    deviation = made._runner.alg.get_policy().distribution.log_std_param  # pyright: ignore
    torch.nn.init.constant_(deviation, 1.0)
    learn(made, 1)
    assert deviation.detach().exp().max() == 1.0
    environment.close()


@pytest.mark.parametrize("library", PPO_LIBRARIES)
def test_a_time_out_is_not_the_end(library: str, tmp_path: Path) -> None:
    """A tenth a step at discount 0.9 is worth 1 for ever; 0.41 at most where the limit of 5 steps is the end."""
    environment = Environment(Reach(observations=Blind(), rewards=Alive(), episode_length=0.1), 8, BACKEND)
    settings = replace(SHORT, iterations=30, steps_per_iteration=20, hidden_sizes=(32,), learning_rate=5e-3)
    made = trainer(library, environment, tmp_path, settings)
    learn(made, 30)
    with torch.no_grad():
        worth = VALUES[library](made, environment.observe()["policy"]).mean().item()
    assert worth == pytest.approx(1.0, abs=0.15)
    environment.close()


@pytest.mark.parametrize("library", PPO_LIBRARIES)
def test_a_training_resumes_where_it_ended(library: str, tmp_path: Path) -> None:
    environment = reach(4)
    learn(trainer(library, environment, tmp_path), 2)
    first = load_policy(tmp_path)
    with pytest.raises(ConfigurationError, match="2 iterations already"):
        learn(trainer(library, environment, tmp_path), 2, resume=True)

    with (tmp_path / "curve.jsonl").open("a") as file:  # as if it had been killed after the checkpoint
        file.write('{"iteration": 2, "env_steps": 7, "seconds": 7.0}\n')
    again = trainer(library, environment, tmp_path)
    again.restore(read_checkpoint(tmp_path / "checkpoint_1.safetensors", library), 1)
    observation = environment.observe()["policy"]
    assert torch.equal(again.actor().module(observation), first.module(observation))

    curve = learn(trainer(library, environment, tmp_path), 3, resume=True)
    assert [progress.iteration for progress in curve] == [2]
    lines = [json.loads(line) for line in (tmp_path / "curve.jsonl").read_text().splitlines()]
    assert [line["iteration"] for line in lines] == [0, 1, 2]
    assert [line["env_steps"] for line in lines] == [lines[0]["env_steps"] * (k + 1) for k in range(3)]
    assert lines[0]["seconds"] < lines[1]["seconds"] < lines[2]["seconds"]
    assert (first.description.iteration, load_policy(tmp_path).description.iteration) == (1, 2)
    with pytest.raises(ConfigurationError, match="holds a training already"):
        learn(trainer(library, environment, tmp_path), 3)
    environment.close()


def interrupt(monkeypatch: pytest.MonkeyPatch, step: int) -> None:
    """As Ctrl-C does: in the midst of that step of any environment, counted from now."""
    stepped, count = Environment.step, itertools.count()

    def interrupted(environment: Environment, action: Tensor) -> Any:
        if next(count) == step:
            raise KeyboardInterrupt
        return stepped(environment, action)

    monkeypatch.setattr(Environment, "step", interrupted)


@pytest.mark.parametrize("library", PPO_LIBRARIES)
def test_an_interrupted_training_resumes(library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint of the iterations that were completed, though none was due."""
    environment = reach(4)
    interrupt(monkeypatch, 2 * STEPS + 5)
    with pytest.raises(KeyboardInterrupt):
        learn(trainer(library, environment, tmp_path), 9)
    assert sorted(path.stem for path in tmp_path.glob("checkpoint_*")) == ["checkpoint_0", "checkpoint_1"]
    curve = learn(trainer(library, environment, tmp_path), 4, resume=True)
    assert [progress.iteration for progress in curve] == [2, 3]
    environment.close()


def test_an_interrupted_command_says_where_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train", "Reach", "--backend", BACKEND, "--num-envs", "2", "--library", "sb3", "--iterations", "9"]
    words += ["--ppo", "steps_per_iteration=4", "--output", str(tmp_path / "training")]
    interrupt(monkeypatch, 6)
    assert main(words) == 130
    assert "checkpoint_0.safetensors is written; --resume" in capsys.readouterr().out
    interrupt(monkeypatch, 2)
    words[-1] = str(tmp_path / "another")
    assert main(words) == 130
    assert "there is no checkpoint" in capsys.readouterr().out


def test_a_folder_with_files_that_a_training_would_write_is_refused(tmp_path: Path) -> None:
    for name in ("curve.jsonl", "policy_3.safetensors", "checkpoint_0.safetensors"):
        folder = tmp_path / f"of_{name}"
        folder.mkdir()
        (folder / name).write_text("another's")
        with pytest.raises(ConfigurationError, match=f"holds {name}, which a training would write"):
            check_new(folder)
    (tmp_path / "notes.txt").touch()
    check_new(tmp_path)


def test_a_training_that_was_killed_while_it_wrote_a_line_resumes(tmp_path: Path) -> None:
    environment = reach(2)
    learn(trainer("sb3", environment, tmp_path), 1)
    with (tmp_path / "curve.jsonl").open("a") as file:
        file.write('{"iteration": 1, "env_st')
    learn(trainer("sb3", environment, tmp_path), 2, resume=True)
    lines = [json.loads(line) for line in (tmp_path / "curve.jsonl").read_text().splitlines()]
    assert [line["iteration"] for line in lines] == [0, 1]
    environment.close()


def test_a_training_that_is_killed_between_its_line_and_its_checkpoint_loses_neither(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A training that is killed while it writes a checkpoint has the line of that iteration already."""
    lines: list[int] = []

    def count(self: Training, iteration: int) -> None:
        lines.append((tmp_path / "curve.jsonl").read_text().count("\n"))
        save(self, iteration)

    save = Training._save
    monkeypatch.setattr(Training, "_save", count)
    environment = reach(2)
    learn(trainer("sb3", environment, tmp_path), 2)
    environment.close()
    assert lines == [1, 2]


def test_a_disk_that_fills_ends_a_training_in_one_error_and_it_resumes(tmp_path: Path) -> None:
    environment = reach(2)
    learn(trainer("sb3", environment, tmp_path), 1)
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.suffix == ".safetensors"}
    with no_file_beyond(20_000), pytest.raises(StorageError, match=r"cannot write .*policy_1\.safetensors"):
        learn(trainer("sb3", environment, tmp_path), 2, resume=True)
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.suffix == ".safetensors"} == before
    assert [progress.iteration for progress in learn(trainer("sb3", environment, tmp_path), 2, resume=True)] == [1]
    environment.close()


def test_a_checkpoint_of_another_training_is_refused(tmp_path: Path) -> None:
    environment = reach(2)
    (tmp_path / "model_3.pt").write_bytes(b"what a library wrote by itself")
    with pytest.raises(ConfigurationError, match="has no checkpoint_<iteration>"):
        learn(trainer("sb3", environment, tmp_path), 2, resume=True)
    learn(trainer("sb3", environment, tmp_path), 1)
    with pytest.raises(ConfigurationError, match="checkpoint of library 'sb3', not of 'skrl'"):
        learn(trainer("skrl", environment, tmp_path), 2, resume=True)
    for line in ('{"iteration": 0}', '{"iteration": 0, "env_steps": "x", "seconds": 1}', "[1]", "nothing"):
        (tmp_path / "curve.jsonl").write_text(f"{line}\n")
        with pytest.raises(ConfigurationError, match="is no curve of a training"):
            learn(trainer("sb3", environment, tmp_path), 2, resume=True)
    (tmp_path / "curve.jsonl").unlink()
    turned = Environment(Reach(rewards=Height(), episode_length=0.5, action="joint_velocity"), 2, BACKEND)
    with pytest.raises(
        ConfigurationError, match="resumed with the task and settings that it began with: the policy was"
    ):
        learn(trainer("sb3", turned, tmp_path), 2, resume=True)
    turned.close()
    other = replace(SHORT, hidden_sizes=(32,))
    with pytest.raises(ConfigurationError, match="does not fit this training"):
        learn(trainer("sb3", environment, tmp_path, other), 2, resume=True)
    environment.close()


def test_the_command_line_trains_plays_and_exports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``orbit train``, ``--resume``, ``play`` and ``export``, one after another."""
    training, exported = tmp_path / "training", tmp_path / "exported"
    chosen = ["--backend", BACKEND, "--num-envs", "4", "--set", "episode_length=0.1"]
    learning = ["train", "Reach", *chosen, "--library", "sb3", "--ppo", "steps_per_iteration=8", "--save-every", "1"]
    assert main([*learning, "--iterations", "2", "--output", str(training)]) == 0
    assert main([*learning, "--iterations", "3", "--resume", str(training)]) == 0
    assert sorted(path.name for path in training.glob("policy_*")) == [f"policy_{i}.safetensors" for i in range(3)]
    record = json.loads((training / "training.json").read_text())
    assert (record["library"], record["ppo"]["steps_per_iteration"], record["settings"]["num_envs"]) == ("sb3", 8, 4)

    result = tmp_path / "played.json"
    assert main(["play", str(training), *chosen, "--episodes", "4", "--json", str(result)]) == 0
    assert json.loads(result.read_text())["episodes"] == 4
    export = ["export", str(training), "--output", str(exported)]
    assert main(export) == 0
    assert main(export) == 2
    assert "policy.json is there already: give another name, or --overwrite" in capsys.readouterr().err
    assert main([*export, "--overwrite"]) == 0
    assert main(["export", str(exported / "policy.safetensors"), "--output", str(exported), "--overwrite"]) == 2
    assert "policy.safetensors is what is read" in capsys.readouterr().err
    assert main(["play", str(exported / "policy.onnx"), *chosen, "--episodes", "4"]) == 0
    assert sorted(path.name for path in exported.iterdir()) == ["policy.json", "policy.onnx", "policy.safetensors"]
    capsys.readouterr()


def test_each_written_policy_is_filmed_and_the_training_is_the_same(tmp_path: Path) -> None:
    pytest.importorskip(
        "imageio_ffmpeg", reason="capability 'video' is not installed: pip install 'orbit-viewer[video]'"
    )
    words = ["train", "Reach", "--backend", BACKEND, "--num-envs", "2", "--algorithm", "sac", "--iterations", "3"]
    words += ["--set", "episode_length=0.1", "--off-policy", "steps_per_iteration=4", "--save-every", "2"]
    assert main([*words, "--output", str(tmp_path / "filmed"), "--videos"]) == 0
    assert main([*words, "--output", str(tmp_path / "plain")]) == 0
    videos = sorted(path.name for path in (tmp_path / "filmed" / "videos").iterdir())
    assert videos == ["policy_0.mp4", "policy_2.mp4"]
    last = [
        read_checkpoint(tmp_path / name / "checkpoint_2.safetensors", "orbit")["actor"] for name in ("filmed", "plain")
    ]
    assert all(torch.equal(last[0][name], last[1][name]) for name in last[0])


def test_weights_and_biases_take_the_curve_offline_or_say_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("wandb", reason="capability 'wandb' is not installed: pip install 'orbit-learn[wandb]'")
    words = ["train", "Reach", "--backend", BACKEND, "--num-envs", "2", "--library", "sb3", "--iterations", "2"]
    words += ["--set", "episode_length=0.1", "--ppo", "steps_per_iteration=8", "--wandb", "orbit"]
    monkeypatch.setenv("WANDB_MODE", "offline")
    assert main([*words, "--output", str(tmp_path / "kept")]) == 0
    (kept,) = tmp_path.glob("kept/wandb/offline-run-*/run-*.wandb")
    assert kept.read_bytes().count(b"episode/return") >= 2  # a record for each iteration
    # A process of its own, because the package keeps its first mode.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("WANDB_")}
    environment |= {"HOME": str(tmp_path), "WANDB_MODE": "online"}
    command = [sys.executable, "-c", "import sys; from orbit_core.cli import main; sys.exit(main())", *words]
    command += ["--output", str(tmp_path / "sent")]
    refused = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)
    assert refused.returncode == 2
    assert "Weights & Biases takes no run (No API key configured" in refused.stderr
    assert not (tmp_path / "sent" / "curve.jsonl").exists()


def test_trackio_takes_the_curve_on_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("trackio", reason="capability 'trackio' is not installed: pip install 'orbit-learn[trackio]'")
    words = ["train", "Reach", "--backend", BACKEND, "--num-envs", "2", "--library", "sb3", "--iterations", "2"]
    words += ["--set", "episode_length=0.1", "--ppo", "steps_per_iteration=8", "--trackio", "orbit"]
    words += ["--output", str(tmp_path / "run")]
    # A process of its own, because the package keeps its first folder.
    command = [sys.executable, "-c", "import sys; from orbit_core.cli import main; sys.exit(main())", *words]
    environment = {**os.environ, "TRACKIO_DIR": str(tmp_path / "kept")}
    subprocess.run(command, env=environment, check=True, timeout=600)
    with contextlib.closing(sqlite3.connect(tmp_path / "kept" / "orbit.db")) as kept:
        rows = kept.execute("SELECT run_name, step, metrics FROM metrics ORDER BY step").fetchall()
    assert [row[:2] for row in rows] == [("run", 0), ("run", 1)]
    assert b"episode/return" in rows[-1][2]


@pytest.mark.parametrize(("project", "reason"), [("a/b", "letters, digits"), ("registry-x", "are reserved")])
def test_trackio_takes_no_run_under_another_projects_name(tmp_path: Path, project: str, reason: str) -> None:
    pytest.importorskip("trackio", reason="capability 'trackio' is not installed: pip install 'orbit-learn[trackio]'")
    with pytest.raises(ConfigurationError, match=rf"--trackio .*{reason}"):
        TrackioLog(project, tmp_path / "run", {})


def test_a_training_needs_no_tensorboard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)  # as if it were not installed
    words = ["train", "Reach", "--backend", BACKEND, "--num-envs", "2", "--library", "orbit", "--algorithm", "ppo"]
    words += ["--iterations", "1", "--set", "episode_length=0.1", "--ppo", "steps_per_iteration=8"]
    assert main([*words, "--output", str(tmp_path / "run")]) == 0
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "training.json", "curve.jsonl", "policy_0.safetensors", "checkpoint_0.safetensors"
    }  # fmt: skip


def test_several_processes_need_a_library_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"RANK": "1", "LOCAL_RANK": "1", "WORLD_SIZE": "2"}.items():
        monkeypatch.setenv(name, value)
    from orbit_learn.cli.train import TrainSettings, train

    with pytest.raises(ConfigurationError, match=r"'sb3' trains in one process: .*--library rsl-rl"):
        train(TrainSettings(task="Reach", backend=BACKEND, library="sb3", device="cuda"))


def test_of_several_processes_one_writes_and_reports(tmp_path: Path) -> None:
    environment = reach(4)
    made = trainer("sb3", environment, tmp_path / "led")
    made.folder.mkdir()
    training = Training(made, "Reach", {}, leader=False)
    training.run(2, 100, lambda progress: pytest.fail("it reported"))
    assert {path.name for path in made.folder.iterdir()} == {"tensorboard_1"}
    environment.close()


def test_a_library_that_is_not_installed_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnknownNameError, match="rsl-rl"):
        trainer_type("rsl_rl")
    for module in [*sys.modules]:  # as in a process that has loaded nothing of it
        if module.startswith(("stable_baselines3.", "orbit_learn.sb3")):
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(ConfigurationError, match=r"pip install .*\[sb3\]"):
        trainer_type("sb3")
