"""Bridges over ROS 1, ROS 2 and Unitree's low-level messages.

An agent reaches a robot by its address, such as ``ros2://127.0.0.1:0/panda?robot=franka_panda``,
``ros1://127.0.0.1:11311`` or ``unitree://127.0.0.1:0/go2`` (:func:`orbit_deploy.link.connect`). ``orbit robot --bridge
ros2`` serves a simulated robot to programs of ROS.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names

if TYPE_CHECKING:
    from orbit_ros.dds import Ros2Node
    from orbit_ros.hardware import CommandKind, RosHardware
    from orbit_ros.hosted import HostedLink
    from orbit_ros.node import RosNode
    from orbit_ros.ros1 import Ros1Node
    from orbit_ros.server import RosServer

__all__ = ["CommandKind", "HostedLink", "Ros1Node", "Ros2Node", "RosHardware", "RosNode", "RosServer"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "dds": ("Ros2Node",),
        "hardware": ("CommandKind", "RosHardware"),
        "hosted": ("HostedLink",),
        "node": ("RosNode",),
        "ros1": ("Ros1Node",),
        "server": ("RosServer",),
    },
)
