"""Checks of joints: limits that a file leaves out, and links that touch where the robot starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from orbit_assets.audit.findings import Finding, Severity, names_in_short
from orbit_assets.self_contacts import touching_links
from orbit_core.scene import Articulation, Joint, JointType

_TURNS = 4.0 * math.pi


def check_joints(articulation: Articulation) -> Iterator[Finding]:
    """Findings on the movable joints, alike ones together; followers need no limits of effort."""
    joints = articulation.movable_joints
    free = [joint for joint in joints if joint.mimic is None]
    for severity, text, group, holds in _CHECKS:
        names = [joint.name for joint in (free if group == "free" else joints) if holds(joint)]
        if names:
            yield Finding(severity, names_in_short(names), text)
    if free and not any(joint.armature for joint in free):
        text = "no joint has armature (the motors' reflected inertia, which steadies contact): add it by edit_joints"
        yield Finding(Severity.NOTE, "model", text)


def home_of(articulation: Articulation) -> dict[str, float]:
    """Positions by joint: the file's home, else zero or the nearest limit; followers after their leaders."""
    named = dict(articulation.home)
    home = {
        joint.name: min(max(named.get(joint.name, 0.0), joint.lower_limit), joint.upper_limit)
        for joint in articulation.movable_joints
    }
    for joint in articulation.movable_joints:
        if joint.mimic is not None and joint.mimic.joint in home:
            home[joint.name] = float(joint.mimic.position(home[joint.mimic.joint]))
    return home


def check_touching(articulation: Articulation) -> Iterator[Finding]:
    """Pairs of links whose hulls touch at home although nothing keeps them from colliding with each other."""
    touching = [f"{first} with {second}" for first, second in touching_links(articulation, home_of(articulation))]
    if not touching:
        return
    acts = articulation.self_collisions
    remedy = (
        "exclude these pairs, or give another home" if acts else "exclude them before self_collisions is switched on"
    )
    severity = Severity.WARNING if acts else Severity.NOTE
    yield Finding(severity, names_in_short(touching), f"links touch at home that no joint connects: {remedy}")


def _endless(joint: Joint) -> bool:
    return joint.type is not JointType.CONTINUOUS and not np.isfinite(joint.upper_limit - joint.lower_limit)


def _turns_far(joint: Joint) -> bool:
    span = joint.upper_limit - joint.lower_limit
    return joint.type is JointType.REVOLUTE and math.isfinite(span) and span > _TURNS


_CHECKS: tuple[tuple[Severity, str, str, Callable[[Joint], bool]], ...] = (
    (Severity.WARNING, "slides or turns without limits: give it a lower and an upper one", "all", _endless),
    (
        Severity.WARNING,
        "turns by more than two whole turns within its limits: are they in degrees?",
        "all",
        _turns_far,
    ),
    (
        Severity.WARNING,
        "cannot move: its lower limit is its upper one; make it fixed if that is meant",
        "all",
        lambda joint: joint.lower_limit == joint.upper_limit,
    ),
    (
        Severity.WARNING,
        "has an effort limit of 0: no motor moves it",
        "free",
        lambda joint: joint.effort_limit == 0,
    ),
    (
        Severity.WARNING,
        "has a velocity limit of 0: give the motor's",
        "free",
        lambda joint: joint.velocity_limit == 0,
    ),
    (
        Severity.NOTE,
        "has no effort limit: give the motor's by edit_joints, or in the actuator group",
        "free",
        lambda joint: math.isinf(joint.effort_limit),
    ),
    (
        Severity.NOTE,
        "has no velocity limit: give the motor's by edit_joints, or in the actuator group",
        "free",
        lambda joint: math.isinf(joint.velocity_limit),
    ),
)
