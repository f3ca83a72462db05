"""Settings of MuJoCo-Warp. Each that MuJoCo has too is described in its XML reference under ``option`` and ``geom``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from orbit_core.interfaces import ConfigurationError
from orbit_mjmodel import ModelConfig


@dataclass(frozen=True, kw_only=True)
class WarpConfig(ModelConfig):
    """Settings of the solver, of its buffers, and of the renderer."""

    CHOICES: ClassVar = ModelConfig.CHOICES | {
        "integrator": ("implicitfast", "discrete", "euler", "rk4"),
        "algorithm": ("auto", "newton", "cg"),
        "overflow": ("error", "count"),
    }

    algorithm: str = "auto"
    """How constraints are solved: ``newton``; ``cg``, conjugate gradients, whose cost grows slower with the number of
    degrees of freedom; ``auto`` takes ``cg`` above 300 of them in an environment."""
    iterations: int = 30
    """Most iterations of the solver per step."""
    fused_solver: bool = True
    """Runs all of Newton's iterations as one launch on a GPU, in which each environment ends when it has converged;
    without, or above 32 degrees of freedom, launches over all environments are repeated until the last has."""
    nconmax: int = 0
    """Contacts per environment, on average over the environments; 0 chooses by the scene."""
    njmax: int = 0
    """Rows of the constraint solver in any one environment; 0 chooses by the scene."""
    overflow: str = "error"
    """What a full buffer does: ``error`` raises; ``count`` warns once and goes on, without the contacts lost."""
    deterministic: bool = False
    """Whether a GPU repeats itself bit for bit, at a cost; a CPU always does."""
    capture: bool = True
    """Whether the launches of a step are recorded once and replayed as a graph; without, each is issued by Python."""

    shadows: bool = True
    """Whether colour images have shadows, at the cost of a ray for each lit pixel."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("nconmax", "njmax"):
            if getattr(self, name) < 0:
                raise ConfigurationError(f"{name} must be 0 (chosen by the scene) or more, not {getattr(self, name)}")
