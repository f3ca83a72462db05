"""Observation manager: measures each term of a task's groups once per step, and applies noise, delay and history."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NoReturn

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.envs.observation_layout import GroupLayout, Observation, TermLayout, groups_of, terms_of_group
from orbit_core.envs.terms import ObservationGroup, ObservationTerm
from orbit_core.interfaces import ConfigurationError, ShapeError, World

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


class Past:
    """The last values of each environment's episode; its first value counts as all before it.

    Args:
        world: whose resets begin episodes.
        value: (N, ...) one like those to come.
        length: how many values are kept.
    """

    def __init__(self, world: World, value: Tensor, length: int) -> None:
        self._selector = world.selector
        # (N, length, ...), the newest first.
        self._values = value.new_zeros(len(value), length, *value.shape[1:])
        # (N,) whose episode has no value yet.
        self._fresh = torch.ones(len(value), dtype=torch.bool, device=value.device)

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget some environments' values, by index or mask."""
        write_rows(self._fresh, True, env_ids)

    def push(self, value: Tensor) -> Tensor:
        """Take in one step's value (N, ...); gives the last ones (N, length, ...), the newest first."""
        # Newest first, so that a delay of k steps is index k.
        newest = value[:, None]
        shifted = torch.cat((newest, self._values[:, :-1]), dim=1)
        values = torch.where(self._fresh.view(-1, *(1 for _ in shifted.shape[1:])), newest, shifted)
        rows = self._selector.resolve(None)  # the others have been observed in this step already
        write_rows(self._values, values, rows)
        write_rows(self._fresh, False, rows)
        return values


class Corruption:
    """Corrupts the values (N, ...) of one term, of any shape; noise and bias differ in each component.

    Args:
        term: says what happens.
        value: (N, ...) one like those to come.
        world: whose environments draw.
        what: the term, for messages.

    Raises:
        ConfigurationError: the delay or the bounds cannot be, or whole numbers are to be scaled or made noisy.
    """

    def __init__(self, term: ObservationTerm, value: Tensor, world: World, what: str) -> None:
        self._term = term = replace(term)  # as it is now: it may be set later
        self._world = world
        noisy = bool(term.noise_std or term.bias_std)
        if (noisy or term.scale != 1.0) and not value.is_floating_point():
            raise ConfigurationError(
                f"{what} gives {value.dtype}: scale, noise and bias need torch.float32, so convert it in its function"
            )
        # Without noise a term keeps its bounds by itself, and the clamp would only cost.
        self._saturation = term.bounds if noisy else None
        self._shape = tuple(value.shape[1:])
        self._bias = torch.zeros_like(value) if term.bias_std else None
        self._delay = _Delay(term.delay, value, world, what) if term.delay != (0, 0) else None
        self.changes = noisy or term.scale != 1.0 or self._delay is not None
        """False where values are seen as they are."""

    def __call__(self, value: Tensor) -> Tensor:
        """Return the corrupted value of this step."""
        term = self._term
        if term.scale != 1.0:
            value = value * term.scale
        if self._bias is not None:
            value = value + self._bias
        if term.noise_std:
            value = value + self._world.random.normal(self._shape, term.noise_std)
        if self._saturation is not None:
            value = value.clamp(*self._saturation)
        return value if self._delay is None else self._delay(value)

    def take_over(self, before: Corruption, what: str) -> None:
        """Go on with what another corruption of the same measurement remembers; a new bias is drawn now.

        Raises:
            ConfigurationError: the delay is another.
        """
        if self._term.delay != before._term.delay:
            raise ConfigurationError(
                f"the delay of {what} is {self._term.delay}, but was {before._term.delay} when the environment was "
                "made: change it before"
            )
        # Kept even if other settings changed, because the past of an episode cannot be measured again.
        self._delay = before._delay
        if self._bias is not None and self._term.bias_std == before._term.bias_std:
            self._bias = before._bias
        else:
            self.draw_bias(None)

    def draw_bias(self, env_ids: Tensor | None) -> None:
        """Draw the errors that an episode keeps, by index or mask."""
        if self._bias is not None:
            drawn = self._world.random.normal(self._shape, self._term.bias_std, env_ids)
            write_rows(self._bias, drawn, env_ids)

    def draw_delay(self, env_ids: Tensor | None) -> None:
        """Draw how late an episode's measurements are, by index or mask."""
        if self._delay is not None:
            self._delay.reset(env_ids)


