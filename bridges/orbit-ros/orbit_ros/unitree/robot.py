"""Unitree's Go2 and G1 as the hardware of our computer: ``rt/lowcmd`` out, ``rt/lowstate`` in."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from msgspec import structs

from orbit_assets.catalogue import robot
from orbit_core.interfaces import UnknownNameError
from orbit_deploy.description import FloatArray, JointKind, RobotDescription
from orbit_deploy.follower import JointTargets
from orbit_deploy.hardware import Measurement, RobotHardware
from orbit_deploy.link import RobotLinkError
from orbit_ros.body import body_of
from orbit_ros.messages import Odometry
from orbit_ros.node import RosNode
from orbit_ros.unitree.layout import (
    NO_POSITION,
    NO_VELOCITY,
    SERVO,
    Fixed,
    GoLowCmd,
    GoLowState,
    HgLowCmd,
    HgLowState,
)

COMMAND, STATE = "lowcmd", "lowstate"
ODOMETRY = "utlidar/robot_odom"
"""Topic where the base is, as an estimator of the robot publishes it."""
RATE = 500.0
"""Rate of commands, Hz, as in Unitree's examples."""
# Seconds for the robot to be found, and after which a silent one is lost
_FOUND, _LOST = 8.0, 0.5
_HEAD, _LOW_LEVEL = (0xFE, 0xEF), 0xFF


@dataclass(frozen=True)
class UnitreeModel:
    """One model."""

    robot: str
    """Name in the catalogue."""
    command: type[Fixed]
    """Message of all motors' commands."""
    state: type[Fixed]
    """Message of all motors' states."""
    motors: tuple[int, ...]
    """Motor of each joint, in the catalogue's order."""
    humanoid: bool
    """True for messages of ``unitree_hg``."""


# The catalogue has legs from left to right, and Go2's motors from right to left.
MODELS = {
    "go2": UnitreeModel("unitree_go2", GoLowCmd, GoLowState, (3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8), humanoid=False),
    "g1": UnitreeModel("unitree_g1", HgLowCmd, HgLowState, tuple(range(29)), humanoid=True),
}


def unitree_model(name: str) -> UnitreeModel:
    """Return a model by its short name or its name in the catalogue.

    Raises:
        UnknownNameError: there is no such model.
    """
    short = name.removeprefix("unitree_")
    if short not in MODELS:
        raise UnknownNameError("Unitree robot", name, [*MODELS])
    return MODELS[short]


class UnitreeHardware(RobotHardware):
    """One Go2 or G1 in low-level mode. Release its own controllers first (Unitree's motion switcher).

    The motors apply ``tau + kp (q - measured) + kd (dq - measured)`` with the description's stiffness and damping, so
    that targets go to them directly.

    Args:
        node: connection to its DDS domain, which the hardware closes.
        model: ``go2`` or ``g1``.
        odometry: whether an estimator publishes where the base is; without one the base is reported at the origin, with
            the orientation and angular velocity that the robot's inertial unit measures.

    Raises:
        UnknownNameError: there is no such model.
        RobotLinkError: no robot publishes its state.
    """

    def __init__(self, node: RosNode, model: str, odometry: bool = True) -> None:
        self._model, self._node = unitree_model(model), node
        described = RobotDescription.of(robot(self._model.robot), RATE)
        self.description = structs.replace(described, objects=["robot"], direct=True)
        """Robot of the catalogue, whose tracked object is its base."""
        self._motors = np.array(self._model.motors)
        self._kp, self._kd = gains(described)
        self._command = self._model.command.empty()
        self._prepare()
        self._state: Fixed | None = None
        self._arrived, self._bad = 0.0, 0
        self._base: list[float] | None = None
        self._odometry = odometry
        self._publish = node.advertise(COMMAND, self._model.command)
        node.subscribe(STATE, self._model.state, self._take)
        if odometry:
            node.subscribe(ODOMETRY, Odometry, self._track)
        end = time.monotonic() + _FOUND
        while self._state is None or (odometry and self._base is None):
            if time.monotonic() > end:
                node.close()
                raise RobotLinkError(self._absence())
            time.sleep(0.01)

    def read(self) -> Measurement:
        state, age = self._state, time.monotonic() - self._arrived
        assert state is not None  # waited for when this was made
        if age > _LOST:
            raise RobotLinkError(f"no state of the {self._model.robot} on 'rt/{STATE}' for {age:.2f} s")
        motors = state.record["motor_state"][0]
        q, dq, tau = (motors[name][self._motors].astype(np.float64) for name in ("q", "dq", "tau_est"))
        return Measurement(q, dq, tau, [self._base or self._inertial(state)])

    def drive(self, targets: JointTargets) -> None:
        motors = self._command.record["motor_cmd"][0]
        motors["q"][self._motors] = targets.positions
        motors["dq"][self._motors] = targets.velocities
        motors["tau"][self._motors] = targets.efforts
        if self._model.humanoid and self._state is not None:
            # A G1 ignores commands that do not repeat the machine type that it reports.
            self._command.record["mode_machine"] = self._state.record["mode_machine"]
        self._publish(self._command.seal())

    def close(self) -> None:
        self._node.close()

    def _prepare(self) -> None:
        record = self._command.record
        motors = record["motor_cmd"][0]
        if not self._model.humanoid:
            record["head"], record["level_flag"] = _HEAD, _LOW_LEVEL
            # Motors without a joint, of which Go2's message has eight, follow nothing.
            motors["mode"], motors["q"], motors["dq"] = SERVO, NO_POSITION, NO_VELOCITY
        motors["mode"][self._motors] = SERVO
        motors["kp"][self._motors], motors["kd"][self._motors] = self._kp, self._kd

    def _take(self, message: Fixed, _: str) -> None:
        # A bad checksum is counted: all bad means another model, a few mean a bad link.
        if not message.sealed:
            self._bad += 1
            return
        self._state, self._arrived = message, time.monotonic()

    def _track(self, message: Odometry, _: str) -> None:
        self._base = body_of(message)

    def _inertial(self, state: Fixed) -> list[float]:
        unit = state.record["imu_state"][0]
        body = Odometry()
        turned, rates = body.pose.pose.orientation, body.twist.twist.angular
        turned.w, turned.x, turned.y, turned.z = (float(value) for value in unit["quaternion"])
        rates.x, rates.y, rates.z = (float(value) for value in unit["gyroscope"])
        return body_of(body)

    def _absence(self) -> str:
        if self._bad:
            return f"all {self._bad} messages on 'rt/{STATE}' have a wrong checksum: is it a {self._model.robot}?"
        if self._state is None:
            return (
                f"no {self._model.robot} publishes 'rt/{STATE}': is the domain right, and the network's interface up?"
            )
        return f"nobody publishes where the base is on 'rt/{ODOMETRY}': start an estimator, or add ?odometry=no"


def gains(description: RobotDescription) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping (J,) of commands: no stiffness where no position is followed."""
    held = np.array([kind is JointKind.POSITION for kind in description.kinds])
    return np.array(description.stiffness) * held, np.array(description.damping)
