"""One of the processes that learn a policy together, as torchrun starts them.

python one_of_several.py LIBRARY FOLDER: trains by RSL-RL ("rsl-rl") or ORBIT's own PPO ("orbit"), and writes the policy
that it ends with to FOLDER/rank_<rank>.safetensors. With "update" it takes one iteration's steps, makes one update of
ORBIT's own PPO, and writes what went in and what came out to FOLDER/update_<rank>.pt.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, PpoSettings, make
from orbit_learn.ppo import PpoTrainer
from orbit_learn.processes import part, rank
from orbit_learn.rsl_rl import RslRlTrainer
from orbit_learn.training import Training

SETTINGS = PpoSettings(iterations=3, steps_per_iteration=12, hidden_sizes=(16,))


def train(kind: type[RslRlTrainer | PpoTrainer], environment: Environment, folder: Path) -> None:
    training = Training(kind(environment, SETTINGS, folder / "training", 1000 * rank()), "Reach", {}, rank() == 0)
    reports: list[int] = []
    training.run(3, 1, lambda progress: reports.append(progress.env_steps)).save(folder / f"rank_{rank()}.safetensors")
    # Steps of both; a process that does not lead is silent.
    assert reports == ([96, 192, 288] if rank() == 0 else []), reports


def update(environment: Environment, folder: Path) -> None:
    trainer = PpoTrainer(environment, SETTINGS, folder, 1000 * rank())
    learn, trainer._update = trainer._update, lambda: None  # pyright: ignore[reportAttributeAccessIssue]
    trainer.iterate(0)
    names = ("seen", "state", "action", "mean", "reward", "ended", "late")
    record = {
        "before": trainer.state(),
        "rollout": {name: getattr(trainer._rollout, name) for name in names},
        "order": trainer._order,
        "last": trainer._loop.observation["policy"],
    }  # fmt: skip
    torch.save(record, folder / f"before_{rank()}.pt")
    learn()
    torch.save({"after": trainer.state(), "numbers": trainer.numbers()}, folder / f"after_{rank()}.pt")


def main() -> None:
    library, folder = sys.argv[1], Path(sys.argv[2])
    torch.set_num_threads(1)
    environment = make("Reach", 4, default_backend(), seed=1000 * rank(), episode_length=0.2)
    if library == "update":
        update(environment, folder)
    else:
        train({"rsl-rl": RslRlTrainer, "orbit": PpoTrainer}[library], environment, folder)
    part()


if __name__ == "__main__":
    main()
