"""Laws are made from active models, by the class of the model."""

from __future__ import annotations

from functools import cache

import torch

from orbit_core.active.law import ActiveLaw
from orbit_core.active.magnetic_seal import MagneticSealLaw
from orbit_core.dynamics.indexing import RowSelector
from orbit_core.interfaces import ConfigurationError, Object
from orbit_core.registry import Registry
from orbit_core.scene import ActiveModel, MagneticSeal

GROUP = "orbit.active"


@cache
def active_laws() -> Registry[type[ActiveLaw]]:
    """The classes of laws, by the name of the class of the model that they compute.

    A program without a package adds its own: ``active_laws().add("GasSpring", GasSpringLaw)``.
    """
    registry = Registry[type[ActiveLaw]]("active model", GROUP)
    registry.add(MagneticSeal.__name__, MagneticSealLaw)
    return registry


def create_law(
    model: ActiveModel, thing: Object, num_envs: int, device: torch.device, selector: RowSelector
) -> ActiveLaw:
    """The law of a model. A model derived from another has that one's, unless it has its own.

    Raises:
        UnknownNameError: nothing computes a model of that class.
        ConfigurationError: the model cannot be, or the package that brings its law is broken.
    """
    kinds = [kind.__name__ for kind in type(model).__mro__ if issubclass(kind, ActiveModel)]
    registry = active_laws()
    known = registry.names
    name = next((kind for kind in kinds if kind in known), kinds[0])
    law = registry.get(name)
    if not (isinstance(law, type) and issubclass(law, ActiveLaw)):
        raise ConfigurationError(
            f"{registry.origin(name)} of group {GROUP} names {law!r}, which is no subclass of "
            "orbit_core.active.ActiveLaw: mend or uninstall it"
        )
    return law(model, thing, num_envs, device, selector)
