"""Actuators at run time: what becomes of joint targets before the engine sees them."""

from orbit_core.actuators.actuators import Actuators, ActuatorState

__all__ = ["ActuatorState", "Actuators"]
