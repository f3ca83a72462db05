"""Simulated worlds: the contract's World, Robot and Object over any backend's engine."""

from orbit_core.world.entities import SimulatedObject
from orbit_core.world.robots import SimulatedRobot
from orbit_core.world.world import SimulatedWorld

__all__ = ["SimulatedObject", "SimulatedRobot", "SimulatedWorld"]
