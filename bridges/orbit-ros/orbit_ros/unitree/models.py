"""Unitree's robots: their messages, motors in order, and values that a command must have."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.interfaces import UnknownNameError
from orbit_ros.unitree.layout import Fixed, GoLowCmd, GoLowState, HgLowCmd, HgLowState

COMMAND, STATE = "lowcmd", "lowstate"
ODOMETRY = "utlidar/robot_odom"
"""Topic where the base is, as an estimator of the robot publishes it."""


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
