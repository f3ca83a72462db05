"""Recording of episodes of many environments at once, in files that survive a crash, gathered into one dataset.

While episodes run, the steps of all environments are in rings (steps, N, ...) on their device, to which each step adds
one row. Only when episodes end are their rows gathered and written to a folder of parts, each file complete and flushed
before the next begins. A part is a safetensors file with the arrays of a few episodes one after the other; its header
describes each. At the end the parts become one dataset, an HDF5 file or a folder of LeRobot's; an interrupted recording
can be resumed.
"""

from __future__ import annotations

import glob
import itertools
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import safetensors.numpy
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from orbit_core.envs.observation_layout import POLICY
from orbit_core.files import as_path, read_bytes, storage_faults, sweep, written_whole
from orbit_core.interfaces import ConfigurationError, Object, Robot, ShapeError, UnknownNameError, World
from orbit_core.rollout.stepping import Pace, StepObserver, roll_out
from orbit_core.sensors.contact import ContactSensor
from orbit_data.episodes import (
    ACTIONS,
    CONTACTS,
    DONES,
    INITIAL,
    NEXT,
    OBSERVED,
    POSES,
    REWARDS,
    STATES,
    TAUGHT,
    Array,
    Episode,
    EpisodeInfo,
)
from orbit_data.folder_lock import LOCK, FolderLock
from orbit_data.formats import (
    check_installed,
    check_recordable,
    check_target,
    gather_dataset,
    is_dataset,
    opened,
)
from orbit_data.manifest.manifest import Difference, Kind, Manifest, differences
from orbit_data.noise import CLEAN, NoisyActor
from orbit_data.reading.budget import MAX_DOCUMENT, TRUSTED
from orbit_data.states import TaskMemory, WorldStates

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.captured_step import StepResult
    from orbit_core.envs.environment import Environment, EpisodeEnd
    from orbit_core.envs.observation_layout import GroupLayout, Observation

_MANIFEST = "manifest.json"
# File that marks a recording that replaces the dataset in the end, instead of extending it.
_REPLACES = "replaces"
_PART = re.compile(r"part_(\d{6,})\.safetensors")
_KEY = "episodes"


