"""Bridges by the scheme of their addresses: ``ros1://``, ``ros2://``, ``rosbridge://`` and ``unitree://``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, urlsplit

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.follower import PathKind
from orbit_deploy.link import RobotLink, RobotLinkError

if TYPE_CHECKING:
    from orbit_deploy.computer import RobotComputer
    from orbit_deploy.description import RobotDescription
    from orbit_deploy.link import BridgeServer
    from orbit_ros.node import RosNode
    from orbit_ros.sources import RosSources

_LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True)
class RosAddress:
    """Parts of an address ``scheme://host:port/prefix?option=value``."""

    host: str
    """Host name or address; 127.0.0.1 where the address names none."""
    port: int | None
    """Port; None for the scheme's default."""
    path: str
    """Prefix of topics, or a robot's name; without slashes at its ends."""
    options: dict[str, str] = field(default_factory=dict)
    """Options after the question mark, by name."""

    @property
    def prefix(self) -> str:
        """Prefix of topics."""
        return f"{self.path}/" if self.path else ""

    @staticmethod
    def of(address: str, keys: Path | None, options: tuple[str, ...]) -> RosAddress:
        """Read an address.

        Args:
            address: to read.
            keys: folder of keys, which ROS has no use for.
            options: names that the bridge knows.

        Raises:
            ConfigurationError: the address is none, an option is unknown, or other machines are reached unasked.
        """
        parts = urlsplit(address)
        try:
            port = parts.port
        except ValueError as error:
            raise ConfigurationError(f"'{address}' is no address: {error}") from None
        if keys is not None:
            raise ConfigurationError("ROS and DDS have no keys here: use zmq:// where a robot is reached by keys")
        found = dict(parse_qsl(parts.query, keep_blank_values=True))
        if unknown := sorted({*found} - {*options, "trusted"}):
            known = ", ".join((*options, "trusted"))
            raise ConfigurationError(f"'{address}' has unknown options {', '.join(unknown)}: known are {known}")
        host = parts.hostname or "127.0.0.1"
        # A robot on an open network obeys anyone who publishes, so that the user has to say that it is not open.
        if host not in _LOOPBACK and found.get("trusted") != "yes":
            raise ConfigurationError(
                f"ROS neither authenticates nor encrypts, and {host} is another machine: on a network of your own, "
                "add ?trusted=yes to the address"
            )
        return RosAddress(host, port, parts.path.strip("/"), found)


@dataclass(frozen=True)
class RosBridge:
    """Bridge over one way into ROS.

    Args:
        node: makes a connection of an address.
        options: of the address that the connection reads.
        client_only: True if programs of ROS cannot be told apart by it, so that no robot is served.
    """

    node: Callable[[RosAddress], RosNode]
    options: tuple[str, ...] = ()
    client_only: bool = False

    def connect(
        self, address: str, period: float, keys: Path | None = None, path: PathKind = PathKind.QUINTIC
    ) -> RobotLink:
        """Connect to a robot of ROS (:meth:`orbit_deploy.link.Bridge.connect`)."""
        # Imported on use: addresses of other schemes must not need Cyclone DDS or rospy.
        from orbit_ros.hardware import CommandKind, RosHardware, served_description
        from orbit_ros.hosted import HostedLink

        parts = RosAddress.of(address, keys, ("robot", "command", "topic", "rate", *_SOURCES, *self.options))
        command = parts.options.get("command", "trajectory")
        if command not in [*CommandKind]:
            raise ConfigurationError(f"command '{command}' is none of {', '.join(CommandKind)}")
        rate = _number(parts, "rate", 100.0)
        node = self.node(parts)
        try:
            if (name := parts.options.get("robot")) is not None:
                description = _catalogued(name)
            # A computer of ORBIT publishes its limits; of other robots the catalogue gives them.
            elif (description := served_description(node, parts.prefix)) is None:
                raise RobotLinkError(
                    f"no robot at {address} publishes 'orbit/description': say which robot it is with ?robot=NAME "
                    "('orbit list robots'), if there is one"
                )
            topic = parts.options.get("topic", "")
            hardware = RosHardware(node, description, CommandKind(command), rate, parts.prefix, topic, _sources(parts))
        except Exception:
            node.close()
            raise
        return HostedLink(hardware, address, period, path)

    def serve(self, computer: RobotComputer, address: str, keys: Path | None = None) -> BridgeServer:
        """Serve a robot's computer to ROS (:meth:`orbit_deploy.link.Bridge.serve`)."""
        from orbit_ros.server import RosServer

        if self.client_only:
            raise ConfigurationError(
                "rosbridge reaches a robot of ROS: serve it with --bridge ros1 or ros2 next to rosbridge"
            )
        parts = RosAddress.of(address, keys, self.options)
        return RosServer(computer, self.node(parts), address, parts.prefix)


