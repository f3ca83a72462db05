"""All actuators of a scene: targets in, what the engine applies out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from orbit_core.actuators.delay import CommandDelay, DelayState
from orbit_core.actuators.models import DcMotorModel, PdModel
from orbit_core.actuators.motors import REFERENCE
from orbit_core.actuators.network_model import NetworkModel
from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import ConfigurationError, Engine, SceneLayout
from orbit_core.interfaces.layout import actuator_of_joint
from orbit_core.scene import ActuatorConfig, ActuatorNetwork, DcMotor, IdealPd, ImplicitPd


@dataclass(frozen=True)
class ActuatorState:
    """A snapshot of the actuators; what the engine's buffers hold is in the engine's."""

    effort_targets: Tensor
    gains: tuple[tuple[Tensor, Tensor], ...]
    delays: tuple[DelayState | None, ...]
    pasts: tuple[Tensor, ...]
    """Of actuator networks."""
    temperatures: tuple[Tensor, ...]
    """Of motors."""


class Actuators:
    """The actuators of N environments of a scene.

    Robots write the targets; joints without an actuator, and those of explicit groups, have no drive in the engine.

    Where no group is explicit the targets are the engine's own buffers, and a step costs nothing. Otherwise
    :meth:`apply` must run before each physics step; so it must where efforts are ``shared``, others adding to them.

    Raises:
        ConfigurationError: a group's delay or torque-speed line cannot be, or its network does not fit.
    """

    def __init__(self, engine: Engine, layout: SceneLayout, random: RandomStreams, shared: bool = False) -> None:
        self._engine = engine
        groups = _group_of_joint(layout)
        self._implicit = {joint for joint, group in groups.items() if isinstance(group, ImplicitPd)}
        ideal = {j: g for j, g in groups.items() if isinstance(g, IdealPd) and not isinstance(g, DcMotor)}
        motors = {j: g for j, g in groups.items() if isinstance(g, DcMotor)}
        parts = (layout.joint_parameters, engine.num_envs, engine.device)
        self._models: list[PdModel] = []
        if ideal:
            self._models.append(PdModel(list(ideal), list(ideal.values()), *parts))
        if motors:
            self._models.append(DcMotorModel(list(motors), list(motors.values()), *parts, layout.scene.physics_dt))
        motor_models = [model for model in self._models if isinstance(model, DcMotorModel)]
        self._windings = [(model.columns, model.windings) for model in motor_models if model.windings is not None]
        self._delays = [_delay([groups[joint] for joint in m.joints], engine.num_envs, random) for m in self._models]
        networks = {joint: group for joint, group in groups.items() if isinstance(group, ActuatorNetwork)}
        self._networks = [
            NetworkModel([j for j, g in networks.items() if g.file == file], file, layout, *parts[1:])
            for file in dict.fromkeys(group.file for group in networks.values())
        ]
        self.explicit = shared or bool(self._models or self._networks)
        """Whether :meth:`apply` has work to do."""
        self.position_targets = engine.position_targets
        """(N, J) rad or m"""
        self.velocity_targets = engine.velocity_targets
        """(N, J) rad/s or m/s"""
        self.effort_targets = torch.zeros_like(engine.efforts) if self.explicit else engine.efforts
        """(N, J) N m or N, added to the PD laws"""

    def apply(self) -> None:
        """Compute the efforts of explicit groups from the present joint state and hand them to the engine."""
        engine = self._engine
        engine.efforts.copy_(self.effort_targets)
        positions, velocities = engine.joint_positions, engine.joint_velocities
        delays = (*self._delays, *(None for _ in self._networks))
        for model, delay in zip((*self._models, *self._networks), delays, strict=True):
            columns = model.columns
            targets: Sequence[Tensor] = (
                self.position_targets[:, columns],
                self.velocity_targets[:, columns],
                self.effort_targets[:, columns],
            )
            if delay is not None:
                targets = delay.push(torch.stack(tuple(targets))).unbind(0)
            engine.efforts[:, columns] = model.efforts(positions[:, columns], velocities[:, columns], targets)

    def memory(self) -> dict[str, Tensor]:
        """What actuator networks and windings remember from step to step, by name."""
        heat = {f"windings {number}": windings.temperatures for number, (_, windings) in enumerate(self._windings)}
        return heat | {f"actuator network {number}": network.past for number, network in enumerate(self._networks)}

    def temperatures(self) -> Tensor | None:
        """(N, J) degrees Celsius of the motors' windings, 25 where none are described; None where there are none."""
        if not self._windings:
            return None
        temperatures = torch.full_like(self.effort_targets, REFERENCE)
        for columns, windings in self._windings:
            temperatures[:, columns] = windings.temperatures
        return temperatures

    def set_gains(
        self, joints: Sequence[int], stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        """Stiffness and damping (n, k) of some joints of the scene, whoever computes their PD law. They outlast resets.

        Raises:
            ConfigurationError: a joint has no actuator.
            UnsupportedCapabilityError: the engine cannot change the gains of its drives.
        """
        native = [column for column, joint in enumerate(joints) if joint in self._implicit]
        if native:
            indices = torch.tensor([joints[column] for column in native], device=self._engine.device)
            self._engine.set_drive_gains(indices, stiffness[:, native], damping[:, native], env_ids)
        explicit = {joint: (model, i) for model in self._models for i, joint in enumerate(model.joints)}
        for column, joint in enumerate(joints):
            if joint in explicit:
                model, index = explicit[joint]
                write_rows(model.stiffness[:, index], stiffness[:, column], env_ids)
                write_rows(model.damping[:, index], damping[:, column], env_ids)
            elif joint not in self._implicit:
                name = self._engine.layout.joints[joint].name
                if any(joint in network.joints for network in self._networks):
                    raise ConfigurationError(f"joint '{name}' is driven by a network, which has no gains: leave it out")
                raise ConfigurationError(f"joint '{name}' has no actuator whose gains could be set: give it a group")

    def reset(self, env_ids: Tensor | None = None) -> None:
        """Forget efforts and delayed commands. Call it after the engine's reset, which sets the other targets."""
        if self.explicit:  # else they are the engine's own
            write_rows(self.effort_targets, 0.0, env_ids)
        for delay in self._delays:
            if delay is not None:
                delay.reset(env_ids)
        for network in self._networks:
            network.reset(env_ids)
        for _, windings in self._windings:
            windings.reset(env_ids)

    def copy(self, origin: Actuators, source: int, rows: Tensor | None) -> None:
        """Give some environments efforts and temperatures of environment ``source`` of an equal scene, no more."""
        self.reset(rows)
        if self.explicit:
            write_rows(self.effort_targets, origin.effort_targets[source].clone(), rows)
        for (_, own), (_, other) in zip(self._windings, origin._windings, strict=True):
            write_rows(own.temperatures, other.temperatures[source].clone(), rows)

    def save_state(self) -> ActuatorState:
        """A detached copy."""
        gains = tuple((model.stiffness.clone(), model.damping.clone()) for model in self._models)
        delays = tuple(None if delay is None else delay.save_state() for delay in self._delays)
        pasts = tuple(network.past.clone() for network in self._networks)
        temperatures = tuple(windings.temperatures.clone() for _, windings in self._windings)
        return ActuatorState(self.effort_targets.clone(), gains, delays, pasts, temperatures)

    def load_state(self, state: ActuatorState) -> None:
        """Return to a saved state."""
        self.effort_targets.copy_(state.effort_targets)
        for model, (stiffness, damping) in zip(self._models, state.gains, strict=True):
            model.stiffness.copy_(stiffness)
            model.damping.copy_(damping)
        for delay, saved in zip(self._delays, state.delays, strict=True):
            if delay is not None and saved is not None:
                delay.load_state(saved)
        for network, past in zip(self._networks, state.pasts, strict=True):
            network.past.copy_(past)
        for (_, windings), temperatures in zip(self._windings, state.temperatures, strict=True):
            windings.temperatures.copy_(temperatures)


def _group_of_joint(layout: SceneLayout) -> dict[int, ActuatorConfig]:
    """Joint of the scene -> the group that drives it, in joint order."""
    groups: dict[int, ActuatorConfig] = {}
    for entity in layout.entities:
        # Groups become objects of each robot's own, so that delays are drawn for each.
        own = replace(entity.spec, actuators=tuple(replace(group) for group in entity.spec.actuators))
        groups |= {entity.joints.start + joint: group for joint, group in actuator_of_joint(own).items()}
    return dict(sorted(groups.items()))


def _delay(groups: Sequence[ActuatorConfig], num_envs: int, random: RandomStreams) -> CommandDelay | None:
    delayed = [group for group in groups if isinstance(group, IdealPd)]
    if all(group.min_delay == group.max_delay == 0 for group in delayed):
        return None
    return CommandDelay(delayed, num_envs, random)
