"""Numbers and texts of an HDF5 file, read within a budget; nothing outside of the file is opened.

HDF5 can refer to other files (soft and external links, external and virtual data), give an object two names, contain
Python objects, and unpack a few bytes to any number. All of these are refused before h5py acts on them.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_data.reading.budget import SMALL, ReadAccount, check_name

Array = npt.NDArray[Any]

# Errors that h5py raises for damaged files.
_FAULTS = (
    OSError, RuntimeError, KeyError, AttributeError, ValueError, TypeError, MemoryError, OverflowError, IndexError,
    NotImplementedError, RecursionError, zlib.error,
)  # fmt: skip
_GZIP, _SHUFFLE, _CHECKSUM, _LZF = 1, 2, 3, 32000
# Limits of each compression's ratio: of deflate by its format, of lzf by its longest copy.
_RATIOS = {_GZIP: 1032, _LZF: 90}
# Bytes up to which a chunk is read without a trial: HDF5 itself does not stop unpacking at the chunk's size.
_UNCHECKED = 1 << 28
# Bytes that are read between two checks of the time.
_SLAB = 1 << 25
# Limit of the nesting of groups.
_DEEPEST = 16


class Hdf5File:
    """HDF5 file opened to read its groups, attributes and arrays of numbers.

    Args:
        path: path of the file.
        what: kind of the file for messages: "dataset" or "recording".

    Raises:
        ConfigurationError: h5py is not installed, the file does not exist, or it is not HDF5.
    """

    def __init__(self, path: Path, what: str) -> None:
        self.path = path
        self._what = what
        self._h5py = hdf5_module()
        self._paths: dict[int, str] = {}
        if not path.is_file():
            raise ConfigurationError(f"there is no file {path}")
        with self.faults("the file"):
            self._file = self._h5py.File(path, "r")
            self.root: Any = self._file["/"]
            """Root group, for reading attributes and members."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def names(self, group: Any) -> list[str]:
        """Return the names in a group.

        Raises:
            ConfigurationError: a name cannot be printed or is a path.
        """
        found = [*group]
        for name in found:
            check_name(name, f"'{group.name}' of {self.path}")
        return found

    def group(self, group: Any, name: str) -> Any:
        """Return a group by name, or None if it does not exist.

        Raises:
            ConfigurationError: the name belongs to a link or an array, or the group has a second name.
        """
        found = self.child(group, name)
        if found is not None and not self.is_group(found):
            raise ConfigurationError(f"'{found.name}' of {self.path} is an array, and no group of arrays")
        return found

    def child(self, group: Any, name: str) -> Any:
        """Return a group or array by name, or None if it does not exist; links are not followed.

        Raises:
            ConfigurationError: the name belongs to a link or another type, or the object has a second name.
        """
        link = group.get(name, getlink=True)
        if link is None:
            return None
        place = f"{group.name.rstrip('/')}/{name}"
        where = f"'{place}' of {self.path}"
        if not isinstance(link, self._h5py.HardLink):
            raise ConfigurationError(f"{where} is a link, which is not followed")
        found = group[name]
        if not isinstance(found, self._h5py.Group | self._h5py.Dataset):
            raise ConfigurationError(f"{where} is neither a group nor an array")
        # Two names of each of forty nested groups would be 2 ** 40 arrays.
        other = self._paths.setdefault(self._h5py.h5o.get_info(found.id).addr, place)
        if other != place:
            raise ConfigurationError(f"{where} is '{other}' by another name, which is not read")
        if place.count("/") > _DEEPEST:
            raise ConfigurationError(f"{where} is within more than {_DEEPEST} groups")
        return found

    def is_group(self, child: Any) -> bool:
        """Return True if a child is a group."""
        return isinstance(child, self._h5py.Group)

    def text(self, group: Any, name: str, most: int) -> str | None:
        """Return an attribute that is one text, or None if there is none.

        Args:
            group: group with the attribute.
            name: name of the attribute.
            most: limit of its characters.

        Raises:
            ConfigurationError: the text is longer.
        """
        value = self._attribute(group, name)
        if isinstance(value, str) and len(value) > most:
            raise ConfigurationError(f"{name} of '{group.name}' of {self.path} has {len(value):,} characters")
        return value if isinstance(value, str) else None

    def integer(self, group: Any, name: str) -> int | None:
        """Return an attribute that is one integer, or None if there is none."""
        value = self._attribute(group, name)
        return int(value) if isinstance(value, np.integer | int) else None

    def numbers(self, group: Any, name: str, account: ReadAccount, kinds: str = "fiub") -> Array:
        """Read an array.

        Args:
            group: group with the array.
            name: name of the array.
            account: account of the bytes and time that are used.
            kinds: letters of the allowed NumPy types; ``S`` for texts of fixed length.

        Raises:
            ConfigurationError: the array does not exist, has another type, or exceeds the budget.
        """
        dataset = self._checked(group, name, kinds)
        stored = dataset.id.get_storage_size()
        account.take(dataset.name, dataset.nbytes, stored)
        if not dataset.shape or not dataset.nbytes:
            return np.asarray(dataset[()])
        found = np.empty(dataset.shape, dataset.dtype)
        row = dataset.nbytes // len(dataset)
        # Whole chunks of rows at a time, so that none is unpacked twice.
        step = dataset.chunks[0] if dataset.chunks else 1
        step *= max(1, _SLAB // (row * step))
        for begin in range(0, len(dataset), step):
            rows = np.s_[begin : begin + step]
            dataset.read_direct(found, rows, rows)
            account.check_time()
        return found

    def texts(self, group: Any, name: str, most: int) -> list[str]:
        """Read a list of texts, of fixed or variable length.

        Args:
            group: group with the list.
            name: name of the list.
            most: limit of the number of texts, and of the characters of each.

        Raises:
            ConfigurationError: there is no such list, or it is longer.
        """
        dataset = self._checked(group, name, "SO")
        where = f"'{dataset.name}' of {self.path}"
        if self._h5py.check_string_dtype(dataset.dtype) is None or dataset.ndim != 1 or len(dataset) > most:
            raise ConfigurationError(f"{where} is no list of at most {most:,} texts")
        found: list[str] = []
        for place in range(len(dataset)):  # one by one, because all may refer to the same long text
            text = dataset.asstr()[place]
            if len(text) > most:
                raise ConfigurationError(f"{where} holds a text of {len(text):,} characters")
            found.append(text)
        return found

    @contextmanager
    def faults(self, what: str) -> Iterator[None]:
        """Turn the library's errors into one sentence.

        Raises:
            ConfigurationError: an operation on ``what`` failed.
        """
        try:
            yield
        except _FAULTS as error:
            reason = str(error).strip().partition("\n")[0]
            raise ConfigurationError(
                f"{what} of {self.path} cannot be read ({reason}): it is truncated, damaged or no HDF5 {self._what}"
            ) from None

    def _attribute(self, group: Any, name: str) -> Any:
        if name not in group.attrs:
            return None
        # By its id: reading an attribute through h5py would already unpack its value.
        attribute = group.attrs.get_id(name)
        if attribute.shape != () or attribute.dtype.kind not in "OSiu" or attribute.get_storage_size() > SMALL:
            return None
        return group.attrs[name]

    def _checked(self, group: Any, name: str, kinds: str) -> Any:
        """Return an array after checking its type and storage.

        Raises:
            ConfigurationError: the array does not exist, or must not be read.
        """
        dataset = self.child(group, name)
        where = f"'{group.name.rstrip('/')}/{name}' of {self.path}"
        if dataset is None or self.is_group(dataset):
            raise ConfigurationError(f"{where} is no array")
        if dataset.dtype.kind not in kinds or dataset.is_virtual or dataset.external:
            raise ConfigurationError(
                f"{where} holds {dataset.dtype} or data of other files, which is not read: only numbers in the file are"
            )
        self._check_storage(dataset, where)
        return dataset

    def _check_storage(self, dataset: Any, where: str) -> None:
        """Refuse filters and chunks that could unpack to more than the array's size.

        Raises:
            ConfigurationError: the storage is refused; the message names the reason.
        """
        if dataset.id.get_storage_size() > self.path.stat().st_size:
            raise ConfigurationError(f"{where} would be larger than its file: it is truncated or damaged")
        if not dataset.chunks:
            return
        chunk = math.prod(dataset.chunks) * dataset.dtype.itemsize
        # HDF5 allocates whole chunks, even for an array of a few numbers.
        if chunk > max(SMALL, dataset.nbytes):
            raise ConfigurationError(
                f"{where} has {dataset.nbytes:,} bytes in chunks of {chunk:,}: the file is made to fill the memory"
            )
        plan = dataset.id.get_create_plist()
        filters = {number: values for number, _, values, _ in map(plan.get_filter, range(plan.get_nfilters()))}
        compressed = [number for number in filters if number in _RATIOS]
        # Two compressions multiply their ratios. The dictionary hides a filter that comes twice, so compare the count.
        if (
            not filters.keys() <= {*_RATIOS, _SHUFFLE, _CHECKSUM}
            or len(filters) < plan.get_nfilters()
            or len(compressed) > 1
            or any(size > chunk for size in filters.get(_LZF, ())[2:3])
        ):
            raise ConfigurationError(
                f"{where} is packed otherwise than once by gzip or lzf, with shuffle or checksums: rewrite it with "
                "'h5repack -f GZIP=4', if you trust it"
            )
        if compressed and _RATIOS[compressed[0]] * dataset.id.get_storage_size() > _UNCHECKED:
            self._check_chunks(dataset, compressed[0], chunk, where)

    def _check_chunks(self, dataset: Any, packing: int, chunk: int, where: str) -> None:
        large: list[Any] = []

        def gather(info: Any) -> None:
            if _RATIOS[packing] * info.size > _UNCHECKED:
                large.append(info)

        dataset.id.chunk_iter(gather)
        for info in large:
            # lzf unpacks to the size in its settings, which is checked above; deflate must be tried.
            if packing == _LZF:
                small = info.size <= 2 * chunk
            else:
                data = dataset.id.read_direct_chunk(info.chunk_offset)[1]
                small = bool(info.filter_mask) or len(zlib.decompressobj().decompress(data, chunk + 1)) <= chunk
            if not small:
                raise ConfigurationError(f"a chunk of {where} unpacks to more than its size: it is made to do harm")


def hdf5_module() -> Any:
    """Return h5py.

    Raises:
        ConfigurationError: it is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise ConfigurationError(f"HDF5 needs h5py: {install_extra('data')}") from error
    return h5py
