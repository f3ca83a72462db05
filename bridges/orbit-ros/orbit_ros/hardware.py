"""A robot of ROS as the hardware of our computer: joint states in, commands of its controllers out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from enum import StrEnum

import msgspec
import numpy as np
from msgspec import structs

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.clocks import StampWatch
from orbit_deploy.description import JointKind, RobotDescription
from orbit_deploy.follower import JointTargets
from orbit_deploy.hardware import Measurement, RobotHardware
from orbit_deploy.link import RobotLinkError
from orbit_deploy.pictures import Picture, PictureKind
from orbit_ros import topics
from orbit_ros.base_twist import BaseTwist
from orbit_ros.body import body_of, rotation
from orbit_ros.messages import (
    Float64MultiArray,
    Imu,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    Odometry,
    String,
    Twist,
    duration_of,
    seconds_of,
)
from orbit_ros.node import RosNode
from orbit_ros.sources import FrameTree, RosCamera, RosClock, RosSources, imu_row

# Seconds for a robot to be found and to say where it is, and after which a silent one is lost
_FOUND, _LOST = 5.0, 0.5


class CommandKind(StrEnum):
    """Message that the robot's controller takes."""

    TRAJECTORY = "trajectory"
    """``JointTrajectory`` of one point, for joint_trajectory_controller."""
    POSITIONS = "positions"
    """``Float64MultiArray`` of positions, for forward_command_controller; the other two likewise."""
    VELOCITIES = "velocities"
    """The same of velocities, rad/s or m/s."""
    EFFORTS = "efforts"
    """The same of efforts, N m or N."""
    TWIST = "twist"
    """``Twist`` of a mobile base in its own axes, m/s and rad/s; its other joints get nothing."""


def served_description(node: RosNode, prefix: str) -> RobotDescription | None:
    """Return the description that a robot of ORBIT publishes; None without one within two seconds."""
    found: list[str] = []
    heard = threading.Event()

    def take(message: String, _: str) -> None:
        found.append(message.data)
        heard.set()

    node.subscribe(prefix + topics.DESCRIPTION, String, take, latched=True)
    if not heard.wait(2.0):
        node.check()
        return None
    try:
        description = msgspec.json.decode(found[0], type=RobotDescription, strict=False)
        description.check()
    except (msgspec.DecodeError, ConfigurationError) as error:
        raise RobotLinkError(f"the robot's description on '{topics.DESCRIPTION}' cannot be read: {error}") from None
    return description


