"""One training: its folder, its policies, and its checkpoints.

A checkpoint is one file of data: no pickle, whichever format the learning library uses. A state is a tree of
dictionaries, lists, numbers, texts, truth values, None and tensors, as libraries have it in ``state_dict``. Tuples
become lists, and NumPy's arrays and numbers become tensors and numbers. In the file, see :mod:`orbit_data.tensor_file`,
a dictionary is ``{"items": [[key, value], ...]}``, for its keys may be numbers, and a tensor ``{"tensor": name}``.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.envs.ppo import PpoSettings
from orbit_core.files import append_line, read_bytes, storage_faults, sweep, written_whole
from orbit_core.interfaces import ConfigurationError, NonFiniteError, SimulationError
from orbit_data.manifest.manifest import Manifest
from orbit_data.tensor_file import parse_json, read_tensors, write_tensors
from orbit_learn.policy import Policy, PolicyDescription
from orbit_learn.policy_file import SUFFIX, newest_file
from orbit_learn.trainer import Progress, Trainer

FORMAT = 1


def write_checkpoint(path: Path | str, library: str, state: Any) -> None:
    """Write a library's state. The file appears whole or not at all.

    Raises:
        ConfigurationError: the state holds something that is no data; names it.
    """
    tensors: dict[str, Tensor] = {}
    document = {"checkpoint": FORMAT, "library": library, "state": _packed(state, tensors)}
    write_tensors(path, document, tensors)


def tensors_in(state: Any) -> list[Tensor]:
    """Return all tensors of a library's state.

    Raises:
        ConfigurationError: the state holds something that is no data; names it.
    """
    tensors: dict[str, Tensor] = {}
    _packed(state, tensors)
    return list(tensors.values())


def read_checkpoint(path: Path | str, library: str) -> Any:
    """Return the state that :func:`write_checkpoint` wrote, its tensors on the CPU.

    Raises:
        ConfigurationError: the file is malformed, no checkpoint, or of another library.
    """
    document, tensors = read_tensors(path)
    if document.get("checkpoint") != FORMAT:
        raise ConfigurationError(f"{path} is no checkpoint of format {FORMAT}, the one that is read")
    if document.get("library") != library:
        raise ConfigurationError(f"{path} is a checkpoint of library {document.get('library')!r}, not of '{library}'")
    try:
        return _unpacked(document.get("state"), tensors)
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"{path} holds no state: {type(error).__name__} {error}") from None


def _packed(value: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        value = torch.from_numpy(value)
    if isinstance(value, Tensor):
        name = str(len(tensors))
        tensors[name] = value
        return {"tensor": name}
    if isinstance(value, dict):
        return {"items": [[_packed(key, tensors), _packed(item, tensors)] for key, item in value.items()]}
    if isinstance(value, list | tuple):
        return [_packed(item, tensors) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ConfigurationError(f"a checkpoint holds data, and no {type(value).__name__}")


def _unpacked(value: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(value, list):
        return [_unpacked(item, tensors) for item in value]
    if isinstance(value, dict):
        if "tensor" in value:
            return tensors[value["tensor"]]
        return {key: _unpacked(item, tensors) for key, item in value["items"]}
    return value


RECORD = "training.json"
CURVE = "curve.jsonl"
CHECKPOINT = "checkpoint"
# Most bytes of a curve, some 300 of each iteration.
_MOST_CURVE = 1 << 26
# Environments that may diverge in any iteration; of many, one in a hundred may.
_FEW_DIVERGED = 3
# Beyond which the products of three layers overflow in single precision.
_LARGEST_WEIGHT = 1e12


@dataclass
class Training:
    """Runs a trainer and writes ``policy_<iteration>.safetensors`` that anyone can load,
    ``checkpoint_<iteration>.safetensors`` to go on from, ``training.json`` with all settings, and ``curve.jsonl`` with
    a line an iteration.

    Args:
        trainer: does the learning.
        task: name of the task.
        record: what to write into ``training.json``; its ``versions``, if any, go into the policies too.
        leader: whether this process writes files; of several GPUs, one does.
    """  # fmt: skip

    trainer: Trainer[Any]
    task: str
    record: dict[str, Any]
    leader: bool = True

    def __post_init__(self) -> None:
        self._steps_before, self._seconds_before, self._diverged_before = 0, 0.0, 0
        self._diverged_last = 0
        self._done = -1
        """The last iteration that was completed."""
        self.manifest = Manifest.of(self.trainer.environment, self.task, self.trainer.seed)
        """Of the environment that is learned in."""
        self.saved: Path | None = None
        """The newest checkpoint that was written."""

    def run(self, iterations: int, save_every: int, report: Callable[[Progress], None], resume: bool = False) -> Policy:
        """Learn until so many iterations are done in all; returns the last policy.

        A checkpoint is written every ``save_every`` iterations, at the end, and when KeyboardInterrupt ends the
        training. What an interrupted iteration has learned stays in that checkpoint's weights; it is done again.

        Raises:
            NonFiniteError: the policy diverged; names the iteration and the last checkpoint, which stays.
        """
        begin = self._resume() if resume else 0
        if begin >= iterations:
            raise ConfigurationError(f"{self.trainer.folder} has {begin} iterations already: ask for more")
        if self.leader:
            self._start(begin)

        def done(progress: Progress) -> None:
            self._check_weights(progress.iteration)
            self._done = progress.iteration
            if self._done % save_every == 0 or self._done == iterations - 1:
                self._save(self._done)
            self._report(progress, report)

        try:
            self.trainer.learn(iterations - begin, done)
        except KeyboardInterrupt:
            if self._done >= 0 and self.saved != self._checkpoint(self._done):
                self._check_weights(self._done + 1)
                self._save(self._done)
            raise
        except Exception:
            # Libraries and the environment each complain in their own way of a policy of NaN.
            self._check_weights(self._done + 1, self.trainer.state())
            raise
        return self._policy(iterations - 1)

    def _check_weights(self, iteration: int, state: Any = None) -> None:
        """Refuse to go on with a policy that diverged, or with a state of the library's that is not finite."""
        weights = self.trainer.actor().module.state_dict().values()
        # A comparison with NaN is false.
        bounded = all(bool((weight.abs() <= _LARGEST_WEIGHT).all()) for weight in weights)
        if bounded and all(bool(torch.isfinite(tensor).all()) for tensor in tensors_in(state)):
            return
        kept = f"{self.saved} holds the last that was sound" if self.saved else "no checkpoint had been written"
        raise NonFiniteError(
            f"the policy diverged in iteration {iteration}, its weights are not finite or beyond "
            f"{_LARGEST_WEIGHT:g}; {kept}: use a smaller learning_rate, or a narrower range of rewards"
        )

    def _resume(self) -> int:
        """Take over the newest checkpoint; returns the iteration to go on with."""
        folder = self.trainer.folder
        newest = newest_file(folder, CHECKPOINT) if folder.is_dir() else None
        if newest is None:
            raise ConfigurationError(
                f"folder {folder} holds no {CHECKPOINT}_<iteration>{SUFFIX} to resume from; what libraries write by "
                "themselves is not read, for it may run code"
            )
        state, iteration = read_checkpoint(newest, self.trainer.name), int(newest.stem.removeprefix(f"{CHECKPOINT}_"))
        try:
            self.trainer.restore(state, iteration)
        except (RuntimeError, ValueError, TypeError, KeyError, AttributeError, IndexError) as error:
            raise ConfigurationError(
                f"{newest} does not fit this training ({str(error).splitlines()[0]}): give the task and settings that "
                "it was written with"
            ) from error
        return iteration + 1

    def _start(self, begin: int) -> None:
        folder = self.trainer.folder
        with storage_faults(folder):
            folder.mkdir(parents=True, exist_ok=True)
        if not begin:
            check_new(folder)
        sweep(folder)
        settings = {"task": self.task, "library": self.trainer.name, **self._algorithm()}
        settings["manifest"] = self.manifest.document()
        with written_whole(folder / RECORD) as record:
            record.write_text(json.dumps({**settings, **self.record}, indent=2, default=str))
        if begin:
            self._continue_curve(begin)

    def _algorithm(self) -> dict[str, Any]:
        settings = self.trainer.settings
        return {"ppo" if isinstance(settings, PpoSettings) else "algorithm": asdict(settings)}

    def _continue_curve(self, begin: int) -> None:
        """Drop what was done after the checkpoint, for it is done again, and count on from there."""
        curve = self.trainer.folder / CURVE
        try:
            lines = read_bytes(curve, _MOST_CURVE).decode().splitlines(keepends=True) if curve.exists() else []
            lines = [line for line in lines if line.endswith("\n")]  # a kill may have torn the last one
            done = [(line, parse_json(line)) for line in lines]
            kept = [(line, values) for line, values in done if values["iteration"] < begin]
            if kept:
                last = kept[-1][1]
                self._steps_before, self._seconds_before = int(last["env_steps"]), float(last["seconds"])
                self._diverged_before = int(last.get("diverged", 0))
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise ConfigurationError(
                f"{curve} is no curve of a training ({error}): remove it to begin another"
            ) from None
        with written_whole(curve) as shortened:
            shortened.write_text("".join(line for line, _ in kept))

    def _save(self, iteration: int) -> None:
        if not self.leader:
            return
        self._policy(iteration).save(self.trainer.folder / f"policy_{iteration}{SUFFIX}")
        checkpoint = self._checkpoint(iteration)
        write_checkpoint(checkpoint, self.trainer.name, self.trainer.state())
        self.saved = checkpoint

    def _checkpoint(self, iteration: int) -> Path:
        return self.trainer.folder / f"{CHECKPOINT}_{iteration}{SUFFIX}"

    def _policy(self, iteration: int) -> Policy:
        trainer, actor = self.trainer, self.trainer.actor()
        versions = self.record.get("versions")
        description = PolicyDescription.of(trainer.environment, self.task, trainer.name, iteration, versions)
        return Policy(actor.module, actor.network, description, self.manifest)

    def _diverged(self) -> int:
        """Episodes that diverged since the training was started or resumed; says so when there are the first.

        Raises:
            SimulationError: too many did in the last iteration.
        """
        environment = self.trainer.environment
        if environment.lost is None:
            return 0
        count, before = environment.lost.count, self._diverged_last
        self._diverged_last = count
        most = max(_FEW_DIVERGED, environment.num_envs // 100)
        if count - before > most:
            raise SimulationError(
                f"{count - before} of {environment.num_envs} environments diverged in one iteration, where {most} may: "
                "use a smaller physics_dt, softer drives or softer contacts"
            )
        if count and not before:
            warnings.warn(
                f"{count} of {environment.num_envs} environments diverged and began anew; they earn nothing and are "
                "counted as 'diverged' (--diverged stop ends the training instead)",
                RuntimeWarning,
                stacklevel=2,
            )
        return count

    def _report(self, progress: Progress, report: Callable[[Progress], None]) -> None:
        if not self.leader:  # its library counts nothing
            return
        progress = replace(
            progress,
            diverged=self._diverged() + self._diverged_before,
            env_steps=progress.env_steps + self._steps_before,
            seconds=progress.seconds + self._seconds_before,
        )
        # Before any episode has ended there is no number, and JSON has no NaN.
        told = asdict(progress)
        for numbers in (told, told["metrics"]):
            numbers.update({name: None for name, value in numbers.items() if value != value})
        append_line(self.trainer.folder / CURVE, json.dumps(told))
        report(progress)


def check_new(folder: Path) -> None:
    """Reject a folder for a new training whose files would replace others, or be taken for its own.

    Raises:
        ConfigurationError: a training has begun in it, or it holds a file of a name that trainings write.
    """
    if (folder / RECORD).exists():
        raise ConfigurationError(f"folder {folder} holds a training already: resume it, or name another")
    written = (CURVE, f"{CHECKPOINT}_*{SUFFIX}", f"policy_*{SUFFIX}")
    taken = [path.name for kind in written for path in folder.glob(kind)]
    if taken:
        raise ConfigurationError(f"folder {folder} holds {min(taken)}, which a training would write: name another")
