"""Bases, arms and end effectors, and robots composed of them.

``"base_omni+franka_panda+allegro_right"`` names a robot by its parts: a base carries an arm, an arm carries an end
effector. Each part brings its model, home position, drives and licence; gains are computed for the robot as a whole,
because an arm moves its hand and a base moves all.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING, TypeVar

from orbit_assets.cache import Model, cached_articulation
from orbit_assets.compose import attach
from orbit_assets.decomposition import without_home_contacts
from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.interfaces.names import match_values
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import (
    ActuatorConfig,
    Articulation,
    DifferentialBase,
    EndEffector,
    Gripper,
    PlanarBase,
    Pose,
    RobotSpec,
    Workspace,
)

if TYPE_CHECKING:
    from orbit_assets.drive_design import DriveDesign

    _Moving = TypeVar("_Moving", ActuatorConfig, DriveDesign, Gripper)


class PartKind(Enum):
    """Role of a part in a robot: a base carries an arm, and an arm an end effector."""

    BASE = "base"
    """Carries an arm: a trolley, a trunk on legs, or a whole humanoid."""
    ARM = "arm"
    """Carries an end effector."""
    END_EFFECTOR = "end effector"


_BASE, _ARM, _TOOL = PartKind
# Allowed compositions: an end effector needs an arm that moves it, or is a robot without one.
_ORDERS = ((_BASE,), (_BASE, _ARM), (_BASE, _ARM, _TOOL), (_ARM,), (_ARM, _TOOL), (_TOOL,))


@dataclass(frozen=True, kw_only=True)
class RobotPart:
    """A base, an arm or an end effector.

    An end effector's frame, and the frame that an arm mounts it on, have z out of the hand; the fingers open along y.
    """

    name: str
    """Name for :func:`orbit_assets.catalogue.robot` and compositions."""
    kind: PartKind
    """Role in a robot."""
    model: Model
    """Recipe of its links and joints."""
    home: Mapping[str, float] = field(default_factory=dict)
    """Joint positions by regular expression over joint names."""
    drives: tuple[ActuatorConfig, ...] = ()
    """Drives with known gains."""
    designs: tuple[DriveDesign, ...] = ()
    """Designs of drives for joints without gains of their own: these are computed for the whole robot."""
    mount: str = ""
    """Frame that carries the next part; empty where nothing can be mounted."""
    frame: str = ""
    """End effector: frame between its fingers. Arm: frame that a task moves where no end effector is mounted."""
    joints: tuple[str, ...] = ()
    """Joints of an arm, by regular expression."""
    gripper: Gripper | None = None
    """Fingers of an end effector that open and close."""
    finger_tips: tuple[str, ...] = ()
    """Links or frames at the ends of a hand's fingers."""
    workspace: Workspace | None = None
    """Workspace of an arm, in its root link; None: a task computes it."""
    end_effector: str = ""
    """Name of an arm's default end effector, mounted where a composition names none."""
    feet: tuple[str, ...] = ()
    """Frames of a base where it is meant to touch the ground."""
    walking_drives: tuple[ActuatorConfig, ...] = ()
    """Drives of a base for learning to walk (:attr:`orbit_core.scene.RobotSpec.walking_drives`)."""
    wheels: tuple[str, ...] = ()
    """Links or frames of a base that roll on the ground."""
    planar_base: PlanarBase | None = None
    """Base of three joints over the floor."""
    differential_base: DifferentialBase | None = None
    """Base of two driven wheels."""
    end_effectors: tuple[EndEffector, ...] = ()
    """End effectors that a base has already, such as a humanoid's hands; one that is mounted on it comes first."""
    pose: Pose = field(default_factory=Pose)
    """Pose of the root link, where this part is the first."""
    fixed_base: bool = True
    """True to fix the root, where this part is the first."""

    def composed(self, name: str, others: Sequence[RobotPart]) -> RobotSpec:
        """Return the robot of this part and of others, from the base up; see :func:`compose`."""
        return compose(name, (self, *others))


