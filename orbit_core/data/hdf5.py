"""Datasets as HDF5 in robomimic's layout, with the manifest beside the demonstrations.

``/data/demo_<i>`` holds ``actions``, ``rewards``, ``dones``, ``states``, ``obs/<term>`` and ``next_obs/<term>`` of
length T, and ours besides: ``poses/``, ``contacts/``, ``initial/``. ``/data`` has the attributes ``total`` and
``env_args``, ``/mask/<name>`` lists demonstrations by name (https://robomimic.github.io/docs/datasets/overview.html).
``/orbit/manifest`` is the manifest as JSON. Nothing but numbers is read: files with objects (of which Python's pickles
are one kind), with links to elsewhere, or with data in other files are refused.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import msgspec
import numpy as np

from orbit_core.data.episodes import (
    Array,
    Dataset,
    Episode,
    EpisodeInfo,
    check_episode,
    check_found,
    check_infos,
    check_size,
    chosen,
)
from orbit_core.data.manifest import Manifest
from orbit_core.files import storage_faults, written_whole
from orbit_core.interfaces import ConfigurationError, StorageError

SUFFIX = ".hdf5"
_GYM = 2
"""robomimic's number for environments in Gymnasium's manner."""
_MANIFEST = "orbit/manifest"
_INFO = "orbit_episode"
_FAULTS = (
    OSError, RuntimeError, KeyError, AttributeError, ValueError, TypeError, MemoryError, OverflowError,
    msgspec.MsgspecError,
)  # fmt: skip
"""What h5py raises of damaged files."""
_REASON = re.compile(r"error message = '([^']*)'")
_DEMO = re.compile(r"demo_[0-9]{1,9}")
_MARGIN, _AHEAD = 1 << 20, 1 << 22
"""Bytes that must be free besides what is written, and for which room is looked for at once."""
_PICTURE = {"compression": "lzf"}
"""How pictures are compressed; numbers as small as states gain nothing from it."""


def write_hdf5(
    path: Path,
    episodes: Iterable[Episode],
    manifest: Manifest | None,
    masks: Mapping[str, Sequence[int]] | None = None,
    compression: str | None = None,
    size: int = 0,
) -> int:
    """Write a dataset, check it, and let it take its place, whole or not at all. Returns the number of episodes.

    Args:
        path: of the file, which is replaced.
        episodes: in their order, which names them ``demo_0`` and so on.
        manifest: of the environment, if it is known.
        masks: subsets by name, as positions; ``success`` is added where the episodes say it.
        compression: of all arrays, ``"gzip"`` or ``"lzf"``; None compresses pictures alone, by ``"lzf"``.
        size: about how many bytes it will have, for which there must be room before anything is written.

    Raises:
        StorageError: the disk is full, or the folder cannot be written.
    """
    h5py = hdf5_module()
    successes: list[int] = []
    count = total = room = 0
    with _room(path, size), written_whole(path) as written:
        with h5py.File(written, "w", libver="latest") as file:
            data = file.create_group("data")
            for count, episode in enumerate(episodes, 1):
                needed = sum(array.nbytes for array in episode.arrays.values())
                if needed > room:
                    file.flush()  # so that little is left to write when it is closed, which must not fail
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
        Hdf5Dataset(written).close()  # before it replaces another, it must be readable
    return count


class Hdf5Dataset(Dataset):
    """A dataset in an HDF5 file, ours or robomimic's.

    Raises:
        ConfigurationError: it is truncated, no HDF5, of another layout, or holds what is not read; says what.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._h5py = hdf5_module()
        if not path.is_file():
            raise ConfigurationError(f"there is no file {path}")
        with self._read_faults("the file"):
            self._file = self._h5py.File(path, "r")
        try:
            with self._read_faults("the file"):
                self._demos = self._names()
                self.manifest = self._manifest()
                self.episodes = [self._info(name) for name in self._demos]
                check_infos(self.episodes, str(path))
                self.masks = self._masks()
        except BaseException:
            self._file.close()
            raise

    def read(self, position: int, names: Sequence[str] | None = None) -> Episode:
        name, info = self._demos[position], self.episodes[position]
        where = f"{name} of {self.path}"
        with self._read_faults(name):
            arrays = dict(self._arrays(self._child(self._file["data"], name), "", names))
        episode = Episode(info, arrays)
        check_found(names, arrays, where)
        check_episode(episode, where, whole=names is None)
        return episode

    def close(self) -> None:
        self._file.close()

    def _names(self) -> list[str]:
        group: Any = self._child(self._file, "data") if "data" in self._file else ()
        if not isinstance(group, self._h5py.Group):
            raise ConfigurationError(f"{self.path} is no dataset of demonstrations: it has no group 'data'")
        found = [name for name in group if _DEMO.fullmatch(name)]
        return sorted(found, key=lambda name: int(name[5:]))

    def _manifest(self) -> Manifest | None:
        if "orbit" not in self._file:
            return None
        return Manifest.decode(self._numbers(self._child(self._file, "orbit"), "manifest").tobytes(), str(self.path))

    def _info(self, name: str) -> EpisodeInfo:
        group = self._child(self._file["data"], name)
        own = group.attrs.get(_INFO)
        if isinstance(own, str):
            return msgspec.json.decode(own, type=EpisodeInfo)
        length = group.attrs.get("num_samples")
        if not isinstance(length, np.integer | int):
            raise ConfigurationError(f"{name} of {self.path} does not say how many steps it has (num_samples)")
        return EpisodeInfo(number=int(name[5:]), length=int(length))

    def _masks(self) -> dict[str, list[int]]:
        if "mask" not in self._file:
            return {}
        places = {name.encode(): place for place, name in enumerate(self._demos)}
        group = self._child(self._file, "mask")
        masks = {name: self._numbers(group, name, "S").tolist() for name in group}
        return {name: [places[each] for each in listed if each in places] for name, listed in masks.items()}

    def _arrays(self, group: Any, prefix: str, names: Sequence[str] | None) -> Iterator[tuple[str, Array]]:
        for name in group:
            path = prefix + name
            child = self._child(group, name)
            if isinstance(child, self._h5py.Group):
                yield from self._arrays(child, f"{path}/", names)
            elif chosen(path, names):
                yield path, self._numbers(group, name)

    def _numbers(self, group: Any, name: str, kinds: str = "fiub") -> Array:
        dataset = self._child(group, name)
        what = f"'{dataset.name}' of {self.path}"
        if dataset.dtype.kind not in kinds or dataset.is_virtual or dataset.external:
            raise ConfigurationError(
                f"{what} holds {dataset.dtype} or data of other files, which is not read: only numbers in the file are"
            )
        check_size(dataset.name, dataset.nbytes, dataset.id.get_storage_size(), str(self.path))
        return dataset[()]

    def _child(self, group: Any, name: str) -> Any:
        """What stands there by itself; a link, which may lead to any file, is not followed."""
        if not isinstance(group.get(name, getlink=True), self._h5py.HardLink):
            raise ConfigurationError(f"'{group.name}/{name}' of {self.path} is a link, which is not followed")
        return group[name]

    @contextmanager
    def _read_faults(self, what: str) -> Iterator[None]:
        try:
            yield
        except _FAULTS as error:
            reason = str(error).strip().partition("\n")[0]
            raise ConfigurationError(
                f"{what} of {self.path} cannot be read ({reason}): it is truncated, damaged or no HDF5 of this layout"
            ) from None


