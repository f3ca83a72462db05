"""Episodes as recordings for viewers: MCAP for Foxglove, RRD for Rerun. They are for looking at, and are not read back.

All episodes are on one timeline, a second apart. Numbers become plots with a line for each component, poses frames in
space, pictures pictures.
"""

from __future__ import annotations

import io
import re
from abc import ABC, abstractmethod
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np

from orbit_core.envs.observation_layout import POLICY
from orbit_core.files import written_whole
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import ACTIONS, CONTACTS, DONES, INITIAL, NEXT, OBSERVED, POSES, STATES, Array, Episode
from orbit_data.manifest.manifest import Manifest
from orbit_data.noise import CLEAN

SUFFIXES = (".mcap", ".rrd")
# Seconds between episodes, so that plots do not join them.
_PAUSE = 1.0
# Frame that poses are expressed in: that of one environment.
_WORLD = "environment"
_ORBIT = "orbit"


def write_for_viewer(path: Path, episodes: Iterable[Episode], manifest: Manifest) -> set[str]:
    """Write episodes for a viewer: Foxglove's if the name ends in .mcap, Rerun's if it ends in .rrd.

    Args:
        path: path of the file, which is replaced once the new one is complete.
        episodes: episodes in their order.
        manifest: manifest of the environment, for the rate and the names of components.

    Returns:
        Names of arrays that are not shown, or prefixes that end in ``/``.

    Raises:
        ConfigurationError: the name ends otherwise, or the package of the format is missing.
        StorageError: the disk is full, or the folder cannot be written.
    """
    if path.suffix not in SUFFIXES:
        raise ConfigurationError(f"the name of {path} must end in {' or '.join(SUFFIXES)}: the viewer's format")
    kind = _McapFile if path.suffix == ".mcap" else _RerunFile
    modules = kind.modules()
    with written_whole(path) as written:
        file = kind(written, modules)
        try:
            return _write(file, episodes, manifest)
        finally:
            file.close()


def _write(file: _ViewerFile, episodes: Iterable[Episode], manifest: Manifest) -> set[str]:
    begin, left_out = 0.0, set[str]()
    for episode in episodes:
        times = begin + manifest.step_dt * np.arange(episode.info.length)
        info = episode.info
        facts = {"number": info.number, "success": info.success, "return": info.episode_return, "backend": info.backend}
        file.note(begin, {**facts, "instruction": info.instruction, **info.metrics})
        for name, array in episode.arrays.items():
            # By shape, because other datasets name pictures as they like.
            if name.startswith(POSES):
                file.poses(name.removeprefix(POSES), times, array)
            elif array.dtype == np.uint8 and array.ndim == 4 and array.shape[-1] == 3:
                file.pictures(name, times, array)
            elif name.startswith((NEXT, INITIAL)):
                # Shown already, as the observation of the step before or after.
                left_out.add(name.partition("/")[0] + "/")
            elif name in (STATES, DONES) or array.ndim > 3:
                left_out.add(name)
            else:
                flat = array.reshape(len(array), -1).astype(np.float64)
                file.numbers(name, times, flat, _components(name, flat.shape[1], manifest))
        begin = float(times[-1]) + _PAUSE
    return left_out


def _components(name: str, count: int, manifest: Manifest) -> tuple[str, ...]:
    """Return the names of an array's columns, by the manifest; numbers where it has no distinct ones."""
    found: tuple[str, ...] = ()
    if name in (ACTIONS, CLEAN):
        found = tuple(each for term in manifest.action_terms.values() for each in term.components)
    elif name.startswith(OBSERVED):
        group, _, term = name.removeprefix(OBSERVED).rpartition("/")
        terms = manifest.observations[group or POLICY].terms if (group or POLICY) in manifest.observations else {}
        found = terms[term].components if term in terms else ()
    elif not name.startswith(CONTACTS) and count == 1:
        return ("value",)
    # Letters and digits only: viewers read dots and brackets as paths.
    plain = tuple(re.sub(r"\W+", "_", each).strip("_") for each in found)
    return plain if len(set(plain)) == count else tuple(f"value_{number}" for number in range(count))


class _ViewerFile(ABC):
    """File that receives one stream of values after another.

    Args:
        path: path of the file.
        modules: those of the format, from :meth:`modules`.
    """

    def __init__(self, path: Path, modules: Sequence[ModuleType]) -> None:
        raise NotImplementedError

    @staticmethod
    @abstractmethod
    def modules() -> Sequence[ModuleType]:
        """Import the packages of the format.

        Raises:
            ConfigurationError: one is missing.
        """

    @abstractmethod
    def note(self, time: float, facts: Mapping[str, Any]) -> None:
        """Write the facts of an episode that begins at ``time`` (s)."""

    @abstractmethod
    def numbers(self, name: str, times: Array, values: Array, components: Sequence[str]) -> None:
        """Write numbers (T, D) of an array at ``times`` (T,) in s, with the names of their components."""

    @abstractmethod
    def poses(self, name: str, times: Array, values: Array) -> None:
        """Write poses (T, 7) in the environment's frame: position in m, quaternion (w, x, y, z)."""

    @abstractmethod
    def pictures(self, name: str, times: Array, values: Array) -> None:
        """Write pictures (T, H, W, 3) uint8."""

    @abstractmethod
    def close(self) -> None:
        """Write the end of the file."""


def _png(picture: Array, pillow: ModuleType) -> bytes:
    data = io.BytesIO()
    # Little compression: files are for a look, and compressing is what takes the time.
    pillow.fromarray(picture).save(data, "PNG", compress_level=1)
    return data.getvalue()


