"""``orbit info``: describe one task, robot, object, sensor, backend or renderer."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Protocol

from rich.console import Console
from rich.text import Text
from tyro.conf import Positional, arg

from orbit_core.backends import backend, backend_names, installable_backends, renderer, renderer_names
from orbit_core.cli.output import console as make_console
from orbit_core.cli.output import new_table, print_heading, print_line, print_rows
from orbit_core.cli.settings import parse_words
from orbit_core.distributions import missing_note
from orbit_core.envs.registry import task_entries
from orbit_core.interfaces.capabilities import IMAGES, Capability
from orbit_core.interfaces.errors import UnknownNameError
from orbit_core.objects import ObjectConfig
from orbit_core.registry import Registry, first_line
from orbit_core.scene import SensorSpec
from orbit_core.sensors import TimedSensor, sensor_types

if TYPE_CHECKING:
    from orbit_core.envs.task import Task
    from orbit_core.interfaces.backend import Backend
    from orbit_core.scene import Scene


def show_sensor(console: Console, name: str) -> None:
    """Return the fields of a sensor's specification, and the values that the sensor holds."""
    sensor = sensor_types().get(name)
    spec = next((kind for kind in _derived(SensorSpec) if kind.__name__ == name), None)
    print_heading(console, f"Sensor {name}", first_line(spec or sensor))
    print_line(console, "brought by", sensor_types().origin(name))
    if spec is not None:
        print_rows(console, "field", "default", ((field.name, _default(field)) for field in dataclasses.fields(spec)))
    print_line(console, "reading", sensor.__name__)
    console.print(Text(inspect.getdoc(sensor) or ""))
    values = inspect.getmembers(sensor, lambda member: isinstance(member, property))
    # Properties of the base class are the same for all sensors.
    own = [(value, first_line(read)) for value, read in values if value[0] != "_" and not hasattr(TimedSensor, value)]
    print_rows(console, "value", "is", own)


def _derived(kind: type) -> Iterator[type]:
    # Specifications are not registered themselves: only loaded classes can be described.
    for below in kind.__subclasses__():
        yield below
        yield from _derived(below)


def _default(field: dataclasses.Field[object]) -> object:
    if field.default is not dataclasses.MISSING:
        return field.default
    return "needed" if field.default_factory is dataclasses.MISSING else field.default_factory()


@dataclass(frozen=True)
class InfoSettings:
    """Everything about one task, robot, object, sensor, backend or renderer."""

    name: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of a task, robot, object, sensor, backend or renderer."""


class InfoSource(Protocol):
    """A package's things that ``orbit info`` describes; the entry-point group ``orbit.info`` names such objects."""

    def names(self) -> Iterable[str]:
        """Return the names of all things."""
        ...

    def has(self, name: str) -> bool:
        """Return True if there is a thing of that name."""
        ...

    def show(self, console: Console, name: str) -> None:
        """Print everything about the thing of that name."""
        ...

    def like(self, name: str) -> Iterable[str]:
        """Return the names of others of its kind, which a task is likely to run with in its place."""
        ...


@functools.cache
def info_sources() -> Registry[InfoSource]:
    """Return what describes things that installed packages bring, in order of precedence."""
    return Registry[InfoSource]("kind of thing", "orbit.info")


def _source_of(name: str) -> InfoSource | None:
    return next((source for source in info_sources().values.values() if source.has(name)), None)


def main(words: Sequence[str]) -> None:
    """Print what is known of a name."""
    # Names of different kinds do not clash in practice; the order decides where they do.
    name = parse_words(InfoSettings, words, "orbit info").name
    console = make_console()
    if name in task_entries():
        _show_task(console, name)
    elif source := _source_of(name):
        source.show(console, name)
    elif name in sensor_types().names:
        show_sensor(console, name)
    elif name in backend_names() or name in installable_backends():
        _show_plugin(console, f"Backend {name}", backend(name), tuple(Capability))  # if missing, says how to install it
    elif name in renderer_names():
        _show_plugin(console, f"Renderer {name}", renderer(name), IMAGES)
    else:
        named = [other for source in info_sources().values.values() for other in source.names()]
        things = [*task_entries(), *named, *sensor_types().names]
        known = [*things, *backend_names(), *installable_backends(), *renderer_names()]
        # What is not installed may be why the name is unknown.
        note = "; ".join(filter(None, (missing_note("orbit.tasks"), info_sources().note)))
        raise UnknownNameError("task, robot, object, sensor, backend or renderer", name, known, note=note)


