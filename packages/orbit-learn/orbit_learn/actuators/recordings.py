"""Logged joint data for fitting actuator networks, from CSV, NPZ and HDF5 files.

A file is one recording at a constant rate. NPZ and HDF5 contain ``time`` (T,) in seconds, and ``position_target``,
``position``, ``velocity`` and ``effort`` (T, k) in rad, rad/s and N m (m, m/s and N), with the joints' names in
``joints`` (k,). A CSV has a column ``time`` and, for each joint, four columns ``JOINT.position_target`` and so on.
"""

from __future__ import annotations

import csv
from array import array as Growing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.files import as_path
from orbit_core.interfaces import ConfigurationError, NonFiniteError
from orbit_data.reading.budget import ReadAccount, ReadBudget, check_name
from orbit_data.reading.hdf5 import Hdf5File
from orbit_data.reading.npz import FAULTS, read_npz

QUANTITIES = ("position_target", "position", "velocity", "effort")
_LEAST_STEPS = 50
# Limit of numbers, to whose squares a network can still be fitted in single precision.
_LARGEST = 1e12
# Limit of joints, and of the characters of their names.
_MOST_NAMES = 1000
# Limit of the characters of a table's line.
_LONGEST_LINE = 1 << 20
# Rows of a table between two checks of bytes and time.
_ROWS = 1000
# Relative difference that the lengths of steps may have.
_UNEVEN = 0.02


@dataclass(frozen=True)
class Recording:
    """Recording of T steps of k joints."""

    joints: tuple[str, ...]
    """Names of the joints."""
    rate: float
    """Rate in Hz."""
    inputs: Tensor
    """Position errors and velocities (T, k, 2)."""
    efforts: Tensor
    """Efforts (T, k)."""


def read_recording(path: Path | str, budget: ReadBudget = ReadBudget()) -> Recording:
    """Read a recording from its file.

    Args:
        path: path of the file.
        budget: limits of bytes and time.

    Raises:
        ConfigurationError: the file does not exist or has none of the three formats, an array is missing or has another
            length, there are fewer than 50 steps, steps are uneven, or the budget is exceeded.
        NonFiniteError: a number is NaN or infinite; the message names the place.
    """
    path = as_path(path)
    if not path.is_file():
        raise ConfigurationError(f"there is no recording {path}")
    readers: Mapping[str, Callable[[Path, ReadAccount], dict[str, Any]]] = {
        ".csv": _read_csv, ".npz": read_npz, ".h5": _read_hdf5, ".hdf5": _read_hdf5
    }  # fmt: skip
    if path.suffix not in readers:
        raise ConfigurationError(f"recording {path} must be {', '.join(readers)}, not '{path.suffix}'")
    try:
        data = readers[path.suffix](path, ReadAccount(budget, f"recording {path}"))
    except (*FAULTS, csv.Error) as error:
        raise ConfigurationError(f"recording {path} cannot be read: {' '.join(str(error).split())}") from None
    return _checked(path, data)


def common_rate(recordings: Sequence[Recording]) -> float:
    """Return the common rate of recordings in Hz.

    Raises:
        ConfigurationError: there are no recordings, or their rates differ.
    """
    rates = [recording.rate for recording in recordings]
    if not rates:
        raise ConfigurationError("there are no recordings to fit to: name one or more")
    if max(rates) - min(rates) > _UNEVEN * max(rates):
        raise ConfigurationError(f"recordings of {min(rates):g} and {max(rates):g} Hz cannot be fitted together")
    return rates[0]


def _checked(path: Path, data: Mapping[str, Any]) -> Recording:
    missing = [name for name in ("time", "joints", *QUANTITIES) if name not in data]
    if missing:
        raise ConfigurationError(f"recording {path} lacks {', '.join(missing)}")
    joints = _names(path, data["joints"])
    if not joints:
        raise ConfigurationError(f"recording {path} names no joint")
    # Two columns of one name would be fitted as two joints with the same data.
    if len({*joints}) < len(joints):
        raise ConfigurationError(f"recording {path} names a joint twice: {', '.join(joints)}")
    time = _real(path, "time", data["time"])
    if time.ndim != 1:
        raise ConfigurationError(f"recording {path}: time has {time.ndim} dimensions, not one")
    arrays = {name: _real(path, name, data[name]) for name in QUANTITIES}
    for name, array in arrays.items():
        if array.shape != (len(time), len(joints)):
            raise ConfigurationError(
                f"recording {path}: {name} is {array.shape}, with {len(time)} times and {len(joints)} joints"
            )
    for name, array in {"time": time, **arrays}.items():
        if not np.isfinite(array).all():
            raise NonFiniteError(
                f"recording {path}: {name} is not finite in step {np.argwhere(~np.isfinite(array))[0][0]}"
            )
    # Numbers that no joint reaches in SI units are a sign of other units, or of damage.
    largest = max(float(np.abs(array).max(initial=0.0)) for array in (time, *arrays.values()))
    if largest > _LARGEST:
        raise ConfigurationError(f"recording {path} holds {largest:g}, which no joint reaches: use SI units")
    if len(time) < _LEAST_STEPS:
        raise ConfigurationError(f"recording {path} has {len(time)} steps: {_LEAST_STEPS} are the fewest")
    # A constant effort has no scale to normalise by, and nothing to learn.
    if not np.ptp(arrays["effort"]):
        raise ConfigurationError(f"recording {path} has one effort throughout: record joints that are driven")
    return Recording(joints, _rate(path, time), *_tensors(arrays))


