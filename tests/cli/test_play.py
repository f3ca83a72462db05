"""``orbit play`` takes a training's whole configuration, less what belongs to training, and says what differs."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.cli.making import make_environment
from orbit_core.interfaces import ConfigurationError
from orbit_learn.cli.play import main, restored_settings
from orbit_learn.cli.train import TrainSettings, _table, for_training
from orbit_learn.cli.trained import PlaySettings
from orbit_learn.description import PolicyDescription
from orbit_learn.networks import Perceptron
from orbit_learn.policy import Policy
from orbit_learn.trainer import Progress

BACKEND = default_backend()
Trained = Callable[..., Path]


@pytest.fixture
def trained(tmp_path: Path) -> Trained:
    """Makes the folder of a training that learned nothing, with the settings given."""

    def folder(**settings: object) -> Path:
        made = for_training(TrainSettings(**{"task": "Reach", "backend": BACKEND, **settings}))  # pyright: ignore[reportArgumentType]
        environment = make_environment(made, 1)
        description = PolicyDescription.of(environment, made.task or "", "none", 0)
        environment.close()
        network = Perceptron((8,), "elu")
        module = network.build(description.observation_size, description.action_size)
        Policy(module.requires_grad_(False).eval(), network, description).save(tmp_path / "policy_0.safetensors")
        record = {"settings": asdict(made), "versions": {}}
        (tmp_path / "training.json").write_text(json.dumps(record, default=str))
        return tmp_path

    return folder


def test_fields_and_settings_of_the_training_hold(trained: Trained) -> None:
    words = ("episode_length=2", "rewards.action_rate.weight=-0.5", "observations.policy.history=2")
    folder = trained(set=words, setting=("iterations=17",), fields={"settle_time": 0.1})
    restored = restored_settings(PlaySettings(policy=folder))
    assert restored.differences == ()
    assert restored.settings.backend == BACKEND
    environment = make_environment(restored.settings, 1)
    task = environment.task
    assert (task.episode_length, task.settle_time, task.rewards.action_rate.weight) == (2.0, 0.1, -0.5)
    assert task.observations.policy.history == 2
    assert environment.world.settings.iterations == 17  # pyright: ignore[reportAttributeAccessIssue]
    environment.close()


def test_what_the_user_says_wins_and_is_told(trained: Trained) -> None:
    folder = trained(set=("episode_length=2", "settle_time=0.1"), setting=("iterations=17",))
    played = restored_settings(
        PlaySettings(policy=folder, backend="another", set=("episode_length=3", "domain_randomization=false"))
    )
    assert played.differences == (
        "episode_length = 3 in place of 2",
        "domain_randomization = false in place of the task's own",
        f"backend another in place of {BACKEND}, without its settings (iterations)",
    )
    assert played.settings.settings == {}
    other = restored_settings(PlaySettings(policy=folder, task="Lift"))
    assert other.differences == ("task Lift in place of Reach, whose fields are not restored",)
    assert other.settings.fields == {}


def test_what_belongs_to_training_is_left_out_and_told(trained: Trained) -> None:
    """Expert's starts and shorter episodes are of Peg-In-Hole's training; a curriculum would begin with the easiest."""
    folder = trained(task="Peg-In-Hole", set=("curriculum_enabled=false", "clearance=0.003"))
    restored = restored_settings(PlaySettings(policy=folder))
    assert set(restored.settings.fields) == {"clearance"}
    assert restored.settings.action == "ik_relative"
    told = [line.partition(" = ")[0] for line in restored.differences]
    assert told == ["action", "curriculum_enabled", "episode_length", "expert_starts"]
    assert all(line.endswith("left out, because it belongs to training") for line in restored.differences)
    asked = restored_settings(PlaySettings(policy=trained(task="Peg-In-Hole", set=("episode_length=10",))))
    assert "episode_length" in asked.settings.fields, "what a user set by hand is the task that was learned"


def test_the_hint_plays_what_was_trained(trained: Trained, capsys: pytest.CaptureFixture[str]) -> None:
    folder = trained(set=("episode_length=0.4",))
    last = Progress(0, 64, 1.0, torch.nan, torch.nan)
    table = _table(TrainSettings(task="Reach", set=("curriculum_enabled=true",)), last, folder)
    (hint,) = [
        cell for name, cell in zip(*(column._cells for column in table.columns), strict=True) if name == "play it"
    ]
    assert hint == f"orbit play {folder}"
    main([str(folder), "--num-envs", "1", "--episodes", "1", "--set", "settle_time=0.05"])
    shown = capsys.readouterr().out
    assert "other than in training: settle_time = 0.05 in place of the task's own" in shown
    assert "20" in shown, "an episode of 0.4 s has 20 steps"


def test_a_record_that_is_none_is_named(trained: Trained) -> None:
    folder = trained()
    (folder / "training.json").write_text("[]")
    with pytest.raises(ConfigurationError, match=r"training\.json describes no training"):
        restored_settings(replace(PlaySettings(policy=folder), num_envs=1))
