"""Node of any version of ROS: topics to publish to and to subscribe to."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TypeVar

from cyclonedds.idl import IdlStruct

Message = TypeVar("Message", bound=IdlStruct)


class RosNode(ABC):
    """Connection to ROS. Callbacks are called by threads of the node and return soon."""

    @abstractmethod
    def advertise(self, topic: str, kind: type[Message], latched: bool = False) -> Callable[[Message], None]:
        """Return a function that publishes messages.

        Args:
            topic: name without a leading slash.
            kind: type of the messages.
            latched: keep the last message for subscribers that come later.
        """

    @abstractmethod
    def subscribe(
        self,
        topic: str,
        kind: type[Message],
        callback: Callable[[Message, str], None],
        latched: bool = False,
        large: bool = False,
    ) -> None:
        """Call a function with each message and the identity of its publisher.

        Args:
            topic: name without a leading slash.
            kind: type of the messages.
            callback: function.
            latched: also receive the last message that was published before.
            large: messages are pictures, whose lost parts are sent again where the publisher offers that.
        """

    def check(self) -> None:
        """Look whether the connection still works; those without a server in between do as long as they are.

        Raises:
            RobotLinkError: it is gone, or its other end has refused something.
        """

    @abstractmethod
    def close(self) -> None:
        """Leave ROS; idempotent."""


def call_safely(callback: Callable[[Message, str], None], message: Message, source: str) -> None:
    """Call a subscriber's function, whose error must not end the thread that hears the next messages.

    Args:
        callback: function.
        message: its message.
        source: publisher of the message.
    """
    try:
        callback(message, source)
    except Exception:
        logging.getLogger(__name__).exception("a message of type %s could not be used", type(message).__name__)
