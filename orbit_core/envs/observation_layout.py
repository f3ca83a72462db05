"""Layout of observations: groups of terms, checked, and their shapes, dtypes and bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace

import torch
from torch import Tensor

from orbit_core.envs.task import Task
from orbit_core.envs.terms import ObservationGroup, ObservationTerm, check_arguments
from orbit_core.interfaces import ConfigurationError, NonFiniteError, first_few
from orbit_core.scene import Scene

Observation = dict[str, Tensor | dict[str, Tensor]]
"""Groups by name: one tensor (N, K) where a group is concatenated, else its terms (N, ...) by name."""


@dataclass(frozen=True)
class TermLayout:
    """A term as its group shows it, history included."""

    shape: tuple[int, ...]
    """Shape of one environment's value."""
    dtype: torch.dtype
    """Type of the numbers."""
    low: float
    """Least value; minus infinity if unbounded."""
    high: float
    """Greatest value; infinity if unbounded."""
    camera: str | None = None
    """Camera whose picture the term is."""


@dataclass(frozen=True)
class GroupLayout:
    """One group of an observation, its terms in order."""

    name: str
    """Name of the group, such as ``policy``."""
    concatenated: bool
    """True for one tensor (N, K), False for a dictionary of terms."""
    terms: Mapping[str, TermLayout]
    """Layouts of the terms by name, in order."""

    @property
    def size(self) -> int:
        """K, the components of a concatenated group.

        Raises:
            ConfigurationError: the group is a dictionary of its terms.
        """
        if not self.concatenated:
            raise _is_dictionary(self.name, self.terms)
        return sum(math.prod(term.shape) for term in self.terms.values())

    @property
    def columns(self) -> dict[str, slice]:
        """Slice of each term in a concatenated group, by name."""
        columns: dict[str, slice] = {}
        end = 0
        for name, term in self.terms.items():
            begin, end = end, end + math.prod(term.shape)
            columns[name] = slice(begin, end)
        return columns


def one_tensor(observation: Observation, group: str = "policy") -> Tensor:
    """A concatenated group (N, K) of an observation.

    Raises:
        ConfigurationError: the group is a dictionary of its terms.
    """
    value = observation[group]
    if isinstance(value, dict):
        raise _is_dictionary(group, value)
    return value


def leaf_shapes(layouts: Mapping[str, GroupLayout]) -> dict[str, tuple[int, ...]]:
    """Shape of each tensor in one environment's observation, by ``group`` or ``group/term``."""
    shapes: dict[str, tuple[int, ...]] = {}
    for group, layout in layouts.items():
        if layout.concatenated:
            shapes[group] = (layout.size,)
        else:
            shapes |= {f"{group}/{name}": term.shape for name, term in layout.terms.items()}
    return shapes


def leaves_of(observation: Observation) -> list[Tensor]:
    """All tensors, in the order of :func:`leaf_shapes`."""
    leaves: list[Tensor] = []
    for group in observation.values():
        if isinstance(group, dict):
            leaves += group.values()
        else:
            leaves.append(group)
    return leaves


def observation_of(layouts: Mapping[str, GroupLayout], leaves: Sequence[Tensor]) -> Observation:
    """The observation whose tensors, in the order of :func:`leaf_shapes`, are ``leaves``."""
    tensors: Iterator[Tensor] = iter(leaves)
    return {
        group: next(tensors) if layout.concatenated else {name: next(tensors) for name in layout.terms}
        for group, layout in layouts.items()
    }


def map_leaves(function: Callable[[Tensor], Tensor], observation: Observation) -> Observation:
    """The observation with each tensor replaced by what ``function`` gives for it."""
    return {
        name: {term: function(value) for term, value in group.items()} if isinstance(group, dict) else function(group)
        for name, group in observation.items()
    }


def _is_dictionary(group: str, terms: Mapping[str, object]) -> ConfigurationError:
    return ConfigurationError(
        f"observation group '{group}' is a dictionary of its terms ({', '.join(terms)}), where one tensor is needed: "
        "give the group concatenate=True, or take what accepts dictionaries"
    )


# The group that every task has.
POLICY = "policy"
_OWN_FIELDS = frozenset(field.name for field in fields(ObservationGroup))


def groups_of(task: Task) -> dict[str, ObservationGroup]:
    """A task's observation groups by name; those set to None are left out.

    Raises:
        ConfigurationError: the task's observations are no dataclass of groups, or none is named ``policy``.
    """
    owner = f"observations of task {type(task).__name__}"
    if not is_dataclass(task.observations) or isinstance(task.observations, type):
        raise ConfigurationError(f"{owner} must be a dataclass of ObservationGroup, not {task.observations!r}")
    # A group is a dataclass as well, and would be read as a dataclass of groups with a puzzling error.
    if isinstance(task.observations, ObservationGroup):
        raise ConfigurationError(
            f"{owner} must be a dataclass of ObservationGroup, not one group: put it in a dataclass, as its field "
            f"'{POLICY}'"
        )
    groups: dict[str, ObservationGroup] = {}
    for field in fields(task.observations):
        group = getattr(task.observations, field.name)
        if group is None:
            continue
        if not isinstance(group, ObservationGroup):
            raise ConfigurationError(
                f"{owner}: '{field.name}' must be an ObservationGroup, but is of type {type(group).__name__}: a group "
                "is a dataclass derived from ObservationGroup, whose fields are the terms"
            )
        groups[field.name] = group
    if POLICY not in groups:
        raise ConfigurationError(f"{owner} have no group '{POLICY}', which a policy sees: there are {_listed(groups)}")
    for name, group in groups.items():
        _check_group(f"observation group '{name}' of task {type(task).__name__}", group)
    return groups


