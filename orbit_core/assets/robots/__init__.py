"""ORBIT's own robots: one module each, loaded when its robot is built."""

from __future__ import annotations

from orbit_core.assets.catalogue import RobotCatalogue, RobotEntry

_ERD = "example-robot-data"
_HERE = "orbit_core.assets.robots"


def register(catalogue: RobotCatalogue) -> None:
    """Add ORBIT's robots."""
    catalogue.add(
        RobotEntry(
            "franka_panda",
            "Franka Emika Panda: 7-joint arm with its parallel-jaw hand",
            f"{_HERE}.franka_panda:build",
            _ERD,
            "Apache-2.0",
        )
    )
