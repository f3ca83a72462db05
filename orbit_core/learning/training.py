"""One training: its folder, its checkpoints, its policies."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from orbit_core.interfaces import ConfigurationError
from orbit_core.learning.policy import SUFFIX, ClippedPolicy, Policy, PolicyDescription
from orbit_core.learning.trainer import Progress, Trainer

RECORD = "training.json"
CURVE = "curve.jsonl"


@dataclass
class Training:
    """Runs a trainer and writes, beside the library's own checkpoints, ``policy_<iteration>.pt`` that anyone can load,
    ``training.json`` with all settings, and ``curve.jsonl`` with a line an iteration.

    Args:
        trainer: does the learning.
        task: name of the task.
        record: what to write into ``training.json``.
        leader: whether this process writes files; of several GPUs, one does.
    """  # fmt: skip

    trainer: Trainer
    task: str
    record: dict[str, Any]
    leader: bool = True

    def run(self, iterations: int, save_every: int, report: Callable[[Progress], None], resume: bool = False) -> Policy:
        """Learn until so many iterations are done in all; returns the last policy."""
        begin = self.trainer.resume(_latest(self.trainer.folder)) if resume else 0
        if begin >= iterations:
            raise ConfigurationError(f"{self.trainer.folder} has {begin} iterations already: ask for more")
        if self.leader:
            self._start(resume)
        self.trainer.learn(iterations - begin, save_every, self._save, lambda progress: self._report(progress, report))
        return self._policy(iterations - 1)

    def _start(self, resume: bool) -> None:
        folder = self.trainer.folder
        folder.mkdir(parents=True, exist_ok=True)
        if not resume and (folder / RECORD).exists():
            raise ConfigurationError(f"folder {folder} holds a training already: resume it, or name another")
        settings = {"task": self.task, "library": self.trainer.name, "ppo": asdict(self.trainer.settings)}
        (folder / RECORD).write_text(json.dumps({**settings, **self.record}, indent=2, default=str))

    def _save(self, iteration: int) -> None:
        if self.leader:
            self._policy(iteration).save(self.trainer.folder / f"policy_{iteration}{SUFFIX}")

    def _policy(self, iteration: int) -> Policy:
        description = PolicyDescription.of(self.trainer.environment, self.task, self.trainer.name, iteration)
        return Policy(ClippedPolicy(self.trainer.actor()), description)

    def _report(self, progress: Progress, report: Callable[[Progress], None]) -> None:
        if not self.leader:  # its library counts nothing
            return
        # Before any episode has ended there is no number, and JSON has no NaN.
        numbers = {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in asdict(progress).items()
        }
        with (self.trainer.folder / CURVE).open("a") as file:
            file.write(json.dumps(numbers) + "\n")
        report(progress)


def _latest(folder: Path) -> Path:
    """The newest of the library's own checkpoints."""
    found = sorted(folder.glob("model_*"), key=lambda file: int(file.stem.removeprefix("model_")))
    if not found:
        raise ConfigurationError(f"folder {folder} holds no checkpoint to resume from")
    return found[-1]
