"""Robots: objects whose actuators take commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from torch import Tensor

from orbit_core.actuators import Actuators
from orbit_core.dynamics.arguments import (
    EFFORTS,
    POSITIONS,
    VELOCITIES,
    Bounds,
    as_floats,
    check_numbers,
    check_shape,
    columns_chosen,
)
from orbit_core.dynamics.indexing import RowSelector, columns_of
from orbit_core.interfaces import ConfigurationError, Engine, EntityLayout, JointTarget, Robot
from orbit_core.scene import RobotSpec
from orbit_core.world.clock import Clock
from orbit_core.world.entities import SimulatedObject


class SimulatedRobot(SimulatedObject, Robot):
    """An articulation whose actuators take commands."""

    @property
    def spec(self) -> RobotSpec:
        return self._spec

    def __init__(
        self, layout: EntityLayout, engine: Engine, actuators: Actuators, clock: Clock, selector: RowSelector
    ) -> None:
        assert isinstance(layout.spec, RobotSpec)  # the world makes robots of robots' layouts alone
        self._spec = layout.spec
        super().__init__(layout, engine, actuators, clock, selector)
        parts = layout.joints, f"of '{self.name}'"
        self._targets = {
            JointTarget.POSITION: _Targets(actuators.position_targets, POSITIONS, "position targets", *parts),
            JointTarget.VELOCITY: _Targets(actuators.velocity_targets, VELOCITIES, "velocity targets", *parts),
            JointTarget.EFFORT: _Targets(actuators.effort_targets, EFFORTS, "effort targets", *parts),
        }

    @property
    def motor_temperatures(self) -> Tensor:
        temperatures = self._actuators.temperatures()
        if temperatures is None:
            raise ConfigurationError(f"no motor of '{self.name}' has windings: give a DcMotor of its actuators some")
        return temperatures[:, self.layout.joints]

    def target_writer(
        self, target: JointTarget, joints: Sequence[int], checked: bool = True
    ) -> Callable[[Tensor], object]:
        return self._targets[target].writer(joints, checked)

    def set_position_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        self._targets[JointTarget.POSITION].write(targets, joints)

    def set_velocity_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        self._targets[JointTarget.VELOCITY].write(targets, joints)

    def set_effort_targets(self, efforts: Tensor, joints: Sequence[int] | None = None) -> None:
        self._targets[JointTarget.EFFORT].write(efforts, joints)


class _Targets:
    """A robot's columns of one of the actuators' buffers; columns that stand in a row are written through a view."""

    def __init__(self, buffer: Tensor, bounds: Bounds, what: str, joints: slice, whose: str) -> None:
        self._buffer = buffer[:, joints]
        self._bounds = bounds
        self._what = f"{what} {whose}"
        self._joints = f"joints {whose}"
        self._writers: dict[tuple[int, ...], Callable[[Tensor], object]] = {}

    def write(self, values: Tensor, joints: Sequence[int] | None) -> None:
        if joints is None:
            self._buffer.copy_(self._checked(values, self._buffer.shape[1]))
            return
        chosen = columns_chosen(joints, self._buffer.shape[1], self._joints)
        writer = self._writers.get(chosen)
        if writer is None:
            writer = self._writers[chosen] = self._unchecked(chosen)
        writer(self._checked(values, len(chosen)))

    def writer(self, joints: Sequence[int], checked: bool) -> Callable[[Tensor], object]:
        """Return a function that writes targets (N, k) of some joints, with or without a look at the numbers."""
        chosen = columns_chosen(joints, self._buffer.shape[1], self._joints)
        return partial(self.write, joints=chosen) if checked else self._unchecked(chosen)

    def _unchecked(self, chosen: tuple[int, ...]) -> Callable[[Tensor], object]:
        columns = columns_of(chosen, self._buffer.device)
        if isinstance(columns, slice):
            return self._buffer[:, columns].copy_
        return partial(self._buffer.index_copy_, 1, columns)

    def _checked(self, values: Tensor, count: int) -> Tensor:
        values = as_floats(values, self._buffer.device, self._what)
        check_shape(values, (len(self._buffer), count), self._what)
        check_numbers(values, self._bounds, self._what)
        return values
