"""What USD bodies weigh: as they say themselves, and as their colliders' sizes and densities say for the rest."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from orbit_assets.mass_properties import mass_properties
from orbit_assets.usd.geometry import Placement, Placements
from orbit_assets.usd.stage import Units, applies, array, authored, number, numbers, rotation
from orbit_core.preparation.merge import MassProperties, combine
from orbit_core.scene import Shape
from orbit_core.scene.pose import FloatArray

_DENSITY = 1000.0
"""kg/m^3, where the stage gives none: UsdPhysics says so."""
NOTHING = MassProperties(0.0, (0.0, 0.0, 0.0), np.zeros((3, 3)))
"""Mass properties of a link without mass."""


def is_given(body: Any) -> bool:
    """Whether a body gives its mass and inertia, so that its colliders' need not be worked out."""
    inertia = len(array(body, "newton:inertia", 1, float)) or any(numbers(body, "physics:diagonalInertia", _ZERO))
    return number(body, "physics:mass") > 0 and bool(inertia)


def solid(prim: Any, body: Any, material: Any, shape: Shape, units: Units) -> MassProperties:
    """What a collider weighs: by its own mass, or the density of itself, its body, or its material.

    UsdPhysics takes a mass of zero for one that is not given; MuJoCo, for a collider without mass.
    """
    if (mass := number(prim, "physics:mass")) > 0:
        return mass_properties(shape.geometry, mass=mass * units.mass).placed(shape.pose)
    if authored(prim, "physics:mass") == 0 and applies(prim, "MjcCollisionAPI"):
        return NOTHING
    sources = (prim, body, *([material] if material else []))
    densities = [number(source, "physics:density") for source in sources]
    given = next((value for value in densities if value > 0), None)
    density = _DENSITY if given is None else given * units.mass / units.length**3
    return mass_properties(shape.geometry, density=density).placed(shape.pose)


def body_mass(body: Any, solids: list[MassProperties], placements: Placements, units: Units) -> MassProperties:
    """A body's own mass, centre and inertia as far as it gives them, and those of its colliders for the rest."""
    of_shapes = combine(solids) if any(each.mass > 0 for each in solids) else NOTHING
    placement = placements.of(body, body)
    mass = number(body, "physics:mass") * units.mass or of_shapes.mass
    center = numbers(body, "physics:centerOfMass", (-math.inf,) * 3)
    x, y, z = placement.point(center) if math.isfinite(center[0]) else of_shapes.center_of_mass
    inertia = _inertia(body, placement, units)
    if inertia is None:
        inertia = of_shapes.inertia * (mass / of_shapes.mass if of_shapes.mass else 1.0)
    return MassProperties(mass, (float(x), float(y), float(z)), inertia)


def _inertia(body: Any, placement: Placement, units: Units) -> FloatArray | None:
    full = array(body, "newton:inertia", 1, float)
    if len(full) == 6:
        xx, yy, zz, xy, xz, yz = full
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        axes = placement.pose.rotation_matrix()
    else:
        diagonal = numbers(body, "physics:diagonalInertia", _ZERO)
        if not any(diagonal):
            return None
        tensor = np.diag(np.asarray(diagonal))
        axes = placement.frame((0.0, 0.0, 0.0), rotation(body, "physics:principalAxes")).rotation_matrix()
    return units.inertia(angular=True) * axes @ tensor @ axes.T


_ZERO = (0.0, 0.0, 0.0)
