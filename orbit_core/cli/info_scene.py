"""What ``orbit info`` tells of things that a scene holds: kinds of objects and of sensors."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Iterator

from rich.console import Console
from rich.text import Text

from orbit_core.cli.output import print_heading, print_line, print_rows
from orbit_core.interfaces.errors import AssetError
from orbit_core.objects import object_config, object_kinds
from orbit_core.registry import first_line
from orbit_core.scene import SensorSpec
from orbit_core.sensors import TimedSensor, sensor_types


def show_object(console: Console, name: str) -> None:
    """The parameters of a kind of object, and what it is made of as they are by default."""
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
    """The fields of a sensor's specification, and the values that the sensor holds."""
    sensor = sensor_types().get(name)
    spec = next((kind for kind in _derived(SensorSpec) if kind.__name__ == name), None)
    print_heading(console, f"Sensor {name}", first_line(spec or sensor))
    print_line(console, "brought by", sensor_types().origin(name))
    if spec is not None:
        print_rows(console, "field", "default", ((field.name, _default(field)) for field in dataclasses.fields(spec)))
    print_line(console, "reading", sensor.__name__)
    console.print(Text(inspect.getdoc(sensor) or ""))
    values = inspect.getmembers(sensor, lambda member: isinstance(member, property))
    own = [(value, first_line(read)) for value, read in values if value[0] != "_" and not hasattr(TimedSensor, value)]
    print_rows(console, "value", "is", own)


def _derived(kind: type) -> Iterator[type]:
    for below in kind.__subclasses__():
        yield below
        yield from _derived(below)


def _default(field: dataclasses.Field[object]) -> object:
    if field.default is not dataclasses.MISSING:
        return field.default
    return "needed" if field.default_factory is dataclasses.MISSING else field.default_factory()