def terms_of_group(group: ObservationGroup) -> dict[str, ObservationTerm]:
    """A group's terms in the order of their fields; those set to None are left out."""
    named = ((field.name, getattr(group, field.name)) for field in fields(group) if field.name not in _OWN_FIELDS)
    return {name: term for name, term in named if term is not None}


def with_sensors_of_terms(scene: Scene, task: Task) -> Scene:
    """The scene with the sensors that observation terms read; equal sensors of one name count once.

    Raises:
        ConfigurationError: two unequal sensors have one name.
    """
    sensors = {sensor.name: sensor for sensor in scene.sensors}
    owners = dict.fromkeys(sensors, "the scene")
    for group_name, group in groups_of(task).items():
        for name, term in terms_of_group(group).items():
            owner = f"observation term '{name}' of group '{group_name}'"
            for sensor in term.sensors:
                # Compared by value: several terms may each bring the same camera.
                if sensors.setdefault(sensor.name, sensor) != sensor:
                    raise ConfigurationError(
                        f"{owner} needs a sensor '{sensor.name}' that differs from that of {owners[sensor.name]}: "
                        "name one of them differently, or give both the same settings"
                    )
                owners.setdefault(sensor.name, owner)
    return replace(scene, sensors=tuple(sensors.values()))


def _check_group(what: str, group: ObservationGroup) -> None:
    for field in fields(group):
        term = getattr(group, field.name)
        if field.name not in _OWN_FIELDS and term is not None and not isinstance(term, ObservationTerm):
            raise ConfigurationError(f"{what}: '{field.name}' must be an ObservationTerm, not {term!r}")
        if isinstance(term, ObservationTerm):
            check_arguments(term, f"{type(group).__name__}.{field.name}")
    terms = terms_of_group(group)
    if not terms:
        raise ConfigurationError(f"{what} has no terms: give it one, or set the group to None")
    for name, history in ((None, group.history), *((name, term.history) for name, term in terms.items())):
        # True is an int to Python, and would count as a history of one.
        if history is not None and (not isinstance(history, int) or isinstance(history, bool) or history < 1):
            place = what if name is None else f"{what}, term '{name}'"
            raise ConfigurationError(f"{place}: history is {history!r}, but must be a whole number of steps from 1 on")


def _listed(groups: Mapping[str, ObservationGroup]) -> str:
    return ", ".join(groups) or "none"


def check_finite(observation: Observation, layouts: Mapping[str, GroupLayout]) -> None:
    """Refuse numbers that are NaN or infinite; this waits for the device.

    Raises:
        NonFiniteError: names group, term, environments and component.
    """
    for name, group in observation.items():
        layout = layouts[name]
        if isinstance(group, dict):
            for term, value in group.items():
                if not _finite(value):
                    _refuse(name, term, value.flatten(1))
        elif not surely_finite(group):
            for term, columns in layout.columns.items():
                _refuse(name, term, group[:, columns])


def _finite(value: Tensor) -> bool:
    """Return True if all numbers are certainly finite; a sum that overflows gives False and is examined."""
    return not value.is_floating_point() or surely_finite(value)


def surely_finite(values: Tensor) -> bool:
    """Return True if all numbers are finite; False where one is not, or where their sum overflows."""
    # NumPy does not see a GPU's memory; the float waits for the device, so that callers ask only where that is allowed.
    if values.device.type != "cpu":
        return math.isfinite(float(values.sum()))
    # NumPy's product in the tensor's own memory: on few numbers it costs a third of torch's sum, and warns of nothing.
    flat = values.numpy().reshape(-1)
    return math.isfinite(flat.dot(flat))


def _refuse(group: str, term: str, values: Tensor) -> None:
    """Raise where one of the values (N, D) of a term is not finite."""
    wrong = ~torch.isfinite(values)
    environments = wrong.any(1).nonzero().squeeze(-1).tolist()
    if not environments:
        return
    component = int(wrong[environments[0]].nonzero()[0])
    number = float(values[environments[0], component])
    plural = "s" if len(environments) > 1 else ""
    raise NonFiniteError(
        f"observation term '{term}' of group '{group}' is not finite in environment{plural} "
        f"{first_few(environments)}: component {component} of environment {environments[0]} is {number}. A term must "
        "give finite numbers: bound what divides or measures, as orbit_core.mdp.sensing.camera_depth does"
    )
