"""Check of a Zarr group's descriptions before zarr acts on them, and a store that checks each chunk.

zarr's codecs include Python's pickle, which executes code, and others unpack a few bytes to any number.
"""

from __future__ import annotations

import bz2
import json
import lzma
import math
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from zarr.abc.store import ByteRequest
from zarr.core.buffer import Buffer, BufferPrototype
from zarr.storage import LocalStore, WrapperStore, ZipStore

from orbit_core.interfaces import ConfigurationError
from orbit_data.reading.budget import DENSEST, MAX_DOCUMENT, SMALL, ReadAccount

_DESCRIPTIONS = (".zarray", ".zgroup", ".zattrs", ".zmetadata", "zarr.json")
_NUMBERS = re.compile(r"[<>|]?(b1|[iu][1248]|f[248])|bool|u?int(8|16|32|64)|float(16|32|64)")
_HARMLESS = ("bytes", "transpose", "shuffle", "crc32c")
# Bytes that a chunk's checksums may add.
_MARGIN = 64
# Limit of an array's missing chunks, each of which takes zarr some 60 microseconds.
_MOST_MISSING = 100_000
# First bytes of a frame of Zstandard, and the most bytes of a block.
_ZSTD_FRAME, _ZSTD_BLOCK = b"\x28\xb5\x2f\xfd", 1 << 17


