"""A recording as a whole: begun, gone on with, gathered into one file."""

from __future__ import annotations

import glob
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.files import as_path, storage_faults, sweep
from orbit_core.interfaces import ConfigurationError
from orbit_core.rollout.stepping import Pace, StepObserver, roll_out
from orbit_data.card import check_card, write_card
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.hdf5 import Hdf5Dataset, write_hdf5
from orbit_data.manifest.compare import Kind, differences
from orbit_data.manifest.manifest import Manifest
from orbit_data.parts import PartFolder
from orbit_data.reading.budget import TRUSTED
from orbit_data.reading.hdf5 import hdf5_module
from orbit_data.recorder import DemonstrationRecorder

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.environment import Environment, EpisodeEnd

_ASIDE = ".replaced-"


class RecordingFile:
    """A dataset that grows: the gathered file, and next to it the folder of what is not gathered yet.

    A recording that replaces the dataset (:meth:`begin_anew`) leaves it as it is until all its own episodes are
    gathered, and keeps another one that was cut off in a folder ``*.parts.replaced-<number>`` until then.

    Args:
        path: of the HDF5 file.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = path = as_path(path)
        self.parts = PartFolder(path.with_name(f"{path.name}.parts"))

    def check_begun(self, resume: bool, overwrite: bool) -> None:
        """Refuse a recording that was cut off, if neither is asked for, to do both, one that still runs, and any where
        h5py is missing, which would be found out once all episodes are over.

        Raises:
            ConfigurationError: tells of both, of the process that records, of what to install, or of a file in the
                place of the card.
        """
        hdf5_module()
        check_card(self.path)
        if resume and overwrite:
            raise ConfigurationError("--resume goes on with a recording, --overwrite begins it anew: give one of them")
        if self.parts.path.exists():
            self.parts.hold()
        self._give_back()
        if not (resume or overwrite):
            self.parts.release()
            self.check_none()

    def check_none(self) -> None:
        """Reject the path of a new dataset where a recording that was cut off is to become one.

        Raises:
            ConfigurationError: there is one; names its folder.
        """
        if self.parts.begun:
            raise ConfigurationError(
                f"{self.parts.path} holds a recording that was cut off: the command that began it goes on with "
                "--resume, and begins another with --overwrite; or give another name"
            )

    def begin_anew(self) -> None:
        """Begin a recording that replaces all that is there, once it is whole.

        Raises:
            ConfigurationError: another process records into the file; names that.
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
        """Let others record into the file; a recording of which no episode is kept is as if it had not begun."""
        self._give_back()
        self.parts.release()

    def infos(self) -> dict[int, EpisodeInfo]:
        """What is known of every episode that is kept, by number."""
        return {info.number: info for info in (*self._gathered(), *self.parts.infos())}

    def take_up(self, manifest: Manifest) -> None:
        """Begin, or go on where a recording of the same environment stands.

        Raises:
            ConfigurationError: what is there was recorded with another environment; names what differs.
        """
        recorded = self.parts.manifest()
        if recorded is None and self._continued:
            dataset = Hdf5Dataset(self.path)
            dataset.close()
            recorded = dataset.known()
        found = [] if recorded is None else differences(recorded, manifest)
        found = [
            each
            for each in found
            if each.kind is not Kind.NOTE or not each.path.startswith(("versions", "input_device"))
        ]
        if found:
            told = "; ".join(str(difference) for difference in found)
            raise ConfigurationError(f"{self.path} was recorded with other settings, so it cannot go on: {told}")
        self.parts.begin(manifest)

    def gather(self) -> int:
        """Put all episodes into the one file, in the order in which they were recorded; returns how many.

        Whatever ends the program on the way, nothing is lost, and another call does the same.
        """
        manifest = self.parts.manifest()
        if manifest is None:
            raise ConfigurationError(f"nothing was recorded in {self.parts.path}")
        sweep(self.path.parent)
        continued = (self.path,) if self._continued else ()
        size = sum(path.stat().st_size for path in (*self.parts.files, *continued))
        count = write_hdf5(self.path, self._episodes(), manifest, size=size)
        write_card(self.path)
        for _, replaced in self._set_aside():
            PartFolder(replaced).remove()
        self.parts.remove()
        return count

    @property
    def _continued(self) -> bool:
        """True if the recording extends a dataset that is there."""
        return self.path.exists() and not self.parts.replaces

    def _set_aside(self) -> list[tuple[int, Path]]:
        """Folders of recordings that were cut off and are to be replaced, by their numbers, the oldest first."""
        prefix = f"{self.parts.path.name}{_ASIDE}"
        found = [path for path in self.path.parent.glob(f"{glob.escape(prefix)}*") if path.is_dir()]
        numbers = [(path.name.removeprefix(prefix), path) for path in found]
        return sorted((int(number), path) for number, path in numbers if number.isdecimal())

    def _give_back(self) -> None:
        """Remove a recording that kept no episode, and put the one in its place that it was to replace."""
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
        dataset = Hdf5Dataset(self.path)
        dataset.close()
        return [*dataset.episodes]

    def _episodes(self) -> Iterator[Episode]:
        """All episodes in the order in which they were recorded, a file at a time; each number once."""
        numbers: set[int] = set()
        if self._continued:
            dataset = Hdf5Dataset(self.path, TRUSTED)
            numbers |= {info.number for info in dataset.episodes}
            yield from map(dataset.read, range(len(dataset.episodes)))
            dataset.close()
        yield from (episode for episode in self.parts.read() if episode.info.number not in numbers)


