"""ROS over rosbridge: JSON over a web socket to a server next to ROS 1 or ROS 2, by ``roslibpy``.

The protocol is rosbridge's version 2: https://github.com/RobotWebTools/rosbridge_suite/blob/ros1/ROSBRIDGE_PROTOCOL.md
"""

from __future__ import annotations

import base64
import dataclasses
import functools
import importlib
import logging
import math
import socket
import threading
from collections.abc import Callable
from typing import Any, TypeVar, get_args, get_type_hints

from cyclonedds.idl import IdlStruct

from orbit_core.installing import install_command
from orbit_core.interfaces import ConfigurationError
from orbit_deploy.link import RobotLinkError
from orbit_ros.messages import Duration, Empty, Time, ros1_member, ros_name
from orbit_ros.node import Message, RosNode, call_safely

# Seconds for the server's socket, and for the handshake of the web socket
_REACHED, _CONNECTED = 2.0, 5.0
_Struct = TypeVar("_Struct", bound=IdlStruct)


class RosbridgeNode(RosNode):
    """Client of one rosbridge server. It does not connect again when the server is gone: a robot must not come back.

    rosbridge does not say who publishes, so that all programs on its topics are one source.

    Args:
        host: of the server.
        port: of the server, usually 9090.
        version: of ROS behind it, 1 or 2, which name types and times differently.

    Raises:
        ConfigurationError: roslibpy is not installed.
        RobotLinkError: no rosbridge server answers there.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 9090, version: int = 1) -> None:
        try:
            self._library = importlib.import_module("roslibpy")
        except ImportError:
            raise ConfigurationError(f"rosbridge needs roslibpy: {install_command('orbit-ros[rosbridge]')}") from None
        self._address, self._ros1 = f"{host}:{port}", version == 1
        self._topics: list[Any] = []
        self._refusal = ""
        try:
            # roslibpy itself tries for ever, in the background.
            socket.create_connection((host, port), _REACHED).close()
        except OSError as error:
            raise RobotLinkError(f"no rosbridge server at {self._address}: {error}") from None
        # Its other transport, Twisted, has a reactor that a process can run once only.
        self._ros = self._library.Ros(host, port, transport="asyncio")
        self._ros.factory.maxRetries = 0
        ready = threading.Event()
        self._ros.factory.on_ready(lambda protocol: self._greet(protocol, ready))
        if not ready.wait(_CONNECTED):
            raise RobotLinkError(f"the server at {self._address} does not answer as rosbridge does")

    def advertise(self, topic: str, kind: type[Message], latched: bool = False) -> Callable[[Message], None]:
        made = self._topic(topic, kind, latch=latched, queue_size=10)
        made.advertise()

        def publish(message: Message) -> None:
            # Without a connection, messages would wait for one.
            self.check()
            made.publish(to_json(message, self._ros1))

        return publish

    def subscribe(
        self,
        topic: str,
        kind: type[Message],
        callback: Callable[[Message, str], None],
        latched: bool = False,
        large: bool = False,
    ) -> None:
        def take(message: Any) -> None:
            call_safely(lambda each, source: callback(from_json(each, kind), source), message, self._address)

        # A queue of one on the server's side: of states, the newest counts.
        self._topic(topic, kind, queue_length=1).subscribe(take)

    def check(self) -> None:
        if not self._ros.is_connected:
            raise RobotLinkError(f"the rosbridge server at {self._address} is gone")
        if self._refusal:
            raise RobotLinkError(f"the rosbridge server at {self._address} refuses: {self._refusal}")

    def close(self) -> None:
        topics, self._topics = self._topics, []
        for each in topics if self._ros.is_connected else ():
            each.unsubscribe()
            each.unadvertise()
        self._ros.close()

    def _topic(self, name: str, kind: type[IdlStruct], **options: Any) -> Any:
        named = ros_name(kind) if self._ros1 else ros_name(kind).replace("/", "/msg/")
        made = self._library.Topic(self._ros, f"/{name}", named, reconnect_on_close=False, **options)
        self._topics.append(made)
        return made

    def _greet(self, protocol: Any, ready: threading.Event) -> None:
        # roslibpy 2.1 knows the operation and has no handler for it, and lets none be registered.
        protocol._message_handlers["status"] = self._hear
        ready.set()

    def _hear(self, status: Any) -> None:
        """Take a status: an error is what the server made of a message of ours."""
        text = str(status.get("msg", ""))
        if status.get("level") == "error":
            self._refusal = " ".join(text.split())
        else:
            logging.getLogger(__name__).info("rosbridge: %s", text)


def to_json(message: IdlStruct, ros1: bool) -> dict[str, Any]:
    """Return a message as rosbridge has it: numbers that are not finite as null, bytes in base 64.

    Args:
        message: to convert.
        ros1: True for ROS 1, where members of times have other names.
    """
    if ros1 and isinstance(message, Time | Duration):
        return {"secs": message.sec, "nsecs": message.nanosec}
    if isinstance(message, Empty):
        return {}
    kind = type(message)
    named = {name: ros1_member(kind, name) if ros1 else name for name, _ in _members(kind)}
    return {theirs: _plain(getattr(message, name), ros1) for name, theirs in named.items()}


def from_json(values: Any, kind: type[_Struct]) -> _Struct:
    """Return a message of rosbridge's; members that it lacks, or that are not ours, are left out.

    Args:
        values: as :func:`to_json` returns them, of ROS 1 or 2.
        kind: type of the message.
    """
    if kind in (Time, Duration):
        return kind(int(values.get("secs", values.get("sec", 0))), int(values.get("nsecs", values.get("nanosec", 0))))
    made = kind()
    for name, element in _members(kind):
        theirs = name if name in values else ros1_member(kind, name)
        if theirs in values:
            setattr(made, name, _value(values[theirs], element, getattr(made, name)))
    return made


def _plain(value: Any, ros1: bool) -> Any:
    if isinstance(value, IdlStruct):
        return to_json(value, ros1)
    if isinstance(value, bytes | bytearray | memoryview):
        return base64.b64encode(value).decode()
    if isinstance(value, list | tuple):
        return [_plain(each, ros1) for each in value]
    # JSON has no such numbers.
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _value(value: Any, element: Any, default: Any) -> Any:
    if isinstance(default, IdlStruct):
        return from_json(value, type(default))
    if isinstance(default, list):
        if isinstance(value, str):
            return base64.b64decode(value)
        if isinstance(element, type) and issubclass(element, IdlStruct):
            return [from_json(each, element) for each in value]
        return [math.nan if each is None else each for each in value]
    return type(default)(math.nan if value is None else value)


@functools.cache
def _members(kind: type[IdlStruct]) -> list[tuple[str, Any]]:
    """Return name of each member, and the type of its elements where it is a sequence."""
    hints = get_type_hints(kind, include_extras=True)
    found: list[tuple[str, Any]] = []
    for member in dataclasses.fields(kind):  # pyright: ignore[reportArgumentType]
        marks = get_args(hints[member.name])
        found.append((member.name, getattr(marks[-1], "subtype", None) if marks else None))
    return found
