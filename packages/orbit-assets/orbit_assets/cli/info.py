"""Robots and kinds of objects for ``orbit info``."""

from __future__ import annotations

import dataclasses

from rich.console import Console
from rich.table import Table

from orbit_assets.catalogue import robot_info, robot_names
from orbit_core.cli.output import new_table, print_heading, print_line, print_rows
from orbit_core.dynamics.rigid_body import drive_responses
from orbit_core.interfaces.errors import AssetError
from orbit_core.interfaces.layout import actuator_of_joint
from orbit_core.objects import object_config, object_kinds
from orbit_core.registry import first_line
from orbit_core.scene import RobotSpec


class _Robots:
    """Robots of the catalogue, and compositions of its parts."""

    def names(self) -> list[str]:
        return robot_names()

    def has(self, name: str) -> bool:
        return "+" in name or name in robot_names()

    def like(self, name: str) -> list[str]:
        """Return the names of other arms, arms with grippers or legged robots, as the robot is one."""
        kind = _kind(name)
        return [other for other in robot_names() if other != name and _kind(other) == kind]

    def show(self, console: Console, name: str) -> None:
        entry = robot_info(name)
        robot = entry.load()
        body = robot.articulation
        print_heading(console, f"Robot {name}", entry.description)
        print_line(console, "source", entry.source or "ORBIT")
        print_line(console, "licence", entry.licence or "unknown")
        print_line(console, "categories", ", ".join(category.value for category in robot.categories) or "none")
        print_line(
            console, "degrees of freedom", f"{entry.dof}{'' if robot.fixed_base else ', and 6 of its free base'}"
        )
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


class _Objects:
    """Kinds of objects, with their parameters and what they are made of by default."""

    def names(self) -> list[str]:
        return object_kinds().names

    def has(self, name: str) -> bool:
        return name in object_kinds().names

    def like(self, name: str) -> list[str]:
        return [other for other in object_kinds().names if other != name]

    def show(self, console: Console, name: str) -> None:
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


ROBOTS, OBJECTS = _Robots(), _Objects()


def _kind(name: str) -> tuple[bool, bool, bool] | None:
    try:
        robot = robot_info(name).load()
    except AssetError:  # its package is not installed
        return None
    grippers = any(effector.gripper is not None for effector in robot.end_effectors)
    return robot.has_arm, grippers, bool(robot.feet)


def _joint_table(robot: RobotSpec) -> Table:
    table = new_table("joint", "type", "limits (rad, m)", "effort (N m, N)", "velocity (rad/s, m/s)", "armature")
    for joint in robot.articulation.movable_joints:
        kind = f"{joint.type.value}, follows {joint.mimic.joint}" if joint.mimic else joint.type.value
        limits = f"{joint.lower_limit:.4g} to {joint.upper_limit:.4g}"
        numbers = (f"{number:.4g}" for number in (joint.effort_limit, joint.velocity_limit, joint.armature))
        table.add_row(joint.name, kind, limits, *numbers)
    return table


def _show_actuators(console: Console, robot: RobotSpec) -> None:
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