class Shares:
    """Environment i records its first ``episodes // num_envs`` episodes, and one more if i < ``episodes % num_envs``.

    So short episodes are not preferred, and a recording that was cut off goes on with the very episodes that it lacks.
    """

    def __init__(self, episodes: int, environment: Environment) -> None:
        count, device = environment.num_envs, environment.device
        self._shares = episodes // count + (torch.arange(count, device=device) < episodes % count).long()

    def __call__(self, end: EpisodeEnd, ended: Tensor) -> Tensor:
        return ended < self._shares[end.env_ids]

    def left(self, infos: Mapping[int, EpisodeInfo]) -> Tensor:
        """Return (N,) episodes that each environment has recorded already.

        Raises:
            ConfigurationError: one was recorded in an environment that there is not.
        """
        done = torch.zeros_like(self._shares)
        for info in infos.values():
            if info.env_id is not None:
                if not 0 <= info.env_id < len(done):
                    raise ConfigurationError(
                        f"an episode was recorded in environment {info.env_id}, and there are {len(done)}: begin "
                        "another recording"
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
) -> Pace:
    """Record episodes until so many are in the file, those that are there already included.

    Args:
        environment: that they run in.
        make_actor: makes who acts, once the first episodes have begun.
        file: takes them.
        task: the name that the environment was made by.
        episodes: in all.
        seed: of the random streams.
        groups: observation groups to record; all if None.
        progress: told, after each step, how many are recorded.

    Raises:
        ConfigurationError: the file was recorded with another environment.
        StorageError: the disk is full; finished episodes are kept.
    """
    try:
        return _record(environment, make_actor, file, task, episodes, seed, groups, progress)
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
) -> Pace:
    file.take_up(Manifest.of(environment, task, seed))
    shares, infos = Shares(episodes, environment), file.infos()
    begun = shares.left(infos)
    environment.reset(seed)
    _skip(environment, begun)
    recorder = DemonstrationRecorder(environment, file.parts, shares, seed, groups, begun)
    wanted = max(0, episodes - len(infos))

    class Teller(StepObserver):
        def before_step(self) -> None:
            progress(len(infos) + recorder.kept)

    pace = Pace(0, 0.0)
    if wanted:
        pace = roll_out(environment, make_actor(), (recorder, Teller()), lambda: recorder.kept >= wanted)
    progress(len(infos) + recorder.kept)
    file.gather()
    return pace


def _skip(environment: Environment, begun: Tensor) -> None:
    """Let the next episode of each environment be the one after those (N,) that are recorded."""
    if not bool(begun.any()):
        return
    environment.world.random.begin(begun - 1)
    environment.reset()