class _McapFile(_ViewerFile):
    """MCAP with JSON messages: Foxglove's own schemas for frames and pictures, and objects of numbers for plots."""

    def __init__(self, path: Path, modules: Sequence[ModuleType]) -> None:
        writer, self._pillow = modules
        self._file = path.open("wb")
        self._writer = writer.Writer(self._file)
        self._writer.start(profile="", library=_ORBIT)
        self._channels: dict[str, int] = {}

    @staticmethod
    def modules() -> Sequence[ModuleType]:
        try:
            from mcap import writer
            from PIL import Image
        except ImportError:
            raise ConfigurationError(f"MCAP needs mcap and Pillow: {install_extra('viewers')}") from None
        return writer, Image

    def note(self, time: float, facts: Mapping[str, Any]) -> None:
        self._add("/episode", "orbit.Episode", time, facts)

    def numbers(self, name: str, times: Array, values: Array, components: Sequence[str]) -> None:
        for time, row in zip(times.tolist(), values.tolist(), strict=True):
            self._add(f"/{name}", "orbit.Numbers", time, dict(zip(components, row, strict=True)))

    def poses(self, name: str, times: Array, values: Array) -> None:
        for time, (x, y, z, *quaternion) in zip(times.tolist(), values.tolist(), strict=True):
            message = {
                "timestamp": _stamp(time),
                "parent_frame_id": _WORLD,
                "child_frame_id": name,
                "translation": {"x": x, "y": y, "z": z},
                "rotation": dict(zip("wxyz", quaternion, strict=True)),
            }
            self._add("/tf", "foxglove.FrameTransform", time, message)

    def pictures(self, name: str, times: Array, values: Array) -> None:
        for time, picture in zip(times.tolist(), values, strict=True):
            data = b64encode(_png(picture, self._pillow)).decode()
            message = {"timestamp": _stamp(time), "frame_id": name, "format": "png", "data": data}
            self._add(f"/{name}", "foxglove.CompressedImage", time, message)

    def close(self) -> None:
        self._writer.finish()
        self._file.close()

    def _add(self, topic: str, schema: str, time: float, message: Mapping[str, Any]) -> None:
        if topic not in self._channels:
            described = _SCHEMAS.get(schema) or {name: {} for name in message}
            kind = msgspec.json.encode({"title": schema, "type": "object", "properties": described})
            number = self._writer.register_schema(name=schema, encoding="jsonschema", data=kind)
            self._channels[topic] = self._writer.register_channel(topic, "json", number)
        stamp = round(time * 1e9)
        self._writer.add_message(self._channels[topic], stamp, msgspec.json.encode(message), stamp)


def _stamp(time: float) -> dict[str, int]:
    seconds, rest = divmod(round(time * 1e9), 10**9)
    return {"sec": seconds, "nsec": rest}


_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_TEXT = {"type": "string"}
_SCHEMAS: Mapping[str, Mapping[str, Any]] = {
    "foxglove.FrameTransform": {
        "timestamp": _TIME,
        "parent_frame_id": _TEXT,
        "child_frame_id": _TEXT,
        "translation": {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}},
        "rotation": {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}},
    },
    "foxglove.CompressedImage": {
        "timestamp": _TIME,
        "frame_id": _TEXT,
        "data": {**_TEXT, "contentEncoding": "base64"},
        "format": _TEXT,
    },
}


class _RerunFile(_ViewerFile):
    """RRD on Rerun's timeline ``time``."""

    def __init__(self, path: Path, modules: Sequence[ModuleType]) -> None:
        self._rerun, self._pillow = modules
        self._stream = self._rerun.RecordingStream(_ORBIT)
        self._stream.save(path)
        self._named: set[str] = set()

    @staticmethod
    def modules() -> Sequence[ModuleType]:
        try:
            import rerun  # pyright: ignore[reportMissingImports] - an optional package
            from PIL import Image
        except ImportError:
            raise ConfigurationError(f"RRD needs rerun-sdk and Pillow: {install_extra('viewers')}") from None
        return rerun, Image

    def note(self, time: float, facts: Mapping[str, Any]) -> None:
        self._stream.set_time("time", duration=time)
        text = ", ".join(f"{name} {value}" for name, value in facts.items() if value not in ("", None))
        self._stream.log("episode", self._rerun.TextLog(text))

    def numbers(self, name: str, times: Array, values: Array, components: Sequence[str]) -> None:
        if name not in self._named:
            self._named.add(name)
            self._stream.log(name, self._rerun.SeriesLines(names=list(components)), static=True)
        self._send(name, times, self._rerun.Scalars.columns(scalars=values))

    def poses(self, name: str, times: Array, values: Array) -> None:
        # Rerun's quaternions are (x, y, z, w).
        turned = np.roll(values[:, 3:], -1, axis=1)
        path = f"{_WORLD}/{name}"
        self._send(path, times, self._rerun.Transform3D.columns(translation=values[:, :3], quaternion=turned))
        if name not in self._named:
            self._named.add(name)
            self._stream.log(path, self._rerun.TransformAxes3D(0.1), static=True)

    def pictures(self, name: str, times: Array, values: Array) -> None:
        blobs = [_png(picture, self._pillow) for picture in values]
        kinds = ["image/png"] * len(blobs)
        self._send(name, times, self._rerun.EncodedImage.columns(blob=blobs, media_type=kinds))

    def close(self) -> None:
        self._stream.disconnect()

    def _send(self, name: str, times: Array, columns: Any) -> None:
        self._stream.send_columns(name, [self._rerun.TimeColumn("time", duration=times)], columns)
