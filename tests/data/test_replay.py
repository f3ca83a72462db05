"""Recorded episodes replayed: exactly where they were recorded, nearly so on another engine."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from orbit_core.backends import backend_names, default_backend
from orbit_core.cli import main
from orbit_core.envs import Environment, make
from orbit_core.envs.actors import scripted_actor
from orbit_core.interfaces import ConfigurationError
from orbit_data.formats import opened, write_dataset
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.recording import RecordingFile, record
from orbit_data.replay import fields_of, replay
from orbit_data.states import TaskMemory

BACKEND = default_backend()
OTHER = next(name for name in backend_names() if name != BACKEND)
FIELDS = {"episode_length": 0.4, "rewards.lift.weight": 30.0}


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    made = make("Lift", 3, BACKEND, seed=1, **FIELDS)
    yield made
    made.close()


@pytest.fixture(scope="module")
def dataset(environment: Environment, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hdf5Dataset]:
    path = tmp_path_factory.mktemp("replay") / "lift.hdf5"
    record(environment, lambda: scripted_actor("expert", environment, 1), RecordingFile(path), "Lift", 5, 1)
    made = Hdf5Dataset(path)
    yield made
    made.close()


@pytest.mark.parametrize("mode", ["actions", "states"])
def test_on_its_own_engine_a_replay_is_the_recording(mode, dataset: Hdf5Dataset, environment: Environment) -> None:
    environment.reset(77)  # somewhere else
    result = replay(environment, dataset, range(5), mode)
    assert result.success == result.recorded_success
    assert result.distances.keys() == {"robot/panda_hand_tcp", "cube"}
    for name, apart in result.distances.items():
        assert apart.shape == (20, 3)
        assert apart.max() < 1e-4, name


def test_on_another_engine_it_leads_a_little_apart(dataset: Hdf5Dataset) -> None:
    elsewhere = make("Lift", 2, OTHER, **fields_of(dataset.known()))
    acted, posed = (replay(elsewhere, dataset, range(3), mode) for mode in ("actions", "states"))
    elsewhere.close()
    hand = acted.distances["robot/panda_hand_tcp"]
    assert (hand[:, 0] <= hand[:, 1]).all()
    assert hand[0].max() < 1e-5
    assert 1e-7 < hand[-1, 1] < 0.02
    assert posed.distances["robot/panda_hand_tcp"].max() < 1e-5
    assert (acted.backend, acted.recorded_on) == (OTHER, (BACKEND,))


def test_the_tasks_fields_are_found_again(dataset: Hdf5Dataset) -> None:
    assert fields_of(dataset.known()) == FIELDS


def test_the_command_replays_on_several_engines_and_draws(dataset: Hdf5Dataset, tmp_path: Path) -> None:
    words = ["data", "play", str(dataset.path), "--episodes", "2", "--backend", BACKEND, "--backend", OTHER]
    assert main([*words, "--json", str(tmp_path / "r.json"), "--plot", str(tmp_path / "r.png")]) == 0
    ours, theirs = json.loads((tmp_path / "r.json").read_text())
    assert (ours["backend"], theirs["backend"]) == (BACKEND, OTHER)
    assert np.shape(theirs["distance_m_quartiles"]["cube"]) == (20, 3)
    assert (tmp_path / "r.png").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_replayed_is_refused(dataset: Hdf5Dataset, environment: Environment, tmp_path: Path) -> None:
    other = make("Lift", 1, BACKEND, action="ik_relative")
    with pytest.raises(ConfigurationError, match=r"action_terms\.joint_position was there and is absent"):
        replay(other, dataset, [0])
    other.close()
    write_dataset(tmp_path / "lerobot", [dataset.read(0)], dataset.known())
    with opened(tmp_path / "lerobot") as lossy, pytest.raises(ConfigurationError, match="has no 'initial/'"):
        replay(environment, lossy, [0])


@pytest.mark.parametrize(
    ("task", "name", "old", "command"),
    [
        ("Velocity-Flat", "VelocityFlat.command", torch.tensor([[0.3, 0.1, -0.2]]), "velocity"),
        ("Cabinet", "Cabinet.goal", torch.tensor([0.2]), "goal"),
    ],
)
def test_goals_of_recordings_from_before_commands_were_terms_are_set(
    task: str, name: str, old: torch.Tensor, command: str
) -> None:
    environment = make(task, 2, BACKEND)
    before = environment.commands[command].clone()
    TaskMemory(environment).write({name: old}, torch.tensor([1]))
    torch.testing.assert_close(environment.commands[command][1], old.flatten())
    torch.testing.assert_close(environment.commands[command][0], before[0])
    environment.close()