class PartFolder:
    """Folder of finished episodes, next to the dataset that they will become.

    Args:
        path: path of the folder; it need not exist.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = as_path(path)
        self._lock: FolderLock | None = None

    @property
    def files(self) -> list[Path]:
        """Part files in the order of writing."""
        found = [path for path in self.path.iterdir() if _PART.fullmatch(path.name)] if self.path.is_dir() else []
        # By number, not by name: beyond a million parts the names have different lengths.
        return sorted(found, key=lambda path: int(path.stem.removeprefix("part_")))

    @property
    def begun(self) -> bool:
        """True if a recording has begun here."""
        return (self.path / _MANIFEST).is_file() or bool(self.files)

    @property
    def replaces(self) -> bool:
        """True if the recording replaces the dataset in the end; otherwise it extends it."""
        return (self.path / _REPLACES).is_file()

    def begin_replacing(self) -> None:
        """Make the recording that begins here replace the dataset in the end.

        Raises:
            ConfigurationError: another process writes into the folder; the message names it.
            StorageError: the folder cannot be written.
        """
        self.hold()
        with storage_faults(self.path):
            (self.path / _REPLACES).touch()

    def hold(self) -> None:
        """Lock the folder against other writers until it is removed or released.

        Raises:
            ConfigurationError: another process writes into the folder; the message names it.
            StorageError: the folder cannot be written.
        """
        if self._lock is None:
            with storage_faults(self.path):
                self.path.mkdir(parents=True, exist_ok=True)
                self._lock = FolderLock(self.path)

    def release(self) -> None:
        """Unlock the folder for other writers."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def begin(self, manifest: Manifest) -> None:
        """Create the folder, or continue with it; half-written files of a killed program are removed.

        Raises:
            ConfigurationError: another process writes into the folder; the message names it.
            StorageError: the folder cannot be written.
        """
        self.hold()
        sweep(self.path)
        with written_whole(self.path / _MANIFEST) as written:
            written.write_bytes(manifest.encode())

    def manifest(self) -> Manifest | None:
        """Return the manifest of the recording; None if none has begun.

        Raises:
            ConfigurationError: its file is damaged.
        """
        path = self.path / _MANIFEST
        return Manifest.decode(read_bytes(path, MAX_DOCUMENT), str(path)) if path.exists() else None

    def add(self, infos: Sequence[EpisodeInfo], arrays: Mapping[str, Array]) -> None:
        """Write finished episodes into a new part.

        Args:
            infos: facts of each episode.
            arrays: arrays (sum of lengths, ...) by name; those of ``initial/`` are (episodes, ...).

        Raises:
            StorageError: the disk is full; what was written before stays.
        """
        last = self.files[-1:]
        number = int(last[0].stem.removeprefix("part_")) + 1 if last else 0
        data = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        header = {_KEY: msgspec.json.encode(infos).decode()}
        path = self.path / f"part_{number:06d}.safetensors"
        with written_whole(path) as written:
            written.write_bytes(safetensors.numpy.save(data, header))

    def infos(self) -> list[EpisodeInfo]:
        """Return the facts of all episodes."""
        return [info for path in self.files for info in _header(path)]

    def read(self) -> Iterator[Episode]:
        """Yield all episodes, file by file.

        Raises:
            ConfigurationError: a file is damaged.
        """
        for path in self.files:
            infos = _header(path)
            try:
                arrays = safetensors.numpy.load(read_bytes(path))
            except (SafetensorError, ValueError, KeyError, TypeError) as error:
                raise ConfigurationError(
                    f"{path} holds no episodes: {error}; remove it to go on without them"
                ) from None
            ends = np.cumsum([info.length for info in infos])
            _check_lengths(path, arrays, len(infos), int(ends[-1]) if len(ends) else 0)
            for row, (info, end) in enumerate(zip(infos, ends.tolist(), strict=True)):
                own = slice(end - info.length, end)
                yield Episode(info, {n: a[row if n.startswith(INITIAL) else own] for n, a in arrays.items()})

    def remove(self) -> None:
        """Delete the recording after it was gathered; files of other kinds stay, and the folder with them.

        Raises:
            ConfigurationError: another process writes into the folder; the message names it.
            StorageError: the folder cannot be deleted.
        """
        self.hold()
        with storage_faults(self.path):
            # The mark first: if the program is killed after it, the rest of the folder extends the dataset, which has
            # its episodes already, and replaces nothing.
            (self.path / _REPLACES).unlink(missing_ok=True)
            for path in (*self.files, self.path / _MANIFEST, self.path / LOCK):
                path.unlink(missing_ok=True)
            sweep(self.path)
            with suppress(OSError):
                self.path.rmdir()
        self.release()


def _check_lengths(path: Path, arrays: Mapping[str, Array], episodes: int, steps: int) -> None:
    for name, array in arrays.items():
        if len(array) != (episodes if name.startswith(INITIAL) else steps):
            raise _damaged(path, f"'{name}' has shape {array.shape}, of {episodes} episodes with {steps} steps")


def _header(path: Path) -> list[EpisodeInfo]:
    try:
        with safe_open(path, framework="np") as file:
            return msgspec.json.decode(file.metadata()[_KEY], type=list[EpisodeInfo])
    except (SafetensorError, OSError, KeyError, TypeError, msgspec.MsgspecError) as error:
        raise _damaged(path, str(error)) from None


def _damaged(path: Path, reason: str) -> ConfigurationError:
    return ConfigurationError(f"{path} holds no episodes: {reason}; remove it to go on without them")


Wanted = Callable[["EpisodeEnd", Tensor], Tensor]
"""Function that selects which ended episodes (n,) are kept, given how many their environments ended before (n,)."""


