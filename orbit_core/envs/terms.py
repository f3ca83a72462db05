"""Terms: small functions of the environment, collected in dataclasses so that each can be changed separately."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Collection, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import wraps
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

from torch import Tensor

from orbit_core.interfaces import ConfigurationError, ShapeError

if TYPE_CHECKING:
    from orbit_core.scene import SensorSpec


TermFunction = Callable[..., Tensor]
"""(env) -> (N, ...); of a term that names an agent, (env, agent) -> (N, ...)"""
EventFunction = Callable[[Any, Tensor], None]
"""(env, env_ids)"""
Bounds = tuple[float, float]
"""Least and most of a number that is drawn uniformly."""


@dataclass(frozen=True)
class Meaning:
    """Description of a term's numbers, for readers who compute them without ORBIT. It stands in every manifest."""

    formula: str
    """One sentence: the quantity, before scale, noise, delay and history."""
    frame: str = ""
    """Frame that it is expressed in; empty where it has none, as joints have."""
    components: tuple[str, ...] | Callable[..., Sequence[str]] = ()
    """Name of each number, or a function of the term's arguments that gives them; empty takes names from the unit."""
    offset: Callable[..., Tensor] | None = None
    """Function of the term's arguments: (D,) that has been subtracted from what a sensor measures. None: nothing."""


class Term:
    """Base of all terms. Fields may be set, and act at the next step; a collection's default is shared, and may not."""

    arguments: ClassVar[tuple[str, ...]] = ("env",)
    """Arguments that the term's function is called with, before the name of an agent."""

    def __set_name__(self, owner: type, name: str) -> None:
        vars(self)["_default_of"] = f"{owner.__name__}.{name}"

    def __setattr__(self, name: str, value: Any) -> None:
        if (default := vars(self).get("_default_of")) is not None:
            raise ConfigurationError(
                f"{default} is the default of every task that has none of its own, so its {name} cannot be set: give "
                f"the task another term, dataclasses.replace(term, {name}=...), or set it in an environment's own task "
                "(env.task)"
            )
        super().__setattr__(name, value)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # A copy belongs to one task, and is no default any more: its fields may be set.
        fields_of = {field.name: deepcopy(getattr(self, field.name), memo) for field in fields(self)}  # pyright: ignore[reportArgumentType]
        return memo.setdefault(id(self), type(self)(**fields_of))


@dataclass(unsafe_hash=True)
class ObservationTerm(Term):
    """``function`` gives (N, ...) of any shape, as float32, uint8, int32, int64 or bool.

    ``scale`` comes first, and all that follows is in the scaled value's unit. Noise, bias and delay are drawn from each
    environment's own stream. Scale, noise and bias need float32.
    """

    function: TermFunction
    scale: float = 1.0
    noise_std: float = 0.0
    """Standard deviation of white noise, drawn at each step."""
    bias_std: float = 0.0
    """Standard deviation of a bias that each episode draws once and keeps."""
    delay: tuple[int, int] = (0, 0)
    """Fewest and most steps of the environment that a measurement is late by, drawn for each episode. What was measured
    first counts as measured ever since."""
    agent: str | None = None
    """Who sees it, where several robots act; the name is the function's second argument. None: all see it."""
    history: int | None = None
    """Steps that are seen, the oldest first; an episode's first value counts as those before it. None: the group's."""
    sensors: tuple[SensorSpec, ...] = ()
    """What the function reads that the scene need not have by itself, such as a camera: added to the scene."""
    bounds: tuple[float, float] | None = None
    """Least and most that the term shows, where noise and bias saturate; None takes the dtype's."""
    camera: str | None = None
    """Name of the camera whose picture the term is: a network takes pictures of one camera as channels of one input."""
    unit: str | None = None
    """Unit of the value before it is scaled, for readers elsewhere; None takes the function's
    (:func:`measured_in`)."""
    meaning: Meaning | None = None
    """What the numbers are; None takes the function's (:func:`means`), or the first lines of its docstring."""


@dataclass(kw_only=True)
class ObservationGroup:
    """A named part of an observation. Derive a dataclass from it, whose fields are terms, each ``ObservationTerm |
    None``; a term set to None is switched off.

    A concatenated group is one tensor (N, K) float32, its terms flattened side by side in the order of their fields;
    else it is a dictionary of the terms as they are.
    """

    concatenate: bool = True
    """True for one tensor, False for a dictionary."""
    history: int = 1
    """Steps that each term shows, where it does not say itself: (N, k, ...), or flattened if concatenated."""


@dataclass(unsafe_hash=True)
class RewardTerm(Term):
    """``weight`` times ``function`` (N,) is added to the reward of each step, times the step's length in seconds."""

    function: TermFunction
    weight: float
    agent: str | None = None
    """Who earns it, where several robots act; the name is the function's second argument. None: each does, in full."""


@dataclass(unsafe_hash=True)
class TerminationTerm(Term):
    """``function`` (N,) bool ends an episode. The time limit is the environment's own and needs no term."""

    function: TermFunction


