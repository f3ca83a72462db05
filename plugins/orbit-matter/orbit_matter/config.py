"""The solver's own settings."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.interfaces.errors import ConfigurationError


@dataclass(frozen=True)
class MatterConfig:
    """How finely matter is computed.

    Raises:
        ConfigurationError: a number is not positive.
    """

    substep: float = 0.00125
    """Longest substep in seconds; a physics step is divided into as many equal ones as it takes."""
    contact_stiffness: float = 2000.0
    """N/m with which one particle resists being pressed into a surface."""
    warm_start: float = 1.0
    """Share of the constraint forces of the last substep that the next one starts from."""
    capture: bool = True
    """Whether launches are recorded once and replayed as a graph."""

    def __post_init__(self) -> None:
        for name in ("substep", "contact_stiffness"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(f"setting '{name}' of orbit-matter is {getattr(self, name)}: give more than 0")
        if not 0.0 <= self.warm_start <= 1.0:
            raise ConfigurationError(f"setting 'warm_start' of orbit-matter is {self.warm_start}: give 0 to 1")