def check_groups(groups: Collection[str], environment: Environment) -> None:
    """Refuse observation groups that an environment lacks.

    Raises:
        UnknownNameError: a group is unknown; the message names the nearest.
    """
    for name in groups:
        if name not in environment.observation:
            raise UnknownNameError("observation group", name, environment.observation)


class DemonstrationRecorder(StepObserver):
    """Recorder of each finished episode: states, actions, observations, rewards, poses, contacts, and initial memory.

    On a GPU each step waits for the device, to know which episodes ended.

    Args:
        environment: environment that is stepped; its episodes have just begun.
        folder: folder that receives the episodes.
        wanted: selects the episodes to keep.
        seed: seed of the random streams.
        groups: observation groups to record; all if None.
        begun: numbers (N,) of episodes that each environment ended before; zeros if None.
        clean: returns the actions (N, A) of the last step without noise, which are recorded too.
        instruction: what the episodes show, in words.
        taught: returns which environments (N,) a person led at the last step, correcting a policy.

    Raises:
        UnknownNameError: a group does not exist.
    """

    def __init__(
        self,
        environment: Environment,
        folder: PartFolder,
        wanted: Wanted,
        seed: int,
        groups: Collection[str] | None = None,
        begun: Tensor | None = None,
        clean: Callable[[], Tensor] | None = None,
        instruction: str = "",
        taught: Callable[[], Tensor] | None = None,
    ) -> None:
        check_groups(groups or (), environment)
        self._environment, self._folder, self._wanted, self._seed = environment, folder, wanted, seed
        self._layouts = {n: o for n, o in environment.observation.items() if groups is None or n in groups}
        self._states, self._memory = WorldStates(environment.world), TaskMemory(environment)
        self._frames = dict(tracked_frames(environment.world))
        sensors = environment.world.sensors.items()
        self._contacts = {name: sensor for name, sensor in sensors if isinstance(sensor, ContactSensor)}
        self._rings: dict[str, Tensor] = {}
        # One more than the longest episode, so that a ring never overwrites an episode that has not been written.
        self._capacity = environment.max_episode_steps + 1
        self._clean, self._instruction, self._taught = clean, instruction, taught
        self._step = 0
        self._initial = {name: value.clone() for name, value in self._memory.read().items()}
        self._seen = environment.observe()
        none = torch.zeros(environment.num_envs, dtype=torch.int64, device=environment.device)
        self.ended = none if begun is None else begun.clone()
        """Numbers (N,) of episodes that each environment has ended."""
        self.kept = 0
        """Episodes that were written."""

    def before_step(self) -> None:
        """Record the state, and the observation of it."""
        self._put(STATES, self._states.read())
        for name, (entity, frame) in self._frames.items():
            self._put(POSES + name, entity.frame_pose(frame))
        for name, sensor in self._contacts.items():
            self._put(CONTACTS + name, sensor.forces)
        for name, value in self._leaves(self._seen):
            self._put(OBSERVED + name, value)

    def stepped(self, action: Tensor, result: StepResult) -> None:
        """Record the action and its results, and write the episodes that ended."""
        self._seen, reward, terminated, truncated, info = result
        self._put(ACTIONS, action.clamp(-1.0, 1.0))
        if self._clean is not None:
            self._put(CLEAN, self._clean())
        if self._taught is not None:
            self._put(TAUGHT, self._taught())
        self._put(REWARDS, reward)
        self._put(DONES, terminated | truncated)
        self._step += 1
        if "final" in info:
            self._finish(info["final"])

    def finish(self, end: EpisodeEnd) -> None:
        """Write episodes that a person ends now, as if their last step had ended them."""
        self._rings[DONES][(self._step - 1) % self._capacity, end.env_ids] = True
        self._finish(end)

    def _put(self, name: str, value: Tensor) -> None:
        # Rings are made at the first step, when the shapes and types of all values are known.
        ring = self._rings.get(name)
        if ring is None:
            ring = self._rings[name] = value.new_zeros((self._capacity, *value.shape))
        if value.shape != ring.shape[1:]:
            raise ShapeError(f"'{name}' has shape {tuple(value.shape)}, but had {tuple(ring.shape[1:])} before")
        ring[self._step % self._capacity] = value

    def _leaves(self, observation: Observation) -> list[tuple[str, Tensor]]:
        """Return the tensors of concatenated groups by ``group``, and of other groups' terms by ``group/term``."""
        leaves: list[tuple[str, Tensor]] = []
        for group in self._layouts:
            value = observation[group]
            named = {f"{group}/{term}": each for term, each in value.items()} if isinstance(value, dict) else {}
            leaves += named.items() if isinstance(value, dict) else [(group, value)]
        return leaves

    def _finish(self, end: EpisodeEnd) -> None:
        ids = end.env_ids
        rows = self._wanted(end, self.ended[ids]).nonzero().squeeze(-1)
        if len(rows):
            kept = end.only(rows)
            arrays = self._arrays(kept)
            self._folder.add(self._infos(kept, arrays.get(TAUGHT)), arrays)
            self.kept += len(rows)
        self.ended[ids] += 1
        # The environment has begun the next episodes by now, so that memory holds their goals.
        for name, value in self._memory.read().items():
            self._initial[name][ids] = value[ids]

    def _infos(self, end: EpisodeEnd, taught: Array | None) -> list[EpisodeInfo]:
        count, backend = self._environment.num_envs, self._environment.world.backend
        returns = torch.stack(list(end.rewards.values())).sum(0).tolist() if end.rewards else [0.0] * len(end.env_ids)
        begins = (end.steps.cumsum(0) - end.steps).cpu().numpy()
        led = [None] * len(begins) if taught is None else np.add.reduceat(taught, begins, dtype=np.int64).tolist()
        ids, numbers = end.env_ids.tolist(), self.ended[end.env_ids].tolist()
        metrics = {name: values.tolist() for name, values in end.metrics.items()}
        return [
            EpisodeInfo(
                # Unique, and the same whenever and in whatever order episodes end.
                number=number * count + env_id,
                length=length,
                success=success,
                episode_return=returns[row],
                metrics={name: float(values[row]) for name, values in metrics.items()},
                seed=self._seed,
                env_id=env_id,
                episode=number,
                backend=backend,
                taught=led[row],
                instruction=self._instruction,
            )
            for row, (env_id, number, length, success) in enumerate(
                zip(ids, numbers, end.steps.tolist(), end.success.tolist(), strict=True)
            )
        ]

    def _arrays(self, end: EpisodeEnd) -> dict[str, Array]:
        """Return the steps of episodes that end now, one episode after the other, and their initial memory."""
        lengths, total = end.steps, int(end.steps.sum())
        last = lengths.cumsum(0) - 1
        first = (last - lengths + 1).repeat_interleave(lengths)
        begin = (self._step - lengths).repeat_interleave(lengths)
        steps = (begin + torch.arange(total, device=lengths.device) - first) % self._capacity
        # One gather for all steps of all ended episodes, instead of one for each episode.
        columns = end.env_ids.repeat_interleave(lengths)
        flat = {name: ring[steps, columns] for name, ring in self._rings.items()}
        arrays = {name: value for name, value in flat.items() if not name.startswith(OBSERVED)}
        for name, final in self._leaves(end.observation):
            value = flat[OBSERVED + name]
            following = value.roll(-1, 0)
            # After an episode's last step the next row belongs to another episode: take what the episode saw last.
            following[last] = final
            self._add_terms(arrays, name, value, following)
        arrays |= {INITIAL + name: value[end.env_ids] for name, value in self._initial.items()}
        return {name: value.cpu().numpy() for name, value in arrays.items()}

    def _add_terms(self, arrays: dict[str, Tensor], name: str, value: Tensor, following: Tensor) -> None:
        """Add the terms of an observation by name; names of groups other than ``policy`` get the group as a prefix."""
        layout = self._layouts[name.partition("/")[0]]
        for term, columns in _terms_in(layout, name).items():
            arrays[OBSERVED + term] = value[:, columns]
            if value.dim() < 4:  # the next picture is the next row's
                arrays[NEXT + term] = following[:, columns]


