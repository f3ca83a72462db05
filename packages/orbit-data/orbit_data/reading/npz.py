"""Arrays of an ``.npz`` archive, read within a budget: NumPy itself allocates the memory that a header claims."""

from __future__ import annotations

import lzma
import math
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from orbit_data.reading.budget import ReadAccount

FAULTS = (
    OSError, ValueError, KeyError, TypeError, RuntimeError, NotImplementedError, EOFError, OverflowError, MemoryError,
    SyntaxError, tokenize.TokenError, zipfile.BadZipFile, zlib.error, lzma.LZMAError,
)  # fmt: skip
"""Errors of :func:`read_npz` for damaged archives, in addition to those of the budget."""
_SUFFIX = ".npy"
# Bytes that are read between two checks of the time.
_SLAB = 1 << 24


def read_npz(path: Path, account: ReadAccount) -> dict[str, npt.NDArray[Any]]:
    """Return all arrays of numbers or texts, by name.

    Args:
        path: path of the archive.
        account: account of the bytes and time that are used.

    Raises:
        ConfigurationError: the budget is exceeded.
        FAULTS: the file is not an archive, or damaged.
    """
    if not zipfile.is_zipfile(path):
        raise ValueError("it is no NPZ archive, as numpy.savez writes them")
    with zipfile.ZipFile(path) as archive:
        members = [info for info in archive.infolist() if info.filename.endswith(_SUFFIX)]
        return {info.filename.removesuffix(_SUFFIX): _read(archive, info, account) for info in members}


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo, account: ReadAccount) -> npt.NDArray[Any]:
    account.check_time()
    with _opened(archive, info) as file:
        read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(npy.read_magic(file))
        if read_header is None:
            raise ValueError(f"{info.filename} is of a version that is not read")
        shape, by_columns, dtype = read_header(file)
        # No objects ("O"): NumPy stores them as pickles, which can execute code.
        if dtype.kind not in "fiubcUS":
            raise ValueError(f"{info.filename} holds {dtype}, and no numbers or texts")
        if any(extent < 0 for extent in shape):
            raise ValueError(f"{info.filename} has shape {shape}")
        # In Python's integers, which do not overflow.
        size = math.prod(shape) * dtype.itemsize
        if size != info.file_size - file.tell():
            raise ValueError(f"{info.filename} would have {size:,} bytes, and holds {info.file_size - file.tell():,}")
        account.take(info.filename, size, info.compress_size)
        array = np.empty(shape, dtype, order="F" if by_columns else "C")
        place = memoryview(cast(Any, array.reshape(-1, order="A").view(np.uint8))) if size else memoryview(b"")
        for begin in range(0, size, _SLAB):
            part = file.read(min(_SLAB, size - begin))
            place[begin : begin + len(part)] = part
            account.check_time()
        return array


@contextmanager
def _opened(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[BinaryIO]:
    with archive.open(info) as file:
        yield cast(BinaryIO, file)
