"""All actuators of a scene: targets in, efforts and drive targets of the engine out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import torch
from torch import Tensor

from orbit_core.actuators.models import REFERENCE, ActuatorContext, ActuatorModel, DcMotorModel, PdModel
from orbit_core.distributions import missing_note
from orbit_core.dynamics.indexing import ColumnView, write_block, write_rows
from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import ConfigurationError, Engine, SceneLayout, UnknownNameError
from orbit_core.interfaces.layout import actuator_of_joint
from orbit_core.registry import Registry
from orbit_core.scene import ActuatorConfig, DcMotor, IdealPd, ImplicitPd

GROUP = "orbit.actuators"
_ORDER = (PdModel, DcMotorModel)


@dataclass(frozen=True)
class DelayState:
    """A snapshot of a delay line."""

    history: Tensor
    """(T, 3, N, k) ring of the last T targets of position, velocity and effort."""
    delays: Tensor
    """(N, k) physics steps by which targets are late."""
    age: Tensor
    """(N, 1) targets since the reset; nothing older is read."""


class CommandDelay:
    """A delay line for targets (3, N, k).

    Joints of one group (the same object) share a delay. The first command after a reset counts as held since ever.

    Args:
        groups: the actuator group of each joint (k,).
        num_envs: N.
        random: draws the delays.
    """

    def __init__(self, groups: Sequence[IdealPd], num_envs: int, random: RandomStreams) -> None:
        for group in groups:
            if not 0 <= group.min_delay <= group.max_delay:
                raise ConfigurationError(
                    f"the delay of actuators {group.joints} must satisfy 0 <= min_delay <= max_delay, not "
                    f"{group.min_delay}, {group.max_delay}"
                )
        # By identity: two groups of equal numbers still draw separate delays.
        self._groups = list({id(group): group for group in groups}.values())
        members = [[j for j, other in enumerate(groups) if other is group] for group in self._groups]
        self._random = random
        device = random.device
        # One slot more than the longest delay, for the command of this step.
        self._length = max((group.max_delay for group in groups), default=0) + 1
        self._history = torch.zeros(self._length, 3, num_envs, len(groups), device=device)
        self._delays = torch.zeros(num_envs, len(groups), dtype=torch.int64, device=device)
        self._age = torch.zeros(num_envs, 1, dtype=torch.int64, device=device)
        self._columns = [torch.tensor(columns, device=device) for columns in members]
        self.reset(None)

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget commands and draw new delays."""
        write_rows(self._age, 0, env_ids)
        for group, columns in zip(self._groups, self._columns, strict=True):
            drawn = self._random.integers(group.min_delay, group.max_delay, env_ids)
            write_block(self._delays, columns, drawn[:, None], env_ids)

    def push(self, targets: Tensor) -> Tensor:
        """Take the commands of this step (3, N, k) and return those in effect."""
        # A ring buffer: slots are reused, and nothing is moved at a step.
        newest = torch.remainder(self._age, self._length)  # each environment writes in turn, from its reset on
        self._history.scatter_(0, newest.expand(1, *targets.shape), targets[None])
        steps_back = torch.minimum(self._delays, self._age)
        slots = torch.remainder(self._age - steps_back, self._length)
        self._age += 1
        return self._history.gather(0, slots.expand(1, 3, *slots.shape)).squeeze(0)

    def save_state(self) -> DelayState:
        """Return a detached copy."""
        return DelayState(self._history.clone(), self._delays.clone(), self._age.clone())

    def load_state(self, state: DelayState) -> None:
        """Return to a saved state."""
        self._history.copy_(state.history)
        self._delays.copy_(state.delays)
        self._age.copy_(state.age)