def _terms_in(layout: GroupLayout, name: str) -> dict[str, slice]:
    """Return the columns of each term in a tensor of the group, by the term's name in files."""
    prefix = "" if layout.name == POLICY else f"{layout.name}/"
    if layout.concatenated:
        return {prefix + term: columns for term, columns in layout.columns.items()}
    return {prefix + name.partition("/")[2]: slice(None)}


_ASIDE = ".replaced-"


class RecordingFile:
    """Dataset that grows: the gathered file, and next to it the folder of episodes that are not gathered yet.

    A recording that replaces the dataset (:meth:`begin_anew`) leaves it unchanged until all its own episodes are
    gathered, and keeps an earlier interrupted one in a folder ``*.parts.replaced-<number>`` until then.

    Args:
        path: path of the dataset: an HDF5 file, or a folder in LeRobot's layout.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = path = as_path(path)
        self.left_out: set[str] = set()
        """Names of arrays that the dataset's format could not store when it was gathered."""
        self.parts = PartFolder(path.with_name(f"{path.name}.parts"))
        """Folder of episodes that are not in the file yet."""

    def check_begun(self, resume: bool, overwrite: bool) -> None:
        """Check that a recording can begin here.

        Args:
            resume: continue an interrupted recording.
            overwrite: replace the recording and the dataset.

        Raises:
            ConfigurationError: both are given, an interrupted recording exists and neither is given, another process
                records here, the format's package is missing, or another file is in the place of the dataset or its
                card.
        """
        check_installed(self.path)  # now: a missing package would otherwise be noticed after all episodes have run
        check_target(self.path)
        if resume and overwrite:
            raise ConfigurationError("--resume continues a recording, --overwrite begins a new one: give one of them")
        if self.parts.path.exists():
            self.parts.hold()
        self._give_back()
        if not (resume or overwrite):
            self.parts.release()
            self.check_none()

    def check_none(self) -> None:
        """Reject the path of a new dataset if an interrupted recording would become one there.

        Raises:
            ConfigurationError: there is such a recording; the message names its folder.
        """
        if self.parts.begun:
            raise ConfigurationError(
                f"{self.parts.path} holds an interrupted recording: the command that began it continues with "
                "--resume, and begins a new one with --overwrite; or choose another name"
            )

    def begin_anew(self) -> None:
        """Begin a recording that replaces the dataset and earlier recordings once it is complete.

        Raises:
            ConfigurationError: another process records into the file; the message names it.
            StorageError: the folder cannot be written.
        """
        if self.parts.path.exists():
            self.parts.hold()
        if self.parts.files:
            number = 1 + max((number for number, _ in self._set_aside()), default=0)
            with storage_faults(self.parts.path):
                self.parts.path.rename(self.parts.path.with_name(f"{self.parts.path.name}{_ASIDE}{number}"))
            self.parts.release()
        self.parts.begin_replacing()

    def release(self) -> None:
        """Unlock the file for other recordings; a recording without kept episodes is undone."""
        self._give_back()
        self.parts.release()

    def infos(self) -> dict[int, EpisodeInfo]:
        """Return the facts of every kept episode, by number."""
        return {info.number: info for info in (*self._gathered(), *self.parts.infos())}

    def take_up(self, manifest: Manifest) -> None:
        """Begin a recording, or continue one of the same environment.

        Raises:
            ConfigurationError: the existing one is of another environment, with the differences; or the format cannot
                store the environment's episodes.
        """
        check_recordable(self.path, manifest)
        recorded = self.parts.manifest()
        if recorded is None and self._continued:
            with opened(self.path, TRUSTED) as dataset:
                recorded = dataset.known()
        found = [] if recorded is None else differences(recorded, manifest)
        found = [each for each in found if not _harmless(each)]
        if found:
            listed = "; ".join(str(difference) for difference in found)
            raise ConfigurationError(
                f"{self.path} was recorded with other settings and cannot be continued: {listed}; give the same, or "
                "another --output"
            )
        self.parts.begin(manifest)

    def check_instruction(self, instruction: str) -> None:
        """Refuse to continue a recording whose episodes show something else, in words.

        Args:
            instruction: of the episodes to come; recorded ones without any fit all.

        Raises:
            ConfigurationError: an episode has another instruction; the message names both.
        """
        others = {info.instruction for info in self.infos().values()} - {"", instruction}
        if others:
            raise ConfigurationError(
                f"{self.path} was recorded with other settings and cannot be continued: instruction was "
                f"'{min(others)}' and is '{instruction}'; give the same, or another --output"
            )

    def gather(self) -> int:
        """Write all episodes into one file, in the order of recording, and return their number.

        If the program is killed meanwhile, nothing is lost, and another call does the same.
        """
        manifest = self.parts.manifest()
        if manifest is None:
            raise ConfigurationError(f"nothing was recorded in {self.parts.path}")
        sweep(self.path.parent)  # half-written files of a killed program
        numbers = {info.number for info in self._gathered()}
        # A kill after gathering leaves parts whose episodes the dataset has already.
        new = [info.number not in numbers for info in self.parts.infos()]
        episodes = itertools.compress(self.parts.read(), new)
        # Parts are not compressed, so that this is an upper estimate.
        size = sum(path.stat().st_size for path in self.parts.files)
        self.left_out = gather_dataset(self.path, episodes, manifest, size, self._continued)
        # The dataset is complete now. Old recordings go first: a kill in between leaves only episodes that it has.
        for _, replaced in self._set_aside():
            PartFolder(replaced).remove()
        self.parts.remove()
        return len(numbers) + sum(new)

    @property
    def _continued(self) -> bool:
        """True if the recording extends an existing dataset."""
        return is_dataset(self.path) and not self.parts.replaces

    def _set_aside(self) -> list[tuple[int, Path]]:
        """Return the folders of interrupted recordings that will be replaced, with their numbers, the oldest first."""
        prefix = f"{self.parts.path.name}{_ASIDE}"
        found = [path for path in self.path.parent.glob(f"{glob.escape(prefix)}*") if path.is_dir()]
        numbers = [(path.name.removeprefix(prefix), path) for path in found]
        return sorted((int(number), path) for number, path in numbers if number.isdecimal())

    def _give_back(self) -> None:
        """Remove a recording without kept episodes, and restore the one that it would have replaced."""
        if self.parts.files:
            return
        if self.parts.path.exists():
            self.parts.remove()
        if aside := self._set_aside():
            with storage_faults(self.parts.path):
                aside[-1][1].rename(self.parts.path)

    def _gathered(self) -> list[EpisodeInfo]:
        if not self._continued:
            return []
        with opened(self.path, TRUSTED) as dataset:
            return [*dataset.episodes]


