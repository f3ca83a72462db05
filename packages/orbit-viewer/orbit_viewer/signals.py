"""Signals that the viewer plots: reward terms, observations, joints, contacts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from torch import Tensor

from orbit_core.sensors import ContactSensor

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

MOST_COMPONENTS = 12
"""Components of a signal that are plotted; more lines cannot be told apart."""
Numbers = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Signal:
    """Numbers of one environment that change from step to step."""

    components: tuple[str, ...]
    """Names of the numbers, as the plot's legend shows them."""
    read: Callable[[int], Numbers]
    """Function from an environment's index to the numbers after the last step."""


def world_signals(world: Any) -> dict[str, Signal]:
    """Return joint positions, velocities and efforts of every robot, poses of objects, and contact forces."""
    signals: dict[str, Signal] = {}
    for name, robot in world.robots.items():
        for quantity, unit in (("positions", "rad, m"), ("velocities", "rad/s, m/s"), ("efforts", "N m, N")):
            read = partial(_row, robot, f"joint_{quantity}")
            signals[f"{name}: joint {quantity}, {unit}"] = Signal(tuple(robot.joint_names), read)
    for name, thing in (*world.robots.items(), *world.objects.items()):
        read = partial(_position, thing)
        signals[f"{name}: position, m"] = Signal(("x", "y", "z"), read)
    for name, sensor in world.sensors.items():
        if isinstance(sensor, ContactSensor):
            signals[f"{name}: contact forces, N"] = Signal(sensor.link_names, partial(_contacts, sensor))
    # A plot without lines is an error in the browser.
    return {name: signal for name, signal in signals.items() if signal.components}


@dataclass
class TaskSignals:
    """Signals of an environment's task, from its last step."""

    environment: Environment
    """Environment that is stepped."""
    _sums: Tensor | None = None
    _terms: Tensor | None = None
    _observation: Mapping[str, Any] = field(default_factory=dict)

    def after_step(self, observation: Any) -> None:
        """Take over the observation of a step, and the contribution of each reward term to it."""
        sums = self.environment.reward_sums.detach().cpu().clone()
        began = (self.environment.state.episode_step <= 1).cpu()
        before = self._sums if self._sums is not None else sums * 0.0
        # A new episode's sums began at zero.
        self._terms = sums - before.masked_fill(began, 0.0)
        self._sums = sums
        self._observation = observation if isinstance(observation, Mapping) else {}

    def all(self) -> dict[str, Signal]:
        """Return the reward terms as one signal, and each term of every observation group that is no picture."""
        signals = {"reward terms": Signal(tuple(self.environment.reward_terms), self._reward)}
        for group in self.environment.observation.values():
            start = 0
            for name, term in group.terms.items():
                size = int(np.prod(term.shape))
                # Pictures are among the cameras' views.
                if term.camera is None:
                    part = slice(start, start + size) if group.concatenated else name
                    names = tuple(map(str, range(size)))
                    signals[f"{group.name}: {name}"] = Signal(names, partial(self._observed, group.name, part, size))
                start += size
        return signals

    def _reward(self, index: int) -> Numbers:
        if self._terms is None:
            return np.zeros(len(self.environment.reward_terms))
        return self._terms[:, index].double().numpy()

    def _observed(self, group: str, part: slice | str, size: int, index: int) -> Numbers:
        value = self._observation.get(group)
        if value is None:
            return np.zeros(size)
        row = value[index, part] if isinstance(part, slice) else value[part][index]
        return row.detach().double().cpu().numpy().ravel()


def _row(thing: Any, name: str, index: int) -> Numbers:
    return getattr(thing, name)[index].detach().double().cpu().numpy()


def _position(thing: Any, index: int) -> Numbers:
    return thing.root_pose[index, :3].detach().double().cpu().numpy()


def _contacts(sensor: ContactSensor, index: int) -> Numbers:
    return sensor.forces[index].norm(dim=-1).double().cpu().numpy()