@dataclass(unsafe_hash=True)
class PremiseTerm(Term):
    """``function`` (N,) bool must hold when an episode begins, after the reset has settled
    (:attr:`Task.settle_time`); results of starts in which it does not hold are worthless."""

    function: TermFunction
    reason: str
    """What is wrong with a start in which it does not hold, for its author; a clause without a full stop."""


class EventTime(Enum):
    """Time of an event."""

    STARTUP = "startup"
    """Once, for all environments, when the world is new."""
    RESET = "reset"
    """Whenever environments begin an episode."""
    INTERVAL = "interval"
    """Again and again, at times that each environment draws for itself."""


@dataclass(unsafe_hash=True)
class EventTerm(Term):
    """``function`` changes some environments: where things start, what they weigh, what the goal is.

    An event of :attr:`EventTime.INTERVAL` happens at the beginning of a step. ``interval`` is the least and the most
    time in seconds from the episode's start, or from the last time, to the next; it is rounded to whole steps.
    """

    arguments: ClassVar[tuple[str, ...]] = ("env", "env_ids")
    function: EventFunction
    time: EventTime = EventTime.RESET
    """Occasion of the event; each reset by default."""
    interval: tuple[float, float] = (0.0, 0.0)


@dataclass(unsafe_hash=True)
class CurriculumTerm(Term):
    """``function`` gives (N,), by how much an episode that has ended changes the difficulty of the next.

    It sees the episode's last state. The terms of a task are added up, and :attr:`Task.difficulty` stays in [0, 1].
    """

    function: TermFunction


@dataclass(unsafe_hash=True)
class ModifyTerm(Term):
    """Curriculum term that changes one value of the task's configuration while it runs.

    ``function(steps, value)`` returns the value that holds from the next step on, given the environment's steps so far
    and the value now. It runs in Python before each step. A reward's weight changes at no cost; after another change a
    step that is compiled, or recorded on a GPU, is captured again.
    """

    arguments: ClassVar[tuple[str, ...]] = ("steps", "value")
    address: str
    """Path of the value in the task: ``"rewards.lift.weight"``, ``"events.push.interval"``, ``"max_forward"``."""
    function: Callable[[int, Any], Any]
    """``(steps, value)`` to the next value; returns ``value`` itself for no change."""


@dataclass(unsafe_hash=True, kw_only=True)
class CommandTerm(Term):
    """A command: a velocity, pose or goal that is sampled when an episode begins, and again in time.

    A sample is drawn uniformly within :meth:`ranges`, and :meth:`command` makes the command of it. Terms read it as
    ``env.commands[name]``, a tensor (N, K). Ready-made ones: :mod:`orbit_core.mdp.commands`.
    """

    live: ClassVar[frozenset[str]] = frozenset()
    """Fields that only :meth:`ranges` reads: setting them in a running environment costs no new capture of its step."""
    resampling_time: Bounds | None = None
    """Least and most seconds until the next sample, drawn with each sample; None: one sample an episode."""

    def ranges(self, env: Any) -> dict[str, Bounds]:
        """Least and most of each number that is drawn, by name."""
        raise NotImplementedError

    def command(self, env: Any, drawn: Tensor, env_ids: Tensor) -> Tensor:
        """Commands (n, K) of environments ``env_ids`` (n,), from the numbers drawn for them (n, D)."""
        return drawn

    def expired(self, env: Any) -> Tensor | None:
        """(N,) bool after a step: where another sample follows now, before its time. None: nowhere."""
        return None

    def follow(self, env: Any, command: Tensor) -> bool:
        """Adjust the command (N, K) in place after a step, where it depends on the state. Return True if it may have
        changed."""
        return False

    def show(self, env: Any, command: Tensor, env_ids: Tensor) -> None:
        """Place markers for new commands (n, K) of environments ``env_ids`` (n,). Override where a scene has some."""


_Term = TypeVar("_Term")
_Function = TypeVar("_Function", bound=TermFunction)


def terms_of(collection: object, kind: type[_Term]) -> dict[str, _Term]:
    """The terms in a dataclass's fields, in order, each with a function of the environment only.

    A field set to None is left out: a term switched off. A collection that is None has no terms.

    Raises:
        TypeError: a field holds something else.
        ConfigurationError: a term's function takes other arguments than it is called with.
    """
    terms: dict[str, _Term] = {}
    if collection is None:
        return terms
    for field in fields(collection):  # pyright: ignore[reportArgumentType]
        term = getattr(collection, field.name)
        if term is None:
            continue
        if not isinstance(term, kind):
            raise TypeError(
                f"{type(collection).__name__}.{field.name} must be a {getattr(kind, '__name__', kind)}, not {term!r}"
            )
        check_arguments(term, f"{type(collection).__name__}.{field.name}")
        terms[field.name] = term if getattr(term, "agent", None) is None else _for_its_agent(term)
    return terms


