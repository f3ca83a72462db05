"""Reader of LeRobot datasets v3.0, of ORBIT and others."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from orbit_core.files import as_path, read_bytes
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import (
    ACTIONS,
    DONES,
    OBSERVED,
    REWARDS,
    STATES,
    Array,
    Dataset,
    Episode,
    EpisodeInfo,
    check_episode,
    check_found,
    check_infos,
    chosen,
)
from orbit_data.lerobot import ACTION, EPISODES, INFO, MANIFEST, PICTURE, SIMULATED, VERSION, read_video
from orbit_data.manifest.manifest import Manifest
from orbit_data.reading.budget import MAX_DOCUMENT, ReadAccount, ReadBudget, check_name
from orbit_data.reading.parquet import arrow_modules, read_columns
from orbit_data.tensor_file import parse_json

_OWN = {ACTION: ACTIONS, "next.reward": REWARDS, "next.done": DONES, SIMULATED: STATES}
# Fields that a pattern of file names may contain; others could produce names of any length.
_PLACE = re.compile(r"\{(chunk_index|file_index|video_key)(:0?[1-9]d)?\}")
# Bytes of memory for one number of meta/episodes.
_ROW_BYTES = 100
# Limit in bytes of the facts of all episodes, each of which takes about 200.
_MOST_INFOS = 1 << 25
_INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")


class LeRobotDataset(Dataset):
    """Dataset in a folder of LeRobot's layout.

    Args:
        path: path of the folder.
        budget: limits of memory and time for opening it, and for reading each episode.

    Raises:
        ConfigurationError: the folder is not a dataset, of another version, or damaged.
    """

    def __init__(self, path: Path | str, budget: ReadBudget = ReadBudget()) -> None:
        self.path, self.budget = as_path(path), budget
        self._arrow, _ = arrow_modules()
        if self._file(INFO) is None:
            raise ConfigurationError(f"{path} is no LeRobot dataset: it has no {INFO}")
        with self._faults():
            account = ReadAccount(budget, str(self.path))
            self._info = parse_json(self._document(INFO, MAX_DOCUMENT) or b"{}")
            version, self._features = self._info.get("codebase_version"), self._info["features"]
            if version != VERSION:
                raise ConfigurationError(
                    f"{path} is a LeRobot dataset of version {version}, and {VERSION} is the one that is read: convert "
                    "it with lerobot's own scripts first"
                )
            for name in self._features:
                check_name(name, f"{INFO} of {self.path}")
            self._rows = self._read_rows(account)
            self.manifest = self._read_manifest()
            self.episodes = self._infos()
            check_infos(self.episodes, account)
            self._check_order()
        self.masks = {}
        self._last: tuple[Path, Any] | None = None

    def read(self, position: int, names: Sequence[str] | None = None) -> Episode:
        row, info = self._rows[position], self.episodes[position]
        where = f"episode {position} of {self.path}"
        with self._faults():
            account = ReadAccount(self.budget, where)
            columns = self._columns(row, account)
            arrays = {name: array for name, array in self._numbers(columns).items() if chosen(name, names)}
            for key in self._features:
                if key.startswith(PICTURE) and chosen(name := OBSERVED + key.removeprefix(PICTURE), names):
                    arrays[name] = self._frames(row, key, account)
        episode = Episode(info, arrays)
        check_found(names, arrays, where)
        check_episode(episode, where, whole=names is None)
        return episode

    def _file(self, name: str) -> Path | None:
        """Return the path of a file within the folder, or None if it does not exist.

        Raises:
            ConfigurationError: the name leads out of the folder, or through a link.
        """
        path = self.path / name
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise ConfigurationError(f"{self.path} names {name[:80]}, which is outside of it and is not read")
        # Every folder on the way, because a linked folder leads out of the dataset just as a linked file.
        for part in (path, *path.parents):
            if part == self.path:
                break
            if part.is_symlink():
                raise ConfigurationError(
                    f"{part} is a link, which may lead to any file and is not followed: copy the dataset with 'cp -rL'"
                )
        return path if path.is_file() else None

    def _document(self, name: str, most: int) -> bytes | None:
        """Return the content of a file, or None if it does not exist."""
        path = self._file(name)
        return None if path is None else read_bytes(path, most)

    def _read_rows(self, account: ReadAccount) -> list[dict[str, Any]]:
        """Read where each episode is.

        Raises:
            ConfigurationError: episodes are missing.
        """
        rows: list[dict[str, Any]] = []
        for each in sorted((self.path / "meta" / "episodes").glob("*/*.parquet")):
            path = self._file(each.relative_to(self.path).as_posix())
            if path is None:
                raise ConfigurationError(f"{each} is no regular file")
            # Statistics are many columns for each feature, and are not used here.
            table = read_columns(path, lambda name: not name.startswith("stats/"), account)
            account.take(path.name, _ROW_BYTES * table.num_rows * table.num_columns)
            rows += table.to_pylist()
        rows.sort(key=lambda row: row["episode_index"])
        numbers, total = [row["episode_index"] for row in rows], self._info["total_episodes"]
        if numbers != [*range(len(rows))] or len(rows) != total:
            missing = next((place for place, number in enumerate(numbers) if place != number), len(rows))
            raise ConfigurationError(
                f"meta/episodes of {self.path} has {len(rows):,} episodes, of which {missing:,} are numbered one after "
                f"the other from 0, and {INFO} states that there are {total}: the dataset is not complete"
            )
        return rows

    def _read_manifest(self) -> Manifest | None:
        data = self._document(MANIFEST, MAX_DOCUMENT)
        return None if data is None else Manifest.decode(data, str(self.path / MANIFEST))

    def _infos(self) -> list[EpisodeInfo]:
        data = self._document(EPISODES, _MOST_INFOS)
        if data is not None:
            infos = msgspec.json.decode(data, type=list[EpisodeInfo])
            if [info.length for info in infos] != [row["length"] for row in self._rows]:
                raise ConfigurationError(
                    f"{self.path / EPISODES} describes other episodes than meta/episodes of {self.path}"
                )
            return infos
        return [EpisodeInfo(int(row["episode_index"]), int(row["length"])) for row in self._rows]

    def _check_order(self) -> None:
        """Refuse overlapping episodes, of which a small file could contain any number.

        Raises:
            ConfigurationError: episodes overlap; the message names the second.
        """
        for last, row in itertools.pairwise(self._rows):
            if row["dataset_from_index"] < last["dataset_from_index"] + last["length"]:
                raise ConfigurationError(
                    f"episode {row['episode_index']} of {self.path} would begin before the end of the one before"
                )

    def _columns(self, row: dict[str, Any], account: ReadAccount) -> dict[str, Array]:
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        path = self._within("data_path", place)
        if self._last is None or self._last[0] != path:
            self._last = None  # before the next file is read, so that memory holds one at a time
            self._last = (path, read_columns(path, self._features.__contains__, account))
        table = self._last[1]
        account.take(path.name, table.nbytes)
        # Indices count over the whole dataset, and a file begins at that of its first row.
        begin = int(row["dataset_from_index"]) - int(table["index"][0].as_py())
        table = table.slice(begin, int(row["length"]))
        return {name: _numbers(table[name].combine_chunks()) for name in table.column_names}

    def _numbers(self, columns: dict[str, Array]) -> dict[str, Array]:
        arrays: dict[str, Array] = {}
        for name, values in columns.items():
            if name in _OWN:
                arrays[_OWN[name]] = values
            elif self.manifest is not None and (named := self._features[name]["names"]):
                arrays |= _terms(values, named, self.manifest)
            elif name.startswith("observation."):
                arrays[OBSERVED + name.removeprefix("observation.")] = values
            elif name not in _INDICES and values.dtype.kind in "fiub":
                arrays[name] = values
        return arrays

    def _frames(self, row: dict[str, Any], key: str, account: ReadAccount) -> Array:
        place = {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
        path = self._within("video_path", {"video_key": key, **place})
        first = round(float(row[f"videos/{key}/from_timestamp"]) * float(self._info["fps"]))
        return read_video(path, first, int(row["length"]), account)

    def _within(self, template: str, place: dict[str, Any]) -> Path:
        """Return the path of a file by one of the patterns of ``meta/info.json``."""
        pattern = self._info[template]
        if "{" in _PLACE.sub("", pattern):
            raise ConfigurationError(f"{template} of {self.path} is '{pattern[:80]}', which is not a supported pattern")
        name = pattern.format(**place)
        path = self._file(name)
        if path is None:
            raise ConfigurationError(f"{self.path} has no file {name[:80]}, which one of its episodes is in")
        return path

    @contextmanager
    def _faults(self) -> Iterator[None]:
        """Turn errors of damaged files into one sentence."""
        wrong = (
            OSError, KeyError, ValueError, TypeError, IndexError, AttributeError, MemoryError, OverflowError,
            ZeroDivisionError, RecursionError, msgspec.MsgspecError,
        )  # fmt: skip
        try:
            yield
        except (*wrong, self._arrow.ArrowException) as error:
            reason = str(error).strip().partition("\n")[0]
            raise ConfigurationError(f"{self.path} cannot be read as a LeRobot dataset: {reason}") from None


def _numbers(column: Any) -> Array:
    """Convert a column of numbers, or of lists of equal length, to (T,) or (T, K)."""
    values = column.flatten() if hasattr(column.type, "value_type") else column
    array = values.to_numpy(zero_copy_only=False)
    return array.reshape(len(column), -1) if values is not column else array


def _terms(values: Array, names: Sequence[str], manifest: Manifest) -> dict[str, Array]:
    """Split columns named ``<term>.<component>`` into the observation's terms, in their shapes."""
    columns: dict[str, list[int]] = {}
    if len(names) != values.shape[1]:
        raise ConfigurationError(f"{len(names)} names are given for {values.shape[1]} components")
    for place, name in enumerate(names):
        columns.setdefault(name.rpartition(".")[0], []).append(place)
    shapes = {
        (name if group == "policy" else f"{group}/{name}"): term.shape
        for group, layout in manifest.observations.items()
        for name, term in layout.terms.items()
    }
    arrays: dict[str, Array] = {}
    for name, own in columns.items():
        arrays[OBSERVED + name] = values[:, own].reshape(len(values), *shapes.get(name, (len(own),)))
    return arrays
