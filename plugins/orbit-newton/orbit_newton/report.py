"""The parts of a scene that a solver takes otherwise than described."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orbit_core.interfaces import Approximation, Capabilities, Capability, Level, SceneLayout
from orbit_core.scene import PhysicsMaterial, Shape


def approximations(layout: SceneLayout, capabilities: Capabilities) -> tuple[Approximation, ...]:
    """The build report."""
    return (*_of_joints(layout, capabilities), *_of_materials(layout, capabilities))


def _of_joints(layout: SceneLayout, capabilities: Capabilities) -> Iterator[Approximation]:
    parameters = layout.joint_parameters
    for entity in layout.entities:
        numbers = range(entity.joints.start, entity.joints.stop)
        fast = [layout.joints[number].name for number in numbers if np.isfinite(parameters.velocity_limit[number])]
        if fast:
            asked = f"velocity limits of joints {', '.join(fast)}"
            why = capabilities[Capability.VELOCITY_LIMITS].reason
            yield Approximation(f"'{entity.name}'", asked, "no limits", why)
        for number in numbers:
            joint = layout.joints[number]
            if joint.mimic and parameters.drive_stiffness[number] + parameters.drive_damping[number] > 0:
                why = "it mimics another joint, whose drive moves both"
                subject = f"joint '{joint.name}' of '{entity.name}'"
                yield Approximation(subject, "a drive of its own", "no drive", why)


def _of_materials(layout: SceneLayout, capabilities: Capabilities) -> Iterator[Approximation]:
    for subject, shape in _shapes(layout):
        for capability, asked in _wishes(shape.material).items():
            support = capabilities[capability]
            if support.level is Level.APPROXIMATE:
                yield Approximation(subject, asked, "nearly that", support.reason)


def _shapes(layout: SceneLayout) -> Iterator[tuple[str, Shape]]:
    for shape in layout.scene.terrain:
        yield f"terrain shape '{shape.name}'", shape
    for entity in layout.entities:
        for link in entity.spec.articulation.links:
            for shape in link.collisions:
                yield f"link '{link.name}' of '{entity.name}'", shape


def _wishes(material: PhysicsMaterial) -> dict[Capability, str]:
    wishes: dict[Capability, str] = {}
    if material.static_friction != material.dynamic_friction:
        asked = f"static friction {material.static_friction}, dynamic {material.dynamic_friction}"
        wishes[Capability.STATIC_FRICTION] = asked
    if material.restitution:
        wishes[Capability.RESTITUTION] = f"restitution {material.restitution}"
    if spring := material.compliance:
        wishes[Capability.COMPLIANT_CONTACT] = f"stiffness {spring.stiffness} N/m, damping {spring.damping} N s/m"
    return wishes
