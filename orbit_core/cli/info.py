"""``orbit info``: describe one task, robot, object, sensor, backend or renderer."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text
from tyro.conf import Positional, arg

from orbit_core.backends import backend, backend_names, installable_backends, renderer, renderer_names
from orbit_core.cli.output import console as make_console
from orbit_core.cli.output import new_table, print_heading, print_line, print_rows
from orbit_core.cli.settings import parse_words
from orbit_core.distributions import missing_note
from orbit_core.envs.registry import task_entries
from orbit_core.interfaces.capabilities import IMAGES, Capability
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.objects import ObjectConfig, object_config, object_kinds
from orbit_core.registry import Registry, first_line
from orbit_core.robots import robot_info, robot_names
from orbit_core.scene import SensorSpec
from orbit_core.sensors import TimedSensor, sensor_types

if TYPE_CHECKING:
    from orbit_core.envs.task import Task
    from orbit_core.interfaces.backend import Backend
    from orbit_core.scene import RobotSpec, Scene


def show_object(console: Console, name: str) -> None:
    """Return the parameters of a kind of object, and what it is made of as they are by default."""
    config = object_config(name)
    print_heading(console, f"Object {name}", first_line(type(config)))
    print_line(console, "brought by", object_kinds().origin(name))
    parameters = ((field.name, getattr(config, field.name)) for field in dataclasses.fields(config))
    print_rows(console, "parameter", "default", parameters)
    try:
        body = config.build(name).articulation
    except AssetError as error:
        print_line(console, "by default", str(error))
        return
    print_line(console, "mass", f"{body.mass:.4g} kg")
    print_line(console, "links", ", ".join(body.link_names))
    if body.joint_names:
        print_line(console, "joints", ", ".join(body.joint_names))


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


def main(words: Sequence[str]) -> None:
    """Print what is known of a name."""
    # Names of different kinds do not clash in practice; the order decides where they do.
    name = parse_words(InfoSettings, words, "orbit info").name
    console = make_console()
    if name in task_entries():
        _show_task(console, name)
    elif "+" in name or name in robot_names():
        _show_robot(console, name)
    elif name in object_kinds().names:
        show_object(console, name)
    elif name in sensor_types().names:
        show_sensor(console, name)
    elif name in backend_names() or name in installable_backends():
        _show_plugin(console, f"Backend {name}", backend(name), tuple(Capability))  # if missing, says how to install it
    elif name in renderer_names():
        _show_plugin(console, f"Renderer {name}", renderer(name), IMAGES)
    else:
        things = [*task_entries(), *robot_names(), *object_kinds().names, *sensor_types().names]
        known = [*things, *backend_names(), *installable_backends(), *renderer_names()]
        note = "; ".join(filter(None, map(missing_note, ("orbit.tasks", "orbit.robots"))))
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
    print_line(console, "robots", _robots_like(task.robot))
    scene = task.scene()
    _show_actions(console, task, scene)
    needs = required_capabilities(scene)
    print_rows(console, "ppo, in training", "default", dataclasses.asdict(task.metadata.ppo).items())
    print_rows(console, "needs", "for", ((need.value, culprit) for need, culprit in needs.items()))


def _show_actions(console: Console, task: Task, scene: Scene) -> None:
    from orbit_core.envs.action_terms import action_terms

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


def _robots_like(name: str) -> str:
    """Return the default robot of a task, then those of its kind: arms, arms with grippers, legged robots."""
    kind = _kind(name)
    # Robots of the same kind are the ones that a task is likely to run with.
    others = [other for other in robot_names() if other != name and _kind(other) == kind]
    return ", ".join([f"{name} (default)", *others])


def _kind(name: str) -> tuple[bool, bool, bool] | None:
    try:
        robot = robot_info(name).load()
    except AssetError:  # its package is not installed
        return None
    grippers = any(effector.gripper is not None for effector in robot.end_effectors)
    return robot.has_arm, grippers, bool(robot.feet)


def _show_robot(console: Console, name: str) -> None:
    entry = robot_info(name)
    robot = entry.load()
    body = robot.articulation
    print_heading(console, f"Robot {name}", entry.description)
    print_line(console, "source", entry.source or "ORBIT")
    print_line(console, "licence", entry.licence or "unknown")
    print_line(console, "categories", ", ".join(category.value for category in robot.categories) or "none")
    print_line(console, "degrees of freedom", f"{entry.dof}{'' if robot.fixed_base else ', and 6 of its free base'}")
    print_line(console, "mass", f"{body.mass:.2f} kg")
    print_line(console, "links", f"{len(body.links)}: {', '.join(body.link_names)}")
    for effector in robot.end_effectors:
        hand = f", gripper {', '.join(effector.gripper.joints)}" if effector.gripper else ""
        arm = ", ".join(effector.arm_joints) or "no arm"
        print_line(console, "end effector", f"{effector.frame}, moved by {arm}{hand}")
    for what, places in (("feet", robot.feet), ("wheels", robot.wheels)):
        if places:
            print_line(console, what, ", ".join(places))
    console.print(_joint_table(robot))
    _show_actuators(console, robot)
    for note in body.notes:
        print_line(console, "note", note)


def _joint_table(robot: RobotSpec) -> Table:
    table = new_table("joint", "type", "limits (rad, m)", "effort (N m, N)", "velocity (rad/s, m/s)", "armature")
    for joint in robot.articulation.movable_joints:
        kind = f"{joint.type.value}, follows {joint.mimic.joint}" if joint.mimic else joint.type.value
        limits = f"{joint.lower_limit:.4g} to {joint.upper_limit:.4g}"
        numbers = (f"{number:.4g}" for number in (joint.effort_limit, joint.velocity_limit, joint.armature))
        table.add_row(joint.name, kind, limits, *numbers)
    return table


def _show_actuators(console: Console, robot: RobotSpec) -> None:
    from orbit_core.dynamics.workspace import drive_responses
    from orbit_core.interfaces.layout import actuator_of_joint

    groups = actuator_of_joint(robot)
    names = robot.articulation.joint_names
    responses = drive_responses(robot)
    for group in robot.actuators:
        values = {field.name: getattr(group, field.name) for field in dataclasses.fields(group)}
        # Tables and nested settings of a group do not fit on the line.
        described = [f"{key} {value:g}" for key, value in values.items() if isinstance(value, float)]
        own = [response for response in responses if groups[names.index(response.joint)] is group]
        if own:
            slowest, fastest = min(drive.slowest for drive in own), max(drive.fastest for drive in own)
            least, most = min(drive.least_damped for drive in own), max(drive.most_damped for drive in own)
            described += [f"natural frequency {_span(slowest, fastest)} Hz", f"damping ratio {_span(least, most)}"]
        print_line(console, f"actuators {', '.join(group.joints)}", f"{type(group).__name__}, {', '.join(described)}")


def _span(least: float, most: float) -> str:
    """Return a range over the workspace, one number where it is none."""
    low, high = f"{least:.2g}", f"{most:.2g}"
    return low if low == high else f"{low} to {high}"


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