def _names(path: Path, values: Any) -> tuple[str, ...]:
    array = np.asarray(values)
    if array.size and (array.ndim != 1 or array.dtype.kind not in "US" or len(array) > _MOST_NAMES):
        raise ConfigurationError(f"recording {path}: joints are no list of names")
    names = tuple(name.decode() if isinstance(name, bytes) else name for name in array.tolist())
    for name in names:
        check_name(name, f"recording {path}")
    return names


def _real(path: Path, name: str, values: Any) -> npt.NDArray[np.float64]:
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise ConfigurationError(f"recording {path}: {name} is of {array.dtype}, and must be of real numbers")
    return array.astype(np.float64, copy=False)


def _rate(path: Path, time: npt.NDArray[np.float64]) -> float:
    steps = np.diff(time)
    step = float(np.median(steps))  # not the mean, which a single gap would move
    if (steps <= 0.0).any():
        raise ConfigurationError(f"recording {path}: time does not rise after {time[int(steps.argmin())]:g} s")
    if np.abs(steps - step).max() > _UNEVEN * step:
        worst = int(np.abs(steps - step).argmax())
        raise ConfigurationError(
            f"recording {path}: its steps are {step:g} s long, but that after {time[worst]:g} s is {steps[worst]:g} s: "
            "resample it evenly"
        )
    return 1.0 / step


def _tensors(arrays: Mapping[str, npt.NDArray[np.float64]]) -> tuple[Tensor, Tensor]:
    inputs = np.empty((*arrays["position"].shape, 2), np.float32)
    inputs[..., 0] = np.subtract(arrays["position_target"], arrays["position"])
    inputs[..., 1] = arrays["velocity"]
    return torch.from_numpy(inputs), torch.as_tensor(arrays["effort"], dtype=torch.float32)


def _read_csv(path: Path, account: ReadAccount) -> dict[str, Any]:
    with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets begin a file with a byte order mark
        rows = (row for row in csv.reader(_lines(file)) if row)
        header = next(rows, None)
        if header is None:
            raise ValueError("it is empty")
        values = Growing("d")  # 8 bytes a number, where a list of floats takes 32
        for number, row in enumerate(rows, 1):
            if len(row) != len(header):
                raise ValueError(f"row {number} has {len(row)} values, and the header names {len(header)} columns")
            if number % _ROWS == 1:
                account.take("a thousand rows", _ROWS * len(header) * values.itemsize)
                account.check_time()
            values.extend(map(float, row))
    body = np.frombuffer(values).reshape(-1, len(header))
    names = {name.strip(): column for column, name in enumerate(header)}
    joints = list(dict.fromkeys(name.rpartition(".")[0] for name in names if "." in name))
    found: dict[str, Any] = {"joints": joints}
    if "time" in names:
        found["time"] = body[:, names["time"]]
    for quantity in QUANTITIES:
        columns = [names[name] for joint in joints if (name := f"{joint}.{quantity}") in names]
        if len(columns) == len(joints):
            found[quantity] = body[:, columns]
    return found


def _lines(file: TextIO) -> Iterator[str]:
    """Yield the lines of a table, and refuse lines longer than any row."""
    while line := file.readline(_LONGEST_LINE + 1):
        if len(line) > _LONGEST_LINE:
            raise ValueError(f"a line has more than {_LONGEST_LINE:,} characters")
        yield line


def _read_hdf5(path: Path, account: ReadAccount) -> dict[str, Any]:
    file = Hdf5File(path, "recording")
    try:
        with file.faults("the file"):
            found = [name for name in ("time", *QUANTITIES) if file.child(file.root, name) is not None]
            data: dict[str, Any] = {name: file.numbers(file.root, name, account) for name in found}
            if file.child(file.root, "joints") is not None:
                data["joints"] = file.texts(file.root, "joints", _MOST_NAMES)
    finally:
        file.close()
    return data