class _Delay:
    """Holds measurements back by the steps that each environment draws at reset."""

    def __init__(self, delay: tuple[int, int], value: Tensor, world: World, what: str) -> None:
        self._fewest, self._most = delay
        if not 0 <= self._fewest <= self._most:
            raise ConfigurationError(f"the delay of {what} must be 0 <= fewest <= most steps, not {delay}")
        self._random = world.random
        self._past = Past(world, value, self._most + 1)
        self._steps = torch.zeros(len(value), dtype=torch.int64, device=value.device)

    def reset(self, env_ids: Tensor | None) -> None:
        write_rows(self._steps, self._random.integers(self._fewest, self._most, env_ids), env_ids)
        self._past.reset(env_ids)

    def __call__(self, value: Tensor) -> Tensor:
        # Gather needs an index of the value's shape; the expanded one takes no memory.
        steps = self._steps.view(-1, *(1 for _ in value.shape)).expand_as(value[:, None])
        return self._past.push(value).gather(1, steps).squeeze(1)


_DTYPES = (torch.float32, torch.uint8, torch.int32, torch.int64, torch.bool)


class ObservationManager:
    """Computes the observation of a world's present state, once per step.

    Terms that share function and agent are measured once; those that share their corruption as well, once corrupted.

    Args:
        env: that is observed; its state has started. Each term is evaluated once, to learn its shape and dtype.

    Raises:
        ConfigurationError: a group or term cannot be; names it.
        ShapeError: a term gives no tensor (N, ...).
    """

    def __init__(self, env: Environment) -> None:
        self._env = env
        self._world = env.world
        self._read()
        self.layouts = {name: group.layout for name, group in self._groups.items()}
        """Layout of each group, by name."""

    def _read(self) -> None:
        self._measurements: list[_Measurement] = []
        # Corruptions of terms, each with the index of the measurement that it changes.
        self._corruptions: list[tuple[int, Corruption]] = []
        self._corrupted: list[ObservationTerm] = []
        self._groups = {name: self._group(name, group) for name, group in groups_of(self._env.task).items()}

    def refresh(self) -> None:
        """Take the terms that the task has now: function, scale, noise and bias may be others.

        Raises:
            ConfigurationError: a term is missing or new, or its shape, dtype, bounds, history or delay is another.
        """
        groups, corruptions = self._groups, self._corruptions
        self._read()
        now = {name: group.layout for name, group in self._groups.items()}
        if now != self.layouts:
            name = next(name for name in {**now, **self.layouts} if now.get(name) != self.layouts.get(name))
            raise ConfigurationError(
                f"observation group '{name}' has other terms, shapes, dtypes or bounds than when the environment was "
                "made: change them before"
            )
        for name, group in self._groups.items():
            for term_name, term, old in zip(group.layout.terms, group.terms, groups[name].terms, strict=True):
                what = f"observation term '{term_name}' of group '{name}'"
                self._corruptions[term.index][1].take_over(corruptions[old.index][1], what)
            self._groups[name] = replace(group, terms=tuple(
                replace(term, past=old.past) for term, old in zip(group.terms, groups[name].terms, strict=True)
            ))  # fmt: skip

    def __call__(self) -> Observation:
        """Everything that is seen now; the tensors are new ones."""
        measured: list[Tensor] = []
        for measurement in self._measurements:  # plain loops: a step's time is that of its Python calls
            value = measurement.function(self._env, *measurement.agent)
            if value.shape != measurement.shape or value.dtype is not measurement.dtype:
                measurement.refuse(value)
            measured.append(value)
        seen: list[Tensor] = []
        for index, corruption in self._corruptions:
            seen.append(corruption(measured[index]) if corruption.changes else measured[index])
        observation: Observation = {}
        for name, group in self._groups.items():
            observation[name] = group.show(seen)
        return observation

    def reset(self, env_ids: Tensor | None) -> None:
        """Draw what holds for an episode, by index or mask."""
        for _, corruption in self._corruptions:
            corruption.draw_bias(env_ids)
        for _, corruption in self._corruptions:
            corruption.draw_delay(env_ids)
        for group in self._groups.values():
            for term in group.terms:
                if term.past is not None:
                    term.past.reset(env_ids)

    def _group(self, name: str, group: ObservationGroup) -> _Group:
        terms: list[_Term] = []
        layouts: dict[str, TermLayout] = {}
        for term_name, term in terms_of_group(group).items():
            what = f"observation term '{term_name}' of group '{name}'"
            index = self._corruption(term, what)
            value = self._measurements[self._corruptions[index][0]].example
            if group.concatenate:
                _check_concatenable(value, what)
            steps = group.history if term.history is None else term.history
            past = Past(self._world, value, steps) if steps > 1 else None
            terms.append(_Term(index, past))
            layouts[term_name] = _layout(term, value, steps, group.concatenate)
        return _Group(tuple(terms), GroupLayout(name, group.concatenate, layouts))

    def _corruption(self, term: ObservationTerm, what: str) -> int:
        """Index of the term's corruption, which an equal term may have brought already."""
        alike = replace(term, history=None, sensors=(), camera=None, meaning=None)
        if alike in self._corrupted:
            return self._corrupted.index(alike)
        measurement = self._measurement(term, what)
        example = self._measurements[measurement].example
        self._corrupted.append(alike)
        self._corruptions.append((measurement, Corruption(term, example, self._world, what)))
        return len(self._corruptions) - 1

    def _measurement(self, term: ObservationTerm, what: str) -> int:
        for index, known in enumerate(self._measurements):
            if (known.term.function, known.term.agent) == (term.function, term.agent):
                return index
        self._measurements.append(_Measurement(term, what, self._env))
        return len(self._measurements) - 1


