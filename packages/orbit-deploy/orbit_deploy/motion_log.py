"""Recorded motion of a robot: what its drives were given and what its joints did, from MCAP, CSV and other logs."""

from __future__ import annotations

import csv
import functools
import hashlib
import io
import re
import struct
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from orbit_core.files import read_bytes
from orbit_core.installing import install_command
from orbit_core.interfaces import ConfigurationError
from orbit_core.registry import Registry
from orbit_deploy.description import FloatArray, RobotDescription
from orbit_deploy.messages import RobotState

# Columns of a CSV file next to "time", each with one column for every joint: "target:joint1"
_COLUMNS = ("target", "target_velocity", "target_effort", "position", "velocity", "effort")
# Bytes up to which a file is read, as a whole, and rows from which it is a motion
_MOST_BYTES = 1 << 31
_SHORTEST = 20


@dataclass(frozen=True)
class MotionLog:
    """Motion of one robot. Arrays are (T,) or (T, J); a row holds the targets of a cycle and the state after it."""

    joints: tuple[str, ...]
    """Names in the order of the columns."""
    times: FloatArray
    """(T,) s from the first row, rising."""
    target: FloatArray
    """rad or m, as the drives were given them."""
    target_velocity: FloatArray
    """rad/s or m/s, as the drives were given them."""
    target_effort: FloatArray
    """N m or N, added to what the drives apply."""
    position: FloatArray
    """Measured, rad or m."""
    velocity: FloatArray
    """Measured, rad/s or m/s."""
    effort: FloatArray
    """Measured, N m or N."""
    source: str = ""
    """File and digest."""
    description: RobotDescription | None = None
    """Robot as its computer described it; None if the log does not say."""

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return float(self.times[-1])

    def selected(self, begin: float = 0.0, seconds: float | None = None) -> MotionLog:
        """Return the rows of a part of the log.

        Args:
            begin: of the part, s.
            seconds: length of the part; to the end if None.
        """
        end = np.inf if seconds is None else begin + seconds
        # The sum of begin and length is rounded: a row at the end would be lost.
        rows = (self.times >= begin) & (self.times <= end + 1e-9)
        if rows.sum() < _SHORTEST:
            raise ConfigurationError(
                f"{self.source or 'the log'} has {int(rows.sum())} rows from {begin:g} to {end:g} s, of "
                f"{self.duration:g} s in all: fewer than {_SHORTEST}"
            )
        parts = {name: getattr(self, name)[rows] for name in _COLUMNS}
        times = self.times[rows]
        return MotionLog(self.joints, times - times[0], **parts, source=self.source, description=self.description)

    def ordered(self, joints: tuple[str, ...]) -> MotionLog:
        """Return the log with its joints in another order.

        Raises:
            ConfigurationError: a joint is missing.
        """
        missing = [name for name in joints if name not in self.joints]
        if missing:
            raise ConfigurationError(
                f"{self.source or 'the log'} lacks joints {', '.join(missing)}: it has {', '.join(self.joints)}"
            )
        columns = [self.joints.index(name) for name in joints]
        parts = {name: getattr(self, name)[:, columns] for name in _COLUMNS}
        return MotionLog(joints, self.times, **parts, source=self.source, description=self.description)

    def write_csv(self, path: Path) -> None:
        """Write the log as a CSV file: ``time`` and a column for each quantity and joint."""
        # Nine digits give a single-precision number back exactly.
        names = ["time", *(f"{kind}:{joint}" for kind in _COLUMNS for joint in self.joints)]
        table = np.column_stack([self.times, *(getattr(self, kind) for kind in _COLUMNS)])
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(names), comments="", encoding="utf-8")


