"""Messages on the wire: MessagePack of typed structures, read strictly.

A client sends a :class:`Hello` with the version first, and gets an :class:`Offer`, or a :class:`Refusal` that says why.
"""

from __future__ import annotations

from typing import TypeVar

import msgspec

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.description import RobotDescription
from orbit_deploy.follower import PathKind
from orbit_deploy.messages import Arrangement, Fault, JointCommand, RobotState
from orbit_deploy.pictures import Picture

MOST_BYTES = 1 << 20
"""Longest message that is read."""
MOST_PICTURE_BYTES = 1 << 26
"""Longest picture that is read."""


class Hello(msgspec.Struct, frozen=True, array_like=True, tag="hello"):
    """First message of a client."""

    version: int
    """Version of the messages that the client speaks."""
    client: str
    """Name of the client, for those who find the robot busy."""
    period: float
    """Seconds between commands."""
    path: PathKind = PathKind.QUINTIC
    """Way in which its commands become a path."""


class Ping(msgspec.Struct, frozen=True, array_like=True, tag="ping"):
    """Question for the robot's clock; keeps the session too."""

    sent: int
    """Client's time, ns."""


class MoveTo(msgspec.Struct, frozen=True, array_like=True, tag="move"):
    """Request for a slow motion."""

    positions: list[float]
    """Positions (J) to move to, rad or m."""


class Order(msgspec.Struct, frozen=True, array_like=True, tag="order"):
    """Request without numbers."""

    word: str
    """``clear``, ``stop`` or ``leave``."""


class Offer(msgspec.Struct, frozen=True, tag="offer"):
    """Answer to a hello: the session has begun."""

    description: RobotDescription
    """Robot of the session."""
    state: RobotState
    """Newest state of the robot."""
    pictures: int = 0
    """Port on which the robot's cameras publish; 0 without cameras."""


class Pong(msgspec.Struct, frozen=True, array_like=True, tag="pong"):
    """Answer to a ping."""

    sent: int
    """Client's time in the ping, ns, returned as it came."""
    clock: int
    """Robot's time, ns."""


class Answer(msgspec.Struct, frozen=True, array_like=True, tag="answer"):
    """State after a request."""

    state: RobotState
    """State of the robot after the request was met."""


class Refusal(msgspec.Struct, frozen=True, array_like=True, tag="refusal"):
    """A request or a session is refused."""

    code: str
    """``version``, ``busy``, ``message`` or ``request``."""
    text: str
    """Reason in words."""


FromClient = Hello | Ping | JointCommand | MoveTo | Arrangement | Order
# An offer is a map, for robots of other versions may describe more.
FromRobot = Pong | RobotState | Fault | Answer | Refusal
_Message = TypeVar("_Message")


class Codec:
    """Encoder and decoders of one thread."""

    def __init__(self) -> None:
        self._encoder = msgspec.msgpack.Encoder()
        self._from_client = msgspec.msgpack.Decoder(FromClient)
        self._from_robot = msgspec.msgpack.Decoder(FromRobot)
        self._offer = msgspec.msgpack.Decoder(Offer)
        self._picture = msgspec.msgpack.Decoder(Picture)

    def encode(self, message: object) -> bytes:
        """Return the bytes of a message."""
        return self._encoder.encode(message)

    def from_client(self, data: bytes) -> FromClient:
        """Read a client's message.

        Raises:
            ConfigurationError: it is none.
        """
        return _read(self._from_client, data)

    def from_robot(self, data: bytes) -> FromRobot | Offer:
        """Read a robot's message.

        Raises:
            ConfigurationError: it is none.
        """
        # A map begins with another byte than an array.
        if data[:1] and data[0] & 0xF0 in (0x80, 0xD0) and data[0] not in (0xDC, 0xDD):
            return _read(self._offer, data)
        return _read(self._from_robot, data)

    def picture(self, data: bytes) -> Picture:
        """Read a picture.

        Raises:
            ConfigurationError: it is none.
        """
        return _read(self._picture, data, MOST_PICTURE_BYTES)


def _read(decoder: msgspec.msgpack.Decoder[_Message], data: bytes, most: int = MOST_BYTES) -> _Message:
    if len(data) > most:
        raise ConfigurationError(f"a message of {len(data):,} bytes is longer than any")
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigurationError(f"a message was not understood: {error}") from None