def check_arguments(term: object, what: str) -> None:
    """Check that a term's function takes the arguments that it is called with.

    Args:
        term: any kind of term; what has no function passes.
        what: place of the term, for the message.

    Raises:
        ConfigurationError: it takes others; names those that it has to take.
    """
    function = getattr(term, "function", None)
    if not isinstance(term, Term) or function is None:
        return
    if not callable(function):
        raise ConfigurationError(f"the function of term {what} is {function!r:.60}, which cannot be called")
    wanted = (*term.arguments, "agent") if getattr(term, "agent", None) is not None else term.arguments
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # of C, without a signature
        return
    try:
        # Binding, not counting: defaults, keywords and bound methods all pass where a call would.
        signature.bind(*wanted)
    except TypeError:
        names = [name for name, each in signature.parameters.items() if each.default is each.empty]
        before = names[:2] == ["world", "task"]
        hint = ": the world is env.world, the task env.task, what it remembers env.state" if before else ""
        raise ConfigurationError(
            f"the function of term {what} takes ({', '.join(names)}), but terms are called with "
            f"({', '.join(wanted)}){hint}"
        ) from None


def _for_its_agent(term: Any) -> Any:
    function, agent = term.function, term.agent
    return replace(term, function=lambda env: function(env, agent))


# Unit of a pose (..., 7).
POSE = "m, quaternion (w, x, y, z)"
# Frame of what is measured in the world.
ENVIRONMENT = "environment: axes of the world, origin of the environment"


def measured_in(unit: str) -> Callable[[_Function], _Function]:
    """Say in which unit a term's function measures; ``"1"`` where there is none."""

    def mark(function: _Function) -> _Function:
        function.unit = unit  # pyright: ignore[reportFunctionMemberAccess] - functions take attributes
        return function

    return mark


def means(
    formula: str,
    frame: str = "",
    components: tuple[str, ...] | Callable[..., Sequence[str]] = (),
    offset: Callable[..., Tensor] | None = None,
) -> Callable[[_Function], _Function]:
    """Say what a term's function measures, :class:`Meaning`."""
    meaning = Meaning(formula, frame, components, offset)

    def mark(function: _Function) -> _Function:
        function.meaning = meaning  # pyright: ignore[reportFunctionMemberAccess] - functions take attributes
        return function

    return mark


def meaning_of(term: ObservationTerm) -> Meaning:
    """Return the meaning of an observation term: its own, its function's, or that of the function's docstring."""
    known = term.meaning or getattr(term.function, "meaning", None)
    if known is not None:
        return known
    paragraph = (term.function.__doc__ or "").strip().partition("\n\n")[0]
    return Meaning(_SHAPE.sub("", " ".join(paragraph.split())))


_SHAPE = re.compile(r"^\(N[^)]*\)\s*")


def unit_of(term: ObservationTerm) -> str:
    """The unit of an observation term before it is scaled; empty where nobody says it."""
    return getattr(term.function, "unit", "") if term.unit is None else term.unit


def once_per_state(function: _Function) -> _Function:
    """Compute a term once per state of the world, and for each agent's name if it takes one."""

    @wraps(function)
    def cached(env: Any, *agent: str) -> Tensor:
        key = (function, *agent)
        # Steps, resets and events move the version; so do commands that change within a step.
        now = env.world.clock.version
        version, value = env.cache.get(key, (-1, None))
        if value is None or version != now:
            value = function(env, *agent)
            env.cache[key] = (now, value)
        return value

    return cached  # pyright: ignore[reportReturnType] - as the function is called, it is called


def per_environment(value: object, what: str, num_envs: int) -> Tensor:
    """A term's value, where it is a tensor (N,).

    Args:
        value: that the term's function gave.
        what: the term, for the message.
        num_envs: N.

    Raises:
        ConfigurationError: it is no tensor.
        ShapeError: it has another shape.
    """
    if not isinstance(value, Tensor):
        raise ConfigurationError(f"{what} gives a {type(value).__name__}: its function must return a torch.Tensor")
    if value.shape != (num_envs,):
        raise ShapeError(
            f"{what} has shape {tuple(value.shape)}, but must have ({num_envs},), a value for each environment"
        )
    return value


def weight_of(name: str, term: RewardTerm) -> float:
    """Return a reward term's weight.

    Raises:
        ConfigurationError: it is no finite number; names the term.
    """
    weight = term.weight
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not math.isfinite(weight):
        raise ConfigurationError(f"the weight of reward term '{name}' must be a finite number, not {weight!r}")
    return float(weight)


def check_same_names(kind: str, before: Collection[str], now: Collection[str], remedy: str) -> None:
    """Check that a collection has the terms that it had when the environment was made.

    Raises:
        ConfigurationError: one is missing, or new; names it.
    """
    if missing := [name for name in before if name not in now]:
        raise ConfigurationError(
            f"{kind} term '{missing[0]}' was there when the environment was made, and cannot be switched off now: "
            f"{remedy}"
        )
    if new := [name for name in now if name not in before]:
        raise ConfigurationError(
            f"{kind} term '{new[0]}' was not there when the environment was made: give it to the task before"
        )