def motion_log(
    joints: tuple[str, ...],
    times: FloatArray,
    columns: dict[str, FloatArray],
    source: str,
    description: RobotDescription | None = None,
) -> MotionLog:
    """Check recorded arrays and return their log; what is missing is zero.

    A missing target is the measured position, a missing velocity its derivative.

    Args:
        joints: names in order.
        times: (T,) s on any clock.
        columns: (T, J) by the names of :class:`MotionLog`'s fields; ``position`` must be among them.
        source: for messages.
        description: of the robot, if it is known.

    Raises:
        ConfigurationError: there are too few rows, times do not rise, or numbers are missing or not finite.
    """
    if "position" not in columns:
        raise ConfigurationError(f"{source} holds no measured positions")
    if len(times) < _SHORTEST:
        raise ConfigurationError(f"{source} holds {len(times)} states of the robot, fewer than {_SHORTEST}")
    if not np.isfinite(times).all():
        raise ConfigurationError(f"{source} has no finite time at state {int(np.argmin(np.isfinite(times)))}")
    if not (np.diff(times) > 0.0).all():
        row = int(np.argmax(np.diff(times) <= 0.0)) + 1
        raise ConfigurationError(f"{source} goes back in time at state {row}")
    # Before anything is derived from them, so that the message names the recorded quantity
    for name, values in columns.items():
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values).all(1)))
            raise ConfigurationError(f"{source} holds a {name} that is not finite, {times[row] - times[0]:.3f} s in")
    full = {name: columns.get(name, np.zeros_like(columns["position"])) for name in _COLUMNS}
    # A log without targets still shows a motion, and one of a free robot has none.
    full["target"] = columns.get("target", columns["position"])
    # A replay that begins in motion needs the speed.
    if "velocity" not in columns:
        full["velocity"] = np.gradient(columns["position"], times, axis=0)
    return MotionLog(joints, times - times[0], **full, source=source, description=description)


@functools.cache
def _readers() -> Registry[Callable[[Path], MotionLog]]:
    return Registry[Callable[[Path], MotionLog]]("format of logs", "orbit.motion_logs")


def read_log(path: Path) -> MotionLog:
    """Read a log: ``.mcap`` and ``.csv`` of ``orbit robot``, others by the entry-point group ``orbit.motion_logs``.

    Args:
        path: file or folder; its suffix names the format, and a folder or ``.bag`` is a recording of ROS.

    Raises:
        ConfigurationError: it is no log, or one that is damaged.
        UnknownNameError: no installed package reads that format.
    """
    if not path.exists():
        raise ConfigurationError(f"there is no log {path}")
    if path.suffix == ".csv":
        return _read_csv(path)
    if path.suffix == ".mcap" and (log := _read_mcap(path)) is not None:
        return log
    return _readers().get("rosbag" if path.is_dir() or path.suffix in (".bag", ".mcap", ".db3") else path.suffix)(path)


def source_of(path: Path, data: bytes) -> str:
    """Return a file's name and the beginning of its SHA-256, which a result states as its source."""
    return f"{path.name} (sha256 {hashlib.sha256(data).hexdigest()[:16]})"


