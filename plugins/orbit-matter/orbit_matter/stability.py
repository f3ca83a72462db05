"""Limits of the solver, found before anything runs.

Free bodies that swing on cloth or rope are solved together with it and may weigh anything. A link of an articulation,
and a free body that the engine holds, between fingers or on a floor, feels matter one physics step late. In that time
dt a pull sets as much of an elastic strip in motion as it passes through, ``sqrt(E A rho) dt``, or all of it. A link
with a tenth of that mass diverges, with a quarter at times, and with a half not (measured with ropes of 0.1 to 20 kg/m,
of 2 and 20 kN, and cloth of 0.5 kg/m^2); a free body does not diverge, but hops.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation, ConfigurationError, SceneLayout
from orbit_core.plugin_kit.bodies import STANDARD_GRAVITY, hanging_weight
from orbit_core.scene import (
    Attachment,
    Cloth,
    Entity,
    Fluid,
    HeightField,
    Rope,
)
from orbit_matter.fields import bounds_of, has_hollows
from orbit_matter.fluid.extent import is_mappable, widest_of
from orbit_matter.substeps import edge_length

FloatArray = npt.NDArray[np.floating]

_SAFE_SHARE = 0.5
"""Part of the mass that a link feels in a physics step that it should have itself."""
_LOST, _MOST_LOST, _NOTED = 1.2, 0.6, 0.02
"""Part of its energy that a rope loses in sharp folds in 3 s, per part that it weighs of its load; the most that was
measured, with a margin; and the least that is reported. Bobs of 5, 50 and 500 g on 25 g of rope lost 14 to 56, 9 to 28
and 3 to 5 % after they were let go at 90 degrees, one of 2 kg 0.8 %."""
_FLOATS = 10
"""Particles of a liquid that a free body weighs at least: of 14 it swings by 5 mm on 1 cm ones, of 5 by 9 mm, and of 4
it jumps out."""
_ROUNDED = 0.02
"""Part of its mass by which a liquid may differ from its box's before it is reported."""
LEAST_MASS = 2e-10
"""Kilograms of a particle, below which contacts overflow single precision."""


