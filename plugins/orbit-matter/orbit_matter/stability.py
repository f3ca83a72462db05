"""What cannot be computed stably, found before anything runs.

A link feels matter one physics step late. In that time dt a pull sets as much of an elastic strip in motion as it
passes through, ``sqrt(E A rho) dt``, or all of it. Where a free link has a tenth of that mass it diverges, with a
quarter at times, and with a half not (measured with ropes of 0.1 to 20 kg/m, of 2 and 20 kN, and cloth of 0.5 kg/m^2).
"""

from __future__ import annotations

import math

import numpy as np

from orbit_core.interfaces import Approximation, ConfigurationError, SceneLayout
from orbit_core.scene import Attachment, Cloth, Entity, Rope
from orbit_matter.substeps import edge_length

LEAST_SHARE = 0.1
"""Of the mass that a free link feels in a physics step, that it must have itself."""
_SAFE_SHARE = 0.5
LEAST_MASS = 2e-10
"""Kilograms of a particle, below which contacts overflow single precision."""


def check(layout: SceneLayout) -> None:
    """Refuse particles that are too light to be computed, and free links that are too light for what is attached.

    Links of articulations are let pass: what their joints add to their inertia is not known here.

    Raises:
        ConfigurationError: names the deformable, what is too light, and the physics step or mass that would do.
    """
    for spec in layout.scene.deformables:
        if not isinstance(spec, Cloth | Rope):
            continue
        particle = spec.mass / len(spec.rest_positions)
        if particle < LEAST_MASS:
            raise ConfigurationError(
                f"the particles of '{spec.name}' weigh {particle:.2g} kg, and {LEAST_MASS:.2g} kg is the least that "
                "can be computed: give it more density or a coarser mesh"
            )
        for attachment in spec.attachments:
            if attachment.entity is not None:
                _check_link(layout, spec, attachment)


def sinking(layout: SceneLayout, contact_stiffness: float) -> tuple[Approximation, ...]:
    """What sinks deeper into what it lies on than it is thick, by its own weight on its particles' contacts."""
    gravity = float(np.linalg.norm(layout.scene.gravity))
    found: list[Approximation] = []
    for spec in layout.scene.deformables:
        if not isinstance(spec, Cloth | Rope):
            continue
        weight = gravity * spec.mass / len(spec.rest_positions)
        thick = 0.5 * spec.thickness if isinstance(spec, Cloth) else spec.radius
        if weight > thick * contact_stiffness:
            why = f"a contact_stiffness of {weight / thick:.2g} N/m would carry it, and {contact_stiffness:g} is used"
            found.append(Approximation(f"'{spec.name}'", "resting on things", "sinks into them or through", why))
    return tuple(found)


def _check_link(layout: SceneLayout, spec: Cloth | Rope, attachment: Attachment) -> None:
    entity = layout.entity(attachment.entity or "").spec
    if not entity.is_free_body:
        return
    mass, strip, step = _felt_mass(entity, spec, attachment), _impedance(spec, attachment), layout.scene.physics_dt
    if mass < LEAST_SHARE * min(strip * step, spec.mass):
        raise ConfigurationError(
            f"'{entity.name}', that resists '{spec.name}' with {mass:.3g} kg where this is attached, is too light for "
            f"it at a physics_dt of {step:g} s: use at most {mass / (_SAFE_SHARE * strip):.2g} s, a heavier link, or "
            "softer or lighter matter"
        )


def _felt_mass(entity: Entity, spec: Cloth | Rope, attachment: Attachment) -> float:
    """Kilograms with which a free link resists a pull across its arm: ``1 / (1 / m + r^2 / I)``."""
    points = spec.pose.transform(spec.rest_positions[list(attachment.particles)])
    found: list[float] = []
    for articulation in entity.alternatives:
        link = articulation.links[0]
        arm = points.mean(0) - entity.pose.transform(np.array([link.center_of_mass]))[0]
        inertia = float(np.linalg.eigvalsh(link.inertia).min())
        found.append(1.0 / (1.0 / link.mass + float(arm @ arm) / inertia))
    return min(found)


def _impedance(spec: Cloth | Rope, attachment: Attachment) -> float:
    """Newtons per m/s with which a pull enters: of cloth over as many edges as particles are held."""
    if isinstance(spec, Rope):
        return math.sqrt(spec.axial_stiffness * spec.linear_density)
    width = edge_length(spec) * len(attachment.particles)
    return width * math.sqrt(spec.membrane_stiffness * spec.area_density)