def _harmless(difference: Difference) -> bool:
    """Return True if a recording goes on in spite of a difference."""
    # Unknown in files that are older than the field, and where a person acts.
    unknown = difference.path in ("noise", "stray") and None in (difference.recorded, difference.present)
    return difference.kind is Kind.NOTE and (unknown or difference.path.startswith(("versions", "input_device")))


class Shares:
    """Share of each environment: ``episodes // num_envs`` episodes, and one more if i < ``episodes % num_envs``.

    Short episodes are therefore not preferred, and an interrupted recording continues with exactly the missing ones.
    """

    def __init__(self, episodes: int, environment: Environment) -> None:
        count, device = environment.num_envs, environment.device
        self._shares = episodes // count + (torch.arange(count, device=device) < episodes % count).long()

    def __call__(self, end: EpisodeEnd, ended: Tensor) -> Tensor:
        return ended < self._shares[end.env_ids]

    def left(self, infos: Mapping[int, EpisodeInfo]) -> Tensor:
        """Return the number (N,) of episodes that each environment has recorded already.

        Raises:
            ConfigurationError: an episode was recorded in an environment that does not exist here.
        """
        done = torch.zeros_like(self._shares)
        for info in infos.values():
            if info.env_id is not None:
                if not 0 <= info.env_id < len(done):
                    raise ConfigurationError(
                        f"an episode was recorded in environment {info.env_id}, but there are only {len(done)}: begin "
                        "a new recording"
                    )
                done[info.env_id] += 1
        return done