@cache
def actuator_models() -> Registry[type[ActuatorModel]]:
    """Return the classes of actuator models, by the name of the class of the groups that they drive.

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
    # A derived class with further fields needs its own model: the base's would ignore them in silence.
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
            f"actuator {kind.__name__} of '{entity}' has its own model, and derives from ImplicitPd, which the "
            "engine drives: derive it from ActuatorConfig or IdealPd"
        )
    model = registry.get(found.__name__)
    if not (isinstance(model, type) and issubclass(model, ActuatorModel)):
        raise ConfigurationError(
            f"{registry.origin(found.__name__)} of group {GROUP} names {model!r}, which is no subclass of "
            "orbit_core.actuators.ActuatorModel: fix or uninstall it"
        )
    return model


@dataclass(frozen=True)
class ActuatorState:
    """A snapshot of the actuators; what the engine's buffers hold is in the engine's."""

    effort_targets: Tensor
    """(N, J) commanded efforts, N m or N."""
    gains: tuple[tuple[Tensor, ...], ...]
    """Gains of each model, as they are randomised."""
    delays: tuple[DelayState | None, ...]
    """Delay line of each model; None without delay."""
    memory: tuple[dict[str, Tensor], ...]
    """Memory of each model."""


class Actuators:
    """The actuators of N environments of a scene.

    Robots write the targets; joints without an actuator, and those of explicit groups, have no drive in the engine.

    Where no group is explicit the targets are the engine's own buffers, and a step costs nothing. Otherwise
    :meth:`apply` must run before each physics step; so it must where efforts are ``shared``, others adding to them.

    Raises:
        ConfigurationError: a group's delay or torque-speed line cannot be, or its network does not fit.
        UnknownNameError: nothing drives groups of a class; names the class and the remedy.
    """

    def __init__(self, engine: Engine, layout: SceneLayout, random: RandomStreams, shared: bool = False) -> None:
        self._engine = engine
        groups = _group_of_joint(layout)
        models = {joint: model_of(group, layout.joints_by_name[joint][0]) for joint, group in groups.items()}
        self._implicit = {joint for joint, model in models.items() if model is None}
        shared_by: dict[Any, list[int]] = {}
        for joint, model in models.items():
            # Joints that share a model are computed in one call, whichever robot they belong to.
            if model is not None:
                group = groups[joint]
                shared_by.setdefault((model, isinstance(group, IdealPd), model.shared_by(group)), []).append(joint)
        self._models: list[ActuatorModel] = []
        self._delays: list[CommandDelay | None] = []
        for (model, _, _), joints in sorted(shared_by.items(), key=_place):
            own = tuple(groups[joint] for joint in joints)
            self._models.append(model(ActuatorContext(tuple(joints), own, layout, engine.num_envs, engine.device)))
            self._delays.append(_delay(own, engine.num_envs, random))
        self.explicit = shared or bool(self._models)
        """Whether :meth:`apply` has work to do."""
        self.position_targets = engine.position_targets
        """(N, J) rad or m"""
        self.velocity_targets = engine.velocity_targets
        """(N, J) rad/s or m/s"""
        self.effort_targets = torch.zeros_like(engine.efforts) if self.explicit else engine.efforts
        """(N, J) N m or N, added to the PD laws"""
        self._targets = (self.position_targets, self.velocity_targets, self.effort_targets)
        # Of measured positions and velocities, the targets, and the engine's efforts
        self._views = [tuple(ColumnView(model.columns) for _ in range(6)) for model in self._models]
        self._covered = len({joint for model in self._models for joint in model.joints}) == len(layout.joints)

    def apply(self) -> None:
        """Compute the efforts of explicit groups from the present joint state and hand them to the engine."""
        engine = self._engine
        if not self._covered:
            # Joints without a model keep the effort that was commanded directly.
            engine.efforts.copy_(self.effort_targets)
        measured = engine.joint_positions, engine.joint_velocities
        for model, delay, views in zip(self._models, self._delays, self._views, strict=True):
            position, velocity, *targets = map(ColumnView.read, views, (*measured, *self._targets))
            if delay is not None:
                targets = delay.push(torch.stack(targets)).unbind(0)
            views[-1].write(engine.efforts, model.efforts(position, velocity, targets))

    @property
    def models(self) -> Mapping[str, ActuatorModel]:
        """Models that are computed before each physics step, by class and first joint."""
        joints = self._engine.layout.joints
        return {f"{type(model).__name__} of joint '{joints[model.joints[0]].name}'": model for model in self._models}

    def temperatures(self) -> Tensor | None:
        """Return winding temperatures (N, J) in degrees Celsius, 25 for joints without; None if no joint has any."""
        warm = [(model.columns, model.temperatures) for model in self._models]
        if all(values is None for _, values in warm):
            return None
        temperatures = torch.full_like(self.effort_targets, REFERENCE)
        for columns, values in warm:
            if values is not None:
                temperatures[:, columns] = values
        return temperatures

    def set_gains(
        self, joints: Sequence[int], stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        """Set stiffness and damping (n, k) of some joints, whether the core or the engine computes their PD law.

        They outlast resets.

        Raises:
            ConfigurationError: a joint has no actuator.
            UnsupportedCapabilityError: the engine cannot change the gains of its drives.
        """
        # A call may mix joints of the engine's drives with joints of explicit models.
        native = [column for column, joint in enumerate(joints) if joint in self._implicit]
        if native:
            indices = torch.tensor([joints[column] for column in native], device=self._engine.device)
            self._engine.set_drive_gains(indices, stiffness[:, native], damping[:, native], env_ids)
        explicit = {joint: (model, i) for model in self._models for i, joint in enumerate(model.joints)}
        for column, joint in enumerate(joints):
            if joint in explicit:
                model, index = explicit[joint]
                if model.gains is None:
                    name = self._engine.layout.joints[joint].name
                    raise ConfigurationError(
                        f"joint '{name}' is driven by a {type(model).__name__}, which has no gains: leave it out"
                    )
                for own, values in zip(model.gains, (stiffness, damping), strict=True):
                    write_rows(own[:, index], values[:, column], env_ids)
            elif joint not in self._implicit:
                name = self._engine.layout.joints[joint].name
                raise ConfigurationError(f"joint '{name}' has no actuator whose gains could be set: give it a group")

    def reset(self, env_ids: Tensor | None = None) -> None:
        """Forget efforts and delayed commands. Call it after the engine's reset, which sets the other targets."""
        if self.explicit:  # else they are the engine's own
            write_rows(self.effort_targets, 0.0, env_ids)
        for delay in self._delays:
            if delay is not None:
                delay.reset(env_ids)
        for model in self._models:
            model.reset(env_ids)

    def copy(self, origin: Actuators, source: int, rows: Tensor | None) -> None:
        """Give some environments efforts and temperatures of environment ``source`` of an equal scene, no more."""
        self.reset(rows)
        if self.explicit:
            write_rows(self.effort_targets, origin.effort_targets[source].clone(), rows)
        for own, other in zip(self._models, origin._models, strict=True):
            if own.temperatures is not None and other.temperatures is not None:
                write_rows(own.temperatures, other.temperatures[source].clone(), rows)

    def save_state(self) -> ActuatorState:
        """Return a detached copy."""
        # Gains are saved too, because events randomise them.
        gains = tuple(tuple(part.clone() for part in model.gains or ()) for model in self._models)
        delays = tuple(None if delay is None else delay.save_state() for delay in self._delays)
        memory = tuple({name: value.clone() for name, value in model.memory.items()} for model in self._models)
        return ActuatorState(self.effort_targets.clone(), gains, delays, memory)

    def load_state(self, state: ActuatorState) -> None:
        """Return to a saved state."""
        self.effort_targets.copy_(state.effort_targets)
        for model, gains, memory in zip(self._models, state.gains, state.memory, strict=True):
            # In place: a captured step refers to these tensors by their memory.
            for own, saved in zip(model.gains or (), gains, strict=True):
                own.copy_(saved)
            for name, saved in memory.items():
                model.memory[name].copy_(saved)
        for delay, saved in zip(self._delays, state.delays, strict=True):
            if delay is not None and saved is not None:
                delay.load_state(saved)


def _place(shared: tuple[Any, list[int]]) -> int:
    """Return where a model stands among the others: delays are drawn in this order, which must not change."""
    (model, *_), _ = shared
    return _ORDER.index(model) if model in _ORDER else len(_ORDER)


def _group_of_joint(layout: SceneLayout) -> dict[int, ActuatorConfig]:
    """Return joint of the scene -> the group that drives it, in joint order."""
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
