"""ROS 1 by ``rospy``, as Debian has it (``apt-get install python3-rospy``), against a real master."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import logging
import os
import sys
import threading
import xmlrpc.client
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cyclonedds.idl import IdlStruct

from orbit_core.interfaces import OrbitError
from orbit_deploy.link import RobotLinkError
from orbit_ros.messages import BY_NAME, Duration, Time, ros1_member, ros_name
from orbit_ros.node import Message, RosNode, call_safely

_LARGE = 1 << 24
_DEBIAN = Path("/usr/lib/python3/dist-packages")
_PACKAGES = "python3-rospy python3-sensor-msgs python3-trajectory-msgs python3-nav-msgs python3-tf2-msgs"


class MissingRosError(OrbitError):
    """ROS 1 that is not installed."""


@functools.cache
def rospy() -> Any:
    """Import and return rospy.

    Raises:
        MissingRosError: it is not installed.
    """
    # At the end, so that Debian's other packages do not replace the environment's.
    if str(_DEBIAN) not in sys.path and (_DEBIAN / "rospy").is_dir():
        sys.path.append(str(_DEBIAN))
    try:
        importlib.import_module("tf2_msgs.msg")
        importlib.import_module("nav_msgs.msg")
        importlib.import_module("trajectory_msgs.msg")
        return importlib.import_module("rospy")
    except ImportError as error:
        raise MissingRosError(f"ROS 1 is not installed ({error}): apt-get install {_PACKAGES}") from None


def to_ros1(message: IdlStruct) -> Any:
    """Return a message as rospy has it."""
    from roslib.message import get_message_class  # pyright: ignore[reportMissingImports]

    if isinstance(message, Time):
        return rospy().Time(message.sec, message.nanosec)
    if isinstance(message, Duration):
        return rospy().Duration(message.sec, message.nanosec)
    made = get_message_class(ros_name(type(message)))()
    for each in dataclasses.fields(message):  # pyright: ignore[reportArgumentType]
        # ROS 1 also has 'seq' in headers, which its publisher counts, and no member in Empty.
        if (name := ros1_member(type(message), each.name)) in made.__slots__:
            setattr(made, name, _convert(getattr(message, each.name), to_ros1, IdlStruct))
    return made


def from_ros1(message: Any) -> Any:
    """Return a message of rospy as this package has it."""
    import genpy  # pyright: ignore[reportMissingImports]

    if isinstance(message, genpy.TVal):
        kind = Time if isinstance(message, genpy.Time) else Duration
        return kind(message.secs, message.nsecs)
    kind = BY_NAME[message._type]
    # Members that ROS 1 has beyond ROS 2's, such as 'seq', are dropped.
    named = {each.name: ros1_member(kind, each.name) for each in dataclasses.fields(kind)}  # pyright: ignore[reportArgumentType]
    own = (genpy.Message, genpy.TVal)
    return kind(
        **{
            name: _convert(getattr(message, theirs), from_ros1, own)
            for name, theirs in named.items()
            if theirs in message.__slots__
        }
    )


def _convert(value: Any, convert: Callable[[Any], Any], kinds: Any) -> Any:
    if isinstance(value, kinds):
        return convert(value)
    if isinstance(value, list | tuple):
        return [convert(each) if isinstance(each, kinds) else each for each in value]
    return value


class Ros1Node(RosNode):
    """Node of rospy, of which a process has one; all objects share it.

    Args:
        host: of the master.
        port: of the master.

    Raises:
        MissingRosError: ROS 1 is not installed.
        RobotLinkError: there is no master, or this process is a node of another one.
    """

    _master = ""
    _lock = threading.Lock()

    def __init__(self, host: str = "127.0.0.1", port: int = 11311) -> None:
        ros, uri = rospy(), f"http://{host}:{port}"
        try:
            # rospy itself waits for a master for ever.
            xmlrpc.client.ServerProxy(uri).getPid("/orbit")
        except (OSError, xmlrpc.client.Error) as error:
            raise RobotLinkError(f"no ROS master at {uri}: {error}; start roscore") from None
        with Ros1Node._lock:
            if not Ros1Node._master:
                os.environ["ROS_MASTER_URI"] = uri
                os.environ.setdefault("ROS_IP", "127.0.0.1" if host in ("127.0.0.1", "localhost") else "")
                if not os.environ["ROS_IP"]:
                    del os.environ["ROS_IP"]
                # rospy puts a file and the level INFO into the root logger, which is the program's own.
                root = logging.getLogger()
                level, handlers = root.level, root.handlers[:]
                try:
                    # Signals and time stay the process's own: rospy would take Ctrl-C, and wait for a simulated clock.
                    ros.init_node("orbit", anonymous=True, disable_signals=True, disable_rostime=True)
                finally:
                    root.setLevel(level)
                    for handler in set(root.handlers) - set(handlers):
                        handler.close()
                    root.handlers[:] = handlers
                Ros1Node._master = uri
            elif Ros1Node._master != uri:
                raise RobotLinkError(f"this process is a node of the ROS master at {Ros1Node._master}, not {uri}")
        self._own: list[Any] = []

    def advertise(self, topic: str, kind: type[Message], latched: bool = False) -> Callable[[Message], None]:
        publisher = rospy().Publisher(f"/{topic}", _class_of(kind), queue_size=10, latch=latched, tcp_nodelay=True)
        self._own.append(publisher)
        return lambda message: publisher.publish(to_ros1(message))

    def subscribe(
        self,
        topic: str,
        kind: type[Message],
        callback: Callable[[Message, str], None],
        latched: bool = False,
        large: bool = False,
    ) -> None:
        def take(message: Any) -> None:
            source = message._connection_header["callerid"]
            call_safely(lambda each, source: callback(from_ros1(each), source), message, source)

        # rospy reads at most so many bytes of a message at a time; a picture in small pieces is slow.
        size = {"queue_size": 1, "buff_size": _LARGE} if large else {}
        self._own.append(rospy().Subscriber(f"/{topic}", _class_of(kind), take, tcp_nodelay=True, **size))

    def close(self) -> None:
        for each in self._own:
            each.unregister()
        self._own = []


def _class_of(kind: type[IdlStruct]) -> Any:
    from roslib.message import get_message_class  # pyright: ignore[reportMissingImports]

    return get_message_class(ros_name(kind))
