"""One of the processes that learn a policy together, as torchrun starts them; on CPUs, which the library refuses.

python one_of_several.py FOLDER: trains, and writes the policy it ended with to FOLDER/rank_<rank>.safetensors.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from unittest import mock

import torch
from rsl_rl.runners import OnPolicyRunner

from orbit_core.backends import default_backend
from orbit_core.envs import PpoSettings, make
from orbit_learn.rsl_rl import RslRlTrainer
from orbit_learn.training import Training


def on_cpu(runner: OnPolicyRunner) -> None:
    """What the library sets up, with the CPUs' way to talk to each other."""
    rank, world = int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"])
    runner.is_distributed, runner.gpu_world_size = True, world
    runner.gpu_global_rank = runner.gpu_local_rank = rank
    runner.cfg["multi_gpu"] = {"global_rank": rank, "local_rank": rank, "world_size": world}
    torch.distributed.init_process_group("gloo", rank=rank, world_size=world)


def main() -> None:
    folder, rank = Path(sys.argv[1]), int(os.environ["RANK"])
    torch.set_num_threads(1)
    environment = make("Reach", 4, default_backend(), seed=1000 * rank, episode_length=0.2)
    settings = PpoSettings(iterations=3, steps_per_iteration=12, hidden_sizes=(16,))
    with mock.patch.object(OnPolicyRunner, "_configure_multi_gpu", on_cpu):
        trainer = RslRlTrainer(environment, settings, folder / "training", 1000 * rank)
    training = Training(trainer, "Reach", {}, leader=rank == 0)
    reports: list[int] = []
    training.run(3, 1, lambda progress: reports.append(progress.env_steps)).save(folder / f"rank_{rank}.safetensors")
    # Steps of both; whoever does not lead is silent.
    assert reports == ([96, 192, 288] if rank == 0 else []), reports
    torch.distributed.destroy_process_group()


main()
