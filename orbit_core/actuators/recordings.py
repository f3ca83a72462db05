"""Logged joint data that actuator networks are fitted to, from CSV, NPZ and HDF5 files.

A file is one recording at an even rate. NPZ and HDF5 hold ``time`` (T,) in seconds, and ``position_target``,
``position``, ``velocity`` and ``effort`` (T, k) in rad, rad/s and N m (m, m/s and N), with the joints' names in
``joints`` (k,). A CSV has a column ``time`` and, for each joint, four columns ``JOINT.position_target`` and so on.
"""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError, NonFiniteError

QUANTITIES = ("position_target", "position", "velocity", "effort")
_LEAST_STEPS = 50
_UNEVEN = 0.02
"""Part of a step by which steps may differ in length."""


@dataclass(frozen=True)
class Recording:
    """T steps of k joints."""

    joints: tuple[str, ...]
    rate: float
    """Hz"""
    inputs: Tensor
    """(T, k, 2) error of position, velocity."""
    efforts: Tensor
    """(T, k)"""


def read_recording(path: Path) -> Recording:
    """A recording from its file.

    Raises:
        ConfigurationError: there is no such file, of none of the three formats; something is missing in it or of
            another length; it is shorter than 50 steps; or its steps are not even.
        NonFiniteError: a number is NaN or infinite; names where.
    """
    if not path.is_file():
        raise ConfigurationError(f"there is no recording {path}")
    readers: Mapping[str, Callable[[Path], dict[str, Any]]] = {
        ".csv": _read_csv, ".npz": _read_npz, ".h5": _read_hdf5, ".hdf5": _read_hdf5
    }  # fmt: skip
    if path.suffix not in readers:
        raise ConfigurationError(f"recording {path} must be {', '.join(readers)}, not '{path.suffix}'")
    try:
        data = readers[path.suffix](path)
    except (OSError, ValueError, KeyError) as error:
        raise ConfigurationError(f"recording {path} cannot be read: {error}") from None
    return _checked(path, data)


def common_rate(recordings: Sequence[Recording]) -> float:
    """Hz: the rate that all recordings have.

    Raises:
        ConfigurationError: there are none, or they differ.
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
    joints = tuple(str(name) for name in data["joints"])
    if not joints:
        raise ConfigurationError(f"recording {path} names no joint")
    if len({*joints}) < len(joints):
        raise ConfigurationError(f"recording {path} names a joint twice: {', '.join(joints)}")
    time = _real(path, "time", data["time"])
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
    if len(time) < _LEAST_STEPS:
        raise ConfigurationError(f"recording {path} has {len(time)} steps: {_LEAST_STEPS} are the fewest")
    if not np.ptp(arrays["effort"]):
        raise ConfigurationError(f"recording {path} has one effort throughout: record joints that are driven")
    return Recording(joints, _rate(path, time), *_tensors(arrays))


def _real(path: Path, name: str, values: Any) -> npt.NDArray[np.float64]:
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise ConfigurationError(f"recording {path}: {name} is of {array.dtype}, and must be of real numbers")
    return array.astype(np.float64)


def _rate(path: Path, time: npt.NDArray[np.float64]) -> float:
    steps = np.diff(time)
    step = float(np.median(steps))
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
    error = arrays["position_target"] - arrays["position"]
    inputs = np.stack((error, arrays["velocity"]), 2)
    return torch.as_tensor(inputs, dtype=torch.float32), torch.as_tensor(arrays["effort"], dtype=torch.float32)


def _read_csv(path: Path) -> dict[str, Any]:
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    rows = [row for row in rows if row]
    if not rows:
        raise ValueError("it is empty")
    header = rows[0]
    ragged = next((number for number, row in enumerate(rows[1:], 1) if len(row) != len(header)), None)
    if ragged is not None:
        raise ValueError(f"row {ragged} has {len(rows[ragged])} values, and the header names {len(header)} columns")
    body = np.array(rows[1:], dtype=np.float64).reshape(-1, len(header))
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


def _read_npz(path: Path) -> dict[str, Any]:
    if not zipfile.is_zipfile(path):
        raise ValueError("it is no NPZ archive, as numpy.savez writes them")
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _read_hdf5(path: Path) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise ConfigurationError("reading HDF5 needs h5py: pip install h5py") from None
    with h5py.File(path, "r") as file:
        names = [name for name in ("time", "joints", *QUANTITIES) if isinstance(file.get(name), h5py.Dataset)]
        data: dict[str, Any] = {name: file[name][()] for name in names}  # pyright: ignore[reportIndexIssue]
    if "joints" in data:
        data["joints"] = [name.decode() if isinstance(name, bytes) else str(name) for name in data["joints"]]
    return data
