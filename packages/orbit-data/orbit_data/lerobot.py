"""LeRobotDataset v3.0: parquet for numbers, video for pictures, written without its hub.

The layout is that of LeRobot's documentation (https://huggingface.co/docs/lerobot/lerobot-dataset-v3): ``data/`` and
``videos/`` hold many episodes per file, ``meta/`` states where each begins. ``meta/orbit_manifest.json`` and
``meta/orbit_episodes.json`` are ORBIT's, and preserve what the layout cannot hold. Pictures of many episodes are in one
video file, from which each frame can be read.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from orbit_core.envs.observation_layout import POLICY
from orbit_core.files import as_path, read_bytes, storage_faults
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_data.card import CARD, is_card
from orbit_data.episodes import (
    ACTIONS,
    DONES,
    OBSERVED,
    REWARDS,
    STATES,
    TAUGHT,
    Array,
    Dataset,
    Episode,
    EpisodeInfo,
    check_episode,
    check_found,
    check_infos,
    chosen,
)
from orbit_data.manifest.manifest import Manifest
from orbit_data.noise import CLEAN
from orbit_data.reading.budget import MAX_DOCUMENT, ReadAccount, ReadBudget, check_name
from orbit_data.reading.parquet import arrow_modules, read_columns, read_texts
from orbit_data.tensor_file import parse_json

# Every second frame is a key frame, so that random access is fast; at crf 18 an eye sees almost no loss.
_EVERY_OTHER = {"g": "2", "crf": "18"}


# Decoders that datasets use. FFmpeg has hundreds more, which untrusted files must not reach.
_DECODERS = ("h264", "hevc", "libdav1d", "av1", "vp9", "mpeg4")


def write_video(path: Path | str, stretches: Iterable[Array], rate: int) -> None:
    """Write pictures as an H.264 video.

    Args:
        path: path of the file.
        stretches: pictures (T, H, W, 3) uint8, one part after the other.
        rate: frames per second.

    Raises:
        ConfigurationError: the encoder is not installed, or the pictures' sides are odd.
    """
    av = _av()
    with av.open(str(as_path(path)), "w") as file:
        stream: Any = None
        for frames in stretches:
            if stream is None:
                height, width = frames.shape[1:3]
                _check_sides(Path(path).name, height, width)
                stream = file.add_stream("libx264", rate=rate, options=_EVERY_OTHER)
                stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            for frame in frames:
                picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
                file.mux(stream.encode(picture))
        if stream is not None:
            file.mux(stream.encode())  # frames that the encoder still holds


def read_video(path: Path | str, first: int, count: int, account: ReadAccount) -> Array:
    """Read frames of a video.

    Args:
        path: path of an MP4 file.
        first: number of the first frame.
        count: number of frames.
        account: account of the bytes and time that are used.

    Returns:
        Pictures (count, H, W, 3) uint8.

    Raises:
        ConfigurationError: the decoder is not installed, or the file is damaged, too short or beyond the budget.
    """
    av, path = _av(), as_path(path)
    done = 0
    limit = {"max_pixels": str(account.budget.pixels)}  # for the decoder, which otherwise decodes frames of any size
    try:
        # An open file and a fixed format: other formats name further files, and URLs lead anywhere.
        with path.open("rb") as data, av.open(data, format="mp4", options=limit, stream_options=[limit]) as file:
            stream = file.streams.video[0]
            if stream.codec_context.name not in _DECODERS:
                raise ConfigurationError(
                    f"video {path} is packed by {stream.codec_context.name}, and none of {', '.join(_DECODERS)}"
                )
            account.check_picture(path.name, stream.width, stream.height)
            account.take(path.name, 3 * count * stream.width * stream.height)
            frames = np.empty((count, stream.height, stream.width, 3), np.uint8)
            step = 1.0 / (float(stream.average_rate) * float(stream.time_base))
            file.seek(round(first * step), stream=stream)
            for frame in file.decode(stream):
                account.check_time()
                if round(frame.pts / step) < first:  # the seek went to the key frame before
                    continue
                account.check_picture(path.name, frame.width, frame.height)
                frames[done] = frame.to_ndarray(format="rgb24")
                done += 1
                if done == count:
                    return frames
    except (av.FFmpegError, IndexError, OSError, TypeError, ValueError, ArithmeticError, MemoryError) as error:
        raise ConfigurationError(f"video {path} cannot be read: {error}") from None
    raise ConfigurationError(f"video {path} ends after {first + done} frames, before frame {first + count}")


def _av() -> Any:
    try:
        import av
    except ImportError as error:
        raise ConfigurationError(f"videos of datasets need PyAV: {install_extra('lerobot')}") from error
    return av


VERSION = "v3.0"
STATE_OF_GROUP = ".state"
"""Suffix of the column of an observation group that the policy does not see."""
STATE, ENVIRONMENT_STATE = "observation.state", "observation.environment_state"
ACTION, EXECUTED = "action", "executed_action"
"""Columns of the actions to learn, and of those that were executed where noise disturbed them."""
INTERVENTION = "complementary_info.is_intervention"
"""Column of the steps that a person led, under LeRobot's name."""
PICTURE, SIMULATED = "observation.images.", "simulation.state"
MANIFEST, EPISODES, INFO = "meta/orbit_manifest.json", "meta/orbit_episodes.json", "meta/info.json"
TASKS, STATISTICS = "meta/tasks.parquet", "meta/stats.json"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
# Files that ORBIT's datasets consist of, in addition to the card. A folder with any other file is never replaced.
_LAYOUT = re.compile(
    r"meta/(info|stats|orbit_manifest|orbit_episodes)\.json|meta/tasks\.parquet"
    r"|(meta/episodes|data)/chunk-\d{3,}/file-\d{3,}\.parquet|videos/[^/]+/chunk-\d{3,}/file-\d{3,}\.mp4"
)
_FILES_A_CHUNK = 1000
_STEPS_A_FILE = 50_000