def check(layout: SceneLayout) -> None:
    """Refuse particles that are too light to be computed.

    Raises:
        ConfigurationError: names the deformable and what would do.
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


def late_links(layout: SceneLayout) -> tuple[Approximation, ...]:
    """Report links that are so light that what is attached to them may shake them where the engine holds them."""
    return tuple(
        found
        for spec in layout.scene.deformables
        if isinstance(spec, Cloth | Rope)
        for attachment in spec.attachments
        if attachment.entity is not None
        for found in _late_link(layout, spec, attachment)
    )


def folding(layout: SceneLayout) -> tuple[Approximation, ...]:
    """Report ropes that swing with free bodies and lose a part of their energy when they go slack and fold."""
    found: list[Approximation] = []
    for spec in layout.scene.deformables:
        if not isinstance(spec, Rope) or not (weight := hanging_weight(spec, layout.scene)):
            continue
        load = weight / STANDARD_GRAVITY - spec.mass
        lost = min(_MOST_LOST, _LOST * spec.mass / load)
        if lost > _NOTED:
            why = f"folds finer than its edges are lost: a load of {_LOST / _NOTED * spec.mass:.2g} kg keeps 98 %"
            got = f"loses up to {100 * lost:.0f} % in 3 s"
            found.append(Approximation(f"'{spec.name}'", "its energy, should it go slack and fold", got, why))
    return tuple(found)


def sinking(layout: SceneLayout, contact_stiffness: float) -> tuple[Approximation, ...]:
    """Report cloths and ropes whose own weight presses them deeper into a support than they are thick."""
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


def tossed(layout: SceneLayout) -> tuple[Approximation, ...]:
    """Report free bodies that are so light that single particles of a liquid toss them."""
    found: list[Approximation] = []
    bodies = [entity.spec for entity in layout.entities if entity.spec.is_free_body]
    for spec in layout.scene.deformables:
        if not isinstance(spec, Fluid):
            continue
        particle = spec.density * spec.spacing**3
        for body in bodies:
            mass = min(articulation.links[0].mass for articulation in body.alternatives)
            if mass < _FLOATS * particle:
                fine = (mass / (_FLOATS * spec.density)) ** (1.0 / 3.0)
                why = f"it weighs {mass / particle:.2g} particles of '{spec.name}': a spacing of {fine:.2g} m would do"
                found.append(Approximation(f"'{body.name}'", f"floating on '{spec.name}'", "is tossed about", why))
    return tuple(found)


def passing(layout: SceneLayout) -> tuple[Approximation, ...]:
    """Report cloth, ropes and soft bodies in scenes of liquids, which neither meets."""
    liquids = [spec.name for spec in layout.scene.deformables if isinstance(spec, Fluid)]
    others = [spec.name for spec in layout.scene.deformables if not isinstance(spec, Fluid)]
    why = "liquids meet links and terrain only"
    return tuple(
        Approximation(f"'{liquid}'", f"contact with '{other}'", "passes through it", why)
        for liquid in liquids
        for other in others
    )


def hollow(layout: SceneLayout, surfaces: Iterable[tuple[str, FloatArray]]) -> tuple[Approximation, ...]:
    """Report what may hold a liquid and has no map of what its walls give, so that only the nearest of them acts.

    Args:
        layout: of the scene.
        surfaces: corners (n, 3) of a box around each surface that liquids meet as it is, and not as a hull, in metres,
            with the name of what it is of.
    """
    spacings = [spec.spacing for spec in layout.scene.deformables if isinstance(spec, Fluid)]
    if not spacings:
        return ()
    fields = [shape.geometry for shape in layout.scene.terrain if isinstance(shape.geometry, HeightField)]
    hollows = [bounds_of(field) for field in fields if has_hollows(field, spacings[0])]
    named = [*surfaces, *(("the terrain's height field", corners) for corners in hollows)]
    found: list[Approximation] = []
    asked, got = "a liquid's volume in its hollows", "up to 32 % too small"
    for name, corners in named:
        if not is_mappable(corners, spacings[0]):
            size = np.ptp(corners, axis=0)
            extent = " x ".join(f"{length:.2g}" for length in size)
            why = f"only its nearest wall acts: {extent} m is too large for a map at a spacing of {spacings[0]:g} m"
            if (side := widest_of(float(size[2]), spacings[0])) > 0.0:
                why += f", {side:.2g} x {side:.2g} m at this height would do"
            found.append(Approximation(name, asked, got, why))
    return tuple(dict.fromkeys(found))


def rounded(layout: SceneLayout) -> tuple[Approximation, ...]:
    """Report liquids whose whole layers of particles hold more or less than their boxes."""
    found: list[Approximation] = []
    for spec in layout.scene.deformables:
        if isinstance(spec, Fluid):
            asked = 8.0 * math.prod(spec.half_extents)
            got = len(spec.rest_positions) * spec.spacing**3
            if abs(got - asked) > _ROUNDED * asked:
                why = (
                    f"particles of {spec.spacing:g} m fill whole layers: let the box be a multiple of it, or refine it"
                )
                box, particles = (f"{spec.density * volume:.3g} kg" for volume in (asked, got))
                found.append(Approximation(f"'{spec.name}'", box, particles, why))
    return tuple(found)


def _late_link(layout: SceneLayout, spec: Cloth | Rope, attachment: Attachment) -> list[Approximation]:
    entity = layout.entity(attachment.entity or "").spec
    articulation = entity.articulation
    # A fixed base does not move, so that nothing is late.
    if entity.fixed_base and attachment.link == articulation.root.name:
        return []
    link = next(link for link in articulation.links if link.name == attachment.link)
    mass = _felt_mass(entity, spec, attachment) if entity.is_free_body else link.mass
    strip, step = _impedance(spec, attachment), layout.scene.physics_dt
    # A short strip is set in motion whole within the step: its own mass bounds what the link feels.
    if mass >= _SAFE_SHARE * min(strip * step, spec.mass):
        return []
    held = "while the engine holds it, between fingers or on a floor" if entity.is_free_body else "in motion"
    why = (
        f"it resists '{spec.name}' with {mass:.3g} kg there, and feels it one physics step late: a physics_dt of "
        f"{mass / (_SAFE_SHARE * strip):.2g} s would do, or a heavier link, or softer or lighter matter"
    )
    return [Approximation(f"link '{link.name}' of '{entity.name}'", held, "may shake or hop", why)]


def _felt_mass(entity: Entity, spec: Cloth | Rope, attachment: Attachment) -> float:
    """Kilograms with which a free link resists a pull across its arm: ``1 / (1 / m + r^2 / I)``."""
    points = spec.pose.transform(spec.rest_positions[list(attachment.particles)])
    found: list[float] = []
    for articulation in entity.alternatives:
        link = articulation.links[0]
        arm = points.mean(0) - entity.pose.transform(np.array([link.center_of_mass]))[0]
        inertia = float(np.linalg.eigvalsh(link.inertia).min())
        found.append(1.0 / (1.0 / link.mass + float(arm @ arm) / inertia))
    # The variant that resists least decides, as one description serves all environments.
    return min(found)


def _impedance(spec: Cloth | Rope, attachment: Attachment) -> float:
    """Newtons per m/s with which a pull enters: of cloth over as many edges as particles are held."""
    if isinstance(spec, Rope):
        return math.sqrt(spec.axial_stiffness * spec.linear_density)
    width = edge_length(spec) * len(attachment.particles)
    return width * math.sqrt(spec.membrane_stiffness * spec.area_density)