class _Measurement:
    """A term's function, and what it gave when it was evaluated first."""

    def __init__(self, term: ObservationTerm, what: str, env: Environment) -> None:
        self.term = term
        self.function = term.function
        self.agent = () if term.agent is None else (term.agent,)
        """Arguments of the function after world and task."""
        self._what = what
        world = env.world
        value = self.function(env, *self.agent)
        if not isinstance(value, Tensor):
            raise ConfigurationError(f"{what} gives a {type(value).__name__}: its function must return a torch.Tensor")
        if value.ndim == 0 or len(value) != world.num_envs:
            expected = f"({world.num_envs}, ...), a row for each environment"
            raise ShapeError(f"{what} has shape {tuple(value.shape)}, but must have {expected}")
        if value.dtype not in _DTYPES:
            raise ConfigurationError(f"{what} gives {value.dtype}: convert it to one of {', '.join(map(str, _DTYPES))}")
        if value.device != world.device:
            raise ConfigurationError(f"{what} is on device {value.device}, the world on {world.device}")
        self.example = value.new_empty(()).expand(value.shape)
        """(N, ...) like all later values; its memory is one number's."""
        self.shape, self.dtype = value.shape, value.dtype

    def refuse(self, value: Tensor) -> NoReturn:
        """Raise a ShapeError for a value whose shape or dtype is not that of the first time."""
        raise ShapeError(
            f"{self._what} has shape {tuple(value.shape)} and {value.dtype}, but had {tuple(self.shape)} and "
            f"{self.dtype} when the environment was made: it must give the same at every step"
        )


@dataclass(frozen=True)
class _Term:
    """A term's place in a group."""

    index: int
    """Among the corruptions."""
    past: Past | None

    def show(self, seen: list[Tensor]) -> Tensor:
        """(N, ...), or (N, k, ...) with a history of k, the oldest first."""
        value = seen[self.index]
        return value if self.past is None else self.past.push(value).flip(1)


@dataclass(frozen=True)
class _Group:
    terms: tuple[_Term, ...]
    layout: GroupLayout

    def show(self, seen: list[Tensor]) -> Tensor | dict[str, Tensor]:
        values: list[Tensor] = []
        for term in self.terms:
            value = seen[term.index] if term.past is None else term.show(seen)
            if self.layout.concatenated and (value.dtype is not torch.float32 or value.ndim != 2):
                value = _flat(value)
            values.append(value)
        if self.layout.concatenated:
            return torch.cat(values, dim=1)
        # Copies, for what a function gave may be the engine's own memory.
        return {name: value.clone() for name, value in zip(self.layout.terms, values, strict=True)}


def _flat(value: Tensor) -> Tensor:
    """(N, D) float32"""
    if value.dtype != torch.float32:
        value = value.float()
    return value if value.ndim == 2 else value.reshape(len(value), -1)


def _check_concatenable(value: Tensor, what: str) -> None:
    if value.dtype == torch.uint8 or value.ndim > 3:
        raise ConfigurationError(
            f"{what} is a picture, of shape {tuple(value.shape)} and {value.dtype}, which does not go into one vector "
            "with other terms: give the group concatenate=False"
        )


def _layout(term: ObservationTerm, value: Tensor, steps: int, concatenated: bool) -> TermLayout:
    low, high = _bounds(value.dtype) if term.bounds is None else term.bounds
    shape = tuple(value.shape[1:])
    if concatenated:
        return TermLayout((steps * value[0].numel(),), torch.float32, low, high)
    return TermLayout((steps, *shape) if steps > 1 else shape, value.dtype, low, high, term.camera)


def _bounds(dtype: torch.dtype) -> tuple[float, float]:
    if dtype == torch.bool:
        return 0.0, 1.0
    if dtype.is_floating_point:
        return -torch.inf, torch.inf
    return torch.iinfo(dtype).min, torch.iinfo(dtype).max
