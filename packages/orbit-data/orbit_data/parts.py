"""Where episodes lie while a recording runs: a folder of files, each written whole and flushed before the next begins.

Whatever ends the program, what a file holds stays. A file is safetensors, its arrays those of a few episodes one after
the other; its header holds what is known of each.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import safetensors.numpy
from safetensors import SafetensorError, safe_open

from orbit_core.files import LOCK, FolderLock, as_path, read_bytes, storage_faults, sweep, written_whole
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import INITIAL, Array, Episode, EpisodeInfo
from orbit_data.manifest.manifest import Manifest
from orbit_data.reading.budget import MAX_DOCUMENT

_MANIFEST = "manifest.json"
_REPLACES = "replaces"
"""Marks a recording that takes the place of the dataset in the end, instead of going on with it."""
_PART = re.compile(r"part_(\d{6,})\.safetensors")
_KEY = "episodes"


class PartFolder:
    """Files of finished episodes beside the dataset that they are going to be.

    Args:
        path: of the folder; it need not be there.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = as_path(path)
        self._lock: FolderLock | None = None

    @property
    def files(self) -> list[Path]:
        """In the order of writing."""
        found = [path for path in self.path.iterdir() if _PART.fullmatch(path.name)] if self.path.is_dir() else []
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
        """Let the recording that begins here take the dataset's place in the end.

        Raises:
            ConfigurationError: another process writes into the folder; names that.
            StorageError: it cannot be written.
        """
        self.hold()
        with storage_faults(self.path):
            (self.path / _REPLACES).touch()

    def hold(self) -> None:
        """Let nobody else write into the folder until it is removed or released.

        Raises:
            ConfigurationError: another process writes into it; names that.
            StorageError: it cannot be written.
        """
        if self._lock is None:
            with storage_faults(self.path):
                self.path.mkdir(parents=True, exist_ok=True)
                self._lock = FolderLock(self.path)

    def release(self) -> None:
        """Let others write into the folder."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def begin(self, manifest: Manifest) -> None:
        """Make the folder, or take it up again: what a killed program left half written is removed.

        Raises:
            ConfigurationError: another process writes into it; names that.
            StorageError: it cannot be written.
        """
        self.hold()
        sweep(self.path)
        with written_whole(self.path / _MANIFEST) as written:
            written.write_bytes(manifest.encode())

    def manifest(self) -> Manifest | None:
        """Of the recording; None if none has begun.

        Raises:
            ConfigurationError: its file is damaged.
        """
        path = self.path / _MANIFEST
        return Manifest.decode(read_bytes(path, MAX_DOCUMENT), str(path)) if path.exists() else None

    def add(self, infos: Sequence[EpisodeInfo], arrays: Mapping[str, Array]) -> None:
        """Write finished episodes: arrays (sum of lengths, ...), of ``initial/`` (episodes, ...).

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
        """What is known of all episodes."""
        return [info for path in self.files for info in _header(path)]

    def read(self) -> Iterator[Episode]:
        """All episodes, file by file.

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
        """Delete the recording, once all is elsewhere; files of other kinds stay, and the folder with them.

        Raises:
            ConfigurationError: another process writes into it; names that.
            StorageError: it cannot be deleted.
        """
        self.hold()
        with storage_faults(self.path):
            # The mark first: what a kill then leaves goes on with the dataset, which has its episodes, and replaces
            # nothing.
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
