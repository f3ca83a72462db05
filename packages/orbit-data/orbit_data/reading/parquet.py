"""Columns of numbers of a Parquet file, read within a budget.

pyarrow unpacks each page to as many bytes as the page's own header states, even if the rest of the file contradicts it.
Therefore these headers, of Thrift's compact protocol (https://parquet.apache.org/docs/file-format/), are read first.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_data.reading.budget import ReadAccount

# Bytes of a number of each type; columns of other types, such as texts, are not read.
_SIZES = {"BOOLEAN": 1, "INT32": 4, "INT64": 8, "FLOAT": 4, "DOUBLE": 8}
# Limit of the nesting of structures in a page's header.
_DEEPEST = 8
_MOST_COLUMNS = 10_000
_MOST_TEXTS, _LONGEST_TEXT = 10_000, 1_000


def read_columns(path: Path, wanted: Callable[[str], bool], account: ReadAccount) -> Any:
    """Return a table of the columns that contain numbers, or lists of numbers.

    Args:
        path: path of the file.
        wanted: returns whether the column of a name is read.
        account: account of the bytes and time that are used.

    Raises:
        ConfigurationError: pyarrow is not installed, or the budget is exceeded.
    """
    arrow, parquet = arrow_modules()
    with parquet.ParquetFile(path) as file:
        metadata, schema = file.metadata, file.schema_arrow
        if metadata.num_columns > _MOST_COLUMNS:
            raise ConfigurationError(f"{path} has {metadata.num_columns:,} columns, more than {_MOST_COLUMNS:,}")
        names = [field.name for field in schema if wanted(field.name) and _is_numeric(arrow, field.type)]
        with path.open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for number in range(metadata.num_row_groups):
                group = metadata.row_group(number)
                for column in map(group.column, range(metadata.num_columns)):
                    account.check_time()
                    if column.path_in_schema.split(".")[0] in {name.split(".")[0] for name in names}:
                        _check_column(data, column, path.name, account)
        # One thread, so that one page at a time is unpacked: the account counts the largest page once.
        return file.read(columns=names, use_threads=False)


def read_texts(path: Path, account: ReadAccount) -> list[str]:
    """Return the texts of a short table's only column of texts, in its rows' order; empty if it has none.

    Args:
        path: path of the file.
        account: account of the bytes and time that are used.

    Raises:
        ConfigurationError: there are too many texts, one is too long, or the budget is exceeded.
    """
    arrow, parquet = arrow_modules()
    with parquet.ParquetFile(path) as file:
        names = [field.name for field in file.schema_arrow if arrow.types.is_string(field.type)][:1]
        if not names:
            return []
        if file.metadata.num_rows > _MOST_TEXTS:
            raise ConfigurationError(f"{path} has {file.metadata.num_rows:,} texts, more than {_MOST_TEXTS:,}")
        with path.open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for number in range(file.metadata.num_row_groups):
                group = file.metadata.row_group(number)
                for column in map(group.column, range(group.num_columns)):
                    if column.path_in_schema == names[0]:
                        largest = max((page.unpacked for page in _pages(data, column)), default=0)
                        account.take(f"texts of {path.name}", largest, column.total_compressed_size)
    # As a dictionary: a short file could refer to one long text in every row.
    with parquet.ParquetFile(path, read_dictionary=names) as file:
        texts = file.read(columns=names, use_threads=False)[names[0]].combine_chunks()
    longest = max((len(text) for text in texts.dictionary.to_pylist() if text), default=0)
    if longest > _LONGEST_TEXT:
        raise ConfigurationError(f"{path} has a text of {longest:,} characters, more than {_LONGEST_TEXT:,}")
    return [text or "" for text in texts.to_pylist()]


def arrow_modules() -> tuple[Any, Any]:
    """Return pyarrow and its module for Parquet.

    Raises:
        ConfigurationError: it is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ConfigurationError(f"LeRobot datasets need pyarrow: {install_extra('lerobot')}") from error
    return pyarrow, pyarrow.parquet


def _is_numeric(arrow: Any, kind: Any) -> bool:
    types = arrow.types
    if types.is_list(kind) or types.is_fixed_size_list(kind) or types.is_large_list(kind):
        kind = kind.value_type
    return types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)


def _check_column(data: mmap.mmap, column: Any, where: str, account: ReadAccount) -> None:
    """Count the memory of a column of a row group: its values, and the largest of its pages."""
    name = f"{column.path_in_schema} of {where}"
    size = _SIZES.get(column.physical_type)
    if size is None:
        return
    values, largest = 0, 0
    for page in _pages(data, column):
        account.check_time()
        values += page.values
        largest = max(largest, page.unpacked)
    if values < column.num_values:
        raise ValueError(f"{name} would have {column.num_values:,} values, and its pages have {values:,}")
    account.take(name, size * values, column.total_compressed_size)
    account.take(f"a page of {name}", largest, column.total_compressed_size)


class _Page:
    """Sizes in a page's header."""

    def __init__(self, header: dict[int, Any]) -> None:
        # Field numbers of PageHeader in parquet.thrift; 5, 7 and 8 describe data, dictionary and version 2 data pages.
        self.unpacked, self.packed = int(header[2]), int(header[3])
        details = next((header[field] for field in (5, 7, 8) if field in header), {})
        self.values = int(details.get(1, 0))
        if min(self.unpacked, self.packed, self.values) < 0:
            raise ValueError("a page has a size below zero")


def _pages(data: mmap.mmap, column: Any) -> Iterator[_Page]:
    starts = [column.data_page_offset]
    if column.has_dictionary_page and column.dictionary_page_offset:
        starts.append(column.dictionary_page_offset)
    place = min(starts)
    end = place + column.total_compressed_size
    if not 0 <= place <= end <= len(data):
        raise ValueError("a column lies outside of its file")
    while place < end:
        header, place = _structure(data, place, 0)
        page = _Page(header)
        yield page
        place += page.packed


def _structure(data: mmap.mmap, place: int, depth: int) -> tuple[dict[int, Any], int]:
    """Return the fields of a structure, by number, and the place after it."""
    if depth > _DEEPEST:
        raise ValueError("a page's header nests too deeply")
    found: dict[int, Any] = {}
    field = 0
    while (head := data[place]) != 0:
        place += 1
        # The upper four bits are the difference to the last field's number, or zero if the number follows.
        if head >> 4:
            field += head >> 4
        else:
            field, place = _integer(data, place)
        found[field], place = _value(data, place, head & 15, depth)
    return found, place + 1


def _value(data: mmap.mmap, place: int, kind: int, depth: int) -> tuple[Any, int]:
    if kind in (1, 2):  # true and false
        return kind == 1, place
    if kind == 3:
        return data[place], place + 1
    if kind in (4, 5, 6):
        return _integer(data, place)
    if kind == 7:
        return None, place + 8
    if kind == 8:
        length, place = _varint(data, place)
        return None, place + length
    if kind == 12:
        return _structure(data, place, depth + 1)
    raise ValueError(f"a page's header holds a value of kind {kind}")


def _integer(data: mmap.mmap, place: int) -> tuple[int, int]:
    value, place = _varint(data, place)
    return value >> 1 ^ -(value & 1), place  # zigzag: the sign is the lowest bit


def _varint(data: mmap.mmap, place: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[place]
        value |= (byte & 127) << shift
        place, shift = place + 1, shift + 7
        if not byte & 128:
            return value, place
        if shift > 63:
            raise ValueError("a page's header holds a number that is too long")