class RosHardware(RobotHardware):
    """Robot that publishes ``joint_states`` and takes commands.

    Args:
        node: connection to ROS, which the hardware closes.
        description: of the robot; joints are found in messages by their names.
        kind: message of the commands.
        rate: at which they are sent, Hz.
        prefix: of the robot's topics, such as ``panda/``.
        commands: topic of the commands; the usual one of their kind if empty.
        sources: topics and frames of what else the robot measures.

    Raises:
        ConfigurationError: the robot's joints take no commands of that kind.
        RobotLinkError: nobody publishes joint states or another source, or some joints have none.
    """

    def __init__(
        self,
        node: RosNode,
        description: RobotDescription,
        kind: CommandKind = CommandKind.TRAJECTORY,
        rate: float = 100.0,
        prefix: str = "",
        commands: str = "",
        sources: RosSources | None = None,
    ) -> None:
        _check_kind(description, kind)
        self._sources = sources = sources or RosSources()
        base = topics.base_of(description)
        # Objects of the robot's description, then those that the address names.
        own = [name for name in description.objects if sources.odometry or name != base]
        named: list[str] = list(dict.fromkeys((*own, *sources.objects, *sources.frames, *([base] if base else []))))
        self.description = structs.replace(
            description, rate=rate, arranges=False, direct=True, objects=named, imus=[*sources.imus]
        )
        self._node, self._kind, self._prefix = node, kind, prefix
        self._state: Measurement | None = None
        self._clock: RosClock | None = None
        self._arrived, self._stamp, self._stamps = 0.0, 0.0, StampWatch()
        self._missing: list[str] = list(description.joints)
        self._misfit = ""
        self._objects: dict[str, list[float]] = {}
        self._twist = BaseTwist.of(description)
        topic = prefix + (commands or topics.COMMANDS[kind])
        message = _MESSAGES.get(kind, Float64MultiArray)
        self._publish = node.advertise(topic, message)
        node.subscribe(prefix + topics.JOINT_STATES, JointState, self._take)
        self._imus: dict[str, tuple[list[float], float]] = {}
        self._inertial_base = base if not sources.odometry else ""
        if self._inertial_base and not sources.imus:
            raise ConfigurationError("without odometry the base follows an inertial unit: name one, as ?imus=imu")
        self._tracked = {
            name: prefix + sources.objects.get(name, topics.body_topic(name, description))
            for name in named
            if name not in sources.frames and name != self._inertial_base
        }
        for name, topic in self._tracked.items():
            # The default binds the name now; a closure would see the last one of the loop.
            node.subscribe(topic, Odometry, lambda message, _, name=name: self._track(name, message))
        for name, topic in sources.imus.items():
            node.subscribe(prefix + topic, Imu, lambda message, _, name=name: self._feel(name, message))
        self._frames = FrameTree(node, sources.world) if sources.frames else None
        self.clock = self._clock = RosClock(node) if sources.clock else None
        self._cameras = _cameras(node, description, sources, prefix)
        end = time.monotonic() + _FOUND
        while absence := self._absence():
            node.check()
            if time.monotonic() > end:
                raise RobotLinkError(absence)
            time.sleep(0.01)
        cameras = [each.description for each in self._cameras if each.description is not None]
        self.description = structs.replace(self.description, cameras=cameras)

    def watch(self, sink: Callable[[Picture], None], now: Callable[[], int]) -> None:
        for camera in self._cameras:
            camera.watch(sink, now)

    def read(self) -> Measurement:
        state, age = self._state, time.monotonic() - self._arrived
        assert state is not None  # waited for when this was made
        self._node.check()
        if self._misfit:
            raise RobotLinkError(f"a message on '{self._prefix}{topics.JOINT_STATES}' {self._misfit}")
        if fault := next((each.fault for each in self._cameras if each.fault), ""):
            raise RobotLinkError(fault)
        if self._clock is not None and self._clock.fault:
            raise RobotLinkError(self._clock.fault)
        if self._stamps.jump:
            topic = self._prefix + topics.JOINT_STATES
            raise RobotLinkError(f"the stamps of '{topic}' jumped by {self._stamps.jump:+.3g} s: connect again")
        # Old positions would look like a robot at rest.
        if age > _LOST:
            raise RobotLinkError(f"no joint states on '{self._prefix}{topics.JOINT_STATES}' for {age:.2f} s")
        now = time.monotonic()
        for name, (_, arrived) in self._imus.items():
            if now - arrived > _LOST:
                raise RobotLinkError(f"inertial unit '{name}' has sent nothing for {now - arrived:.2f} s")
        self._look_at_frames()
        objects = [self._objects[name] for name in self.description.objects]
        imus = [self._imus[name][0] for name in self.description.imus]
        return Measurement(state.positions, state.velocities, state.efforts, objects, imus)

    def drive(self, targets: JointTargets) -> None:
        positions, velocities, efforts = (
            values.tolist() for values in (targets.positions, targets.velocities, targets.efforts)
        )
        if self._kind is CommandKind.TRAJECTORY:
            # To be reached when the next command is due, so that the controller interpolates between both.
            point = JointTrajectoryPoint(positions, velocities, [], [], duration_of(1.0 / self.description.rate))
            self._publish(JointTrajectory(joint_names=self.description.joints, points=[point]))
            return
        if self._kind is CommandKind.TWIST:
            # Both are there since this was made.
            assert self._twist is not None
            assert self._state is not None
            self._publish(self._twist.twist(targets.velocities, self._state.positions))
            return
        data = {"positions": positions, "velocities": velocities, "efforts": efforts}[self._kind]
        self._publish(Float64MultiArray(data=data))

    def close(self) -> None:
        self._node.close()

    def _take(self, message: JointState, _: str) -> None:
        places = {name: place for place, name in enumerate(message.name)}
        self._missing = [name for name in self.description.joints if name not in places]
        if self._missing:
            return
        for what in ("position", "velocity", "effort"):
            values = getattr(message, what)
            # Velocities and efforts may be left out.
            if len(values) != len(message.name) and (len(values) or what == "position"):
                self._misfit = f"has {len(values)} numbers of {what} for {len(message.name)} names"
                return
        # Publishers order joints as they like, and may add others.
        order = [places[name] for name in self.description.joints]
        now, stamp = time.monotonic(), seconds_of(message.header.stamp)
        positions = np.array(message.position, np.float64)[order]
        last = self._state
        if len(message.velocity) == len(message.name):
            velocities = np.array(message.velocity, np.float64)[order]
        elif last is not None and stamp > self._stamp:
            # By the publisher's stamps, as arrival times jitter.
            velocities = (positions - last.positions) / (stamp - self._stamp)
        else:
            velocities = np.zeros(len(order))
        if len(message.effort) == len(message.name):
            efforts = np.array(message.effort, np.float64)[order]
        else:
            efforts = np.zeros(len(order))
        # Stamps of a simulated robot pass as fast as its clock.
        if self._clock is None:
            self._stamps.add(stamp, now)
        elif self._clock.known:
            self._stamps.add(stamp, 1e-9 * self._clock.now())
        self._state, self._arrived, self._stamp = Measurement(positions, velocities, efforts), now, stamp

    def _track(self, name: str, message: Odometry) -> None:
        self._objects[name] = body_of(message)

    def _feel(self, name: str, message: Imu) -> None:
        row = imu_row(message)
        self._imus[name] = row, time.monotonic()
        if self._inertial_base:
            # At the origin, turned and turning as the first unit says.
            (first, *_) = self._sources.imus
            if name == first:
                turn = rotation(np.array(row[:4]))
                self._objects[self._inertial_base] = [*[0.0] * 3, *row[:4], *[0.0] * 3, *(turn @ row[4:7]).tolist()]

    def _look_at_frames(self) -> None:
        for name, frame in self._sources.frames.items():
            assert self._frames is not None  # made with any frame
            if (body := self._frames.body(frame)) is not None:
                self._objects[name] = body

    def _absence(self) -> str:
        """Return the reason why the robot is not complete yet; empty if it is."""
        topic = self._prefix + topics.JOINT_STATES
        if self._state is not None:
            self._look_at_frames()
            for name in self.description.objects:
                if name in self._objects:
                    continue
                if name in self._sources.frames:
                    frame = self._sources.frames[name]
                    return f"nobody publishes frame '{frame}' of '{name}' in '{self._sources.world}' on '{topics.TF}'"
                if name != self._inertial_base:
                    return f"nobody publishes where '{name}' is: '{self._tracked[name]}'"
            for name, named in self._sources.imus.items():
                if name not in self._imus:
                    return f"no inertial unit publishes on '{self._prefix}{named}'"
            for camera in self._cameras:
                if camera.description is None:
                    return camera.fault or f"nobody publishes the calibration of '{camera.name}': '{camera.info}'"
            if self._clock is not None and not self._clock.known:
                return f"nobody publishes the time on '{topics.CLOCK}'"
            return ""
        if self._misfit:
            return f"a message on '{topic}' {self._misfit}"
        if len(self._missing) < len(self.description.joints):
            return f"'{topic}' lacks the joints {', '.join(self._missing)}"
        return f"nobody publishes joints of {self.description.model} on '{topic}'"


