"""Actuators at run time: what becomes of joint targets before the engine sees them.

Models of one's own: docs/actuators.md.
"""

from orbit_core.actuators.actuators import Actuators, ActuatorState, actuator_models
from orbit_core.actuators.models import ActuatorContext, ActuatorModel, PdModel

__all__ = ["ActuatorContext", "ActuatorModel", "ActuatorState", "Actuators", "PdModel", "actuator_models"]
