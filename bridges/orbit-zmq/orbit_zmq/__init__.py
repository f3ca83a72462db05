"""Bridge over ZeroMQ: ``zmq://host:port``. Importing it does not import ZeroMQ."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from orbit_deploy.computer import RobotComputer
    from orbit_zmq.client import ZmqLink
    from orbit_zmq.server import ZmqServer

__all__ = ["connect", "make_keys", "serve"]


def connect(address: str, period: float, keys: Path | None = None, path: str = "quintic") -> ZmqLink:
    """Connect to a robot (:meth:`orbit_deploy.link.Bridge.connect`)."""
    from orbit_deploy.follower import PathKind
    from orbit_zmq.client import ZmqLink

    return ZmqLink(address, period, keys, PathKind(path))


def serve(computer: RobotComputer, address: str, keys: Path | None = None) -> ZmqServer:
    """Serve a robot's computer (:meth:`orbit_deploy.link.Bridge.serve`)."""
    from orbit_zmq.server import ZmqServer

    return ZmqServer(computer, address, keys)


def make_keys(folder: Path) -> None:
    """Make keys of a robot and of a client in a new folder (:func:`orbit_zmq.keys.make_keys`)."""
    from orbit_zmq.keys import make_keys as make

    make(folder)


def __dir__() -> list[str]:
    return sorted(__all__)