def _cameras(node: RosNode, description: RobotDescription, sources: RosSources, prefix: str) -> list[RosCamera]:
    """Return the cameras that the robot's description has, or else those that the address names."""
    if sources.images or sources.depths:
        return [
            RosCamera(node, name, _under(prefix, sources.images.get(name)), _under(prefix, sources.depths.get(name)))
            for name in dict.fromkeys((*sources.images, *sources.depths))
        ]
    return [
        RosCamera(
            node,
            each.name,
            prefix + topics.color_topic(each.name) if PictureKind.RGB in each.kinds else "",
            prefix + topics.depth_topic(each.name) if PictureKind.DEPTH in each.kinds else "",
            each,
        )
        for each in description.cameras
    ]


def _under(prefix: str, topic: str | None) -> str:
    return "" if topic is None else prefix + topic


_MESSAGES = {CommandKind.TRAJECTORY: JointTrajectory, CommandKind.TWIST: Twist}


def _check_kind(description: RobotDescription, kind: CommandKind) -> None:
    if kind is CommandKind.TWIST:
        if BaseTwist.of(description) is None:
            raise ConfigurationError(
                f"{description.model} has no mobile base that takes a twist: choose another ?command="
            )
        return
    served = {
        CommandKind.TRAJECTORY: {JointKind.POSITION, JointKind.VELOCITY},
        CommandKind.POSITIONS: {JointKind.POSITION},
        CommandKind.VELOCITIES: {JointKind.VELOCITY},
        CommandKind.EFFORTS: {JointKind.EFFORT},
    }[kind]
    for name, own in zip(description.joints, description.kinds, strict=True):
        if own not in served:
            raise ConfigurationError(
                f"joint {name} takes {own} commands, which '{kind}' does not carry: choose another with ?command="
            )
