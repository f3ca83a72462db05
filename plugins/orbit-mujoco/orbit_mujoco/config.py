"""MuJoCo's own settings. Each is described in MuJoCo's XML reference under ``option`` and ``geom``."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.interfaces import ConfigurationError

INTEGRATORS = ("implicitfast", "implicit", "euler", "rk4", "discrete")
SOLVERS = ("newton", "cg", "pgs")
CONES = ("elliptic", "pyramidal")


@dataclass(frozen=True, kw_only=True)
class MujocoConfig:
    """Settings of the solver and of contacts between shapes that ask for nothing special."""

    threads: int = 0
    """Threads that step environments; 0 takes every core."""
    integrator: str = "implicitfast"
    """``implicitfast`` and ``implicit`` integrate drive and joint damping implicitly; ``euler`` joint damping only."""
    solver: str = "newton"
    iterations: int = 100
    """At most, per step."""
    ls_iterations: int = 50
    """At most, per line search."""
    cone: str = "elliptic"
    """``pyramidal`` weakens friction by up to 30 % in directions between the axes of a contact."""
    impratio: float = 1.0
    """Stiffness of friction over that of the normal; larger values creep less under load."""
    contact_solref: tuple[float, float] = (0.02, 1.0)
    """Time constant (s) and damping ratio of contacts."""
    contact_solimp: tuple[float, float, float, float, float] = (0.9, 0.95, 0.001, 0.5, 2.0)
    """Impedance of contacts: least, greatest, width (m), midpoint, power."""
    shadow_size: int = 1024
    """Width of the renderer's shadow map in pixels; 0 draws no shadows, 4096 suits videos."""
    antialiasing: int = 0
    """Samples per pixel of colour images; 4 suits videos."""

    def __post_init__(self) -> None:
        for name, known in (("integrator", INTEGRATORS), ("solver", SOLVERS), ("cone", CONES)):
            if getattr(self, name) not in known:
                raise ConfigurationError(f"{name} '{getattr(self, name)}' is not one of {', '.join(known)}")
        if self.threads < 0:
            raise ConfigurationError(f"threads must be 0 (every core) or more, not {self.threads}")
        for name in ("iterations", "ls_iterations", "impratio"):
            if getattr(self, name) <= 0:
                raise ConfigurationError(f"{name} must be positive, not {getattr(self, name)}")
        for name, length in (("contact_solref", 2), ("contact_solimp", 5)):
            if len(getattr(self, name)) != length:
                raise ConfigurationError(f"{name} takes {length} numbers, not {len(getattr(self, name))}")
