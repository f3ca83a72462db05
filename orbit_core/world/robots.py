"""Robots: objects whose actuators take commands."""

from __future__ import annotations

from collections.abc import Sequence

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
from orbit_core.dynamics.indexing import Masking, columns_of
from orbit_core.interfaces import ConfigurationError, Engine, EntityLayout, Robot
from orbit_core.scene import RobotSpec
from orbit_core.world.clock import Clock
from orbit_core.world.entities import SimulatedObject


class SimulatedRobot(SimulatedObject, Robot):
    """An articulation whose actuators take commands."""

    @property
    def spec(self) -> RobotSpec:
        spec = self.layout.spec
        assert isinstance(spec, RobotSpec)  # the world makes robots of robots' layouts alone
        return spec

    def __init__(
        self, layout: EntityLayout, engine: Engine, actuators: Actuators, clock: Clock, masking: Masking
    ) -> None:
        super().__init__(layout, engine, actuators, clock, masking)
        parts = layout.joints, masking, f"of '{self.name}'"
        self._position_targets = _Targets(actuators.position_targets, POSITIONS, "position targets", *parts)
        self._velocity_targets = _Targets(actuators.velocity_targets, VELOCITIES, "velocity targets", *parts)
        self._effort_targets = _Targets(actuators.effort_targets, EFFORTS, "effort targets", *parts)

    @property
    def motor_temperatures(self) -> Tensor:
        temperatures = self._actuators.temperatures()
        if temperatures is None:
            raise ConfigurationError(f"no motor of '{self.name}' has windings: give a DcMotor of its actuators some")
        return temperatures[:, self.layout.joints]

    def set_position_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        self._position_targets.write(targets, joints)

    def set_velocity_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        self._velocity_targets.write(targets, joints)

    def set_effort_targets(self, efforts: Tensor, joints: Sequence[int] | None = None) -> None:
        self._effort_targets.write(efforts, joints)


class _Targets:
    """A robot's columns of one of the actuators' buffers; columns that stand in a row are written through a view."""

    def __init__(self, buffer: Tensor, bounds: Bounds, what: str, joints: slice, masking: Masking, whose: str) -> None:
        self._buffer = buffer[:, joints]
        self._bounds = bounds
        self._what = f"{what} {whose}"
        self._joints = f"joints {whose}"
        self._masking = masking
        self._views: dict[tuple[int, ...], Tensor] = {}

    def write(self, values: Tensor, joints: Sequence[int] | None) -> None:
        if joints is None:
            self._buffer.copy_(self._checked(values, self._buffer.shape[1]))
            return
        chosen = columns_chosen(joints, self._buffer.shape[1], self._joints)
        values = self._checked(values, len(chosen))
        view = self._views.get(chosen)
        if view is not None:
            view.copy_(values)
            return
        columns = columns_of(chosen, self._buffer.device)
        self._buffer[:, columns] = values
        if isinstance(columns, slice):
            self._views[chosen] = self._buffer[:, columns]

    def _checked(self, values: Tensor, count: int) -> Tensor:
        values = as_floats(values, self._buffer.device, self._what)
        check_shape(values, (len(self._buffer), count), self._what)
        if not self._masking.traced:
            check_numbers(values, self._bounds, self._what)
        return values
