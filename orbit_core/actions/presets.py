"""Action spaces by one word: the action terms that it stands for, for a given robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from orbit_core.actions.base_velocity import BaseVelocityConfig
from orbit_core.actions.binary_gripper import BinaryGripperConfig
from orbit_core.actions.differential_drive import DifferentialDriveConfig
from orbit_core.actions.differential_ik import DifferentialIkConfig
from orbit_core.actions.embodiment import joint_commands
from orbit_core.actions.joint_effort import JointEffortConfig
from orbit_core.actions.joint_position import JointPositionConfig
from orbit_core.actions.joint_velocity import JointVelocityConfig
from orbit_core.actions.modes import CommandMode
from orbit_core.actions.registry import generator_descriptions, motion_generators
from orbit_core.actions.term import ActionTerm
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.scene import RobotSpec


@dataclass(frozen=True)
class ActionPreset:
    """What a word stands for: the term that moves the joints of a robot."""

    description: str
    """What one unit of action is, in one line."""
    term: Callable[[RobotSpec], ActionTerm]


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
