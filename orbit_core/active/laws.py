"""Force laws of objects, computed for all environments at once before each physics step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import Bounds
from orbit_core.dynamics.indexing import Masking, write_rows
from orbit_core.interfaces import ConfigurationError, Object, UnknownNameError
from orbit_core.interfaces.names import find_name
from orbit_core.registry import Registry
from orbit_core.scene import ActiveModel, MagneticSeal

NOT_NEGATIVE = Bounds(0.0, 1e9)


class ActiveLaw:
    """The force law of an object, for N environments at once, from the state before each physics step.

    A subclass names the ``joints`` or ``links`` of its object that it acts on, makes its parameters with
    :meth:`parameter`, and overrides :meth:`efforts` or :meth:`wrenches`. These keep to what a captured step may do:
    tensor operations, what lasts written in place, no look at a tensor's values.

    Args:
        model: the law as data.
        thing: the object, whose state it reads.
        num_envs: N.
        device: of all tensors.
        masking: which environments a call is for.
    """

    joints: Sequence[int] = ()
    """Indices among the object's joints that :meth:`efforts` are of."""
    links: Sequence[int] = ()
    """Indices among the object's links that :meth:`wrenches` are of."""

    def __init__(
        self, model: ActiveModel, thing: Object, num_envs: int, device: torch.device, masking: Masking
    ) -> None:
        self.model = model
        self.thing = thing
        self.num_envs = num_envs
        self.device = device
        self._masking = masking
        self._parameters: dict[str, Tensor] = {}
        self._nominal: dict[str, float] = {}
        self.memory: dict[str, Tensor] = {}
        """(N, ...) tensors that the law remembers from step to step, by name: part of snapshots, cleared by resets."""

    @property
    def parameters(self) -> Mapping[str, Tensor]:
        """(N,) values of each parameter, by name."""
        return self._parameters

    @property
    def nominal(self) -> Mapping[str, float]:
        """Each parameter's value in the scene, by name."""
        return self._nominal

    def parameter(self, name: str, value: float) -> Tensor:
        """Make a parameter: (N,) of one value, which may differ between environments later."""
        self._nominal[name] = float(value)
        # One value per environment, so that events can randomise it.
        self._parameters[name] = torch.full((self.num_envs,), float(value), device=self.device)
        return self._parameters[name]

    def set_parameter(self, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        """Set (n,) values, zero or more, of a parameter in some environments. They outlast resets.

        Raises:
            UnknownNameError: the law has no such parameter.
            ArgumentError, ShapeError, NonFiniteError: values that cannot be.
        """
        if name not in self._parameters:
            raise UnknownNameError("parameter", name, self._parameters, f"active model '{self.model.name}'")
        chosen = self._masking.choose(env_ids)
        what = f"{name} of active model '{self.model.name}' of '{self.thing.name}'"
        # In place: captured steps hold on to the tensor.
        write_rows(self._parameters[name], chosen.values(values, (), what, NOT_NEGATIVE), chosen.rows)

    def efforts(self) -> Tensor:
        """Return (N, len(joints)) N m or N, added to drives, springs and commands of these joints."""
        raise NotImplementedError(f"{type(self).__name__} names joints and gives no efforts")

    def wrenches(self) -> Tensor:
        """Return (N, len(links), 6) force at the centre of mass and torque, world axes, added to those that are set."""
        raise NotImplementedError(f"{type(self).__name__} names links and gives no wrenches")

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget some environments' past, by index or mask. Extend where a zero is no fresh start."""
        for kept in self.memory.values():
            write_rows(kept, 0.0, env_ids)


class MagneticSealLaw(ActiveLaw):
    """The effort of a :class:`~orbit_core.scene.MagneticSeal` on its joint. Parameters: ``force`` and ``decay``.

    Raises:
        UnknownNameError: the object has no such joint.
        ConfigurationError: a number that cannot be, or a joint without the limit at which it is shut.
    """

    def __init__(
        self, model: MagneticSeal, thing: Object, num_envs: int, device: torch.device, masking: Masking
    ) -> None:
        super().__init__(model, thing, num_envs, device, masking)
        joint = find_name(model.joint, thing.joint_names, "joint", f"'{thing.name}'")
        self.joints = (joint,)
        for name in ("force", "decay", "arm"):
            if not 0.0 < getattr(model, name) < math.inf:
                raise ConfigurationError(
                    f"{name} of active model '{model.name}' of '{thing.name}' must be above zero, not "
                    f"{getattr(model, name):g}"
                )
        # Shut is a limit of the joint unless the model says otherwise.
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
        """Return (N,) metres of gap at the seal."""
        position = self.thing.joint_positions[:, self.joints[0]]
        return (self._arm * self._way * (position - self._shut)).clamp_min(0.0)

    def efforts(self) -> Tensor:
        # The lower bound keeps a randomised decay of zero from dividing by zero.
        falls = 1.0 + self.gap() / self._decay.clamp_min(1e-9)
        return (-self._way * self._arm * self._force / falls.square())[:, None]


GROUP = "orbit.active"


@cache
def active_laws() -> Registry[type[ActiveLaw]]:
    """Return the classes of laws, by the name of the class of the model that they compute.

    A program without a package adds its own: ``active_laws().add("GasSpring", GasSpringLaw)``.
    """
    registry = Registry[type[ActiveLaw]]("active model", GROUP)
    registry.add(MagneticSeal.__name__, MagneticSealLaw)
    return registry


def create_law(model: ActiveModel, thing: Object, num_envs: int, device: torch.device, masking: Masking) -> ActiveLaw:
    """Return the law of a model. A model derived from another has that one's, unless it has its own.

    Raises:
        UnknownNameError: nothing computes a model of that class.
        ConfigurationError: the model cannot be, or the package that brings its law is broken.
    """
    # The nearest base that has a law wins, as method resolution does.
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
    return law(model, thing, num_envs, device, masking)
