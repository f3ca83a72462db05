"""Zarr replay buffers in the layout of Diffusion Policy, as episodes; read alone, never written.

Arrays of ``data/``, of which ``action`` must be one, hold the steps of all episodes one after the other, and
``meta/episode_ends`` where each ends (Chi and others, Diffusion Policy, RSS 2023; also of UMI and others). They are
folders (``.zarr``) or archives (``.zarr.zip``), of formats 2 and 3.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.data.episodes import (
    ACTIONS,
    OBSERVED,
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
from orbit_core.interfaces import ConfigurationError

SUFFIXES = (".zarr", ".zarr.zip")
_CODECS = (
    "bytes",
    "transpose",
    "sharding_indexed",
    "crc32c",
    "shuffle",
    "blosc",
    "zstd",
    "gzip",
    "zlib",
    "bz2",
    "lzma",
    "lz4",
)
"""What may turn stored bytes into numbers; among Zarr's others is Python's pickle, which runs what the file says."""
_DESCRIPTIONS = (".zarray", "zarr.json")
_LONGEST = 1 << 20
"""Bytes of a description."""


def is_zarr(path: Path) -> bool:
    """Whether a path looks like a Zarr group, by its name or by what a folder holds."""
    return path.name.endswith(SUFFIXES) or any((path / name).is_file() for name in (".zgroup", "zarr.json"))


class ZarrDataset(Dataset):
    """A Zarr group with ``data/action`` and ``meta/episode_ends``.

    Raises:
        ConfigurationError: it is none, damaged, or stored in a way that is not read; says what.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.manifest, self.masks = path, None, {}
        if not path.exists():
            raise ConfigurationError(f"there is no file or folder {path}")
        zarr = _zarr()
        with self._faults():
            stored = self._check_codecs()
            self._store = zarr.storage.ZipStore(path, mode="r") if path.is_file() else zarr.storage.LocalStore(path)
            group = zarr.open_group(self._store, mode="r")
            self._arrays: dict[str, Any] = {_ours(name): array for name, array in group["data"].arrays()}
            ends = np.asarray(group["meta/episode_ends"][:]).astype(np.int64)
        if ACTIONS not in self._arrays:
            raise ConfigurationError(
                f"{path} has no data/action, without which it is no replay buffer of demonstrations"
            )
        self._check_sizes(ends, stored)
        self._begins = np.concatenate([np.zeros(1, np.int64), ends])
        self.episodes = [EpisodeInfo(i, int(length)) for i, length in enumerate(np.diff(self._begins))]
        check_infos(self.episodes, str(path))

    def read(self, position: int, names: Sequence[str] | None = None) -> Episode:
        rows = slice(int(self._begins[position]), int(self._begins[position + 1]))
        with self._faults():
            arrays = {name: np.asarray(a[rows]) for name, a in self._arrays.items() if chosen(name, names)}
        episode = Episode(self.episodes[position], arrays)
        where = f"episode {position} of {self.path}"
        check_found(names, arrays, where)
        check_episode(episode, where, whole=names is None)
        return episode

    def close(self) -> None:
        self._store.close()

    def _check_codecs(self) -> int:
        """Refuse what decodes by anything but plain numbers, before Zarr sees it. Returns the bytes that are stored."""
        stored = 0
        for name, size, text in self._files():
            stored += size
            for codec in _codecs(json.loads(text)) if text else ():
                if codec not in _CODECS:
                    raise ConfigurationError(
                        f"{name} of {self.path} is stored by the codec '{codec}', which is not read"
                    )
        return stored

    def _files(self) -> Iterator[tuple[str, int, bytes]]:
        """Name, size, and of an array's description its text."""
        if self.path.is_file():
            with zipfile.ZipFile(self.path) as archive:
                for info in archive.infolist():
                    described = info.filename.rpartition("/")[2] in _DESCRIPTIONS
                    self._check_description(info.filename, info.file_size if described else 0)
                    yield info.filename, info.compress_size, archive.read(info) if described else b""
            return
        for each in self.path.rglob("*"):
            if each.is_symlink():
                raise ConfigurationError(f"{each} is a link, which may lead to any file and is not followed")
            if each.is_file():
                self._check_description(str(each), each.stat().st_size if each.name in _DESCRIPTIONS else 0)
                yield str(each), each.stat().st_size, each.read_bytes() if each.name in _DESCRIPTIONS else b""

    def _check_description(self, name: str, size: int) -> None:
        if size > _LONGEST:
            raise ConfigurationError(f"{name} of {self.path} describes an array in {size} bytes, which is too much")

    def _check_sizes(self, ends: Array, stored: int) -> None:
        if ends.ndim != 1 or not len(ends) or (np.diff(ends, prepend=0) <= 0).any():
            raise ConfigurationError(f"meta/episode_ends of {self.path} are not the rising ends of episodes")
        for name, array in self._arrays.items():
            if not array.shape or array.shape[0] < ends[-1]:
                raise ConfigurationError(
                    f"'{name}' of {self.path} has shape {array.shape}, and {ends[-1]} steps are told"
                )
            check_size(name, array.nbytes, stored, str(self.path))

    @contextmanager
    def _faults(self) -> Iterator[None]:
        """What is missing or damaged, as one sentence."""
        wrong = (
            OSError, KeyError, ValueError, TypeError, AttributeError, IndexError, RuntimeError, MemoryError,
            ZeroDivisionError, OverflowError, RecursionError, NotImplementedError, EOFError, zlib.error,
            zipfile.BadZipFile,
        )  # fmt: skip
        try:
            yield
        except wrong as error:
            reason = str(error).strip().partition("\n")[0]
            raise ConfigurationError(f"{self.path} cannot be read as a Zarr replay buffer: {reason}") from None


def _ours(name: str) -> str:
    return ACTIONS if name == "action" else OBSERVED + name


def _codecs(description: Any) -> Iterable[str]:
    """Names of all codecs of an array's description, of format 2 or 3, those within shards included."""
    if isinstance(description, dict):
        if isinstance(description.get("id"), str):
            yield description["id"]
        for codec in description.get("codecs") or ():
            if isinstance(codec, dict) and isinstance(codec.get("name"), str):
                yield codec["name"].removeprefix("numcodecs.")
        if description.get("dtype") == "|O":
            yield "objects"
        for inner in description.values():
            yield from _codecs(inner)
    elif isinstance(description, list):
        for inner in description:
            yield from _codecs(inner)


def _zarr() -> Any:
    try:
        import zarr
        import zarr.storage
    except ImportError as error:
        raise ConfigurationError("Zarr datasets need zarr: pip install 'orbit-core[zarr]'") from error
    return zarr
