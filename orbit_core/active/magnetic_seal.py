"""A magnet that holds a door or a drawer shut."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from orbit_core.active.law import ActiveLaw
from orbit_core.dynamics.indexing import RowSelector
from orbit_core.interfaces import ConfigurationError, Object
from orbit_core.interfaces.names import find_name
from orbit_core.scene import MagneticSeal


class MagneticSealLaw(ActiveLaw):
    """The effort of a :class:`~orbit_core.scene.MagneticSeal` on its joint. Parameters: ``force`` and ``decay``.

    Raises:
        UnknownNameError: the object has no such joint.
        ConfigurationError: a number that cannot be, or a joint without the limit at which it is shut.
    """

    def __init__(
        self, model: MagneticSeal, thing: Object, num_envs: int, device: torch.device, selector: RowSelector
    ) -> None:
        super().__init__(model, thing, num_envs, device, selector)
        joint = find_name(model.joint, thing.joint_names, "joint", f"'{thing.name}'")
        self.joints = (joint,)
        for name in ("force", "decay", "arm"):
            if not 0.0 < getattr(model, name) < math.inf:
                raise ConfigurationError(
                    f"{name} of active model '{model.name}' of '{thing.name}' must be above zero, not "
                    f"{getattr(model, name):g}"
                )
        spec = thing.joints[joint]
        shut = (spec.lower_limit if model.opens_up else spec.upper_limit) if model.closed is None else model.closed
        if not math.isfinite(shut):
            raise ConfigurationError(
                f"active model '{model.name}' of '{thing.name}' holds joint '{model.joint}' at its limit, and it has "
                "none: say where it is shut (closed)"
            )
        self._shut, self._way, self._arm = shut, 1.0 if model.opens_up else -1.0, model.arm
        self._force, self._decay = self.parameter("force", model.force), self.parameter("decay", model.decay)

    def gap(self) -> Tensor:
        """(N,) metres of gap at the seal."""
        position = self.thing.joint_positions[:, self.joints[0]]
        return (self._arm * self._way * (position - self._shut)).clamp_min(0.0)

    def efforts(self) -> Tensor:
        falls = 1.0 + self.gap() / self._decay.clamp_min(1e-9)
        return (-self._way * self._arm * self._force / falls.square())[:, None]
