"""One training: its folder, its checkpoints, its policies."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
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

    def __post_init__(self) -> None:
        self._steps_before, self._seconds_before = 0, 0.0

    def run(self, iterations: int, save_every: int, report: Callable[[Progress], None], resume: bool = False) -> Policy:
        """Learn until so many iterations are done in all; returns the last policy."""
        begin = self.trainer.resume(_latest(self.trainer.folder)) if resume else 0
        if begin >= iterations:
            raise ConfigurationError(f"{self.trainer.folder} has {begin} iterations already: ask for more")
        if self.leader:
            self._start(begin)
        self.trainer.learn(iterations - begin, save_every, self._save, lambda progress: self._report(progress, report))
        return self._policy(iterations - 1)

    def _start(self, begin: int) -> None:
        folder = self.trainer.folder
        folder.mkdir(parents=True, exist_ok=True)
        if not begin and (folder / RECORD).exists():
            raise ConfigurationError(f"folder {folder} holds a training already: resume it, or name another")
        settings = {"task": self.task, "library": self.trainer.name, "ppo": asdict(self.trainer.settings)}
        (folder / RECORD).write_text(json.dumps({**settings, **self.record}, indent=2, default=str))
        if begin:
            self._continue_curve(begin)

    def _continue_curve(self, begin: int) -> None:
        """Drop what was done after the checkpoint, for it is done again, and count on from there."""
        curve = self.trainer.folder / CURVE
        lines = curve.read_text().splitlines() if curve.exists() else []
        kept = [line for line in lines if json.loads(line)["iteration"] < begin]
        shortened = curve.with_suffix(".writing")
        shortened.write_text("".join(f"{line}\n" for line in kept))
        os.replace(shortened, curve)
        if kept:
            last = json.loads(kept[-1])
            self._steps_before, self._seconds_before = last["env_steps"], last["seconds"]

    def _save(self, iteration: int) -> None:
        if self.leader:
            self._policy(iteration).save(self.trainer.folder / f"policy_{iteration}{SUFFIX}")

    def _policy(self, iteration: int) -> Policy:
        description = PolicyDescription.of(self.trainer.environment, self.task, self.trainer.name, iteration)
        return Policy(ClippedPolicy(self.trainer.actor()), description)

    def _report(self, progress: Progress, report: Callable[[Progress], None]) -> None:
        if not self.leader:  # its library counts nothing
            return
        progress = replace(
            progress,
            env_steps=progress.env_steps + self._steps_before,
            seconds=progress.seconds + self._seconds_before,
        )
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