def compose(name: str, parts: Sequence[RobotPart]) -> RobotSpec:
    """Compose a robot of these parts, from the base up.

    Names of a part's links, joints and frames that a part below it has already get the part's name as prefix.

    Raises:
        ConfigurationError: the parts are in no order in which they could be mounted, or one has no flange for the
            next.
        UnknownNameError: a mount is no link or frame of its part.
        AssetError: a part's model cannot be had.
    """
    # Late: drive design imports torch, which the catalogue does not need.
    from orbit_assets.drive_design import designed_drives

    _check_order(name, parts)
    first, *others = parts
    mounted, body = [first], cached_articulation(first.model)
    for part in others:
        carrier = mounted[-1]
        articulation = cached_articulation(part.model)
        # A prefix is only given where names clash: the names of most robots stay those of their files.
        prefix = f"{part.name}_" if _taken(body) & _taken(articulation) else ""
        mounted.append(_prefixed(part, prefix))
        body = attach(body, articulation, carrier.mount, prefix=prefix)
    body = replace(merge_fixed_links(body), name=name)
    home = {pattern: value for part in mounted for pattern, value in part.home.items()}
    if body.self_collisions:
        # Only the whole robot shows which links touch: a hand may touch the arm that carries it.
        body = without_home_contacts(body, home)
    designs = [design for part in mounted for design in part.designs]
    drives: tuple[ActuatorConfig, ...] = tuple(drive for part in mounted for drive in part.drives)
    # After composition: an arm's gains depend on the mass of its hand.
    if designs:
        computed, note = designed_drives(body, designs)
        drives, body = drives + computed, replace(body, notes=(*body.notes, note))
    return RobotSpec(
        name=name,
        articulation=body,
        pose=first.pose,
        fixed_base=first.fixed_base,
        home=home,
        actuators=drives,
        semantic_label="robot",
        # Arms compensate gravity; robots that stand on the ground must carry their weight.
        gravity_compensation=first.fixed_base,
        end_effectors=_end_effectors(mounted, body),
        feet=first.feet,
        walking_drives=first.walking_drives,
        planar_base=first.planar_base,
        differential_base=first.differential_base,
        wheels=first.wheels,
        licence=_licence(parts),
        source=", ".join(dict.fromkeys(package for part in parts for package in part.model.packages)),
    )


def _licence(parts: Sequence[RobotPart]) -> str:
    licences = {part.model.licence for part in parts}
    if len(licences) == 1:
        return licences.pop()
    return "; ".join(f"{part.model.licence} ({part.name})" for part in parts)


def _check_order(name: str, parts: Sequence[RobotPart]) -> None:
    kinds = tuple(part.kind for part in parts)
    if kinds not in _ORDERS:
        asked = " + ".join(f"{part.name} ({part.kind.value})" for part in parts)
        allowed = ", ".join("+".join(kind.value for kind in order) for order in _ORDERS)
        raise ConfigurationError(f"'{name}' is {asked}: allowed are {allowed}")
    for lower, upper in itertools.pairwise(parts):
        if not lower.mount:
            raise ConfigurationError(
                f"'{name}': {lower.kind.value} '{lower.name}' has no flange on which '{upper.name}' could be mounted: "
                f"take another {lower.kind.value}, or '{upper.name}' alone"
            )


def _taken(articulation: Articulation) -> set[str]:
    frames = (frame.name for frame in articulation.frames)
    return {*articulation.link_names, *frames, *(joint.name for joint in articulation.joints)}


def _prefixed(part: RobotPart, prefix: str) -> RobotPart:
    """Return the part with its names as :func:`attach` gives them."""
    if not prefix:
        return part
    # Names in patterns are regular expressions: the prefix must match literally.
    pattern = re.escape(prefix)
    gripper = part.gripper and _patterned(part.gripper, pattern)
    return replace(
        part,
        home={f"{pattern}(?:{key})": value for key, value in part.home.items()},
        drives=tuple(_patterned(drive, pattern) for drive in part.drives),
        designs=tuple(_patterned(design, pattern) for design in part.designs),
        mount=part.mount and prefix + part.mount,
        frame=part.frame and prefix + part.frame,
        joints=tuple(f"{pattern}(?:{joint})" for joint in part.joints),
        gripper=gripper,
        finger_tips=tuple(prefix + name for name in part.finger_tips),
    )


def _patterned(moving: _Moving, pattern: str) -> _Moving:
    return replace(moving, joints=tuple(f"{pattern}(?:{joint})" for joint in moving.joints))


def _end_effectors(parts: Sequence[RobotPart], body: Articulation) -> tuple[EndEffector, ...]:
    own = parts[0].end_effectors
    arm = next((part for part in parts if part.kind is PartKind.ARM), None)
    tool = parts[-1]
    if arm is not None:
        space = arm.workspace
        # A workspace is given in the arm's root, which the base carries at its mount.
        if space is not None and arm is not parts[0]:
            space = space.placed(_seat(body, parts[0]))
        return (EndEffector(tool.frame or arm.mount, arm.joints, tool.gripper, tool.finger_tips, space), *own)
    if tool.kind is PartKind.END_EFFECTOR:
        return (EndEffector(tool.frame, (), tool.gripper, tool.finger_tips), *own)
    return own


def _seat(body: Articulation, carrier: RobotPart) -> Pose:
    """Return the pose of a base's mount in its root, its joints at home."""
    names = body.joint_names
    home = match_values(carrier.home, names, "joint", f"the home pose of '{carrier.name}'")
    frame = body.frame(carrier.mount)
    return link_poses(body, {names[index]: value for index, value in home.items()})[frame.link] @ frame.pose
