"""Bullet's own settings. Most are described in the PyBullet guide under ``setPhysicsEngineParameter``."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.interfaces import ConfigurationError

MOST_PER_CLIENT = 15
"""Environments that the bits of a collision filter tell apart."""


@dataclass(frozen=True, kw_only=True)
class BulletConfig:
    """Settings of the solver, of the processes that run it, and of the renderer."""

    workers: int = 0
    """Processes that share the environments; 1 simulates in this process, 0 takes one per core where it pays."""
    envs_per_client: int = 1
    """Environments that stand apart in one Bullet world, which takes 29 MB. More of them save memory and no time, and
    what an environment does then depends, in the last digits, on how many there are. Scenes with deformables have a
    world each."""
    solver_iterations: int = 200
    """Iterations of the constraint solver per step. Fingers that hold a heavy thing need more than Bullet's 50."""
    contact_erp: float = 0.2
    """Share of the penetration that a step removes."""
    joint_erp: float = 0.8
    """Share of the opening of loops that a step removes, and in scenes with loops of the way beyond joint limits."""
    restitution_threshold: float = 0.05
    """m/s; slower impacts do not rebound."""
    renderer: str = "auto"
    """``tiny`` draws in software; ``egl`` draws with OpenGL, whose depth has 16 bits; ``auto`` takes OpenGL for large
    colour images where it loads."""
    simplify_meshes: bool = True
    """Draw dense visual meshes as fine as the cameras' height in pixels needs; False draws every triangle."""
    shadows: bool = True
    """Whether colour images have shadows."""

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise ConfigurationError(f"workers must be 0 (one per core) or more, not {self.workers}")
        if not 1 <= self.envs_per_client <= MOST_PER_CLIENT:
            raise ConfigurationError(f"envs_per_client must be from 1 to {MOST_PER_CLIENT}, not {self.envs_per_client}")
        for name in ("solver_iterations", "contact_erp", "joint_erp"):
            if getattr(self, name) <= 0:
                raise ConfigurationError(f"{name} must be positive, not {getattr(self, name)}")
        if self.restitution_threshold < 0:
            raise ConfigurationError(f"restitution_threshold must not be negative, but is {self.restitution_threshold}")
        if self.renderer not in ("auto", "tiny", "egl"):
            raise ConfigurationError(f"renderer '{self.renderer}' is not one of auto, tiny, egl")
