"""The gamepad on the screen: a page with sticks to drag, by mouse or fingers, and a socket that it talks through."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import msgspec
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from orbit_data.teleoperation.device import Event
from orbit_viewer.guard import Page

PATH = "/pad"
# s that sticks count as held after they were last heard of; a held pad is heard of 20 times a second.
_HELD = 0.25
# s from one telling of how things stand to the next.
_TOLD = 0.2
# Bytes of a frame; who sends more is no pad.
_LONGEST = 1024
_REST = (0.0,) * 6, (0.0,) * 3


class PadFrame(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What a pad says: shares in [-1, 1] of the hand's twist and of the base's (forward, left, turn), and a wish."""

    hand: tuple[float, float, float, float, float, float]
    base: tuple[float, float, float]
    event: Event | None = None


class Pad:
    """The pad's page, and what was last heard of its sticks.

    Args:
        heard: called, in the web server's thread, with what a frame asks for, after it was taken over.
    """

    def __init__(self, heard: Callable[[Event | None], None]) -> None:
        self._heard = heard
        self._lock = threading.Lock()
        self._shares: tuple[tuple[float, ...], tuple[float, ...]] = _REST
        self._time = -math.inf
        self.rows: Mapping[str, str] = {}
        """How things stand, for the person."""
        html = Path(__file__).with_name("pad.html").read_bytes()
        self.page = Page(PATH, html, self._listen)

    @property
    def shares(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Six of the hand's twist and three of the base's speeds; zeros where nobody holds a stick."""
        with self._lock:
            return self._shares if time.perf_counter() - self._time < _HELD else _REST

    async def _listen(self, connection: ServerConnection) -> None:
        telling = asyncio.create_task(self._tell(connection))
        try:
            async for message in connection:
                if fault := self._take(message):
                    await connection.send(msgspec.json.encode({"error": fault}).decode())
        except ConnectionClosed:
            pass
        finally:
            telling.cancel()

    async def _tell(self, connection: ServerConnection) -> None:
        with suppress(ConnectionClosed):
            while True:
                await connection.send(msgspec.json.encode(dict(self.rows)).decode())
                await asyncio.sleep(_TOLD)

    def _take(self, message: str | bytes) -> str:
        """Take over what a frame says; why not, if it cannot be."""
        if len(message) > _LONGEST:
            return f"a frame has {_LONGEST} bytes at most"
        try:
            frame = msgspec.json.decode(message, type=PadFrame)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            return f"no frame: {error}"
        if not all(abs(share) <= 1.0 for share in (*frame.hand, *frame.base)):
            return "shares lie in [-1, 1]"
        with self._lock:
            self._shares, self._time = (frame.hand, frame.base), time.perf_counter()
        self._heard(frame.event)
        return ""
