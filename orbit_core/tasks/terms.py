"""Terms: small functions on (world, task), collected in a task's dataclasses so that each can be changed alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum
from functools import wraps
from typing import TYPE_CHECKING, Any, TypeVar

from torch import Tensor

if TYPE_CHECKING:
    from orbit_core.tasks.task import Task
    from orbit_core.world import SimulatedWorld

TermFunction = Callable[["SimulatedWorld", Any], Tensor]
"""(world, task) -> (N, ...)"""
EventFunction = Callable[["SimulatedWorld", Any, Tensor], None]
"""(world, task, env_ids)"""


@dataclass(frozen=True)
class ObservationTerm:
    """``function`` gives (N, k); the observation is the terms of a task side by side, in the order of their fields.

    ``noise_std`` adds white noise, drawn from each environment's own stream.
    """

    function: TermFunction
    scale: float = 1.0
    noise_std: float = 0.0


@dataclass(frozen=True)
class RewardTerm:
    """``weight`` times ``function`` (N,) is added to the reward of each step, times the step's length in seconds."""

    function: TermFunction
    weight: float


@dataclass(frozen=True)
class TerminationTerm:
    """``function`` (N,) bool ends an episode. The time limit is the environment's own and needs no term."""

    function: TermFunction


class EventTime(Enum):
    """When an event happens."""

    STARTUP = "startup"
    """Once, for all environments, when the world is new."""
    RESET = "reset"
    """Whenever environments begin an episode."""


@dataclass(frozen=True)
class EventTerm:
    """``function`` changes some environments: where things start, what they weigh, what the goal is."""

    function: EventFunction
    time: EventTime = EventTime.RESET


_Term = TypeVar("_Term")


def terms_of(collection: object, kind: type[_Term]) -> dict[str, _Term]:
    """The terms in a dataclass's fields, in order. A field set to None is left out: a term switched off.

    Raises:
        TypeError: a field holds something else.
    """
    terms: dict[str, _Term] = {}
    for field in fields(collection):  # pyright: ignore[reportArgumentType]
        term = getattr(collection, field.name)
        if term is None:
            continue
        if not isinstance(term, kind):
            raise TypeError(f"{type(collection).__name__}.{field.name} must be a {kind.__name__}, not {term!r}")
        terms[field.name] = term
    return terms


def once_per_state(function: TermFunction) -> TermFunction:
    """Compute a term once per state of the world, however many terms ask for it."""

    @wraps(function)
    def cached(world: SimulatedWorld, task: Task) -> Tensor:
        version, value = task.cache.get(function, (-1, None))
        if value is None or version != world.clock.version:
            value = function(world, task)
            task.cache[function] = (world.clock.version, value)
        return value

    return cached
