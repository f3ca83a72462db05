"""The solver's own settings."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.interfaces.errors import ConfigurationError

SHORTEST_SUBSTEP = 1e-6
"""Seconds, below which single precision no longer tells velocities."""


@dataclass(frozen=True)
class MatterConfig:
    """Settings of the matter solver.

    Raises:
        ConfigurationError: a number is not positive, or a substep so short that a step would never end.
    """

    substep: float | None = None
    """Longest substep in seconds; a physics step is divided into as many equal ones as it takes. None takes what the
    finest mesh of the scene needs to hang within 1 % of its length and to bend as its stiffness says, between 0.25 and
    1.25 ms, or 0.84 ms where there is cloth to be grasped."""
    contact_stiffness: float = 1000.0
    """N/m with which one particle resists being pressed into a surface."""
    solid_iterations: int = 6
    """Iterations of conjugate gradients in a step of solids; take more where some environments have much stiffer
    solids."""
    threads: int = 0
    """CPU threads, each with some of the environments; 0 takes every core."""
    capture: bool = True
    """True to record launches once and replay them as a graph."""

    def __post_init__(self) -> None:
        for name in ("substep", "contact_stiffness"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise ConfigurationError(f"setting '{name}' of orbit-matter is {value}: give more than 0")
        if self.substep is not None and self.substep < SHORTEST_SUBSTEP:
            raise ConfigurationError(
                f"setting 'substep' of orbit-matter is {self.substep:g} s: give {SHORTEST_SUBSTEP:g} s or more"
            )
        if self.solid_iterations < 1:
            raise ConfigurationError(
                f"setting 'solid_iterations' of orbit-matter is {self.solid_iterations}: give 1 or more"
            )
        if self.threads < 0:
            raise ConfigurationError(
                f"setting 'threads' of orbit-matter is {self.threads}: give 0 (every core) or more"
            )
