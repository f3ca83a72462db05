"""SAPIEN's own settings: PhysX's solver and contacts, and the renderer's quality."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.interfaces import ConfigurationError

TIERS = ("fast", "pbr", "rt")
DENOISERS = ("none", "oidn", "optix")


@dataclass(frozen=True, kw_only=True)
class RasterConfig:
    """Settings of the rasterisers, tiers ``fast`` and ``pbr``."""

    shadow_size: int = 1024
    """Width of the rasterisers' shadow map in pixels; 0 draws no shadows, 4096 suits videos."""

    def __post_init__(self) -> None:
        _at_least(self, 0, "shadow_size")


@dataclass(frozen=True, kw_only=True)
class PathConfig:
    """Settings of the path tracer, tier ``rt``."""

    samples_per_pixel: int = 8
    """Samples per pixel of tier ``rt``."""
    path_depth: int = 6
    """Greatest number of surfaces that a path of tier ``rt`` meets."""
    denoiser: str = "none"
    """Denoiser of tier ``rt``: ``oidn`` needs an NVIDIA GPU or the package pyoidn, ``optix`` an NVIDIA GPU."""

    def __post_init__(self) -> None:
        _one_of(self, "denoiser", DENOISERS)
        _at_least(self, 1, "samples_per_pixel", "path_depth")


@dataclass(frozen=True, kw_only=True)
class SapienConfig(RasterConfig, PathConfig):
    """Settings of PhysX and of the renderer."""

    workers: int = 1
    """Processes that share the environments; 1 simulates in this process, 0 takes one per core where it pays. Results
    do not depend on it."""
    envs_per_world: int = 8
    """Environments in a PhysX world; a process holds whole ones. With 1, what an environment does depends on no other
    and not on their number; with more it depends on those of its world, in the last bit, and a step is cheaper."""
    position_iterations: int = 24
    """Iterations of the solver per step and body."""
    velocity_iterations: int = 4
    """Iterations of the solver per step and body."""
    temporal_gauss_seidel: bool = True
    """PhysX's TGS solver, or else PGS: softer, but no environment then depends on how many there are."""
    bounce_threshold: float = 0.05
    """Speed of approach in m/s below which contacts do not rebound."""
    contact_offset: float = 0.001
    """Metres at which each of two shapes looks for contacts, ahead of touch. PhysX gives contacts that begin a step
    more than 4 mm apart no friction, and takes back what slid before they touched: with 10 mm, a box that lands at
    2 m/s slides on as over ice. What is faster than this distance in a step sinks in before it is met."""
    max_depenetration_velocity: float = 10.0
    """Speed in m/s with which overlapping bodies are pushed apart."""
    tendon_stiffness: float = 1e5
    """Stiffness of the constraint that makes a mimic joint follow, N m/rad or N/m."""
    env_spacing: float = 2.0
    """Metres between the environments' origins in a PhysX world, four times as many over a shared ground; poses are
    given without it."""
    shared_ground_above: int = 64
    """Number of environments in a PhysX world above which they share a level ground plane, which is faster."""
    tier: str = "fast"
    """Quality of images: ``fast`` and ``pbr`` rasterise, ``rt`` traces paths."""

    def __post_init__(self) -> None:
        RasterConfig.__post_init__(self)
        PathConfig.__post_init__(self)
        _one_of(self, "tier", TIERS)
        _at_least(self, 0, "workers", "velocity_iterations", "bounce_threshold", "shared_ground_above")
        _at_least(self, 1, "position_iterations", "envs_per_world")
        for name in ("contact_offset", "max_depenetration_velocity", "tendon_stiffness", "env_spacing"):
            if getattr(self, name) <= 0:
                raise ConfigurationError(f"{name} must be positive, not {getattr(self, name)}")


def _one_of(config: object, name: str, known: tuple[str, ...]) -> None:
    if getattr(config, name) not in known:
        raise ConfigurationError(f"{name} '{getattr(config, name)}' is not one of {', '.join(known)}")


def _at_least(config: object, least: int, *names: str) -> None:
    for name in names:
        if getattr(config, name) < least:
            raise ConfigurationError(f"{name} must be at least {least}, not {getattr(config, name)}")
