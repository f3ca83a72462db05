"""Datasets as HDF5 in robomimic's layout, with the manifest in the same file.

``/data/demo_<i>`` holds ``actions``, ``rewards``, ``dones``, ``states``, ``obs/<term>`` and ``next_obs/<term>`` of
length T, and arrays of ORBIT: ``poses/``, ``contacts/``, ``initial/``. ``/data`` has the attributes ``total`` and
``env_args``, ``/mask/<name>`` lists demonstrations by name (https://robomimic.github.io/docs/datasets/overview.html).
``/orbit/manifest`` is the manifest as JSON. Only numbers are read: files with objects (Python's pickles are one kind),
with links to elsewhere, or with data in other files are refused.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import msgspec
import numpy as np

from orbit_core.files import as_path, storage_faults, written_whole
from orbit_core.interfaces import ConfigurationError, StorageError
from orbit_data.episodes import Array, Dataset, Episode, EpisodeInfo, check_episode, check_found, check_infos, chosen
from orbit_data.manifest.manifest import Manifest
from orbit_data.reading.budget import MAX_DOCUMENT, ReadAccount, ReadBudget
from orbit_data.reading.hdf5 import Hdf5File, hdf5_module

SUFFIX = ".hdf5"
# robomimic's number for environments with Gymnasium's interface (EnvType.GYM_TYPE).
_GYM = 2
_MANIFEST = "orbit/manifest"
_INFO = "orbit_episode"
_REASON = re.compile(r"error message = '([^']*)'")
_DEMO = re.compile(r"demo_[0-9]{1,9}")
# Bytes that must stay free after writing, and bytes that one check of the free space covers.
_MARGIN, _AHEAD = 1 << 20, 1 << 22
# Compression of pictures; arrays as small as states gain nothing from it.
_PICTURE: dict[str, Any] = {"compression": "lzf"}
# Bytes of the pictures that are compressed together.
_CHUNK = 1 << 18


def write_hdf5(
    path: Path | str,
    episodes: Iterable[Episode],
    manifest: Manifest | None,
    masks: Mapping[str, Sequence[int]] | None = None,
    compression: str | None = None,
    size: int = 0,
) -> int:
    """Write a dataset, check it, move it to its path as a whole, and return the number of episodes.

    Args:
        path: path of the file, which is replaced.
        episodes: episodes in order; they get the names ``demo_0`` and so on.
        manifest: manifest of the environment, if it is known.
        masks: subsets by name, as positions; ``success`` is added if the episodes state it.
        compression: compression of all arrays, ``"gzip"`` or ``"lzf"``; None compresses only pictures, by ``"lzf"``.
        size: estimate of the file's bytes, which must be free before anything is written.

    Raises:
        StorageError: the disk is full, or the folder cannot be written.
    """
    path, h5py = as_path(path), hdf5_module()
    # Free space is checked ahead of several episodes at once, because each check allocates a file.
    successes: list[int] = []
    count = total = room = 0
    with _room(path, size), written_whole(path) as written:
        with h5py.File(written, "w", libver="latest") as file:
            data = file.create_group("data")
            for count, episode in enumerate(episodes, 1):
                needed = sum(array.nbytes for array in episode.arrays.values())
                if needed > room:
                    file.flush()  # so that closing has little left to write: a failure there crashes HDF5
                    _check_room(path, needed + _AHEAD)
                    room = needed + _AHEAD
                room -= needed
                _write_episode(data.create_group(f"demo_{count - 1}"), episode, compression)
                total += episode.info.length
                successes += [count - 1] if episode.info.success else []
            file.flush()
            _check_room(path, 0)
            data.attrs["total"] = total
            data.attrs["env_args"] = json.dumps(_env_args(manifest))
            if manifest is not None:
                file.create_dataset(_MANIFEST, data=np.frombuffer(manifest.encode(), np.uint8))
            for name, positions in {**({"success": successes} if successes else {}), **(masks or {})}.items():
                file.create_dataset(f"mask/{name}", data=np.array([f"demo_{i}" for i in positions], dtype="S"))
        Hdf5Dataset(written).close()  # it must be readable before it replaces another file
    return count


class Hdf5Dataset(Dataset):
    """Dataset in an HDF5 file, of ORBIT or robomimic.

    Args:
        path: path of the file.
        budget: limits of memory and time for opening it, and for reading each episode.

    Raises:
        ConfigurationError: the file is truncated, not HDF5, of another layout, or contains data that is not read.
    """

    def __init__(self, path: Path | str, budget: ReadBudget = ReadBudget()) -> None:
        self.path, self.budget = as_path(path), budget
        self._file = Hdf5File(self.path, "dataset")
        try:
            with self._file.faults("the file"):
                # The bytes on the disk, not the file's length: a file with holes can be of any length.
                account = ReadAccount(budget, str(self.path), 512 * self.path.stat().st_blocks)
                self._data, self._demos = self._demonstrations()
                self.manifest = self._manifest(account)
                self.episodes = [self._info(name, account) for name in self._demos]
                check_infos(self.episodes, account)
                self.masks = self._masks(account)
        except BaseException:
            self._file.close()
            raise

    def read(self, position: int, names: Sequence[str] | None = None) -> Episode:
        name, info = self._demos[position], self.episodes[position]
        where = f"{name} of {self.path}"
        with self._file.faults(name):
            account = ReadAccount(self.budget, where)
            arrays = dict(self._arrays(self._file.group(self._data, name), "", names, account))
        episode = Episode(info, arrays)
        check_found(names, arrays, where)
        check_episode(episode, where, whole=names is None)
        return episode

    def close(self) -> None:
        self._file.close()

    def _demonstrations(self) -> tuple[Any, list[str]]:
        group = self._file.group(self._file.root, "data")
        if group is None:
            raise ConfigurationError(f"{self.path} is no dataset of demonstrations: it has no group 'data'")
        found = [name for name in self._file.names(group) if _DEMO.fullmatch(name)]
        # By number: HDF5 lists names by their characters, demo_10 before demo_2.
        return group, sorted(found, key=lambda name: int(name[5:]))

    def _manifest(self, account: ReadAccount) -> Manifest | None:
        group = self._file.group(self._file.root, "orbit")
        if group is None:
            return None
        data = self._file.numbers(group, "manifest", account).tobytes()
        return Manifest.decode(data, str(self.path))

    def _info(self, name: str, account: ReadAccount) -> EpisodeInfo:
        account.check_time()
        group = self._file.group(self._data, name)
        own = self._file.text(group, _INFO, MAX_DOCUMENT)
        if own is not None:
            return msgspec.json.decode(own, type=EpisodeInfo)
        length = self._file.integer(group, "num_samples")
        if length is None:
            raise ConfigurationError(f"{name} of {self.path} does not say how many steps it has (num_samples)")
        return EpisodeInfo(number=int(name[5:]), length=length)

    def _masks(self, account: ReadAccount) -> dict[str, list[int]]:
        group = self._file.group(self._file.root, "mask")
        if group is None:
            return {}
        places = {name.encode(): place for place, name in enumerate(self._demos)}
        masks = {name: self._file.numbers(group, name, account, "S").tolist() for name in self._file.names(group)}
        return {name: [places[each] for each in listed if each in places] for name, listed in masks.items()}

    def _arrays(
        self, group: Any, prefix: str, names: Sequence[str] | None, account: ReadAccount
    ) -> Iterator[tuple[str, Array]]:
        for name in self._file.names(group):
            path = prefix + name
            child = self._file.child(group, name)
            account.check_time()
            if self._file.is_group(child):
                yield from self._arrays(child, f"{path}/", names, account)
            elif chosen(path, names):
                yield path, self._file.numbers(group, name, account)


def check_replaceable(path: Path) -> None:
    """Reject a file that a dataset must not replace: only those that ORBIT wrote are replaced.

    Raises:
        ConfigurationError: it is no such file.
    """
    if not path.exists():
        return
    own = False
    # Of a file that cannot be read nobody knows whose it is.
    with suppress(ConfigurationError), closing(Hdf5File(path, "dataset")) as file, file.faults("the file"):
        data = file.group(file.root, "data")
        demos = [] if data is None else [name for name in file.names(data) if _DEMO.fullmatch(name)]
        own = bool(demos) and file.text(file.group(data, demos[0]), _INFO, MAX_DOCUMENT) is not None
    if not own:
        raise ConfigurationError(
            f"{path} is not a dataset that ORBIT wrote. It is not replaced: choose another name, or move it away first"
        )


@contextmanager
def _room(path: Path, size: int) -> Iterator[None]:
    """Check that the disk has room, and report a full disk more clearly than HDF5 does.

    Raises:
        StorageError: the disk is full, or HDF5 could not write.
    """
    try:
        with _hushed(), storage_faults(path):
            if size:
                _check_room(path, size)
            yield
    except (RuntimeError, StorageError) as error:
        if (reason := _REASON.search(str(error))) is None and isinstance(error, StorageError):
            raise
        message = reason.group(1) if reason else str(error).strip().partition("\n")[0]
        raise StorageError(f"cannot write {path}: {message}") from error


@contextmanager
def _hushed() -> Iterator[None]:
    """Silence the tracebacks that HDF5 prints for each of its objects when it cannot write; they cannot be caught."""
    hooks = sys.excepthook, sys.unraisablehook
    sys.excepthook = sys.unraisablehook = lambda *_: None
    try:
        yield
    finally:
        sys.excepthook, sys.unraisablehook = hooks


def _check_room(path: Path, size: int) -> None:
    """Detect a full disk, or a used-up quota, before HDF5 does, which crashes then.

    Raises:
        StorageError: the disk has no room for ``size`` bytes.
    """
    # Allocating respects quotas and reserved blocks, which the file system's free space does not show.
    with storage_faults(path), TemporaryFile(dir=path.parent) as file:
        os.posix_fallocate(file.fileno(), 0, size + _MARGIN)


def _write_episode(group: Any, episode: Episode, compression: str | None) -> None:
    for name, array in episode.arrays.items():
        picture = array.dtype == np.uint8 and array.ndim == 4  # (T, H, W, C)
        options = {"compression": compression} if compression and array.ndim else _PICTURE if picture else {}
        if picture and array.size:
            # Whole pictures: the library's own choice parts them by channel, and is read three times as slowly.
            frames = min(max(1, _CHUNK // array[0].nbytes), len(array))
            options = {**options, "chunks": (frames, *array.shape[1:])}
        group.create_dataset(name, data=array, **options)
    group.attrs["num_samples"] = episode.info.length
    group.attrs[_INFO] = msgspec.json.encode(episode.info).decode()


def _env_args(manifest: Manifest | None) -> dict[str, Any]:
    if manifest is None:
        return {"env_name": "", "type": _GYM, "env_version": "", "env_kwargs": {}}
    robot = next((r.model for r in manifest.robots.values() if r.agent), "")
    kwargs = {"backend": manifest.backend, "robot": robot, "action": manifest.configuration.get("action", "")}
    return {
        "env_name": f"orbit/{manifest.task}-v0",
        "type": _GYM,
        "env_version": manifest.versions.get("orbit", ""),
        "env_kwargs": kwargs,
    }
