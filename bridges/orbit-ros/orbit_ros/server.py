"""A robot's computer as a robot of ROS: joints, clock, frames and bodies out, trajectories and arrays in.

With the simulated robot, a world of ours is the robot of ROS programs.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.computer import RobotComputer
from orbit_deploy.description import FloatArray
from orbit_deploy.messages import Fault, JointCommand, RobotState
from orbit_deploy.pictures import Picture, PictureKind
from orbit_ros import topics
from orbit_ros.base_twist import BaseTwist
from orbit_ros.body import Accelerometer, imu, odometry, transform
from orbit_ros.messages import (
    CameraInfo,
    Clock,
    Empty,
    Float64MultiArray,
    Header,
    Image,
    Imu,
    JointState,
    JointTrajectory,
    Odometry,
    String,
    TFMessage,
    Twist,
    seconds_of,
    time_of,
)
from orbit_ros.node import RosNode
from orbit_ros.sources import camera_messages

# Seconds between commands to the computer while a trajectory is followed, and that streams are expected to come at
_PERIOD = 0.02
# Periods of silence after which a held command is repeated: between those of a stream it would make stairs of the path
_SILENCE = 2.0
# Seconds that an array of commands is held, and after which the next publisher may command
_HELD = 0.5
# Least seconds between joint states: each costs this process 0.2 ms or more
_INTERVAL = 0.005
# States between frames, bodies and inertial measurements: they change slowly and cost more
_SLOWER = 4


@dataclass(frozen=True)
class _Goal:
    """Knots (K, ) of all joints at times (K,) after ``start`` on our clock, held until ``end``."""

    start: float
    end: float
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    efforts: FloatArray

    @property
    def streamed(self) -> bool:
        """True for a single target, which the next one of a stream replaces."""
        return len(self.times) == 1

    def at(self, now: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities and efforts (J,): linear between knots."""
        after = now - self.start
        return tuple(  # pyright: ignore[reportReturnType]
            np.array([np.interp(after, self.times, column) for column in table.T])
            for table in (self.positions, self.velocities, self.efforts)
        )