@dataclass(frozen=True)
class ArrayLayout:
    """Description of an array, before any of its data is read."""

    name: str
    """Path within the group."""
    packing: str
    """Codec that packs the chunks; empty if none does."""
    shape: tuple[int, ...]
    """Extent along each axis, in elements."""
    chunks: tuple[int, ...]
    """Extent of a chunk along each axis, in elements."""
    itemsize: int
    """Bytes of an element."""

    @property
    def size(self) -> int:
        """Bytes of the array."""
        return math.prod(self.shape) * self.itemsize

    @property
    def chunk_size(self) -> int:
        """Bytes of a chunk."""
        return math.prod(self.chunks) * self.itemsize

    @property
    def chunk_count(self) -> int:
        """Number of chunks, missing ones included."""
        return math.prod(-(-extent // chunk) for extent, chunk in zip(self.shape, self.chunks, strict=True))


@dataclass(frozen=True)
class _Stored:
    """File of the group."""

    key: str
    packed: int
    """Bytes on the disk."""
    size: int
    """Bytes after unpacking from an archive."""
    read: Callable[[], bytes]


class ZarrFiles:
    """Files of a Zarr group, in a folder or an archive.

    Args:
        path: path of the folder or archive.
        account: account of the opening.

    Raises:
        ConfigurationError: a file is a link, or an array is stored in an unsupported way; the message names it.
    """

    def __init__(self, path: Path, account: ReadAccount) -> None:
        self.path = path
        self.layouts: dict[str, ArrayLayout] = {}
        """Arrays by their path within the group."""
        stored: dict[str, list[int]] = {}
        for file in self._files(account):
            account.check_time()
            folder, _, name = file.key.rpartition("/")
            if name in _DESCRIPTIONS:
                self._describe(file, folder)
            else:
                sizes = stored.setdefault(folder, [0, 0, 0])
                sizes[0], sizes[1], sizes[2] = sizes[0] + 1, sizes[1] + file.packed, max(sizes[2], file.size)
        for layout in self.layouts.values():
            below = [sizes for folder, sizes in stored.items() if f"{folder}/".startswith(f"{layout.name}/")]
            count, packed = sum(sizes[0] for sizes in below), sum(sizes[1] for sizes in below)
            self._check(layout, count, packed, max((sizes[2] for sizes in below), default=0))

    def store(self) -> Any:
        """Return a store for zarr, which checks each chunk before it is unpacked."""
        inner = ZipStore(self.path, mode="r") if self.path.is_file() else LocalStore(self.path, read_only=True)
        return _CheckedStore(inner, self)

    def check_chunk(self, key: str, data: bytes) -> None:
        """Refuse a chunk that unpacks to more bytes than a chunk of its array.

        Args:
            key: path of the chunk within the group.
            data: stored bytes.

        Raises:
            ConfigurationError: the chunk is too large.
        """
        layout = next((each for each in self.layouts.values() if key.startswith(f"{each.name}/")), None)
        if layout is None:
            return
        most = layout.chunk_size + _MARGIN
        if _unpacked(layout.packing, data, most) > most:
            raise ConfigurationError(
                f"{key} of {self.path} unpacks to more than the {layout.chunk_size:,} bytes of a chunk: it is made to "
                "fill the memory"
            )

    def _files(self, account: ReadAccount) -> Iterator[_Stored]:
        if self.path.is_file():
            with zipfile.ZipFile(self.path) as archive:
                for info in archive.infolist():
                    yield _Stored(
                        info.filename, info.compress_size, info.file_size, lambda info=info: archive.read(info)
                    )
            return
        for each in self.path.rglob("*"):
            account.check_time()
            if each.is_symlink():
                raise ConfigurationError(f"{each} is a link, which may lead to any file and is not followed")
            if each.is_file():
                size = each.stat().st_size
                yield _Stored(each.relative_to(self.path).as_posix(), size, size, each.read_bytes)

    def _describe(self, file: _Stored, folder: str) -> None:
        if file.size > MAX_DOCUMENT:
            raise ConfigurationError(f"{file.key} of {self.path} has {file.size:,} bytes, which no description needs")
        name = file.key.rpartition("/")[2]
        if folder.count("/") != 1 or name not in (".zarray", "zarr.json"):
            return  # not an array that is read
        described = json.loads(file.read())
        if name == ".zarray":
            packings = _packings_of_v2(described)
            self.layouts[folder] = self._layout(folder, described, described["dtype"], described["chunks"], packings)
        elif described["node_type"] == "array":
            grid, packings = described["chunk_grid"]["configuration"]["chunk_shape"], _packings_of_v3(described)
            self.layouts[folder] = self._layout(folder, described, described["data_type"], grid, packings)

    def _layout(self, name: str, told: Any, dtype: Any, chunks: Any, packings: list[str]) -> ArrayLayout:
        where = f"'{name}' of {self.path}"
        if not isinstance(dtype, str) or not _NUMBERS.fullmatch(dtype):
            raise ConfigurationError(f"{where} holds {str(dtype)[:60]}, which is not read: only real numbers are")
        for packing in packings:
            if packing not in (*_HARMLESS, *_UNPACKED):
                raise ConfigurationError(f"{where} is stored by the codec '{packing[:60]}', which is not read")
        packed = [place for place, each in enumerate(packings) if each in _UNPACKED]
        # A codec after a packing would be applied to packed bytes; only a checksum is useful there.
        if len(packed) > 1 or (packed and {*packings[packed[0] + 1 :]} - {"crc32c"}):
            raise ConfigurationError(f"{where} is packed more than once, which is not read: {', '.join(packings)}")
        extents = (*told["shape"], *chunks)
        if any(type(extent) is not int or not 0 <= extent < 2**62 for extent in extents) or 0 in chunks:
            raise ConfigurationError(f"{where} has shape {told['shape']} in chunks of {chunks}"[:200])
        packing = packings[packed[0]] if packed else ""
        return ArrayLayout(name, packing, tuple(told["shape"]), tuple(chunks), np.dtype(dtype).itemsize)

    def _check(self, layout: ArrayLayout, count: int, packed: int, largest: int) -> None:
        where = f"'{layout.name}' of {self.path}"
        if layout.size > max(SMALL, DENSEST * packed):
            raise ConfigurationError(
                f"{where} would be {layout.size / 1e9:.3g} GB, of which next to nothing is stored: it is truncated or "
                "made to fill the memory"
            )
        if layout.chunk_size > max(SMALL, layout.size) or largest > max(SMALL, 2 * layout.chunk_size):
            raise ConfigurationError(
                f"{where} has {layout.size:,} bytes in chunks of {layout.chunk_size:,}, and files of up to "
                f"{largest:,}: it is made to fill the memory"
            )
        if layout.chunk_count - count > _MOST_MISSING:
            raise ConfigurationError(f"{where} lacks {layout.chunk_count - count:,} of its chunks: it is truncated")


class _CheckedStore(WrapperStore[Any]):
    """Store that checks chunks."""

    def __init__(self, store: Any, files: ZarrFiles) -> None:
        super().__init__(store)
        self._files = files

    def _with_store(self, store: Any) -> _CheckedStore:
        return _CheckedStore(store, self._files)

    async def get(self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None) -> Buffer | None:
        """Return the data under a key, None if there is none."""
        found = await super().get(key, prototype, byte_range)
        if found is not None and key.rpartition("/")[2] not in _DESCRIPTIONS:
            self._files.check_chunk(key, found.to_bytes())
        return found


def _packings_of_v2(told: Any) -> list[str]:
    """Return the codecs of an array of format 2, in the order of packing."""
    return [_codec_name(each) for each in (*(told.get("filters") or ()), told.get("compressor")) if each is not None]


def _packings_of_v3(told: Any) -> list[str]:
    """Return the codecs of an array of format 3, in the order of packing."""
    others = ["storage transformers"] if told.get("storage_transformers") else []
    return [*(_codec_name(each) for each in told["codecs"]), *others]


def _codec_name(codec: Any) -> str:
    name = codec if isinstance(codec, str) else codec.get("id", codec.get("name"))
    settings = {} if isinstance(codec, str) else {**codec, **(codec.get("configuration") or {})}
    if name in ("lzma", "numcodecs.lzma") and (settings.get("format", 1) != 1 or settings.get("filters")):
        return "lzma without a header"  # whose settings can request any memory
    return str(name).removeprefix("numcodecs.")


def _unpacked_by(make: Callable[[], Any], ratio: int) -> Callable[[bytes, int], int]:
    """Return a function that counts the bytes, up to one more than ``most``, that a stream unpacks to."""

    def count(data: bytes, most: int) -> int:
        if ratio * len(data) <= SMALL:  # no trial: even the highest ratio would be harmless
            return 0
        size = 0
        while data and size <= most:
            unpacker = make()  # a new one for each stream: these formats allow several one after the other
            size += len(unpacker.decompress(data, most + 1 - size))
            data = unpacker.unused_data if unpacker.eof else b""
        return size

    return count


def _zstd_size(data: bytes, most: int) -> int:
    """Count the bytes of a frame of Zstandard (RFC 8878): by its header, or by the most that its blocks can hold."""
    if data[:4] != _ZSTD_FRAME or len(data) < 6:
        return 0
    flag, single = data[4] >> 6, data[4] >> 5 & 1
    place = 5 + (not single) + (0, 1, 2, 4)[data[4] & 3]
    if width := (single, 2, 4, 8)[flag]:
        return int.from_bytes(data[place : place + width], "little") + 256 * (flag == 1)
    size, last = -_ZSTD_BLOCK, False  # the last block may be almost empty, so it does not count
    while not last and place + 3 <= len(data) and size <= most:
        header = int.from_bytes(data[place : place + 3], "little")
        last, kind, length = bool(header & 1), header >> 1 & 3, header >> 3
        size += _ZSTD_BLOCK if kind == 2 else length  # 2 is a compressed block, which does not state its size
        place += 3 + (1 if kind == 1 else length)  # 1 is one byte that is repeated
    return size


# Counts of the bytes that each packing unpacks to, from what is stored.
_UNPACKED: dict[str, Callable[[bytes, int], int]] = {
    "blosc": lambda data, most: int.from_bytes(data[4:8], "little"),
    "lz4": lambda data, most: int.from_bytes(data[:4], "little"),
    "zstd": _zstd_size,
    "gzip": _unpacked_by(lambda: zlib.decompressobj(31), 1032),
    "zlib": _unpacked_by(zlib.decompressobj, 1032),
    "bz2": _unpacked_by(bz2.BZ2Decompressor, 1 << 20),
    "lzma": _unpacked_by(lambda: lzma.LZMADecompressor(memlimit=1 << 28), 1 << 20),
}


def _unpacked(packing: str, data: bytes, most: int) -> int:
    return _UNPACKED[packing](data, most) if packing else len(data)
