"""One training: its folder, its policies, and its checkpoints.

A checkpoint is one file of data and never a pickle, unlike the libraries' own. A state is a tree of
dictionaries, lists, numbers, texts, truth values, None and tensors, as libraries have it in ``state_dict``. Tuples
become lists, and NumPy's arrays and numbers become tensors and numbers. In the file, see :mod:`orbit_data.tensor_file`,
a dictionary is ``{"items": [[key, value], ...]}``, because its keys may be numbers, and a tensor ``{"tensor": name}``.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.envs.environment import Environment
from orbit_core.envs.ppo import PpoSettings
from orbit_core.files import append_line, read_bytes, storage_faults, sweep, written_whole
from orbit_core.interfaces import ConfigurationError, NonFiniteError, SimulationError
from orbit_data.manifest.manifest import Manifest
from orbit_data.tensor_file import parse_json, read_tensors, write_tensors
from orbit_learn.across import parts_of
from orbit_learn.memory import memory_parts
from orbit_learn.policy import Policy, PolicyDescription
from orbit_learn.policy_file import SUFFIX, newest_file, read_policy
from orbit_learn.trainer import Progress, Trainer

FORMAT = 1


def write_checkpoint(path: Path | str, library: str, state: Any) -> None:
    """Write a library's state; the file appears complete or not at all.

    Raises:
        ConfigurationError: the state contains something other than data; the message names its type.
    """
    tensors: dict[str, Tensor] = {}
    document = {"checkpoint": FORMAT, "library": library, "state": _packed(state, tensors)}
    write_tensors(path, document, tensors)


def tensors_in(state: Any) -> list[Tensor]:
    """Return all tensors of a library's state.

    Raises:
        ConfigurationError: the state contains something other than data; the message names its type.
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
    # NumPy's numbers first: float64 is also a Python float, and would keep its type.
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        value = torch.from_numpy(value)
    if isinstance(value, Tensor):
        # Numbered, because names from paths could collide or be too long.
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
# Limit of a curve's bytes; an iteration takes some 300.
_MOST_CURVE = 1 << 26
# Number of environments that may diverge in any iteration; of many, one in a hundred may.
_FEW_DIVERGED = 3
# Limit of a weight, beyond which the products of three layers overflow in single precision.
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
        # Last completed iteration.
        self._done = -1
        self._parts = parts_of(self.trainer.environment)
        self.manifest = _manifest(self._parts, self.task, self.trainer.seed)
        """Manifest of the environment; across engines that of the first, with the names and settings of all."""
        self.saved: Path | None = None
        """Newest checkpoint that was written."""

    def run(self, iterations: int, save_every: int, report: Callable[[Progress], None], resume: bool = False) -> Policy:
        """Learn until ``iterations`` are done in total, and return the last policy.

        A checkpoint is written every ``save_every`` iterations, at the end, and when KeyboardInterrupt ends the
        training. The checkpoint then also has what the interrupted iteration has learned; that iteration is repeated.

        Args:
            iterations: total number of iterations, including those before a resumption.
            save_every: iterations between checkpoints.
            report: called after each iteration.
            resume: continue from the newest checkpoint of the folder.

        Raises:
            NonFiniteError: the policy diverged; the message names the iteration and the last checkpoint, which stays.
        """
        begin = self._resume() if resume else 0
        if begin >= iterations:
            raise ConfigurationError(f"{self.trainer.folder} has {begin} iterations already: request more")
        if self.leader:
            self._start(begin)

        def done(progress: Progress) -> None:
            # Before saving, so that the last checkpoint is always one to resume from.
            self._check_weights(progress.iteration)
            self._done = progress.iteration
            # The curve first: a line without a checkpoint is written again by a resumption, and none is missing.
            total = self._add_to_curve(progress) if self.leader else progress
            if self._done % save_every == 0 or self._done == iterations - 1:
                self._save(self._done)
            if self.leader:  # only the leading process's library counts episodes
                report(total)

        try:
            self.trainer.learn(iterations - begin, done)
        except KeyboardInterrupt:
            if self._done >= 0 and self.saved != self._checkpoint(self._done):
                self._check_weights(self._done + 1)
                self._save(self._done)
            raise
        except Exception:
            # A policy with NaN fails in the library or the environment, each with another message: report the cause.
            self._check_weights(self._done + 1, self.trainer.state())
            raise
        return self._policy(iterations - 1)

    def _check_weights(self, iteration: int, state: Any = None) -> None:
        """Refuse a policy that diverged, or a library's state that is not finite.

        Args:
            iteration: number of the iteration for the message.
            state: library's state, if it is checked too.
        """
        weights = self.trainer.actor().module.state_dict().values()
        # A comparison with NaN is false, so that NaN counts as unbounded.
        bounded = all(bool((weight.abs() <= _LARGEST_WEIGHT).all()) for weight in weights)
        if bounded and all(bool(torch.isfinite(tensor).all()) for tensor in tensors_in(state)):
            return
        kept = f"{self.saved} has the last finite one" if self.saved else "no checkpoint had been written"
        raise NonFiniteError(
            f"the policy diverged in iteration {iteration}, its weights are not finite or beyond "
            f"{_LARGEST_WEIGHT:g}; {kept}: use a smaller learning_rate, or a narrower range of rewards"
        )

    def _resume(self) -> int:
        """Restore the newest checkpoint, and return the number of the next iteration."""
        folder = self.trainer.folder
        newest = newest_file(folder, CHECKPOINT) if folder.is_dir() else None
        if newest is None:
            raise ConfigurationError(
                f"folder {folder} has no {CHECKPOINT}_<iteration>{SUFFIX} to resume from; the libraries' own files are "
                "not read, because they may run code"
            )
        state, iteration = read_checkpoint(newest, self.trainer.name), int(newest.stem.removeprefix(f"{CHECKPOINT}_"))
        # Weights may fit another robot or action of as many numbers, which would go on in silence.
        if (policy := self.policy_file(iteration)).exists():
            try:
                description = read_policy(policy)[0]
                self._check_engines(description.backend)
                description.find_group(self._parts[0])
            except ConfigurationError as error:
                raise ConfigurationError(
                    f"{folder} is resumed with the task and settings that it began with: {error}"
                ) from None
        try:
            self.trainer.restore(state, iteration)
        except (RuntimeError, ValueError, TypeError, KeyError, AttributeError, IndexError) as error:
            raise ConfigurationError(
                f"{newest} does not fit this training ({str(error).splitlines()[0]}): give the task and settings that "
                "it was written with"
            ) from error
        return iteration + 1

    def _check_engines(self, begun: str) -> None:
        """Refuse other engines than those that the training began on, named as in a manifest; their order is free."""
        now = self.manifest.backend
        if sorted(begun.split(", ")) != sorted(now.split(", ")):
            raise ConfigurationError(
                f"it began on {begun}, and is resumed on {now}; give --backend {begun.replace(',', '')}, or begin "
                "another training in a folder of its own"
            )

    def _start(self, begin: int) -> None:
        folder = self.trainer.folder
        with storage_faults(folder):
            folder.mkdir(parents=True, exist_ok=True)
        if not begin:
            check_new(folder)
        sweep(folder)  # half-written files of a killed training
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
        """Remove lines of iterations after the checkpoint, which are repeated, and continue counting from there."""
        curve = self.trainer.folder / CURVE
        try:
            lines = read_bytes(curve, _MOST_CURVE).decode().splitlines(keepends=True) if curve.exists() else []
            lines = [line for line in lines if line.endswith("\n")]  # a killed program may leave a partial last line
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
        self._policy(iteration).save(self.policy_file(iteration))
        # The policy first: a checkpoint without its policy could not be played, the other way round nothing is lost.
        checkpoint = self._checkpoint(iteration)
        write_checkpoint(checkpoint, self.trainer.name, self.trainer.state())
        self.saved = checkpoint

    def policy_file(self, iteration: int) -> Path:
        """Return the file of the policy of an iteration, which exists where one was written."""
        return self.trainer.folder / f"policy_{iteration}{SUFFIX}"

    def _checkpoint(self, iteration: int) -> Path:
        return self.trainer.folder / f"{CHECKPOINT}_{iteration}{SUFFIX}"

    def _policy(self, iteration: int) -> Policy:
        trainer, actor = self.trainer, self.trainer.actor()
        versions = self.record.get("versions")
        description = PolicyDescription.of(self._parts[0], self.task, trainer.name, iteration, versions)
        description = replace(description, memory=memory_parts(actor.module), backend=self.manifest.backend)
        return Policy(actor.module, actor.network, description, self.manifest)

    def _diverged(self) -> int:
        """Return the number of episodes that diverged since the start or resumption; warn at the first ones.

        Raises:
            SimulationError: too many diverged in the last iteration.
        """
        num_envs = self.trainer.environment.num_envs
        count, before = sum(part.lost.count for part in self._parts if part.lost is not None), self._diverged_last
        self._diverged_last = count
        most = max(_FEW_DIVERGED, num_envs // 100)
        if count - before > most:
            raise SimulationError(
                f"{count - before} of {num_envs} environments diverged in one iteration, where {most} may: "
                "use a smaller physics_dt, softer drives or softer contacts"
            )
        if count and not before:
            warnings.warn(
                f"{count} of {num_envs} environments diverged and began new episodes; they get no "
                "reward and are counted as 'diverged' (--diverged stop ends the training instead)",
                RuntimeWarning,
                stacklevel=2,
            )
        return count

    def _add_to_curve(self, progress: Progress) -> Progress:
        """Write an iteration's line, and return its progress counted from the first start of the training."""
        total = replace(
            progress,
            diverged=self._diverged() + self._diverged_before,
            env_steps=progress.env_steps + self._steps_before,
            seconds=progress.seconds + self._seconds_before,
        )
        # Before any episode has ended there is no number, and JSON has no NaN.
        values = asdict(total)
        for numbers in (values, values["metrics"], values["engines"]):
            numbers.update({name: None for name, value in numbers.items() if value != value})
        append_line(self.trainer.folder / CURVE, json.dumps(values))
        return total


def _manifest(parts: Sequence[Environment], task: str, seed: int) -> Manifest:
    """Return the manifest of the environments of one engine or several."""
    made = [Manifest.of(part, task, seed) for part in parts]
    if len(made) == 1:
        return made[0]
    return replace(
        made[0],
        backend=", ".join(each.backend for each in made),
        settings={each.backend: each.settings for each in made},
        versions={name: version for each in made for name, version in each.versions.items()},
        num_envs=sum(each.num_envs for each in made),
    )


def check_new(folder: Path) -> None:
    """Reject a folder for a new training that has files of another training.

    Raises:
        ConfigurationError: a training has begun in the folder, or a file has a name that trainings write.
    """
    if (folder / RECORD).exists():
        raise ConfigurationError(f"folder {folder} holds a training already: resume it, or name another")
    written = (CURVE, f"{CHECKPOINT}_*{SUFFIX}", f"policy_*{SUFFIX}")
    taken = [path.name for kind in written for path in folder.glob(kind)]
    if taken:
        raise ConfigurationError(f"folder {folder} holds {min(taken)}, which a training would write: name another")