class RosServer:
    """Serves one robot's computer to ROS.

    Commands are anonymous in ROS: the program of the first one has the robot until it is silent for half a second, and
    others are ignored with a fault.

    Args:
        computer: of the robot; its loop runs in another thread.
        node: connection to ROS, which the server closes.
        address: for messages.
        prefix: of the robot's topics.
    """

    def __init__(self, computer: RobotComputer, node: RosNode, address: str, prefix: str = "") -> None:
        self.address = address
        self._computer, self._node, self._description = computer, node, computer.description
        self._lock, self._fresh, self._ended = threading.Lock(), threading.Event(), threading.Event()
        self._state: RobotState | None = None
        self._goal: _Goal | None = None
        self._source, self._heard, self._sequence = "", 0.0, 0
        self._ignored: set[str] = set()
        self._force = Accelerometer()
        self._joints = node.advertise(prefix + topics.JOINT_STATES, JointState)
        self._clock = node.advertise(topics.CLOCK, Clock)
        self._frames = node.advertise(topics.TF, TFMessage)
        self._faults = node.advertise(prefix + topics.FAULTS, String)
        self._base = topics.base_of(self._description)
        self._bodies = {
            name: node.advertise(prefix + topics.body_topic(name, self._description), Odometry)
            for name in self._description.objects
        }
        self._imu = node.advertise(prefix + topics.IMU, Imu) if self._base else None
        self._cameras = {camera.name: camera for camera in self._description.cameras}
        self._pictures = {
            (camera.name, kind): _advertise(node, prefix, camera.name, kind)
            for camera in self._description.cameras
            for kind in camera.kinds
        }
        describe = node.advertise(prefix + topics.DESCRIPTION, String, latched=True)
        describe(String(msgspec.json.encode(_finite(self._description)).decode()))
        node.subscribe(prefix + topics.COMMANDS["trajectory"], JointTrajectory, self._take_trajectory)
        for kind in ("positions", "velocities", "efforts"):
            node.subscribe(
                prefix + topics.COMMANDS[kind],
                Float64MultiArray,
                lambda message, source, kind=kind: self._take_array(kind, message, source),
            )
        self._twist = BaseTwist.of(self._description)
        if self._twist is not None:
            node.subscribe(prefix + topics.TWIST, Twist, self._take_twist)
        node.subscribe(prefix + topics.STOP, Empty, lambda _, __: self._stop())
        node.subscribe(prefix + topics.CLEAR, Empty, lambda _, __: self._clear())
        computer.on_state.append(self._keep)
        computer.on_fault.append(self._report)
        computer.on_picture.append(self._show)
        self._threads = [
            threading.Thread(target=target, name=f"ros {target.__name__}", daemon=True)
            for target in (self._send_states, self._send_commands)
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop serving; idempotent."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._fresh.set()
        for thread in self._threads:
            thread.join(2.0)
        self._computer.on_state.remove(self._keep)
        self._computer.on_fault.remove(self._report)
        self._computer.on_picture.remove(self._show)
        self._computer.leave(self.address)
        self._node.close()

    # From the robot

    def _keep(self, state: RobotState) -> None:
        self._state = state
        self._fresh.set()

    def _send_states(self) -> None:
        count = 0
        while self._fresh.wait() and not self._ended.is_set():
            self._fresh.clear()
            state = self._state
            assert state is not None  # set before the event
            stamp = time_of(state.stamp)
            self._joints(
                JointState(Header(stamp), self._description.joints, state.positions, state.velocities, state.efforts)
            )
            if count % _SLOWER == 0:
                self._clock(Clock(stamp))
                self._send_bodies(state, Header(stamp, topics.WORLD))
            count += 1
            self._ended.wait(_INTERVAL)

    def _send_bodies(self, state: RobotState, header: Header) -> None:
        frames = []
        for name, body in zip(self._description.objects, state.objects, strict=True):
            child = topics.BASE if name == self._base else name
            self._bodies[name](odometry(body, header, child))
            frames.append(transform(body, header, child))
            if self._imu is not None and name == self._base:
                self._imu(imu(body, self._force.update(body, state.stamp), replace(header, frame_id=child)))
        if frames:
            self._frames(TFMessage(frames))

    def _show(self, picture: Picture) -> None:
        image, info = self._pictures[picture.camera, picture.kind]
        header = Header(time_of(picture.stamp), picture.camera)
        message, calibration = camera_messages(self._cameras[picture.camera], picture, header)
        info(calibration)
        image(message)

    def _report(self, fault: Fault) -> None:
        self._faults(String(f"{fault.code}: {fault.text}"))

    def _refuse(self, text: str) -> None:
        self._report(Fault(self._computer.clock.now(), "shape", text))

    # To the robot

    def _stop(self) -> None:
        with self._lock:
            self._goal = None
        self._computer.stop()

    def _clear(self) -> None:
        with self._lock:
            self._goal = None
        self._computer.clear()

    def _take_trajectory(self, message: JointTrajectory, source: str) -> None:
        if not self._accept(source):
            return
        names = self._description.joints
        unknown = [name for name in message.joint_names if name not in names]
        if unknown or not message.points:
            cause = f"the robot has no joint {', '.join(unknown)}" if unknown else "it has no points"
            self._refuse(f"a trajectory is ignored: {cause}")
            return
        order = [names.index(name) for name in message.joint_names]
        now, state = time.monotonic(), self._state
        start = np.array(state.targets if state is not None else self._description.home)
        knots = [(0.0, start, np.zeros(len(names)), np.zeros(len(names)))]
        for point in message.points:
            rows = [knots[-1][1].copy(), np.zeros(len(names)), np.zeros(len(names))]
            for row, values in zip(rows, (point.positions, point.velocities, point.effort), strict=True):
                if len(values) not in (0, len(order)):
                    self._refuse(f"a trajectory is ignored: a point has {len(values)} numbers, not {len(order)}")
                    return
                if len(values):
                    row[order] = values
            knots.append((seconds_of(point.time_from_start), *rows))
        if len(knots) == 2 and knots[1][0] <= _SILENCE * _PERIOD:
            del knots[0]  # a stream's point is the next target, not the end of a path from here
        times = np.array([knot[0] for knot in knots])
        if (np.diff(times) < 0.0).any():
            self._refuse("a trajectory is ignored: its times do not increase")
            return
        tables = (np.array([knot[column] for knot in knots]) for column in (1, 2, 3))
        # The last point is repeated, so that the path ends there.
        self._follow(_Goal(now, now + times[-1] + 3.0 * _PERIOD, times, *tables))

    def _take_array(self, kind: str, message: Float64MultiArray, source: str) -> None:
        if not self._accept(source):
            return
        joints = len(self._description.joints)
        if len(message.data) != joints:
            self._refuse(f"{kind} are ignored: {len(message.data)} numbers for {joints} joints")
            return
        self._hold(kind, np.array(message.data, np.float64))

    def _take_twist(self, message: Twist, source: str) -> None:
        assert self._twist is not None  # subscribed to with one only
        if self._accept(source):
            state = self._state
            here = np.array(state.positions if state is not None else self._description.home)
            self._hold("velocities", self._twist.velocities(message, here))

    def _hold(self, kind: str, values: FloatArray) -> None:
        """Command values (J,) of one kind until the next ones, half a second at most."""
        row, zeros = values[None], np.zeros((1, len(values)))
        state = self._state
        held = np.array(state.targets if state is not None else self._description.home)[None]
        tables = {
            "positions": (row, zeros, zeros),
            "velocities": (held, row, zeros),
            "efforts": (held, zeros, row),
        }[kind]
        now = time.monotonic()
        self._follow(_Goal(now, now + _HELD, np.zeros(1), *tables))

    def _accept(self, source: str) -> bool:
        """Return True if commands of this publisher count; its session begins with the first."""
        now = time.monotonic()
        if source != self._source and now - self._heard < _HELD:
            if source not in self._ignored:
                self._ignored.add(source)
                self._report(Fault(self._computer.clock.now(), "busy", "a second publisher's commands are ignored"))
            return False
        begins = source != self._source
        self._source, self._heard = source, now
        if begins:
            try:
                self._computer.open(self.address, _PERIOD)
            except ConfigurationError as error:
                self._report(Fault(self._computer.clock.now(), "busy", str(error)))
                self._source = ""
                return False
        return True

    def _follow(self, goal: _Goal) -> None:
        with self._lock:
            self._goal = goal
        # At once: the next one of the thread comes up to a period later.
        self._submit(goal)

    def _send_commands(self) -> None:
        while not self._ended.wait(_PERIOD):
            goal = self._goal
            if goal is None:
                self._computer.heard()
            elif time.monotonic() > goal.end:
                with self._lock:
                    self._goal = None if self._goal is goal else self._goal
            elif not goal.streamed or time.monotonic() - goal.start > _SILENCE * _PERIOD:
                self._submit(goal)

    def _submit(self, goal: _Goal) -> None:
        with self._lock:
            numbers = (values.tolist() for values in goal.at(time.monotonic()))
            self._computer.submit(JointCommand(self._sequence, self._computer.clock.now(), *numbers))
            self._sequence += 1


def _advertise(
    node: RosNode, prefix: str, camera: str, kind: PictureKind
) -> tuple[Callable[[Image], None], Callable[[CameraInfo], None]]:
    """Return the functions that publish a camera's pictures of one kind, and its calibration next to them."""
    topic = prefix + (topics.color_topic(camera) if kind is PictureKind.RGB else topics.depth_topic(camera))
    folder = topic.rpartition("/")[0]
    return node.advertise(topic, Image), node.advertise(f"{folder}/{topics.CAMERA_INFO}", CameraInfo)


def _finite(description: object) -> object:
    """Return plain data with infinities as strings, which JSON lacks."""
    plain = msgspec.to_builtins(description)
    return {
        key: [str(value) if isinstance(value, float) and not np.isfinite(value) else value for value in values]
        if isinstance(values, list)
        else values
        for key, values in plain.items()
    }
