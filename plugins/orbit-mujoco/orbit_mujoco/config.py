"""MuJoCo's own settings. Each is described in MuJoCo's XML reference under ``option`` and ``geom``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from orbit_core.interfaces import ConfigurationError
from orbit_mjmodel import ModelConfig


@dataclass(frozen=True, kw_only=True)
class MujocoConfig(ModelConfig):
    """Settings of the solver and of the renderer."""

    CHOICES: ClassVar = ModelConfig.CHOICES | {
        "integrator": ("implicitfast", "implicit", "euler", "rk4", "discrete"),
        "solver": ("newton", "cg", "pgs"),
    }

    threads: int = 0
    """Threads that step environments; 0 takes every core."""
    solver: str = "newton"
    """How constraints are solved."""
    shadow_size: int | None = None
    """Width of the renderer's shadow map in pixels; 0 draws no shadows. None takes 1024, or 2048 for pictures higher
    than 400 pixels."""
    antialiasing: int = 0
    """Samples per pixel of colour images; 4 suits videos."""
    simplify_meshes: bool = True
    """Draw dense visual meshes as fine as the cameras' height in pixels needs: software draws pictures of 84 pixels
    several times as fast. False draws every triangle."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.threads < 0:
            raise ConfigurationError(f"threads must be 0 (every core) or more, not {self.threads}")
