"""Log of a robot in an MCAP file, which Foxglove and ROS tools read: commands, states and faults as JSON."""

from __future__ import annotations

import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import msgspec

from orbit_core.files import storage_faults
from orbit_core.installing import install_command
from orbit_core.interfaces import ConfigurationError
from orbit_deploy.description import RobotDescription
from orbit_deploy.messages import Fault, JointCommand, RobotState

# Seconds between looks at the queue, and between messages: written at once, a tenth of a second of them would hold
# Python's lock for milliseconds, and the loop with it
_INTERVAL, _PAUSE = 0.02, 5e-4
# Bytes that are compressed at a time
_CHUNK = 1 << 17
_NUMBERS = {"type": "array", "items": {"type": "number"}}


class RobotLog:
    """Writer of a robot's messages. The loop only appends to a queue; a thread writes.

    Args:
        path: of the file, which must end in ``.mcap``.
        description: of the robot, kept as metadata.

    Raises:
        ConfigurationError: mcap is not installed, or the name ends otherwise.
        StorageError: the file cannot be written.
    """

    def __init__(self, path: Path, description: RobotDescription) -> None:
        try:
            from mcap.writer import Writer
        except ImportError:
            raise ConfigurationError(f"logs need mcap: {install_command('orbit-deploy[log]')}") from None
        if path.suffix != ".mcap":
            raise ConfigurationError(f"the name of log {path} must end in .mcap")
        with storage_faults(path):
            self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=_CHUNK)
        self._writer.start(profile="", library="orbit-deploy")
        self._writer.add_metadata("robot", {"description": msgspec.json.encode(description).decode()})
        self._channels = {kind: self._channel(kind) for kind in (JointCommand, RobotState, Fault)}
        self._queue: deque[tuple[int, JointCommand | RobotState | Fault]] = deque()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._write, name="robot log", daemon=True)
        self._thread.start()

    def add(self, stamp: int, message: JointCommand | RobotState | Fault) -> None:
        """Append a message of a time on the robot's clock, ns; returns at once."""
        # A deque's append takes no lock of ours, and the loop must not wait.
        self._queue.append((stamp, message))

    def close(self) -> None:
        """Write what is left, and the file's index; idempotent."""
        if not self._ended.is_set():
            self._ended.set()
            self._thread.join()
            self._writer.finish()
            self._file.close()

    def _channel(self, kind: type[JointCommand | RobotState | Fault]) -> int:
        properties: dict[str, Any] = {
            field.name: _NUMBERS if field.type == list[float] else {} for field in msgspec.structs.fields(kind)
        }
        schema = self._writer.register_schema(
            name=f"orbit.{kind.__name__}",
            encoding="jsonschema",
            data=msgspec.json.encode({"type": "object", "properties": properties}),
        )
        topic = {JointCommand: "/command", RobotState: "/state", Fault: "/fault"}[kind]
        return self._writer.register_channel(topic=topic, message_encoding="json", schema_id=schema)

    def _write(self) -> None:
        while True:
            ended = self._ended.wait(_INTERVAL)
            while self._queue:
                stamp, message = self._queue.popleft()
                # By name: an array would mean nothing to a reader of the file.
                values = {name: getattr(message, name) for name in message.__struct_fields__}
                self._writer.add_message(
                    channel_id=self._channels[type(message)],
                    log_time=max(stamp, 0),
                    publish_time=max(stamp, 0),
                    data=msgspec.json.encode(values),
                )
                if not self._ended.is_set():
                    time.sleep(_PAUSE)
            if ended:
                return
