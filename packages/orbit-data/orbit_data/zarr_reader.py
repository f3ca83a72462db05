"""Zarr replay buffers in the layout of Diffusion Policy, as episodes; read alone, never written.

Arrays of ``data/``, of which ``action`` must be one, hold the steps of all episodes one after the other, and
``meta/episode_ends`` where each ends (Chi and others, Diffusion Policy, RSS 2023; also of UMI and others). They are
folders (``.zarr``) or archives (``.zarr.zip``), of formats 2 and 3.
"""

from __future__ import annotations

import lzma
import math
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.files import as_path
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import (
    ACTIONS,
    OBSERVED,
    Array,
    Dataset,
    Episode,
    EpisodeInfo,
    check_episode,
    check_found,
    check_infos,
    chosen,
)
from orbit_data.reading.budget import ReadAccount, ReadBudget

SUFFIXES = (".zarr", ".zarr.zip")
_ENDS = "meta/episode_ends"
# Bytes that are read at a time, after which the clock is looked at.
_SLAB = 1 << 25
# Chunks that are read at a time.
_CHUNKS = 500


def is_zarr(path: Path | str) -> bool:
    """Return True if a path looks like a Zarr group, by its name or by what a folder holds."""
    path = as_path(path)
    return path.name.endswith(SUFFIXES) or any((path / name).is_file() for name in (".zgroup", "zarr.json"))


class ZarrDataset(Dataset):
    """A Zarr group with ``data/action`` and ``meta/episode_ends``.

    Args:
        path: of the folder or the archive.
        budget: limits on what opening it, and reading each episode, may take.

    Raises:
        ConfigurationError: it is none, damaged, or stored in a way that is not read; says what.
    """

    def __init__(self, path: Path | str, budget: ReadBudget = ReadBudget()) -> None:
        self.path, self.budget, self.manifest, self.masks = as_path(path), budget, None, {}
        if not (self.path.is_file() or self.path.is_dir()):
            raise ConfigurationError(f"there is no file or folder {self.path}")
        account = ReadAccount(budget, str(self.path))
        with self._faults():
            self._arrays, ends = self._open(account)
        if ACTIONS not in self._arrays:
            raise ConfigurationError(
                f"{path} has no data/action, without which it is no replay buffer of demonstrations"
            )
        self._check_lengths(ends)
        self._begins = np.concatenate([np.zeros(1, np.int64), ends])
        self.episodes = [EpisodeInfo(i, int(length)) for i, length in enumerate(np.diff(self._begins))]
        check_infos(self.episodes, account)

    def read(self, position: int, names: Sequence[str] | None = None) -> Episode:
        begin, end = int(self._begins[position]), int(self._begins[position + 1])
        where = f"episode {position} of {self.path}"
        account = ReadAccount(self.budget, where)
        with self._faults():
            arrays = {
                name: _rows(name, array, begin, end, account)
                for name, array in self._arrays.items()
                if chosen(name, names)
            }
        episode = Episode(self.episodes[position], arrays)
        check_found(names, arrays, where)
        check_episode(episode, where, whole=names is None)
        return episode

    def close(self) -> None:
        self._store.close()

    def _open(self, account: ReadAccount) -> tuple[dict[str, Any], Array]:
        """Return the arrays by our names for them, and where each episode ends."""
        zarr, files_type = _zarr()
        files = files_type(self.path, account)
        self._store = files.store()
        # The descriptions that were checked, not consolidated copies of them, which could differ.
        group = zarr.open_group(self._store, mode="r", use_consolidated=False)
        arrays = {_ours(name): array for name, array in group["data"].arrays() if f"data/{name}" in files.layouts}
        ends = group[_ENDS]
        if _ENDS not in files.layouts or ends.ndim != 1 or ends.dtype.kind not in "iu":
            raise ConfigurationError(f"{_ENDS} of {self.path} are not the rising ends of episodes")
        return arrays, _rows(_ENDS, ends, 0, ends.shape[0], account).astype(np.int64)

    def _check_lengths(self, ends: Array) -> None:
        if not len(ends) or (np.diff(ends, prepend=0) <= 0).any():
            raise ConfigurationError(f"{_ENDS} of {self.path} are not the rising ends of episodes")
        for name, array in self._arrays.items():
            if not array.shape or array.shape[0] < ends[-1]:
                raise ConfigurationError(
                    f"'{name}' of {self.path} has shape {array.shape}, but the episodes have {ends[-1]} steps"
                )

    @contextmanager
    def _faults(self) -> Iterator[None]:
        """Turn errors of damaged files into one sentence."""
        wrong = (
            OSError, KeyError, ValueError, TypeError, AttributeError, IndexError, RuntimeError, MemoryError,
            ZeroDivisionError, OverflowError, RecursionError, NotImplementedError, EOFError, zlib.error,
            zipfile.BadZipFile, lzma.LZMAError,
        )  # fmt: skip
        try:
            yield
        except wrong as error:
            reason = str(error).strip().partition("\n")[0]
            raise ConfigurationError(f"{self.path} cannot be read as a Zarr replay buffer: {reason}") from None


def _ours(name: str) -> str:
    return ACTIONS if name == "action" else OBSERVED + name


def _rows(name: str, array: Any, begin: int, end: int, account: ReadAccount) -> Array:
    """Return rows of an array, read some chunks at a time."""
    row = math.prod(array.shape[1:]) * array.dtype.itemsize
    found_rows, rows = end - begin, array.chunks[0]
    account.take(name, row * max(found_rows, rows))
    found = np.empty((found_rows, *array.shape[1:]), array.dtype)
    # Whole chunks of rows at a time, so that none is unpacked twice.
    across = math.prod(-(-extent // chunk) for extent, chunk in zip(array.shape[1:], array.chunks[1:], strict=True))
    step = rows * max(1, min(_SLAB // max(1, rows * row), _CHUNKS // max(1, across)))
    for first in range(begin - begin % rows, end, step):
        part = slice(max(first, begin), min(first + step, end))
        found[part.start - begin : part.stop - begin] = array[part]
        account.check_time()
    return found


def _zarr() -> tuple[Any, Any]:
    """Return the zarr module, and the class that checks a group's files."""
    try:
        import zarr

        from orbit_data.reading.zarr_store import ZarrFiles
    except ImportError as error:
        raise ConfigurationError(f"Zarr datasets need zarr: {install_extra('zarr')}") from error
    return zarr, ZarrFiles