@contextmanager
def _room(path: Path, size: int) -> Iterator[None]:
    """Make sure that there is room on the disk, and say so where there is none; the library does it less clearly.

    Raises:
        StorageError: there is not, or the library could not write.
    """
    try:
        with _hushed(), storage_faults(path):
            if size:
                _check_room(path, size)
            yield
    except (RuntimeError, StorageError) as error:
        if (reason := _REASON.search(str(error))) is None and isinstance(error, StorageError):
            raise
        told = reason.group(1) if reason else str(error).strip().partition("\n")[0]
        raise StorageError(f"cannot write {path}: {told}") from error


@contextmanager
def _hushed() -> Iterator[None]:
    """Where it cannot write, the library also prints a traceback for each of its objects, which nobody can catch."""
    hooks = sys.excepthook, sys.unraisablehook
    sys.excepthook = sys.unraisablehook = lambda *_: None
    try:
        yield
    finally:
        sys.excepthook, sys.unraisablehook = hooks


def _check_room(path: Path, size: int) -> None:
    """Find out that the disk is full, or the user's share of it, before the library does, which then crashes.

    Raises:
        StorageError: there is no room for so many bytes.
    """
    with storage_faults(path), TemporaryFile(dir=path.parent) as file:
        os.posix_fallocate(file.fileno(), 0, size + _MARGIN)


def _write_episode(group: Any, episode: Episode, compression: str | None) -> None:
    for name, array in episode.arrays.items():
        picture = array.dtype == np.uint8 and array.ndim == 4
        options = {"compression": compression} if compression and array.ndim else _PICTURE if picture else {}
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


def hdf5_module() -> Any:
    """h5py.

    Raises:
        ConfigurationError: it is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise ConfigurationError("HDF5 needs h5py: pip install 'orbit-core[data]'") from error
    return h5py
