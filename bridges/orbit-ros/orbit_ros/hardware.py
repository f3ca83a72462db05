"""A robot of ROS as the hardware of our computer: joint states in, commands of its controllers out."""

from __future__ import annotations

import threading
import time
from enum import StrEnum

import msgspec
import numpy as np
from msgspec import structs

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.description import JointKind, RobotDescription
from orbit_deploy.follower import JointTargets
from orbit_deploy.hardware import Measurement, RobotHardware
from orbit_deploy.link import RobotLinkError
from orbit_ros import topics
from orbit_ros.body import body_of
from orbit_ros.messages import (
    Float64MultiArray,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    Odometry,
    String,
    duration_of,
    seconds_of,
)
from orbit_ros.node import RosNode

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
        return msgspec.json.decode(found[0], type=RobotDescription, strict=False)
    except msgspec.DecodeError as error:
        raise RobotLinkError(f"the robot's description on '{topics.DESCRIPTION}' cannot be read: {error}") from None


class RosHardware(RobotHardware):
    """Robot that publishes ``joint_states`` and takes commands.

    Args:
        node: connection to ROS, which the hardware closes.
        description: of the robot; joints are found in messages by their names.
        kind: message of the commands.
        rate: at which they are sent, Hz.
        prefix: of the robot's topics, such as ``panda/``.
        commands: topic of the commands; the usual one of their kind if empty.

    Raises:
        ConfigurationError: the robot's joints take no commands of that kind.
        RobotLinkError: nobody publishes joint states, or some joints have none.
    """

    def __init__(
        self,
        node: RosNode,
        description: RobotDescription,
        kind: CommandKind = CommandKind.TRAJECTORY,
        rate: float = 100.0,
        prefix: str = "",
        commands: str = "",
    ) -> None:
        _check_kind(description, kind)
        self.description = structs.replace(description, rate=rate, arranges=False, direct=True)
        self._node, self._kind, self._prefix = node, kind, prefix
        self._state: Measurement | None = None
        self._arrived, self._stamp = 0.0, 0.0
        self._missing: list[str] = list(description.joints)
        self._objects: dict[str, list[float]] = {}
        topic = prefix + (commands or topics.COMMANDS[kind])
        message = JointTrajectory if kind is CommandKind.TRAJECTORY else Float64MultiArray
        self._publish = node.advertise(topic, message)
        node.subscribe(prefix + topics.JOINT_STATES, JointState, self._take)
        for name in description.objects:
            topic = prefix + topics.body_topic(name, description)
            # The default binds the name now; a closure would see the last one of the loop.
            node.subscribe(topic, Odometry, lambda message, _, name=name: self._track(name, message))
        end = time.monotonic() + _FOUND
        while self._state is None or len(self._objects) < len(description.objects):
            node.check()
            if time.monotonic() > end:
                raise RobotLinkError(self._absence())
            time.sleep(0.01)

    def read(self) -> Measurement:
        state, age = self._state, time.monotonic() - self._arrived
        assert state is not None  # waited for when this was made
        self._node.check()
        # Old positions would look like a robot at rest.
        if age > _LOST:
            raise RobotLinkError(f"no joint states on '{self._prefix}{topics.JOINT_STATES}' for {age:.2f} s")
        return Measurement(
            state.positions, state.velocities, state.efforts, [self._objects[name] for name in self.description.objects]
        )

    def drive(self, targets: JointTargets) -> None:
        positions, velocities, efforts = (
            values.tolist() for values in (targets.positions, targets.velocities, targets.efforts)
        )
        if self._kind is CommandKind.TRAJECTORY:
            # To be reached when the next command is due, so that the controller interpolates between both.
            point = JointTrajectoryPoint(positions, velocities, [], [], duration_of(1.0 / self.description.rate))
            self._publish(JointTrajectory(joint_names=self.description.joints, points=[point]))
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
        if not np.isfinite(positions).all():
            return  # as if it had not come: the robot is lost if it goes on
        self._state, self._arrived, self._stamp = Measurement(positions, velocities, efforts), now, stamp

    def _track(self, name: str, message: Odometry) -> None:
        self._objects[name] = body_of(message)

    def _absence(self) -> str:
        topic = self._prefix + topics.JOINT_STATES
        if self._state is not None:
            name = next(each for each in self.description.objects if each not in self._objects)
            return f"nobody publishes where '{name}' is: '{self._prefix}{topics.body_topic(name, self.description)}'"
        if len(self._missing) < len(self.description.joints):
            return f"'{topic}' lacks the joints {', '.join(self._missing)}"
        return f"nobody publishes joints of {self.description.model} on '{topic}'"


def _check_kind(description: RobotDescription, kind: CommandKind) -> None:
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
