"""Processes that learn one policy together on CPUs: the same weights, and the update of one process with all steps."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError
from orbit_learn import processes
from orbit_learn.curves import curve_of
from orbit_learn.policy import load_policy
from orbit_learn.ppo import PpoTrainer
from tests.learning.one_of_several import SETTINGS
from tests.learning.test_training import reach

TIMEOUT = 600
PROGRAM = [sys.executable, "-c", "import sys; from orbit_core.cli import main; sys.exit(main(sys.argv[1:]))"]


def free_port() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return str(free.getsockname()[1])


def all_ended(started: list[subprocess.Popen[bytes]]) -> None:
    for process in started:
        _, complaint = process.communicate(timeout=TIMEOUT)
        assert process.returncode == 0, complaint.decode()


def run_two(library: str, folder: Path) -> None:
    """Run both processes of ``one_of_several.py``."""
    address = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": free_port(), "WORLD_SIZE": "2"}
    command = [sys.executable, "-m", "tests.learning.one_of_several", library, str(folder)]
    ranked = [{**os.environ, **address, "RANK": str(rank), "LOCAL_RANK": str(rank)} for rank in range(2)]
    root = Path(__file__).parents[2]
    all_ended([subprocess.Popen(command, env=own, stderr=subprocess.PIPE, cwd=root) for own in ranked])


@pytest.mark.parametrize("library", ["rsl-rl", "orbit"])
def test_several_processes_learn_one_policy(library: str, tmp_path: Path) -> None:
    """Each from its own environments; the same in the end, and one of them keeps it."""
    run_two(library, tmp_path)
    first, second = (load_policy(tmp_path / f"rank_{rank}.safetensors").module.state_dict() for rank in range(2))
    layers = [name for name in first if "weight" in name or "bias" in name]
    assert len(layers) == 4
    for name in layers:
        torch.testing.assert_close(first[name], second[name])
    kept = load_policy(tmp_path / "training").module.state_dict()
    assert all(torch.equal(kept[name], first[name]) for name in layers)


def tensors_of(state: Any) -> Iterator[torch.Tensor]:
    """Yield weights and statistics of a trainer's state, and moments of its optimiser."""
    for value in state.values() if isinstance(state, dict) else ():
        yield from [value] if isinstance(value, torch.Tensor) else tensors_of(value)


def test_an_update_of_two_processes_is_that_of_one_with_all_environments(tmp_path: Path) -> None:
    run_two("update", tmp_path)
    parts, ends = (
        [torch.load(tmp_path / f"{name}_{rank}.pt", weights_only=True) for rank in range(2)]
        for name in ("before", "after")
    )
    for one, other in zip(tensors_of(parts[0]["before"]), tensors_of(parts[1]["before"]), strict=True):
        assert torch.equal(one, other)
    assert not torch.equal(parts[0]["rollout"]["seen"], parts[1]["rollout"]["seen"])
    environment = reach(8)
    trainer = PpoTrainer(environment, SETTINGS, tmp_path, 0)
    trainer.load(parts[0]["before"])
    for name in parts[0]["rollout"]:
        getattr(trainer._rollout, name).copy_(torch.cat([part["rollout"][name] for part in parts], 1))
    trainer._loop.take({"policy": torch.cat([part["last"] for part in parts])})
    # A minibatch of one process with all environments holds those that both processes take.
    count = len(parts[0]["order"]) // SETTINGS.minibatches
    steps_and_rows = [(part["order"] // 4, part["order"] % 4 + 4 * rank) for rank, part in enumerate(parts)]
    places = [(8 * step + row).split(count) for step, row in steps_and_rows]
    trainer._order.copy_(torch.cat([torch.cat(pair) for pair in zip(*places, strict=True)]))
    trainer._update()
    for number, value in trainer.numbers().items():
        assert ends[0]["numbers"][number] == pytest.approx(value, rel=1e-3, abs=1e-6)
    for end in ends:
        for name in ("actor", "critic"):
            old, expected = parts[0]["before"][name], trainer.state()[name]
            for key, weight in end["after"][name].items():
                assert (weight - expected[key]).norm() <= 1e-3 * (expected[key] - old[key]).norm() + 1e-6, key
    environment.close()


def test_torchrun_of_two_machines_trains_in_one_folder(tmp_path: Path) -> None:
    """Two launchers, as on two machines, with the words of one."""
    port, folder = free_port(), tmp_path / "out"
    started = []
    for machine in range(2):
        words = [sys.executable, "-m", "torch.distributed.run", "--nnodes", "2", "--node-rank", str(machine)]
        words += ["--nproc-per-node", "1", "--master-addr", "127.0.0.1", "--master-port", port, "--no-python"]
        words += [*PROGRAM, "train", "Reach", "--backend", default_backend(), "--num-envs", "4"]
        words += ["--library", "orbit", "--algorithm", "ppo", "--iterations", "2", "--output", str(folder)]
        words += ["--set", "episode_length=0.2", "--ppo", "steps_per_iteration=8"]
        started.append(subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE))
    all_ended(started)
    assert [line["env_steps"] for line in curve_of(folder)] == [64, 128]
    assert len([*folder.glob("tensorboard/*")]) == 1
    assert load_policy(folder).description.task == "Reach"


def test_processes_that_do_not_meet_say_how_they_are_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    for name in ("RANK", "MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigurationError, match=re.escape("the 2 processes of this training do not meet")):
        processes.meet(torch.device("cpu"))
    assert processes.met() == 1
    processes.part()
