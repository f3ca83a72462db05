"""Actuator models are found by the class of a joint's group."""

from __future__ import annotations

from dataclasses import fields
from functools import cache

from orbit_core.actuators.model import ActuatorModel
from orbit_core.actuators.models import DcMotorModel, PdModel
from orbit_core.distributions import missing_note
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.registry import Registry
from orbit_core.scene import ActuatorConfig, DcMotor, IdealPd, ImplicitPd

GROUP = "orbit.actuators"


@cache
def actuator_models() -> Registry[type[ActuatorModel]]:
    """The classes of actuator models, by the name of the class of the groups that they drive.

    A program without a package adds its own: ``actuator_models().add("SpringMotor", SpringMotorModel)``.
    """
    registry = Registry[type[ActuatorModel]]("actuator", GROUP)
    registry.add(IdealPd.__name__, PdModel)
    registry.add(DcMotor.__name__, DcMotorModel)
    return registry


def model_of(group: ActuatorConfig, entity: str) -> type[ActuatorModel] | None:
    """Return the model that drives a group; None for :class:`ImplicitPd`, which the engine drives.

    A class derived from another has that one's model, unless it has its own, or fields that this one does not read.

    Args:
        group: of joints.
        entity: name of the robot or object, for messages.

    Raises:
        UnknownNameError: nothing drives groups of that class.
        ConfigurationError: a model of one's own for a class derived from ImplicitPd, or no model is registered.
    """
    registry, kind = actuator_models(), type(group)
    names = registry.names
    own = [c for c in kind.__mro__ if issubclass(c, ActuatorConfig) and (c is ImplicitPd or c.__name__ in names)]
    found = next((c for c in own if len(fields(c)) == len(fields(kind))), None)
    if found is None:
        raise UnknownNameError(
            "actuator",
            kind.__name__,
            [ImplicitPd.__name__, *names],
            f"actuators of '{entity}'",
            missing_note(GROUP)
            or f"nothing computes the efforts of a {kind.__name__}: add its model, "
            f'orbit_core.actuators.actuator_models().add("{kind.__name__}", ...), see docs/actuators.md',
        )
    if found is ImplicitPd:
        return None
    if issubclass(kind, ImplicitPd):
        raise ConfigurationError(
            f"actuator {kind.__name__} of '{entity}' has a model of its own, and derives from ImplicitPd, which the "
            "engine drives: derive it from ActuatorConfig or IdealPd"
        )
    model = registry.get(found.__name__)
    if not (isinstance(model, type) and issubclass(model, ActuatorModel)):
        raise ConfigurationError(
            f"{registry.origin(found.__name__)} of group {GROUP} names {model!r}, which is no subclass of "
            "orbit_core.actuators.ActuatorModel: mend or uninstall it"
        )
    return model
