"""Lines of the build report about inertias that an engine takes only after they are raised."""

from __future__ import annotations

from collections.abc import Iterator

from orbit_core.interfaces.built import Approximation
from orbit_core.interfaces.layout import EntityLayout
from orbit_core.scene.inertias import FloatArray, lacking_moment, principal_axes, raised_moments

_ROUNDING = 1e-9
"""Share of the largest moment that the sum of the others may lack without a line in the build report."""


def inertia_approximations(entity: EntityLayout, engine: str) -> Iterator[Approximation]:
    """Yield a line for each link of which ``solid_moments`` raises the moments beyond rounding."""
    for link in entity.spec.articulation.links:
        if link.mass <= 0:
            continue
        moments, _ = principal_axes(link.inertia)
        if lacking_moment(moments) > _ROUNDING * moments[2]:
            asked = f"principal moments {_listed(moments)} kg m^2"
            why = f"no solid has them (two must add up to at least the third), and {engine} takes none such"
            got = _listed(raised_moments(moments))
            yield Approximation(f"link '{link.name}' of '{entity.name}'", asked, got, why)


def _listed(moments: FloatArray) -> str:
    return ", ".join(f"{moment:.4g}" for moment in moments)
