"""The observation groups of a task, checked, and the sensors that their terms bring along."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace

from orbit_core.envs.task import Task
from orbit_core.envs.terms import ObservationGroup, ObservationTerm, check_arguments
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Scene

POLICY = "policy"
"""The group that every task has."""
_OWN_FIELDS = frozenset(field.name for field in fields(ObservationGroup))


def groups_of(task: Task) -> dict[str, ObservationGroup]:
    """A task's observation groups by name; those set to None are left out.

    Raises:
        ConfigurationError: the task's observations are no dataclass of groups, or none is named ``policy``.
    """
    owner = f"observations of task {type(task).__name__}"
    if not is_dataclass(task.observations) or isinstance(task.observations, type):
        raise ConfigurationError(f"{owner} must be a dataclass of ObservationGroup, not {task.observations!r}")
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
        if history is not None and (not isinstance(history, int) or isinstance(history, bool) or history < 1):
            place = what if name is None else f"{what}, term '{name}'"
            raise ConfigurationError(f"{place}: history is {history!r}, but must be a whole number of steps from 1 on")


def _listed(groups: Mapping[str, ObservationGroup]) -> str:
    return ", ".join(groups) or "none"