@dataclass
class _Statistics:
    """Minimum, maximum, mean and deviation of each component, gathered episode by episode."""

    low: Array
    high: Array
    total: Array
    squares: Array
    count: int = 0

    @staticmethod
    def of(values: Array) -> _Statistics:
        rows = values.reshape(len(values), -1).astype(np.float64)
        return _Statistics(rows.min(0), rows.max(0), rows.sum(0), np.square(rows).sum(0), len(rows))

    def add(self, other: _Statistics) -> None:
        self.low, self.high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        self.total, self.squares = self.total + other.total, self.squares + other.squares
        self.count += other.count

    @staticmethod
    def read(table: Mapping[str, Any]) -> _Statistics:
        """Return the statistics that :meth:`table` wrote."""
        low, high, mean, deviation = (
            np.array(table[name], np.float64).ravel() for name in ("min", "max", "mean", "std")
        )
        count = int(table["count"][0])
        return _Statistics(low, high, mean * count, (deviation**2 + mean**2) * count, count)

    def table(self, picture: bool) -> dict[str, Any]:
        mean = self.total / self.count
        # Rounding can make the variance of a constant slightly negative.
        deviation = np.sqrt(np.maximum(self.squares / self.count - mean**2, 0.0))
        parts = {"min": self.low, "max": self.high, "mean": mean, "std": deviation}
        shape = (3, 1, 1) if picture else (-1,)
        return {**{n: v.reshape(shape).tolist() for n, v in parts.items()}, "count": [self.count]}


