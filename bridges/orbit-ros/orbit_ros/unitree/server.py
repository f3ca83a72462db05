"""A simulated Go2 or G1 that speaks Unitree's low-level messages: ``rt/lowcmd`` in, ``rt/lowstate`` out."""

from __future__ import annotations

import math
import threading
import time

import numpy as np

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.computer import RobotComputer
from orbit_deploy.follower import PathKind
from orbit_deploy.messages import Fault, JointCommand, RobotState
from orbit_ros import topics
from orbit_ros.body import Accelerometer, odometry, rotation
from orbit_ros.messages import Header, Odometry, time_of
from orbit_ros.node import RosNode
from orbit_ros.unitree.layout import NO_POSITION, SERVO, Fixed
from orbit_ros.unitree.robot import COMMAND, ODOMETRY, RATE, STATE, gains, unitree_model

# States between two of the base's odometry
_SLOWER = 5
# Seconds without commands after which another publisher may command
_HELD = 0.5
# Relative difference of gains that single precision explains
_CLOSE = 1e-4
_EXPECTED_HEAD = (0xFE, 0xEF)


class UnitreeServer:
    """Serves the computer of a simulated Go2 or G1 to programs of ``unitree_sdk2``.

    The simulated motors have the gains of the robot's description: commands with other gains, a wrong checksum or
    numbers that are none are not carried out, and the robot stops as it does without commands.

    Args:
        computer: of the robot, which permits direct targets; its loop runs in another thread.
        node: connection to the DDS domain, which the server closes.
        address: for messages.

    Raises:
        UnknownNameError: the robot is neither.
        ConfigurationError: the robot permits no direct targets.
    """

    def __init__(self, computer: RobotComputer, node: RosNode, address: str) -> None:
        description = computer.description
        self._model = unitree_model(description.model)
        if not description.direct:
            raise ConfigurationError("Unitree's motors take targets as they come: add --direct to 'orbit robot'")
        self.address = address
        self._computer, self._node, self._description = computer, node, description
        self._motors = np.array(self._model.motors)
        self._kp, self._kd = gains(description)
        self._base = topics.base_of(description)
        self._fresh, self._ended = threading.Event(), threading.Event()
        self._state: RobotState | None = None
        self._source, self._heard, self._sequence = "", 0.0, 0
        self._reported: set[str] = set()
        self._force = Accelerometer()
        self._publish = node.advertise(STATE, self._model.state)
        self._publish_base = node.advertise(ODOMETRY, Odometry)
        node.subscribe(COMMAND, self._model.command, self._take)
        computer.on_state.append(self._keep)
        self._thread = threading.Thread(target=self._send, name="unitree states", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop serving; idempotent."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._fresh.set()
        self._thread.join(2.0)
        self._computer.on_state.remove(self._keep)
        self._computer.leave(self.address)
        self._node.close()

    def _keep(self, state: RobotState) -> None:
        self._state = state
        self._fresh.set()

    def _send(self) -> None:
        message, count = self._model.state.empty(), 0
        while self._fresh.wait() and not self._ended.is_set():
            self._fresh.clear()
            state = self._state
            assert state is not None  # set before the event
            record = message.record
            motors = record["motor_state"][0]
            motors["mode"][self._motors] = SERVO
            motors["q"][self._motors] = state.positions
            motors["dq"][self._motors] = state.velocities
            motors["tau_est"][self._motors] = state.efforts
            record["tick"] = state.stamp // 1_000_000 % 2**32
            if self._base:
                self._measure(record["imu_state"], state)
            self._publish(message.seal())
            if self._base and count % _SLOWER == 0:
                header = Header(time_of(state.stamp), "odom")
                body = state.objects[self._description.objects.index(self._base)]
                self._publish_base(odometry(body, header, "base_link"))
            count += 1

    def _measure(self, unit: np.ndarray, state: RobotState) -> None:
        body = state.objects[self._description.objects.index(self._base)]
        turn = rotation(np.array(body[3:7]))
        unit["quaternion"] = body[3:7]
        unit["gyroscope"] = turn.T @ np.array(body[10:13])
        unit["accelerometer"] = self._force.update(body, state.stamp)
        pitch = math.asin(min(1.0, max(-1.0, -turn[2, 0])))
        unit["rpy"] = (math.atan2(turn[2, 1], turn[2, 2]), pitch, math.atan2(turn[1, 0], turn[0, 0]))

    def _take(self, message: Fixed, source: str) -> None:
        now = time.monotonic()
        if not message.sealed:
            self._report("checksum", "a command has a wrong checksum")
            return
        if not self._model.humanoid and tuple(message.record["head"][0]) != _EXPECTED_HEAD:
            self._report("head", "a command does not begin with FE EF")
            return
        if source != self._source:
            if now - self._heard < _HELD:
                self._report(f"busy {source}", "a second publisher's commands are ignored")
                return
            try:
                self._computer.open(self.address, 1.0 / min(RATE, self._description.rate), PathKind.DIRECT)
            except ConfigurationError as error:
                self._report("busy", str(error))
                return
            self._source = source
        self._heard = now
        motors = message.record["motor_cmd"][0][self._motors]
        if not (motors["mode"] == SERVO).all():
            self._computer.stop()
            return
        close = np.isclose(motors["kp"], self._kp, rtol=_CLOSE) & np.isclose(motors["kd"], self._kd, rtol=_CLOSE)
        if not close.all():
            worst = int(np.argmin(close))
            self._report(
                "gains",
                f"a command has gains {motors['kp'][worst]:g} and {motors['kd'][worst]:g} for "
                f"{self._description.joints[worst]}, and the simulated motor has {self._kp[worst]:g} and "
                f"{self._kd[worst]:g}",
            )
            return
        if (motors["q"] == np.float32(NO_POSITION)).any():
            self._report("position", "a command holds no position for some joint with stiffness")
            return
        numbers = (motors[name].astype(np.float64).tolist() for name in ("q", "dq", "tau"))
        self._computer.submit(JointCommand(self._sequence, self._computer.clock.now(), *numbers))
        self._sequence += 1

    def _report(self, kind: str, text: str) -> None:
        """Report a fault once for each kind."""
        if kind in self._reported:
            return
        self._reported.add(kind)
        fault = Fault(self._computer.clock.now(), kind.split()[0], text)
        for listener in self._computer.on_fault:
            listener(fault)
