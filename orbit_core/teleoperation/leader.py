"""A leader arm: joint values as lines of JSON over a socket of this computer."""

from __future__ import annotations

import math
import socket
import threading
import time
from contextlib import suppress

import msgspec

from orbit_core.interfaces import ConfigurationError
from orbit_core.teleoperation.device import Device, DeviceLostError, Event, Reading

_LONGEST = 65536
"""Bytes of a line; who sends more is no leader."""


class LeaderFrame(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """One line: ``{"joints": {"panda_joint1": 0.1}, "gripper_open": true, "event": "record"}``, each of it optional."""

    joints: dict[str, float] = {}
    """rad or m by the robot's joint names; joints that are not named hold."""
    gripper_open: bool | None = None
    event: Event | None = None


class Leader(Device):
    """Listens for one leader at a time. A line that is no frame is answered by ``{"error": ...}`` and changes nothing.

    Args:
        joint_names: that frames may name.
        port: at 127.0.0.1; 0 takes a free one.

    Raises:
        ConfigurationError: the port is taken.
    """

    def __init__(self, joint_names: tuple[str, ...], port: int) -> None:
        self._names = joint_names
        self._lock = threading.Lock()
        self._joints: dict[str, float] | None = None
        self._gripper: bool | None = None
        self._events: list[Event] = []
        self._moved: float | None = None
        self._lost = ""
        self._connected = False
        try:
            self._server = socket.create_server(("127.0.0.1", port))
        except OSError as error:
            raise ConfigurationError(f"no leader can connect to port {port}: {error}; choose --leader-port") from None
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def read(self) -> Reading:
        with self._lock:
            if self._lost:
                raise DeviceLostError(self._lost)
            reading = Reading(
                joints=self._joints, gripper_open=self._gripper, events=tuple(self._events), moved_at=self._moved
            )
            self._events, self._moved = [], None
        return reading

    def close(self) -> None:
        self._server.close()

    def _serve(self) -> None:
        with suppress(OSError):  # the socket is closed in the end
            while True:
                connection, _ = self._server.accept()
                with self._lock:
                    taken, self._connected = self._connected, True
                if taken:
                    _tell(connection, "another leader is connected")
                    connection.close()
                else:
                    threading.Thread(target=self._listen, args=(connection,), daemon=True).start()

    def _listen(self, connection: socket.socket) -> None:
        with suppress(OSError), connection, connection.makefile("rb") as lines:
            while line := lines.readline(_LONGEST):
                if not line.endswith(b"\n"):
                    _tell(connection, f"a line is at most {_LONGEST} bytes, and ends in a newline")
                    break
                if fault := self._take(line):
                    _tell(connection, fault)
        with self._lock:
            self._lost = "the leader arm's connection was closed"

    def _take(self, line: bytes) -> str:
        """Take over what a line says; why not, if it cannot be."""
        try:
            frame = msgspec.json.decode(line, type=LeaderFrame)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            return f"no frame: {error}"
        strange = [name for name in frame.joints if name not in self._names]
        if strange:
            return f"the robot has no joint '{strange[0]}'; it has {', '.join(self._names)}"
        if not all(map(math.isfinite, frame.joints.values())):
            return "joint values must be finite"
        with self._lock:
            if frame.joints:
                self._joints = {**(self._joints or {}), **frame.joints}
            self._gripper = self._gripper if frame.gripper_open is None else frame.gripper_open
            self._events += [frame.event] if frame.event else []
            self._moved = self._moved or time.perf_counter()
        return ""


def _tell(connection: socket.socket, fault: str) -> None:
    with suppress(OSError):
        connection.sendall(msgspec.json.encode({"error": fault}) + b"\n")
