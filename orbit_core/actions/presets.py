"""Registry of action terms, their presets by name, and the drives that they need."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

from orbit_core.actions.base import CommandMode
from orbit_core.actions.differential_ik import DifferentialIkConfig
from orbit_core.actions.embodiment import joint_commands
from orbit_core.actions.grippers import BinaryGripperConfig
from orbit_core.actions.joints import JointEffortConfig, JointPositionConfig, JointVelocityConfig
from orbit_core.actions.mobile_base import BaseVelocityConfig, DifferentialDriveConfig
from orbit_core.actions.term import ActionTerm
from orbit_core.interfaces import ConfigurationError, UnknownNameError, match_names
from orbit_core.registry import ClassRegistry
from orbit_core.scene import ActuatorConfig, RobotSpec

GROUP = "orbit.motion"
_OWN = (
    DifferentialIkConfig,
    JointPositionConfig,
    JointVelocityConfig,
    JointEffortConfig,
    BinaryGripperConfig,
    BaseVelocityConfig,
    DifferentialDriveConfig,
)


@cache
def motion_generators() -> ClassRegistry[ActionTerm]:
    """The configurations of all installed motion generators, read once."""
    return ClassRegistry[ActionTerm]("motion generator", GROUP, _OWN, ActionTerm)


def generator_descriptions() -> dict[str, str]:
    """The first line that each configuration says of itself, by the generator's name."""
    return motion_generators().descriptions


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
    # The same object, so that scenes without such terms compare equal.
    if not unwanted:
        return spec
    groups = [part for group in spec.actuators for part in _split(group, spec, unwanted)]
    return replace(spec, actuators=tuple(groups))


def _split(group: ActuatorConfig, spec: RobotSpec, unwanted: Mapping[str, tuple[str, ...]]) -> list[ActuatorConfig]:
    """The group in parts, each of joints that lose the same gains."""
    names = spec.articulation.joint_names
    parts: dict[tuple[str, ...], list[str]] = {}
    for joint in match_names(group.joints, names, "joint", f"'{spec.name}'"):
        # Escaped, because a joint's name may hold characters of regular expressions.
        parts.setdefault(unwanted.get(names[joint], ()), []).append(re.escape(names[joint]))
    return [replace(group, joints=tuple(part), **dict.fromkeys(gains, 0.0)) for gains, part in parts.items()]


@dataclass(frozen=True)
class ActionPreset:
    """Preset of an action word: the term that moves the joints of a robot."""

    description: str
    """What one unit of action is, in one line."""
    term: Callable[[RobotSpec], ActionTerm]
    """Function that makes the term for a robot."""


def preset_terms(spec: RobotSpec, name: str, prefix: str = "") -> dict[str, ActionTerm]:
    """The action terms of an action space, by name, in the order of the action's components.

    The first is of the space's own name. A gripper on the robot's end effector and a planar base, where the robot has
    them and the first term leaves them alone, add the terms ``gripper`` and ``base``. Any motion generator's name is an
    action space too, with the generator's own defaults.

    Args:
        spec: of the robot, under the name that it has in the scene.
        name: of a preset or of a motion generator.
        prefix: begins the terms' names, so that those of several robots fit into one task.

    Raises:
        UnknownNameError: there is no such action space.
        ConfigurationError: the generator has settings without defaults, or the robot lacks what it moves.
    """
    terms = {name: _leading(spec, name)}
    moved = {*terms[name].joint_indices(spec, name)}
    more: dict[str, ActionTerm] = {}
    if spec.end_effectors and spec.end_effector.gripper:
        more["gripper"] = BinaryGripperConfig()
    if spec.planar_base:
        more["base"] = BaseVelocityConfig()
    elif spec.differential_base:
        more["base"] = DifferentialDriveConfig()
    # Each joint belongs to one term at most.
    terms |= {key: term for key, term in more.items() if moved.isdisjoint(term.joint_indices(spec, key))}
    return {prefix + key: replace(term, robot=spec.name) for key, term in terms.items()}


def action_words() -> dict[str, str]:
    """All action spaces by name, each with what one unit of action is, or what its generator does."""
    presets = {name: preset.description for name, preset in ACTION_PRESETS.items()}
    return presets | {name: text for name, text in generator_descriptions().items() if name not in presets}


def _leading(spec: RobotSpec, name: str) -> ActionTerm:
    if name in ACTION_PRESETS:
        return ACTION_PRESETS[name].term(spec)
    generators = motion_generators()
    known = {*ACTION_PRESETS, *generators.names}
    if name not in known:
        raise UnknownNameError("action space", name, known, note=generators.note)
    try:
        return generators.get(name)()
    except TypeError as error:
        raise ConfigurationError(
            f"motion generator '{name}' is no action space by its name alone ({error}): compose it, "
            "actions=ActionTerms(...)"
        ) from None


def _joint_position(spec: RobotSpec) -> ActionTerm:
    commands = joint_commands(spec)
    return JointPositionConfig(scale=commands.position_scale, limit_speed=commands.limit_speed)


def _joint_position_relative(spec: RobotSpec) -> ActionTerm:
    limit_speed = joint_commands(spec).limit_speed
    return JointPositionConfig(scale=0.05, mode=CommandMode.INTEGRATED, limit_speed=limit_speed)


ACTION_PRESETS: Mapping[str, ActionPreset] = {
    "joint_position": ActionPreset("joint positions from home, as far as the robot says", _joint_position),
    "joint_position_relative": ActionPreset("0.05 rad or m from each joint's last target", _joint_position_relative),
    "joint_velocity": ActionPreset("1 rad/s or m/s of each joint", lambda spec: JointVelocityConfig()),
    "joint_effort": ActionPreset("each joint's effort limit", lambda spec: JointEffortConfig()),
    "ik_absolute": ActionPreset(
        "0.5 m, pi rad from the hand's pose at home, in the robot's root frame",
        lambda spec: DifferentialIkConfig(mode=CommandMode.ABSOLUTE, position_scale=0.5, rotation_scale=math.pi),
    ),
    "ik_relative": ActionPreset(
        "5 cm, 0.2 rad from the hand's measured pose, in world axes", lambda spec: DifferentialIkConfig()
    ),
}
