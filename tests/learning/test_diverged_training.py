"""A policy that diverges ends its training with one sentence, and the last sound checkpoint stays the newest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import nn

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, PpoSettings
from orbit_core.interfaces import NonFiniteError
from orbit_learn.learners import trainer_type
from orbit_learn.networks import ActorNetwork
from orbit_learn.trainer import Progress, Trainer
from orbit_learn.training import Training, read_checkpoint
from orbit_tasks.reach import Reach

BACKEND = default_backend()


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    made = Environment(Reach(episode_length=0.5), 8, BACKEND)
    yield made
    made.close()


class Scripted(Trainer[PpoSettings]):
    """Learns nothing; its weight becomes what the test says, by iteration."""

    name = "scripted"

    def __init__(self, environment: Environment, folder: Path, weights: tuple[float, ...]) -> None:
        super().__init__(environment, PpoSettings(), folder, 0)
        self._weights = weights
        self._layer = nn.Linear(1, 1)

    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        for iteration, weight in enumerate(self._weights):
            self._layer.weight.data.fill_(weight)
            if weight < 0.0:
                raise RuntimeError("normal expects all elements of std >= 0.0")
            report(Progress(iteration, iteration, 1.0, 0.0, 0.0))

    def state(self) -> Any:
        return dict(self._layer.state_dict())

    def restore(self, state: Any, iteration: int) -> None:
        raise NotImplementedError

    def actor(self) -> ActorNetwork:
        return SimpleNamespace(module=self._layer, network=None)  # pyright: ignore[reportReturnType]


@pytest.mark.parametrize("weights", [(1.0, 2.0, torch.nan), (1.0, 2.0, 1e30), (1.0, 2.0, -torch.inf)])
def test_the_iteration_is_named_and_the_last_checkpoint_stays(
    weights: tuple[float, ...], environment: Environment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether the library notices, by an error of its own, or not."""
    monkeypatch.setattr(Training, "_policy", lambda *_: SimpleNamespace(save=lambda path: None))
    training = Training(Scripted(environment, tmp_path, weights), "Reach", {})
    with pytest.raises(NonFiniteError, match=r"diverged in iteration 2.*checkpoint_1\.safetensors.*learning_rate"):
        training.run(3, 1, lambda _: None)
    assert sorted(path.name for path in tmp_path.glob("checkpoint_*")) == [
        "checkpoint_0.safetensors",
        "checkpoint_1.safetensors",
    ]
    assert float(read_checkpoint(tmp_path / "checkpoint_1.safetensors", "scripted")["weight"]) == 2.0


def test_an_error_of_the_library_with_sound_weights_stays_its_own(environment: Environment, tmp_path: Path) -> None:
    training = Training(Scripted(environment, tmp_path, (-1.0,)), "Reach", {})
    with pytest.raises(RuntimeError, match="normal expects"):
        training.run(3, 1, lambda _: None)


def test_a_huge_learning_rate_is_no_raw_error(environment: Environment, tmp_path: Path) -> None:
    """This library complains while its weights are finite still, and too large to compute with."""
    settings = PpoSettings(iterations=3, steps_per_iteration=8, hidden_sizes=(8, 8), learning_rate=1e30)
    training = Training(trainer_type("sb3")(environment, settings, tmp_path, 0), "Reach", {})
    with pytest.raises(NonFiniteError, match=r"diverged in iteration \d"):
        training.run(3, 1, lambda _: None)
    assert not list(tmp_path.glob("checkpoint_[12].safetensors"))
