"""Materials as sound depends on them: elasticity, density and inner damping."""

from __future__ import annotations

import math
from dataclasses import dataclass

from orbit_core.interfaces import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class SoundMaterial:
    """Elastic and damping constants of a material.

    Raises:
        ConfigurationError: a constant is out of its range.
    """

    name: str
    """Name for messages."""
    density: float
    """kg/m^3."""
    young: float
    """Modulus of elasticity, Pa."""
    poisson: float
    """Poisson's ratio, from 0 to 0.5."""
    mass_damping: float
    """Rayleigh damping in proportion to mass, 1/s."""
    stiffness_damping: float
    """Rayleigh damping in proportion to stiffness, s."""
    contact_time: float = 2e-4
    """Seconds that a hit lasts: modes faster than about 1.5 over it stay silent. Soft materials have longer ones."""
    scrape: float = 1e-3
    """Share of the power lost to sliding friction that becomes vibration."""

    def __post_init__(self) -> None:
        positive = (self.density, self.young, self.contact_time)
        others = (self.mass_damping, self.stiffness_damping, self.scrape)
        numbers = all(math.isfinite(value) for value in (*positive, *others, self.poisson))
        if not numbers or min(positive) <= 0.0 or min(others) < 0.0 or not 0.0 <= self.poisson < 0.5:
            raise ConfigurationError(
                f"sound material '{self.name}' needs density, Young's modulus and contact time above zero, dampings "
                f"and scrape of at least zero, and Poisson's ratio from 0 to below 0.5, not {self}"
            )

    def decay(self, angular_frequency: float) -> float:
        """Return the rate in 1/s at which a mode of that angular frequency (rad/s) decays."""
        return 0.5 * (self.mass_damping + self.stiffness_damping * angular_frequency**2)


# Zheng and James, Toward High-Quality Modal Contact Sound, ACM Transactions on Graphics 30(4), 2011, table 1: density,
# Young's modulus, Poisson's ratio and Rayleigh damping. Contact times are those of a hit by a hard ball of 1 cm.
_TABLE = (
    SoundMaterial(
        name="steel", density=7850.0, young=2.0e11, poisson=0.29, mass_damping=5.0, stiffness_damping=3e-8,
        contact_time=5e-5,
    ),
    SoundMaterial(
        name="aluminium", density=2700.0, young=6.9e10, poisson=0.33, mass_damping=5.0, stiffness_damping=5e-8,
        contact_time=6e-5,
    ),
    SoundMaterial(
        name="glass", density=2600.0, young=6.2e10, poisson=0.20, mass_damping=1.0, stiffness_damping=1e-7,
        contact_time=6e-5,
    ),
    SoundMaterial(
        name="ceramic", density=2700.0, young=7.2e10, poisson=0.19, mass_damping=6.0, stiffness_damping=1e-7,
        contact_time=6e-5,
    ),
    SoundMaterial(
        name="wood", density=750.0, young=1.1e10, poisson=0.25, mass_damping=60.0, stiffness_damping=2e-6,
        contact_time=3e-4,
    ),
    SoundMaterial(
        name="plastic", density=1070.0, young=1.4e9, poisson=0.35, mass_damping=30.0, stiffness_damping=1e-6,
        contact_time=4e-4,
    ),
)  # fmt: skip

MATERIALS = {material.name: material for material in _TABLE}
"""Common materials by name."""
