"""Franka's arms and their hand by libfranka's protocol (`franky <https://github.com/TimSchneider42/franky>`_)."""

from __future__ import annotations

import importlib
import re
import threading
import time
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from orbit_core.installing import install_command
from orbit_core.interfaces import ConfigurationError
from orbit_deploy.description import RobotDescription
from orbit_deploy.follower import JointTargets
from orbit_deploy.hardware import Measurement, RobotHardware
from orbit_deploy.link import RobotLinkError

_ARM = 7
# m/s of the fingers, and m of a change of their distance below which a motion goes on
_FINGER_SPEED, _SAME_WIDTH = 0.1, 1e-3
# Seconds between looks at the hand, whose state takes some milliseconds to arrive
_LOOK = 0.02


class FrankaHardware(RobotHardware):
    """One arm, with or without Franka's hand, at its control box or at ``franky-sim``, which speaks the same protocol.

    The arm applies ``stiffness (q - measured) + damping (dq - measured)`` of the description as torques, computed by
    franky at 1000 Hz in a thread of its own. The hand moves to a width at once and reports it; it takes no forces.

    Args:
        address: ``franka://host``; ``?realtime=no`` for a kernel without real time, as for simulated robots.
        description: of the robot: seven joints of an arm, then two of a hand or none.

    Raises:
        ConfigurationError: franky is not installed, the address is none, or the robot has other joints.
        RobotLinkError: no robot answers there, or it lets nobody control it.
    """

    def __init__(self, address: str, description: RobotDescription) -> None:
        parts = urlsplit(address)
        options = dict(parse_qsl(parts.query, keep_blank_values=True))
        realtime = options.pop("realtime", "yes")
        if not parts.hostname or parts.path.strip("/") or options or realtime not in ("yes", "no"):
            raise ConfigurationError(f"'{address}' is no address of a Franka robot: give franka://host?realtime=yes")
        arm, hand = description.joints[:_ARM], description.joints[_ARM:]
        if not all(re.fullmatch(rf"(panda|fr3)_joint{i + 1}", name) for i, name in enumerate(arm)) or len(hand) not in (
            0,
            2,
        ):
            raise ConfigurationError(f"{description.model} is no Franka arm: its joints are {', '.join(arm + hand)}")
        try:
            franky = importlib.import_module("franky")
        except ImportError:
            raise ConfigurationError(
                f"Franka's robots need franky: {install_command('orbit-deploy[franka]')}"
            ) from None
        self.description = description
        self._address = address
        # The gripper's network errors arrive as RuntimeError.
        self._failures = (RuntimeError, *(
            getattr(franky, name)
            for name in ("Exception", "NetworkException", "ControlException", "CommandException", "RealtimeException",
                         "IncompatibleVersionException", "InvalidOperationException", "ProtocolException",
                         "GripperException")
        ))  # fmt: skip
        config = franky.RealtimeConfig.Enforce if realtime == "yes" else franky.RealtimeConfig.Ignore
        try:
            self._robot = franky.Robot(parts.hostname, realtime_config=config)
            self._hand = _Hand(franky.Gripper(parts.hostname), self._failures) if hand else None
            # Without a period: the loop of the robot's computer paces it.
            self._tracker: Any = franky.JointImpedanceTracker(
                self._robot,
                stiffness=np.array(description.stiffness[:_ARM]),
                damping=np.array(description.damping[:_ARM]),
            )
        except self._failures as error:
            raise RobotLinkError(f"no Franka robot to control at {address}: {_line(error)}") from None

    def read(self) -> Measurement:
        state = self._robot.state
        rows = [np.array(values, np.float64) for values in (state.q, state.dq, state.tau_J)]
        if self._hand is not None:
            fingers = (np.full(2, self._hand.width / 2.0), np.zeros(2), np.zeros(2))
            rows = [np.concatenate((row, own)) for row, own in zip(rows, fingers, strict=True)]
        if not all(np.isfinite(row).all() for row in rows):
            raise RobotLinkError(f"the robot at {self._address} reports numbers that are not finite")
        positions, velocities, efforts = rows
        return Measurement(positions, velocities, efforts)

    def drive(self, targets: JointTargets) -> None:
        if not self._tracker.is_running:
            raise RobotLinkError(f"the robot at {self._address} has ended its control: {self._reason()}")
        self._tracker.set_target(targets.positions[:_ARM], targets.velocities[:_ARM], targets.efforts[:_ARM])
        if self._hand is not None:
            self._hand.move(float(targets.positions[_ARM:].sum()))

    def close(self) -> None:
        if self._hand is not None:
            self._hand.close()
        try:
            # Torques fade and the arm is damped to rest.
            self._tracker.stop()
        except self._failures:
            return

    def _reason(self) -> str:
        try:
            self._robot.join_motion()
        except self._failures as error:
            return _line(error)
        return "another program stopped it"


class _Hand:
    """Franka's hand, asked and moved by a thread of its own, as an answer takes longer than a cycle.

    Args:
        gripper: of franky.
        failures: exceptions of franky.
    """

    def __init__(self, gripper: Any, failures: tuple[type[BaseException], ...]) -> None:
        self._gripper, self._failures = gripper, failures
        self.width: float = gripper.width
        """Distance of the fingers, m."""
        self._most = float(gripper.max_width)
        self._wanted, self._sent = self.width, self.width
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="franka hand", daemon=True)
        self._thread.start()

    def move(self, width: float) -> None:
        """Move to a distance of the fingers, m; returns at once."""
        self._wanted = min(max(width, 0.0), self._most)

    def close(self) -> None:
        """End the thread; the fingers stay."""
        self._ended.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        motion: Any = None
        while not self._ended.wait(_LOOK):
            try:
                self.width = self._gripper.width
                if motion is not None and not motion.wait(0.0):
                    continue
                if motion is not None:
                    motion.get()
                    motion = None
                if abs(self._wanted - self._sent) > _SAME_WIDTH:
                    self._sent = self._wanted
                    motion = self._gripper.move_async(self._sent, _FINGER_SPEED)
            except self._failures:
                # Fingers that meet an object end their motion with one; the arm's errors are those of the robot.
                motion = None
                time.sleep(_LOOK)


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())
