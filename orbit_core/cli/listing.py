"""``orbit list``: names, with a line on each. What describes itself without the tensor library answers at once."""

from __future__ import annotations

import functools
import importlib.metadata
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import Positional, arg

from orbit_core.cli.settings import parse_words
from orbit_core.distributions import missing_note
from orbit_core.interfaces.errors import OrbitError
from orbit_core.registry import Registry

Rows = list[tuple[str, str]]
"""Names, each with a line on it."""


@dataclass(frozen=True)
class ListSettings:
    """Names of all tasks, sensors, backends and the like.

    Further kinds are renderers, matter solvers, action spaces and motion generators; with orbit-assets robots and
    objects, with orbit-learn kept policies and learning libraries.
    """

    kind: Annotated[Positional[str], arg(metavar="KIND")] = ""
    """What to list; all kinds if left out."""


def main(words: Sequence[str]) -> None:
    """Print the names of one kind."""
    kind = parse_words(ListSettings, words, "orbit list").kind
    rows = lists().get(kind)() if kind else [(name, "") for name in lists().names]
    # Plain print and not a table: the output is meant for grep and cut.
    width = max((len(name) for name, _ in rows), default=0)
    for name, description in rows:
        print(f"{name:<{width}}  {description}".rstrip())
    if note := missing_note(f"orbit.{kind}"):
        print(f"note: {note}", file=sys.stderr)


@functools.cache
def lists() -> Registry[Callable[[], Rows]]:
    """Return what can be listed, by kind; packages add kinds through the entry-point group ``orbit.lists``."""
    registry = Registry[Callable[[], Rows]]("kind", "orbit.lists")
    for kind, rows in _LISTS.items():
        registry.add(kind, rows)
    return registry


def _tasks() -> list[tuple[str, str]]:
    from orbit_core.envs.registry import task_entries

    return [(entry.name, entry.description) for entry in task_entries().values()]


def _sensors() -> list[tuple[str, str]]:
    from orbit_core.registry import first_line
    from orbit_core.sensors import sensor_types

    rows = []
    # One by one, so that a broken package shows as a line and hides no others.
    for name in sensor_types().names:
        try:
            rows.append((name, first_line(sensor_types().get(name))))
        except OrbitError as error:
            rows.append((name, f"broken: {error}"))
    return rows


def _backends() -> list[tuple[str, str]]:
    from orbit_core.backends import backend_names, installable_backends

    return [(name, _state(name)) for name in backend_names()] + _missing(installable_backends())


def _renderers() -> list[tuple[str, str]]:
    from orbit_core.backends import renderer_names

    return [(name, _state(name)) for name in renderer_names()]


def _matter() -> list[tuple[str, str]]:
    from orbit_core.backends import installable_matter, matter_names, matter_solver
    from orbit_core.interfaces.capabilities import MATTER

    rows: list[tuple[str, str]] = []
    for name in matter_names():
        does = [each.value for each in MATTER if matter_solver(name).capabilities().has(each)]
        rows.append((name, f"simulates {', '.join(does)} with any backend"))
    return rows + _missing(installable_matter())


def _actions() -> list[tuple[str, str]]:
    from orbit_core.actions import action_words

    return [*action_words().items()]


def _motion() -> list[tuple[str, str]]:
    from orbit_core.actions import generator_descriptions

    return [*generator_descriptions().items()]


def _missing(commands: Mapping[str, str]) -> list[tuple[str, str]]:
    return [(name, f"not installed: {command}") for name, command in commands.items()]


def _state(name: str) -> str:
    from orbit_core.backends import renderer

    try:
        versions = renderer(name).versions()  # which finds backends too
    except (OrbitError, importlib.metadata.PackageNotFoundError) as error:
        return f"broken: {error}"
    return "installed: " + ", ".join(f"{package} {version}" for package, version in versions.items())


# Functions import what they list, because each kind loads other modules.
_LISTS = {
    "tasks": _tasks,
    "sensors": _sensors,
    "backends": _backends,
    "renderers": _renderers,
    "matter": _matter,
    "actions": _actions,
    "motion": _motion,
}