@dataclass
class LeRobotWriter:
    """Writer of episodes one after the other; :meth:`finish` completes the dataset.

    Args:
        path: path of the folder, which is created.
        task: what episodes show that name no instruction of their own.
        rate: steps per second, a whole number.
        robot: type of the robot.
        joint_terms: terms of the policy that are in ``observation.state``, :func:`joint_terms`; None for all.
    """

    path: Path
    task: str
    rate: int
    robot: str
    joint_terms: frozenset[str] | None = None
    features: dict[str, Any] = field(init=False, default_factory=dict)
    """Dtype, shape and names of each column, by its name in LeRobot's layout; known after the first episode."""
    left_out: set[str] = field(init=False, default_factory=set)
    """Names of arrays that the layout cannot store."""

    def __post_init__(self) -> None:
        self._rows: list[dict[str, Array]] = []
        self._pictures: dict[str, list[Array]] = {}
        self._episodes: list[dict[str, Any]] = []
        self._infos: list[EpisodeInfo] = []
        self._statistics: dict[str, _Statistics] = {}
        self._tasks: dict[str, int] = {}
        self._file = 0
        self._total = 0

    def extend(self, dataset: LeRobotDataset) -> None:
        """Begin with the episodes of a dataset that ORBIT wrote, before any other episode.

        Its files are linked, not read: numbers need no copy, and pictures that were encoded twice would lose quality.
        """
        files = (path for place in ("data", "videos") for path in sorted((dataset.path / place).rglob("file-*.*")))
        for path in files:
            target = self.path / path.relative_to(dataset.path)
            with storage_faults(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                try:
                    os.link(path, target)
                except OSError:  # a file system without hard links
                    shutil.copyfile(path, target)
        self._episodes, statistics = dataset.index()
        self._infos = [*dataset.episodes]
        self._tasks = dict(zip(dataset.instructions, itertools.count(), strict=False))
        self._statistics = {name: _Statistics.read(table) for name, table in statistics.items()}
        self.features = dict(dataset.features)
        self._total = sum(info.length for info in self._infos)
        last = max((row["data/chunk_index"], row["data/file_index"]) for row in self._episodes)
        self._file = last[0] * _FILES_A_CHUNK + last[1] + 1

    def add(self, episode: Episode) -> None:
        """Add an episode; files are written once they have enough steps."""
        if self._rows and sum(len(rows["index"]) for rows in self._rows) + episode.info.length > _STEPS_A_FILE:
            self._flush()
        pictures = {name: array for name, array in episode.named(OBSERVED).items() if is_film(name, array)}
        numbers = self._numbers(episode)
        self.left_out |= {
            name for name in episode.arrays
            if name not in (ACTIONS, CLEAN, REWARDS, DONES, STATES, TAUGHT) and not name.startswith(OBSERVED)
        }  # fmt: skip
        row = self._place(episode.info)
        begin = sum(len(rows["index"]) for rows in self._rows)
        for name, frames in pictures.items():
            key = PICTURE + name
            self.features.setdefault(key, _video_feature(frames, self.rate))
            self._pictures.setdefault(key, []).append(frames)
            # A tenth of the frames is enough for the mean colour, and ten times as fast.
            self._count(row, key, frames[::10].reshape(-1, 3) / 255.0, picture=True)
            row |= {f"videos/{key}/chunk_index": self._file // _FILES_A_CHUNK}
            row |= {f"videos/{key}/file_index": self._file % _FILES_A_CHUNK}
            row |= {f"videos/{key}/from_timestamp": begin / self.rate}
            row |= {f"videos/{key}/to_timestamp": (begin + episode.info.length) / self.rate}
        for name, values in numbers.items():
            self._count(row, name, values)
        self._rows.append(numbers)
        self._episodes.append(row)
        self._infos.append(episode.info)
        self._total += episode.info.length

    def finish(self, manifest: Manifest | None) -> None:
        """Write the last files and the description; ``meta/info.json`` comes last, because it makes the dataset valid.

        Raises:
            ConfigurationError: there are no episodes.
        """
        if not self._episodes:
            raise ConfigurationError(f"a LeRobot dataset needs at least one episode: none was given for {self.path}")
        if self._rows:
            self._flush()
        arrow, _ = arrow_modules()
        place = {"chunk_index": 0, "file_index": 0}
        self._write_table(_EPISODES_PATH.format(**place), arrow.Table.from_pylist(self._episodes))
        numbers = arrow.array([*self._tasks.values()], arrow.int64())
        tasks = arrow.table({"task_index": numbers, "__index_level_0__": [*self._tasks]})
        self._write_table(TASKS, tasks.replace_schema_metadata(_pandas_index()))
        self._write_text(EPISODES, msgspec.json.encode(self._infos).decode())
        if manifest is not None:
            self._write_text(MANIFEST, manifest.encode().decode())
        tables = {name: s.table(name.startswith(PICTURE)) for name, s in self._statistics.items()}
        self._write_text(STATISTICS, json.dumps(tables, indent=2))
        self._write_text(INFO, json.dumps(self._info(), indent=2))

    def _numbers(self, episode: Episode) -> dict[str, Array]:
        length, place = episode.info.length, len(self._episodes)
        numbers: dict[str, Array] = {}
        names: dict[str, list[str]] = {}
        for column, terms in self._columns_of(episode).items():
            flat = {name: array.reshape(length, -1).astype(np.float32) for name, array in terms.items()}
            numbers[column] = np.concatenate([*flat.values()], axis=1)
            names[column] = [f"{name}.{i}" for name, array in flat.items() for i in range(array.shape[1])]
        # Policies of LeRobot learn what is in its column of actions: those that the demonstrator chose.
        numbers[ACTION] = episode.arrays.get(CLEAN, episode.arrays[ACTIONS]).astype(np.float32)
        if CLEAN in episode.arrays:
            numbers[EXECUTED] = episode.arrays[ACTIONS].astype(np.float32)
        if TAUGHT in episode.arrays:
            numbers[INTERVENTION] = episode.arrays[TAUGHT].astype(np.bool_)
        if STATES in episode.arrays:
            numbers[SIMULATED] = episode.arrays[STATES].astype(np.float32)
        # LeRobot's names of rewards and ends begin with "next.": they are results of the action.
        frames = np.arange(length, dtype=np.int64)
        if REWARDS in episode.arrays:
            numbers["next.reward"] = episode.arrays[REWARDS].astype(np.float32)
        if DONES in episode.arrays:
            numbers["next.done"] = episode.arrays[DONES].astype(np.bool_)
        numbers |= {"timestamp": (frames / self.rate).astype(np.float32), "frame_index": frames}
        numbers |= {"episode_index": np.full_like(frames, place), "index": frames + self._total}
        told = episode.info.instruction or self.task
        numbers["task_index"] = np.full_like(frames, self._tasks.setdefault(told, len(self._tasks)))
        for name, values in numbers.items():
            feature = _feature(values, names.get(name))
            if self.features.setdefault(name, feature) != feature:
                raise ConfigurationError(f"'{name}' has {values.shape[1:]} in episode {place}, unlike in earlier ones")
        return numbers

    def _columns_of(self, episode: Episode) -> dict[str, dict[str, Array]]:
        """Return the terms of each column: those that the policy sees, other groups, and pictures without a video."""
        columns: dict[str, dict[str, Array]] = {}
        # By name, so that columns have one order whichever format the episodes come from.
        for name, array in sorted(episode.named(OBSERVED).items()):
            group, slash, _ = name.rpartition("/")
            if is_film(name, array):
                continue
            if slash:
                column = f"{group}{STATE_OF_GROUP}"
            elif array.ndim > 3:
                column = f"observation.{name}"
            else:
                column = state_column(name, self.joint_terms)
            columns.setdefault(column, {})[name] = array
        return columns

    def _place(self, info: EpisodeInfo) -> dict[str, Any]:
        chunk, number = divmod(self._file, _FILES_A_CHUNK)
        return {
            "episode_index": len(self._episodes),
            "tasks": [info.instruction or self.task],
            "length": info.length,
            "data/chunk_index": chunk,
            "data/file_index": number,
            "dataset_from_index": self._total,
            "dataset_to_index": self._total + info.length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }

    def _count(self, row: dict[str, Any], name: str, values: Array, picture: bool = False) -> None:
        own = _Statistics.of(values)
        row |= {f"stats/{name}/{key}": value for key, value in own.table(picture).items()}
        if name in self._statistics:
            self._statistics[name].add(own)
        else:
            self._statistics[name] = own

    def _flush(self) -> None:
        arrow, _ = arrow_modules()
        place = dict(zip(("chunk_index", "file_index"), divmod(self._file, _FILES_A_CHUNK), strict=True))
        columns = {n: np.concatenate([rows[n] for rows in self._rows]) for n in self._rows[0]}
        table = arrow.table({name: _column(arrow, values) for name, values in columns.items()})
        self._write_table(DATA_PATH.format(**place), table)
        for key, frames in self._pictures.items():
            target = self.path / VIDEO_PATH.format(video_key=key, **place)
            with storage_faults(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                write_video(target, frames, self.rate)
        self._rows, self._pictures = [], {}
        self._file += 1

    def _info(self) -> dict[str, Any]:
        return {
            "codebase_version": VERSION,
            "robot_type": self.robot,
            "total_episodes": len(self._episodes),
            "total_frames": self._total,
            "total_tasks": len(self._tasks),
            "chunks_size": _FILES_A_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 500,
            "fps": self.rate,
            # LeRobot's layout has named splits; this one has all episodes.
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if any(name.startswith(PICTURE) for name in self.features) else None,
            "features": self.features,
        }

    def _write_table(self, name: str, table: Any) -> None:
        target = self.path / name
        with storage_faults(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            arrow_modules()[1].write_table(table, target, compression="snappy")

    def _write_text(self, name: str, text: str) -> None:
        with storage_faults(self.path / name):
            (self.path / name).parent.mkdir(parents=True, exist_ok=True)
            (self.path / name).write_text(text, encoding="utf-8")


def joint_terms(manifest: Manifest) -> frozenset[str]:
    """Return the policy's terms that have a number for each of a robot's joints: LeRobot's ``observation.state``.

    All other numbers that a policy sees are its ``observation.environment_state``, for LeRobot's policies want the two
    apart: ACT rejects an ``observation.state`` on its own.
    """
    joints = {name for robot in manifest.robots.values() if robot.agent for name in robot.joint_names}
    group = manifest.observations.get(POLICY)
    terms = {} if group is None else group.terms
    return frozenset(name for name, term in terms.items() if term.components and joints.issuperset(term.components))


def state_column(term: str, joint_terms: frozenset[str] | None) -> str:
    """Return the column of a term of the policy; ``joint_terms`` is None where nothing is known of the terms."""
    return STATE if joint_terms is None or term in joint_terms else ENVIRONMENT_STATE


def whole_rate(rate: float) -> int:
    """Return the number of steps per second.

    Raises:
        ConfigurationError: it is not a whole number, which LeRobot needs.
    """
    if abs(rate - round(rate)) > 1e-6:
        raise ConfigurationError(f"LeRobot needs a whole number of steps per second, not {rate:g}")
    return round(rate)


def check_recordable(manifest: Manifest) -> None:
    """Check that an environment's episodes can be written in this layout, before any is recorded.

    Raises:
        ConfigurationError: the rate is not a whole number, pictures have odd sides, or a package is missing.
    """
    arrow_modules()
    whole_rate(1.0 / manifest.step_dt)
    group = manifest.observations.get(POLICY)
    for name, term in ({} if group is None else group.terms).items():
        if term.dtype == "uint8" and len(term.shape) == 3 and term.shape[2] == 3:
            _av()
            _check_sides(name, *term.shape[:2])


def _check_sides(name: str, height: int, width: int) -> None:
    """Reject pictures with odd sides: yuv420p stores one colour for each two by two pixels."""
    if height % 2 or width % 2:
        raise ConfigurationError(f"a video needs even sides, and pictures of {name} are {width} x {height}")


def write_lerobot(
    path: Path | str,
    episodes: Iterable[Episode],
    manifest: Manifest | None,
    rate: float,
    continued: LeRobotDataset | None = None,
) -> set[str]:
    """Write a dataset into a new folder, and return the names of arrays that it cannot store.

    An error leaves the folder unfinished; :func:`orbit_data.formats.write_dataset` writes only complete ones.

    Args:
        path: path of the folder, which must not exist.
        episodes: episodes in order.
        manifest: manifest of the environment, if it is known.
        rate: steps per second.
        continued: dataset whose episodes come first.

    Raises:
        ConfigurationError: the rate is not a whole number, or there are no episodes.
        StorageError: the disk is full, or the folder cannot be written.
    """
    path = as_path(path)
    steps = whole_rate(rate)
    robot = next((r.model for r in manifest.robots.values() if r.agent), "") if manifest else "unknown"
    terms = joint_terms(manifest) if manifest else None
    writer = LeRobotWriter(path, manifest.task if manifest else path.stem, steps, robot, terms)
    if continued is not None:
        writer.extend(continued)
    for episode in episodes:
        writer.add(episode)
    writer.finish(manifest)
    return writer.left_out


def check_replaceable(path: Path) -> None:
    """Reject a path that a dataset must not replace: only empty folders and datasets that ORBIT wrote are replaced.

    Raises:
        ConfigurationError: the path is a file, or a folder with anything else; the message names one such file.
    """
    if not path.exists():
        return
    if not path.is_dir():
        raise ConfigurationError(f"{path} is a file, which no folder replaces: choose another name, or remove it first")
    foreign = next(_foreign(path), None)
    if foreign is not None or (any(path.iterdir()) and not (path / EPISODES).is_file()):
        what = "" if foreign is None else f": it holds {foreign}"
        raise ConfigurationError(
            f"{path} is not, or not only, a dataset that ORBIT wrote{what}. It is not replaced: choose another "
            "name, or move it away first"
        )


def _foreign(folder: Path) -> Iterator[str]:
    """Yield the paths within a folder that ORBIT's datasets do not have, including links."""
    for place, folders, files in os.walk(folder):
        links = [name for name in folders if (Path(place) / name).is_symlink()]
        for name in (*files, *links):
            path = Path(place) / name
            inner = path.relative_to(folder).as_posix()
            own = is_card(path) if inner == CARD else _LAYOUT.fullmatch(inner)
            if path.is_symlink() or not own:
                yield inner


def is_film(name: str, array: Array) -> bool:
    """Return whether an observation becomes a video: a picture of three colours that the policy sees."""
    return "/" not in name and array.dtype == np.uint8 and array.ndim == 4 and array.shape[3] == 3


def _feature(values: Array, names: list[str] | None) -> dict[str, Any]:
    return {"dtype": str(values.dtype), "shape": list(values.shape[1:]) or [1], "names": names}


def _video_feature(frames: Array, rate: int) -> dict[str, Any]:
    height, width, channels = frames.shape[1:]
    info = {
        "video.height": height, "video.width": width, "video.codec": "h264", "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False, "video.fps": rate, "video.channels": channels, "has_audio": False,
    }  # fmt: skip
    return {
        "dtype": "video",
        "shape": [height, width, channels],
        "names": ["height", "width", "channels"],
        "info": info,
    }


def _column(arrow: Any, values: Array) -> Any:
    if values.ndim == 1:
        return arrow.array(values)
    return arrow.FixedSizeListArray.from_arrays(arrow.array(values.reshape(-1)), values.shape[1])


def _pandas_index() -> Mapping[str, str]:
    """Return metadata that makes the tasks' words the table's index, as pandas writes it."""
    kinds = (("task_index", "task_index", "int64", "int64"), (None, "__index_level_0__", "unicode", "object"))
    columns = [
        {"name": name, "field_name": field, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, field, kind, numpy in kinds
    ]
    metadata = {"index_columns": ["__index_level_0__"], "column_indexes": [], "columns": columns}
    return {"pandas": json.dumps(metadata)}


# Reader of LeRobot datasets v3.0, of ORBIT and others -----------------------------------------------------------------

_OWN = {INTERVENTION: TAUGHT, ACTION: ACTIONS, "next.reward": REWARDS, "next.done": DONES, SIMULATED: STATES}
# Fields that a pattern of file names may contain; others could produce names of any length.
_PLACE = re.compile(r"\{(chunk_index|file_index|video_key)(:0?[1-9]d)?\}")
# Bytes of memory for one number of meta/episodes.
_ROW_BYTES = 100
# Limit in bytes of the facts of all episodes, each of which takes about 200.
_MOST_INFOS = 1 << 25
# Task of an episode: its words in meta/episodes are lists of texts, which are not read, and its statistics are numbers.
_OWN_TASK = "stats/task_index/min"
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
            self.instructions: Sequence[str] = self._read_tasks(account)
            """What episodes show, in words, by ``task_index``."""
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
            # Statistics are many columns for each feature, of which one is used here.
            table = read_columns(path, lambda name: name == _OWN_TASK or not name.startswith("stats/"), account)
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

    @property
    def features(self) -> Mapping[str, Any]:
        """Type, shape and names of each column."""
        return self._features

    def index(self) -> tuple[list[dict[str, Any]], dict[str, Any]]:
        """Return the row of each episode in ``meta/episodes``, all columns included, and ``meta/stats.json``.

        Only for a dataset that this machine wrote: its columns of texts are read as they are.

        Raises:
            ConfigurationError: a file is damaged.
        """
        with self._faults():
            tables = sorted((self.path / "meta" / "episodes").glob("*/*.parquet"))
            rows = [row for path in tables for row in arrow_modules()[1].read_table(path).to_pylist()]
            rows.sort(key=lambda row: row["episode_index"])
            return rows, parse_json(self._document(STATISTICS, MAX_DOCUMENT) or b"{}")

    def _read_tasks(self, account: ReadAccount) -> list[str]:
        """Read the words of each task."""
        path = self._file(TASKS)
        if path is None:
            return []
        numbers = read_columns(path, "task_index".__eq__, account)["task_index"].to_pylist()
        return [text for _, text in sorted(zip(numbers, read_texts(path, account), strict=False))]

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
        return [
            EpisodeInfo(int(row["episode_index"]), int(row["length"]), instruction=self._instruction(row))
            for row in self._rows
        ]

    def _instruction(self, row: Mapping[str, Any]) -> str:
        """Return the words of an episode's task; empty if nothing states them."""
        index = row.get(_OWN_TASK)
        return self.instructions[int(index[0])] if index and self.instructions else ""

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
        own = _OWN | ({ACTION: CLEAN, EXECUTED: ACTIONS} if EXECUTED in columns else {})
        for name, values in columns.items():
            if name in own:
                arrays[own[name]] = values
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
