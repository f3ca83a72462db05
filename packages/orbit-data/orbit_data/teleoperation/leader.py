"""Leader arm: joint values as lines of JSON over a socket of this computer."""

from __future__ import annotations

import asyncio
import secrets
import socket
import threading
import time
from collections import deque
from contextlib import suppress
from typing import Any

import msgspec

from orbit_core.interfaces import ConfigurationError
from orbit_data.teleoperation.device import FARTHEST, Device, DeviceLostError, Event, EventQueue, Reading, within_reach

# Limit of a line's bytes; a leader sends fewer.
_LONGEST = 65536
# Seconds within which a connection must send the token.
_PATIENCE = 5.0
# Limit of connections without the token at a time; one more closes the oldest, so that strangers cannot use up all.
_STRANGERS = 16


class LeaderToken(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """First line: ``{"token": "..."}``."""

    token: str
    """Secret that the session printed; other senders are turned away."""


class LeaderFrame(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Later line: ``{"joints": {"panda_joint1": 0.1}, "gripper_open": true, "event": "record"}``, all optional."""

    joints: dict[str, float] = {}
    """Positions in rad or m by the robot's joint names; other joints hold."""
    gripper_open: bool | None = None
    """Wanted state of the gripper; None keeps the last one."""
    event: Event | None = None
    """Button pressed since the last line."""


class Leader(Device):
    """Server for one leader at a time, which must know the token.

    A web page can make a browser connect to this computer, and so can every user of it. They do not know the token, and
    their messages, silence and disconnection have no effect. A leader's invalid line is answered by ``{"error": ...}``
    and has no effect either.

    Args:
        joint_names: joints that frames may name.
        port: port at 127.0.0.1; 0 takes a free one.

    Raises:
        ConfigurationError: the port is taken.
    """

    def __init__(self, joint_names: tuple[str, ...], port: int) -> None:
        self.token = secrets.token_urlsafe(24)
        """Token that a leader sends first."""
        self._names = joint_names
        self._lock = threading.Lock()
        self._joints: dict[str, float] | None = None
        self._gripper: bool | None = None
        self._events = EventQueue()
        self._moved: float | None = None
        self._lost = ""
        self._connected = False
        self._strangers: deque[asyncio.Task[Any]] = deque()
        try:
            self._socket = socket.create_server(("127.0.0.1", port))
        except OSError as error:
            raise ConfigurationError(f"no leader can connect to port {port}: {error}; choose --leader-port") from None
        self.port = self._socket.getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._serving = self._loop.create_task(self._serve())
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def greeting(self) -> str:
        """First line of a leader, without its end."""
        return msgspec.json.encode(LeaderToken(self.token)).decode()

    def read(self) -> Reading:
        with self._lock:
            if self._lost:
                raise DeviceLostError(self._lost)
            reading = Reading(
                joints=self._joints, gripper_open=self._gripper, events=self._events.take(), moved_at=self._moved
            )
            self._moved = None
        return reading

    def close(self) -> None:
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._serving.cancel)
            self._thread.join()

    # In the thread of the socket ------------------------------------------------------------------------------------

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        with suppress(asyncio.CancelledError):
            self._loop.run_until_complete(self._serving)
        # A connection that is being accepted is a task that begins another, and closes its socket only once it has run.
        while asyncio.all_tasks(self._loop):
            self._loop.run_until_complete(asyncio.sleep(0))
            for task in (tasks := asyncio.all_tasks(self._loop)):
                task.cancel()
            self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self._loop.run_until_complete(asyncio.sleep(0))  # closes the sockets of cancelled tasks
        self._loop.close()
        self._socket.close()

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._meet, sock=self._socket, limit=_LONGEST)
        try:
            await asyncio.Future()
        finally:
            server.close()

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with suppress(OSError):
                if fault := await self._greet(reader):
                    await _answer(writer, fault)
                else:
                    await self._listen(reader, writer)
        except asyncio.CancelledError:  # pushed out, or the session ends
            writer.transport.abort()
        finally:
            writer.close()

    async def _greet(self, reader: asyncio.StreamReader) -> str:
        """Wait for the token, and return why the connection is refused; empty if it is not."""
        task = asyncio.current_task()
        assert task is not None
        self._strangers.append(task)
        if len(self._strangers) > _STRANGERS:
            self._strangers[0].cancel()
        try:
            line = await asyncio.wait_for(_line(reader), _PATIENCE)
            given = msgspec.json.decode(line, type=LeaderToken).token
        except (TimeoutError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            given = ""
        finally:
            self._strangers.remove(task)
        # In constant time, so that answers do not reveal how much of a guess is right.
        if not secrets.compare_digest(given.encode(errors="replace"), self.token.encode()):
            return 'the first line must be {"token": "..."}, with the token that was printed where the session began'
        if self._connected:
            return "another leader is connected"
        self._connected = True
        return ""

    async def _listen(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await _line(reader):
                if not line.endswith(b"\n"):
                    await _answer(writer, f"a line is at most {_LONGEST} bytes, and ends in a newline")
                    break
                if fault := self._take(line):
                    await _answer(writer, fault)
        finally:
            with self._lock:
                self._lost = "the leader arm's connection was closed"

    def _take(self, line: bytes) -> str:
        """Apply a line, and return why it is refused; empty if it is not."""
        try:
            frame = msgspec.json.decode(line, type=LeaderFrame)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            return f"invalid frame: {error}"
        strange = [name for name in frame.joints if name not in self._names]
        if strange:
            return f"the robot has no joint '{strange[0]}'; it has {', '.join(self._names)}"
        if not within_reach(frame.joints.values()):
            return f"joint values must be finite, and at most {FARTHEST:g} rad or m"
        with self._lock:
            if frame.event and not self._events.add(frame.event):
                return f"{len(self._events)} events wait for the next step already: send them one at a time"
            if frame.joints:
                self._joints = {**(self._joints or {}), **frame.joints}
            self._gripper = self._gripper if frame.gripper_open is None else frame.gripper_open
            self._moved = self._moved or time.perf_counter()  # the oldest: latency counts from the first move
        return ""


async def _line(reader: asyncio.StreamReader) -> bytes:
    """Read a line; one that is too long is returned without its end."""
    try:
        return await reader.readline()
    except ValueError:  # asyncio has thrown the line away
        return b"too long"


async def _answer(writer: asyncio.StreamWriter, fault: str) -> None:
    writer.write(msgspec.json.encode({"error": fault}) + b"\n")
    await writer.drain()