def record(
    environment: Environment,
    make_actor: Callable[[], Actor],
    file: RecordingFile,
    task: str,
    episodes: int,
    seed: int,
    groups: Collection[str] | None = None,
    progress: Callable[[int], None] = lambda recorded: None,
    noise: float = 0.0,
    instruction: str = "",
    stray: float = 0.0,
) -> Pace:
    """Record episodes until the file contains ``episodes``, including those that are there already.

    Args:
        environment: environment that runs the episodes.
        make_actor: makes the actor, after the first episodes have begun.
        file: recording that receives the episodes.
        task: name that the environment was made by.
        episodes: total number of episodes.
        seed: seed of the random streams.
        groups: observation groups to record; all if None.
        progress: called after each step with the number of recorded episodes.
        noise: standard deviation of the noise on executed actions, :class:`NoisyActor`; the actor's own actions are
            recorded as ``clean_actions``.
        instruction: what the episodes show, in words.
        stray: the same as ``noise``, at the start of an episode only.

    Raises:
        ConfigurationError: the file was recorded with another environment, instruction or noise, or the noise is
            negative.
        StorageError: the disk is full; finished episodes are kept.
    """
    try:
        return _record(environment, make_actor, file, task, episodes, seed, groups, progress, noise, instruction, stray)
    finally:
        file.release()


