"""Bodies and joints as engines can take them: stand-ins for no mass, raised inertias, followers, springs, ropes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.layout import Approximation, EntityLayout, SceneLayout
from orbit_core.scene import Articulation, Joint, JointType, Link, Rope, Scene
from orbit_core.scene.articulation import FloatArray, lacking_moment, principal_axes, raised_moments

STAND_IN = 1e-9
"""Of the mass, and of the smallest moments of inertia, that a link without mass carries: an engine's stand-in for none,
below what single precision resolves of the sum. A joint's acceleration is off by up to some forty times as much."""
# Share of the largest moment that the sum of the others may lack without a line in the build report
_ROUNDING = 1e-9
# The most of ``h^2 k / m``, m being the least that the joint moves: joints of a chain together shake up to twice as
# fast as each does alone
_SOFT = 1.0
STANDARD_GRAVITY = 9.81
"""m/s^2."""


def is_massless(articulation: Articulation, link: Link) -> bool:
    """Return True if the link moves and has no mass. A root without mass is that of a fixed base."""
    return link.mass == 0 and link is not articulation.root


def carried(articulation: Articulation, link: Link) -> list[Link]:
    """Return the links with mass that hang on a link without, no other link with mass between."""
    by_name = {other.name: other for other in articulation.links}
    found: list[Link] = []
    pending = [link.name]
    while pending:
        parent = pending.pop()
        children = [by_name[joint.child] for joint in articulation.joints if joint.parent == parent]
        found += [child for child in children if child.mass > 0]
        pending += [child.name for child in children if child.mass == 0]
    return found


def with_stand_in(articulation: Articulation, link: Link) -> Link:
    """Return the link; if it has no mass, with :data:`STAND_IN` times the mass and inertia that it carries."""
    if not is_massless(articulation, link):
        return link
    held = carried(articulation, link)
    moment = sum(float(np.linalg.eigvalsh(each.inertia)[0]) for each in held)
    return replace(link, mass=STAND_IN * sum(each.mass for each in held), inertia=STAND_IN * moment * np.eye(3))


def stand_in_approximations(entity: EntityLayout, engine: str) -> Iterator[Approximation]:
    """Yield A line of the build report for each link of the entity that has a stand-in for no mass."""
    articulation = entity.spec.articulation
    for link in articulation.links:
        if is_massless(articulation, link):
            got = f"{STAND_IN:g} of the mass and of the smallest moment of inertia that it carries"
            why = f"{engine} moves nothing without mass"
            yield Approximation(f"link '{link.name}' of '{entity.name}'", "no mass", got, why)


def inertia_approximations(entity: EntityLayout, engine: str) -> Iterator[Approximation]:
    """Yield a line for each link of which ``solid_moments`` raises the moments beyond rounding."""
    for link in entity.spec.articulation.links:
        if link.mass <= 0:
            continue
        # Compared in principal axes, where the triangle inequality holds.
        moments, _ = principal_axes(link.inertia)
        if lacking_moment(moments) > _ROUNDING * moments[2]:
            asked = f"principal moments {_listed(moments)} kg m^2"
            why = f"no solid has them (two must add up to at least the third), and {engine} takes none such"
            got = _listed(raised_moments(moments))
            yield Approximation(f"link '{link.name}' of '{entity.name}'", asked, got, why)


def _listed(moments: FloatArray) -> str:
    return ", ".join(f"{moment:.4g}" for moment in moments)


def on_leaders(layout: SceneLayout, values: FloatArray) -> FloatArray:
    """Return inertias or dampings (J,) with those of followers added to the joints that they follow.

    A gear passes them on by its ratio squared: the kinetic energy, or the power lost, is the same.
    """
    borne = values.copy()
    for entity in layout.entities:
        joints, names = entity.spec.articulation.movable_joints, entity.spec.articulation.joint_names
        for index, joint in enumerate(joints, entity.joints.start):
            if joint.mimic is not None:
                leader = entity.joints.start + names.index(joint.mimic.joint)
                borne[leader] += joint.mimic.slope(0.0) ** 2 * values[index]
                borne[index] = 0.0
    return borne


def least_inertias(layout: SceneLayout) -> FloatArray:
    """Return the least inertia (J,) that each joint moves: its child link and the armature, kg or kg m^2."""
    values = [
        _least_inertia(entity.spec.articulation, joint)
        for entity in layout.entities
        for joint in entity.spec.articulation.movable_joints
    ]
    return np.array(values, dtype=np.float64) + layout.joint_parameters.armature


def softest(layout: SceneLayout, time_step: float) -> FloatArray:
    """Return the largest spring stiffness (J,) that may be taken at the beginning of steps of ``time_step`` seconds."""
    return _SOFT * least_inertias(layout) / time_step**2


def soft_springs(layout: SceneLayout, time_step: float) -> npt.NDArray[np.bool_]:
    """Return a mask (J,) of the springs that may be taken at the beginning of steps of ``time_step`` seconds."""
    return layout.joint_parameters.spring_stiffness <= softest(layout, time_step)


def _least_inertia(articulation: Articulation, joint: Joint) -> float:
    link = next(link for link in articulation.links if link.name == joint.child)
    sliding = joint.type is JointType.PRISMATIC
    if link.mass == 0:
        held = carried(articulation, link)
        return sum(each.mass if sliding else float(np.linalg.eigvalsh(each.inertia)[0]) for each in held)
    axis = joint.child_pose.rotation_matrix() @ np.asarray(joint.axis)
    return link.mass if sliding else float(axis @ np.asarray(link.inertia) @ axis)


def hanging_weight(rope: Rope, scene: Scene) -> float:
    """Return the weight on Earth, in newtons, of a rope with its free attached bodies; 0 without such bodies."""
    held = {attachment.entity for attachment in rope.attachments}
    loads = [
        sum(link.mass for link in entity.articulation.links)
        for entity in scene.entities
        if entity.name in held and not entity.fixed_base
    ]
    return STANDARD_GRAVITY * (sum(loads) + rope.mass) if loads else 0.0