def _ros1(parts: RosAddress) -> RosNode:
    from orbit_ros.ros1 import Ros1Node

    # The master's usual port.
    return Ros1Node(parts.host, parts.port or 11311)


def _ros2(parts: RosAddress) -> RosNode:
    from orbit_ros.dds import Ros2Node

    # ROS 2 has domains in the place of ports, and 0 is the usual one.
    return Ros2Node(parts.port or 0, parts.host)


def _rosbridge(parts: RosAddress) -> RosNode:
    from orbit_ros.rosbridge import RosbridgeNode

    version = parts.options.get("ros", "1")
    if version not in ("1", "2"):
        raise ConfigurationError(f"ros is the version of ROS behind rosbridge, 1 or 2, not '{version}'")
    return RosbridgeNode(parts.host, parts.port or 9090, int(version))


class UnitreeBridge:
    """Bridge over Unitree's low-level messages: ``unitree://host:domain/go2``."""

    def connect(
        self, address: str, period: float, keys: Path | None = None, path: PathKind = PathKind.DIRECT
    ) -> RobotLink:
        """Connect to a Go2 or G1 (:meth:`orbit_deploy.link.Bridge.connect`)."""
        from orbit_ros.hosted import HostedLink
        from orbit_ros.unitree.robot import UnitreeHardware

        parts = RosAddress.of(address, keys, ("odometry",))
        hardware = UnitreeHardware(_ros2(parts), parts.path, odometry=parts.options.get("odometry", "yes") != "no")
        return HostedLink(hardware, address, period, path)

    def serve(self, computer: RobotComputer, address: str, keys: Path | None = None) -> BridgeServer:
        """Serve a simulated Go2 or G1 (:meth:`orbit_deploy.link.Bridge.serve`)."""
        from orbit_ros.unitree.server import UnitreeServer

        parts = RosAddress.of(address, keys, ())
        return UnitreeServer(computer, _ros2(parts), address)


_SOURCES = ("images", "depths", "imus", "objects", "frames", "world", "odometry", "time")


def _sources(parts: RosAddress) -> RosSources:
    """Return the sources that an address names, as ``images=front:head/color/image_raw,hand``."""
    from orbit_ros import topics
    from orbit_ros.sources import RosSources

    odometry, clock = parts.options.get("odometry", "yes"), parts.options.get("time", "wall")
    if odometry not in ("yes", "no") or clock not in ("wall", "clock"):
        raise ConfigurationError(f"odometry is yes or no, and time wall or clock, not '{odometry}' and '{clock}'")
    return RosSources(
        _named(parts, "images", topics.color_topic),
        _named(parts, "depths", topics.depth_topic),
        _named(parts, "imus", lambda _: topics.IMU),
        _named(parts, "objects", lambda name: f"objects/{name}"),
        _named(parts, "frames", lambda name: name),
        parts.options.get("world", topics.WORLD),
        odometry == "yes",
        clock == "clock",
    )


def _named(parts: RosAddress, option: str, usual: Callable[[str], str]) -> dict[str, str]:
    """Return the topics or frames of an option by name; the usual one where only the name is given."""
    found: dict[str, str] = {}
    for each in filter(None, parts.options.get(option, "").split(",")):
        name, _, given = each.partition(":")
        found[name] = given.lstrip("/") or usual(name)
    return found


def _number(parts: RosAddress, name: str, default: float) -> float:
    try:
        value = float(parts.options.get(name, default))
    except ValueError:
        value = float("nan")
    if not 1.0 <= value <= 1000.0:
        raise ConfigurationError(f"{name} is a number from 1 to 1000, not '{parts.options[name]}'")
    return value


def _catalogued(name: str) -> RobotDescription:
    from msgspec import structs

    from orbit_assets.catalogue import robot
    from orbit_deploy.description import RobotDescription

    spec = robot(name)
    # A robot that walks or drives needs an estimate of its base, which ROS publishes as odometry.
    return structs.replace(RobotDescription.of(spec), objects=[] if spec.fixed_base else ["robot"])


ROS1, ROS2, UNITREE = RosBridge(_ros1), RosBridge(_ros2), UnitreeBridge()
ROSBRIDGE = RosBridge(_rosbridge, ("ros",), client_only=True)