def _record(
    environment: Environment,
    make_actor: Callable[[], Actor],
    file: RecordingFile,
    task: str,
    episodes: int,
    seed: int,
    groups: Collection[str] | None,
    progress: Callable[[int], None],
    noise: float,
    instruction: str,
    stray: float,
) -> Pace:
    file.check_instruction(instruction or task)
    file.take_up(replace(Manifest.of(environment, task, seed), noise=noise, stray=stray))
    shares, infos = Shares(episodes, environment), file.infos()
    begun = shares.left(infos)
    environment.reset(seed)
    _skip(environment, begun)
    wanted = max(0, episodes - len(infos))
    actor = make_actor()
    noisy = NoisyActor(actor, environment, noise, seed, stray) if noise or stray else None
    clean = None if noisy is None else lambda: noisy.clean
    recorder = DemonstrationRecorder(environment, file.parts, shares, seed, groups, begun, clean, instruction)

    class Teller(StepObserver):
        def before_step(self) -> None:
            progress(len(infos) + recorder.kept)

    pace = Pace(0, 0.0)
    if wanted:
        pace = roll_out(environment, noisy or actor, (recorder, Teller()), lambda: recorder.kept >= wanted)
    progress(len(infos) + recorder.kept)
    file.gather()
    return pace


def _skip(environment: Environment, begun: Tensor) -> None:
    """Make the next episode of each environment the one after those (N,) that are recorded."""
    if not bool(begun.any()):
        return
    # The reset goes on to the next episode of each stream.
    environment.world.random.begin(begun - 1)
    environment.reset()


def tracked_frames(world: World) -> Iterator[tuple[str, tuple[Object, str]]]:
    """Yield the frames whose poses describe a world: end effectors, and links of objects that can move.

    A robot without an end effector has the frame of its root.

    Args:
        world: world whose robots and objects are listed.

    Yields:
        Name of the track, and the entity and frame that it follows.
    """
    for name, robot in world.robots.items():
        ends = [end.frame for end in robot.spec.end_effectors] if isinstance(robot, Robot) else []
        for frame in ends or robot.link_names[:1]:
            yield f"{name}/{frame}", (robot, frame)
    for name, thing in world.objects.items():
        for link in thing.link_names[1 if thing.spec.fixed_base else 0 :]:
            yield (name if len(thing.link_names) == 1 else f"{name}/{link}"), (thing, link)
