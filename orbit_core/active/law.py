"""What computes an active model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import Bounds
from orbit_core.dynamics.indexing import RowSelector, write_rows
from orbit_core.interfaces import Object, UnknownNameError
from orbit_core.scene import ActiveModel

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
        selector: which environments a call is for.
    """

    joints: Sequence[int] = ()
    """Indices among the object's joints that :meth:`efforts` are of."""
    links: Sequence[int] = ()
    """Indices among the object's links that :meth:`wrenches` are of."""

    def __init__(
        self, model: ActiveModel, thing: Object, num_envs: int, device: torch.device, selector: RowSelector
    ) -> None:
        self.model = model
        self.thing = thing
        self.num_envs = num_envs
        self.device = device
        self._selector = selector
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
        """Make a parameter: (N,) of one value, which may come to differ between environments."""
        self._nominal[name] = float(value)
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
        chosen = self._selector.select(env_ids)
        what = f"{name} of active model '{self.model.name}' of '{self.thing.name}'"
        write_rows(self._parameters[name], chosen.values(values, (), what, NOT_NEGATIVE), chosen.rows)

    def efforts(self) -> Tensor:
        """(N, len(joints)) N m or N, beside drives, springs and commands of these joints."""
        raise NotImplementedError(f"{type(self).__name__} names joints and gives no efforts")

    def wrenches(self) -> Tensor:
        """(N, len(links), 6) force at the centre of mass and torque, world axes, beside those that are set."""
        raise NotImplementedError(f"{type(self).__name__} names links and gives no wrenches")

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget some environments' past, by index or mask. Extend where a zero is no fresh start."""
        for kept in self.memory.values():
            write_rows(kept, 0.0, env_ids)
