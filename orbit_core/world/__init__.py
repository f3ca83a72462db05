"""Worlds that are simulated: the contract's World, Robot and Object over any backend's engine."""

from orbit_core.world.world import WorldFactory, simulate

__all__ = ["WorldFactory", "simulate"]