def _show_task(console: Console, name: str) -> None:
    from orbit_core.envs.configuration import DEFAULT_PRESET, configure
    from orbit_core.envs.observation_layout import groups_of, terms_of_group
    from orbit_core.interfaces.requirements import required_capabilities

    entry = task_entries()[name]
    task = configure(entry.task_type(), {})
    print_heading(console, f"Task {name}", entry.description)
    console.print(Text(f"\n{inspect.getdoc(type(task))}\n"))
    fields = {field.name: field.default for field in dataclasses.fields(task) if field.init and _is_plain(field)}
    print_rows(console, "field", "default", fields.items())
    for name, group in groups_of(task).items():
        kind = "one tensor" if group.concatenate else "a dictionary"
        print_line(console, f"observations, {name} ({kind})", ", ".join(terms_of_group(group)))
    presets = ", ".join((f"{DEFAULT_PRESET} (default)", *task.observation_presets))
    print_line(console, "presets of observations, --set observations=NAME", presets)
    for part in ("commands", "rewards", "terminations", "events"):
        print_line(console, part, _terms(task, part))
    if source := _source_of(task.robot):
        print_line(console, "robots", ", ".join((f"{task.robot} (default)", *source.like(task.robot))))
    scene = task.scene()
    _show_actions(console, task, scene)
    needs = required_capabilities(scene)
    print_rows(console, "ppo, in training", "default", dataclasses.asdict(task.metadata.ppo).items())
    print_rows(console, "needs", "for", ((need.value, culprit) for need, culprit in needs.items()))


def _show_actions(console: Console, task: Task, scene: Scene) -> None:
    from orbit_core.envs.action_manager import action_terms

    robots = {robot.name: robot for robot in scene.robots}
    table = new_table("action term", "motion generator", "robot", "components", "joints")
    for name, term in action_terms(task, scene).items():
        robot = robots[term.robot]
        names = robot.articulation.joint_names
        components = term.components(robot, name)
        joints = [names[joint] for joint in term.joint_indices(robot, name)]
        size = f"{len(components)}" if list(components) == joints else f"{len(components)}: {', '.join(components)}"
        table.add_row(name, term.name, robot.name, size, ", ".join(joints))
    console.print(table)


def _is_plain(field: dataclasses.Field[Any]) -> bool:
    return isinstance(field.default, bool | int | float | str | tuple | ObjectConfig)


def _terms(task: Task, part: str) -> str:
    collection = getattr(task, part)
    if collection is None:
        return "none"
    names = [field.name for field in dataclasses.fields(collection) if getattr(collection, field.name) is not None]
    return ", ".join(names) or "none"


def _show_plugin(console: Console, title: str, plugin: Backend, shown: Sequence[Capability]) -> None:
    capabilities = plugin.capabilities()
    versions = ", ".join(f"{package} {version}" for package, version in plugin.versions().items())
    print_heading(console, title, versions)
    settings = {field.name: field.default for field in dataclasses.fields(plugin.config_type)}
    print_rows(console, "setting", "default", settings.items())
    table = new_table("capability", "level", "how it differs, or why it is missing")
    for capability in shown:
        support = capabilities[capability]
        table.add_row(capability.value, support.level.value, support.reason)
    console.print(table)
    _show_gaps(console, plugin)


def _show_gaps(console: Console, plugin: Backend) -> None:
    if not plugin.gaps():
        return
    units: dict[tuple[str, str], str] = {}
    # Units belong to the scenarios, which another distribution defines.
    for source in Registry[Callable[[], dict[tuple[str, str], str]]]("units", "orbit.units").values.values():
        units |= source()
    table = new_table("scenario or check", "metric", "error up to", "why", title="Declared gaps")
    for gap in plugin.gaps():
        limit = f"{gap.limit:g} {units.get((gap.scenario, gap.metric), '')}"
        reason = f"{', '.join(gap.robots)}: {gap.reason}" if gap.robots else gap.reason
        table.add_row(gap.scenario, gap.metric, limit.strip(), reason)
    console.print(table)
