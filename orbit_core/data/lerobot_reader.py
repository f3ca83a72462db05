"""LeRobotDatasets v3.0, ours and others', as episodes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from orbit_core.data.episodes import (
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
    check_size,
    chosen,
)
from orbit_core.data.lerobot import ACTION, EPISODES, INFO, MANIFEST, PICTURE, SIMULATED, VERSION, arrow_modules
from orbit_core.data.manifest import Manifest
from orbit_core.data.video import read_video
from orbit_core.interfaces import ConfigurationError

_OWN = {ACTION: ACTIONS, "next.reward": REWARDS, "next.done": DONES, SIMULATED: STATES}
_PLACE = re.compile(r"\{(chunk_index|file_index|video_key)(:0?[1-9]d)?\}")
"""What a pattern of file names may hold; others could ask for names of any length."""
_INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")


class LeRobotDataset(Dataset):
    """A folder in LeRobot's layout.

    Raises:
        ConfigurationError: it is none, of another version, or damaged; says what.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._arrow, self._parquet = arrow_modules()
        if not (path / INFO).is_file():
            raise ConfigurationError(f"{path} is no LeRobot dataset: it has no {INFO}")
        with self._faults():
            self._info: dict[str, Any] = json.loads((path / INFO).read_text(encoding="utf-8"))
            version, self._features = self._info.get("codebase_version"), self._info["features"]
            if version != VERSION:
                raise ConfigurationError(
                    f"{path} is a LeRobot dataset of version {version}, and {VERSION} is the one that is read: convert "
                    "it with lerobot's own scripts first"
                )
            folders = sorted((path / "meta" / "episodes").glob("*/*.parquet"))
            self._rows = [row for each in folders for row in self._table(each).to_pylist()]
            self.manifest = self._read_manifest()
            self.episodes = self._infos()
            check_infos(self.episodes, str(path))
        self.masks = {}
        self._last: tuple[Path, Any] | None = None

    def read(self, position: int, names: Sequence[str] | None = None) -> Episode:
        row, info = self._rows[position], self.episodes[position]
        with self._faults():
            columns = self._columns(row)
            arrays = {name: array for name, array in self._numbers(columns).items() if chosen(name, names)}
            for key in self._features:
                if key.startswith(PICTURE) and chosen(name := OBSERVED + key.removeprefix(PICTURE), names):
                    arrays[name] = self._frames(row, key)
        episode = Episode(info, arrays)
        where = f"episode {position} of {self.path}"
        check_found(names, arrays, where)
        check_episode(episode, where, whole=names is None)
        return episode

    def _table(self, path: Path) -> Any:
        """A parquet file, whose numbers must be about as many as it has room for."""
        with self._parquet.ParquetFile(path) as file:
            told = file.metadata
            groups = [told.row_group(i) for i in range(told.num_row_groups)]
            values = sum(group.column(j).num_values for group in groups for j in range(told.num_columns))
            check_size(str(path.relative_to(self.path)), 8 * values, path.stat().st_size, str(self.path))
            return file.read()

    def _read_manifest(self) -> Manifest | None:
        path = self.path / MANIFEST
        return Manifest.decode(path.read_bytes(), str(path)) if path.is_file() else None

    def _infos(self) -> list[EpisodeInfo]:
        path = self.path / EPISODES
        if path.is_file():
            infos = msgspec.json.decode(path.read_bytes(), type=list[EpisodeInfo])
            if [info.length for info in infos] != [row["length"] for row in self._rows]:
                raise ConfigurationError(f"{path} tells of other episodes than meta/episodes of {self.path}")
            return infos
        return [EpisodeInfo(int(row["episode_index"]), int(row["length"])) for row in self._rows]

    def _columns(self, row: dict[str, Any]) -> dict[str, Array]:
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        path = self._within("data_path", place)
        if self._last is None or self._last[0] != path:
            self._last = (path, self._table(path))
        table = self._last[1]
        begin = int(row["dataset_from_index"]) - int(table["index"][0].as_py())
        table = table.slice(begin, int(row["length"]))
        return {name: _numbers(table[name].combine_chunks()) for name in table.column_names if name in self._features}

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

    def _frames(self, row: dict[str, Any], key: str) -> Array:
        place = {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
        path = self._within("video_path", {"video_key": key, **place})
        first = round(float(row[f"videos/{key}/from_timestamp"]) * float(self._info["fps"]))
        return read_video(path, first, int(row["length"]))

    def _within(self, template: str, place: dict[str, Any]) -> Path:
        """The file that one of the patterns of ``meta/info.json`` names."""
        pattern = self._info[template]
        if "{" in _PLACE.sub("", pattern):
            raise ConfigurationError(f"{template} of {self.path} is '{pattern[:80]}', which is no pattern that is read")
        name = pattern.format(**place)
        path = self.path / name
        if not path.resolve().is_relative_to(self.path.resolve()):
            raise ConfigurationError(f"{self.path} names {name}, which is outside of it and is not read")
        return path

    @contextmanager
    def _faults(self) -> Iterator[None]:
        """What is missing or damaged, as one sentence."""
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
    """(T,) or (T, K) of a column of numbers or of lists of equally many."""
    values = column.flatten() if hasattr(column.type, "value_type") else column
    array = values.to_numpy(zero_copy_only=False)
    return array.reshape(len(column), -1) if values is not column else array


def _terms(values: Array, names: Sequence[str], manifest: Manifest) -> dict[str, Array]:
    """Terms of the observation, of columns named ``<term>.<component>``, in their shapes."""
    columns: dict[str, list[int]] = {}
    if len(names) != values.shape[1]:
        raise ConfigurationError(f"{len(names)} names are told of {values.shape[1]} components")
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