def _read_mcap(path: Path) -> MotionLog | None:
    """Return the log of a robot's computer, or None if the file is a recording of something else."""
    try:
        from mcap.exceptions import EndOfFile, McapError
        from mcap.records import Channel, Footer, Message, Metadata
        from mcap.stream_reader import StreamReader
    except ImportError:
        raise ConfigurationError(f"logs need mcap: {install_command('orbit-deploy[log]')}") from None
    data = read_bytes(path, _MOST_BYTES)
    description: RobotDescription | None = None
    channels: set[int] = set()
    rows: list[_StateRow] = []
    whole, fault = False, "it is empty"
    try:
        # Record after record and not by the index at its end, which a file lacks whose writer was killed.
        for record in StreamReader(io.BytesIO(data)).records:
            # Other programs write MCAP too, recordings of ROS 2 among them.
            if isinstance(record, Metadata) and record.name == "robot":
                description = msgspec.json.decode(record.metadata["description"], type=RobotDescription)
            elif isinstance(record, Channel) and record.topic == "/state":
                channels.add(record.id)
            elif isinstance(record, Message) and record.channel_id in channels and description is not None:
                rows.append(_DECODER.decode(record.data))
            whole = whole or isinstance(record, Footer)
    except (EndOfFile, McapError, msgspec.MsgspecError, KeyError, ValueError, struct.error) as error:
        # The reader unpacks what is left of a file without looking at its length.
        fault = str(error) or fault
    # Robots' computers write the description at once: without one, it may be a recording of ROS.
    if whole and description is None:
        return None
    if description is None or not (whole or rows):
        raise ConfigurationError(f"{path} is damaged or was cut off: {fault}")
    rows.sort(key=lambda row: row.stamp)
    if not whole:
        seconds = 1e-9 * (rows[-1].stamp - rows[0].stamp)
        warnings.warn(f"{path} was cut off or is damaged after {seconds:.1f} s: those are read", RuntimeWarning, 3)
    source = source_of(path, data)
    if not rows:
        raise ConfigurationError(f"{source} holds no states of the robot")
    times = 1e-9 * np.array([row.stamp - rows[0].stamp for row in rows])
    fields = {
        "target": "targets",
        "target_velocity": "target_velocities",
        "target_effort": "target_efforts",
        "position": "positions",
        "velocity": "velocities",
        "effort": "efforts",
    }
    columns = {kind: np.array([getattr(row, name) for row in rows], np.float64) for kind, name in fields.items()}
    # A state that answers a request has the stamp of the cycle before.
    rising = np.concatenate(([True], np.diff(np.maximum.accumulate(times)) > 0.0))
    columns = {kind: values[rising] for kind, values in columns.items()}
    return motion_log(tuple(description.joints), times[rising], columns, source, description)


class _StateRow(msgspec.Struct):
    """Part of a logged :class:`~orbit_deploy.messages.RobotState` that a motion needs, by name."""

    stamp: int
    positions: list[float]
    velocities: list[float]
    efforts: list[float]
    targets: list[float]
    target_velocities: list[float]
    target_efforts: list[float]


_DECODER = msgspec.json.Decoder(_StateRow)
assert set(_StateRow.__struct_fields__) <= set(RobotState.__struct_fields__), "a log holds states"


def _read_csv(path: Path) -> MotionLog:
    data = read_bytes(path, _MOST_BYTES)
    source = source_of(path, data)
    # Bytes that are no text are found below, as a name or a number that is none.
    try:
        rows = list(csv.reader(io.StringIO(data.decode("utf-8", errors="replace"))))
    except csv.Error as error:
        raise ConfigurationError(f"{source} is no CSV file: {error}") from None
    header = [name.strip() for name in rows[0]] if rows else []
    if "time" not in header:
        raise ConfigurationError(f"{source} has no column 'time': write 'time', 'target:JOINT', 'position:JOINT', ...")
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise ConfigurationError(f"{source} has several columns of one name: {', '.join(twice)}")
    lengths = [len(row) for row in rows]
    if (
        wrong := next((line for line, length in enumerate(lengths) if length not in (0, len(header))), None)
    ) is not None:
        raise ConfigurationError(
            f"{source} has {lengths[wrong]} numbers in line {wrong + 1}, and its header {len(header)} columns: was it "
            "cut off?"
        )
    try:
        table = np.array([[float(value) for value in row] for row in rows[1:] if row], np.float64)
    except ValueError as error:
        raise ConfigurationError(f"{source} holds something that is no number: {error}") from None
    # A header only
    table = table.reshape(-1, len(header))
    joints = tuple(name.removeprefix("position:") for name in header if name.startswith("position:"))
    columns: dict[str, FloatArray] = {}
    for kind in _COLUMNS:
        places = [header.index(name) for joint in joints if (name := f"{kind}:{joint}") in header]
        if places and len(places) != len(joints):
            raise ConfigurationError(f"{source} has '{kind}' for {len(places)} of its {len(joints)} joints")
        if places:
            columns[kind] = table[:, places]
    unknown = [name for name in header if name != "time" and not re.match(rf"({'|'.join(_COLUMNS)}):", name)]
    if unknown:
        raise ConfigurationError(f"{source} has columns that mean nothing here: {', '.join(unknown)}")
    if not joints:
        raise ConfigurationError(f"{source} holds no measured positions")
    return motion_log(joints, table[:, header.index("time")], columns, source)
