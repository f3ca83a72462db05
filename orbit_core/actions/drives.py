"""Drives that suit the commands of action terms."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from orbit_core.actions.term import ActionTerm
from orbit_core.interfaces import match_names
from orbit_core.scene import ActuatorConfig, RobotSpec


def with_drives_for(spec: RobotSpec, terms: Mapping[str, ActionTerm]) -> RobotSpec:
    """The robot with drives that do not work against its action terms, by name.

    The joints of a term lose the gains that it says are unwanted; other joints keep their drives as they are.
    """
    names = spec.articulation.joint_names
    unwanted = {
        names[joint]: term.unwanted_gains
        for name, term in terms.items()
        if term.unwanted_gains
        for joint in term.joint_indices(spec, name)
    }
    if not unwanted:
        return spec
    groups = [part for group in spec.actuators for part in _split(group, spec, unwanted)]
    return replace(spec, actuators=tuple(groups))


def _split(group: ActuatorConfig, spec: RobotSpec, unwanted: Mapping[str, tuple[str, ...]]) -> list[ActuatorConfig]:
    """The group in parts, each of joints that lose the same gains."""
    names = spec.articulation.joint_names
    parts: dict[tuple[str, ...], list[str]] = {}
    for joint in match_names(group.joints, names, "joint", f"'{spec.name}'"):
        parts.setdefault(unwanted.get(names[joint], ()), []).append(re.escape(names[joint]))
    return [replace(group, joints=tuple(part), **dict.fromkeys(gains, 0.0)) for gains, part in parts.items()]
