"""Agents on real robots: what every bridge shares.

A client connects to a robot's computer by its address, and makes a task's environment over it::

    link = connect("zmq://127.0.0.1:5555", period=0.02)
    environment = make("Lift", 1, world=robot_world(link, period=0.02))
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names

if TYPE_CHECKING:
    from orbit_deploy.computer import ComputerSettings, RobotBusyError, RobotComputer
    from orbit_deploy.description import RobotDescription
    from orbit_deploy.engine import RobotWorld, robot_world
    from orbit_deploy.follower import FollowerSettings, PathKind
    from orbit_deploy.hardware import Measurement, RobotHardware
    from orbit_deploy.link import RobotFaultError, RobotLink, RobotLinkError, connect
    from orbit_deploy.local import LocalLink
    from orbit_deploy.simulated import Imperfections, SimulatedHardware

__all__ = [
    "ComputerSettings",
    "FollowerSettings",
    "Imperfections",
    "LocalLink",
    "Measurement",
    "PathKind",
    "RobotBusyError",
    "RobotComputer",
    "RobotDescription",
    "RobotFaultError",
    "RobotHardware",
    "RobotLink",
    "RobotLinkError",
    "RobotWorld",
    "SimulatedHardware",
    "connect",
    "robot_world",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "computer": ("ComputerSettings", "RobotBusyError", "RobotComputer"),
        "description": ("RobotDescription",),
        "engine": ("RobotWorld", "robot_world"),
        "follower": ("FollowerSettings", "PathKind"),
        "hardware": ("Measurement", "RobotHardware"),
        "link": ("RobotFaultError", "RobotLink", "RobotLinkError", "connect"),
        "local": ("LocalLink",),
        "simulated": ("Imperfections", "SimulatedHardware"),
    },
)
