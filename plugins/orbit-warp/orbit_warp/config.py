"""Settings of MuJoCo-Warp. Each that MuJoCo has too is described in its XML reference under ``option`` and ``geom``."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.interfaces import ConfigurationError

INTEGRATORS = ("implicitfast", "euler", "rk4")
ALGORITHMS = ("newton", "cg")
CONES = ("elliptic", "pyramidal")
OVERFLOWS = ("error", "count")


@dataclass(frozen=True, kw_only=True)
class WarpConfig:
    """Settings of the solver, of its buffers, and of contacts between shapes that ask for nothing special."""

    integrator: str = "implicitfast"
    """``implicitfast`` integrates drive and joint damping implicitly; ``euler`` joint damping only."""
    algorithm: str = "newton"
    """How constraints are solved."""
    iterations: int = 30
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

    def __post_init__(self) -> None:
        choices = (
            ("integrator", INTEGRATORS),
            ("algorithm", ALGORITHMS),
            ("cone", CONES),
            ("overflow", OVERFLOWS),
        )
        for name, known in choices:
            if getattr(self, name) not in known:
                raise ConfigurationError(f"{name} '{getattr(self, name)}' is not one of {', '.join(known)}")
        for name in ("iterations", "ls_iterations", "impratio"):
            if getattr(self, name) <= 0:
                raise ConfigurationError(f"{name} must be positive, not {getattr(self, name)}")
        for name in ("nconmax", "njmax"):
            if getattr(self, name) < 0:
                raise ConfigurationError(f"{name} must be 0 (chosen by the scene) or more, not {getattr(self, name)}")
        for name, length in (("contact_solref", 2), ("contact_solimp", 5)):
            if len(getattr(self, name)) != length:
                raise ConfigurationError(f"{name} takes {length} numbers, not {len(getattr(self, name))}")
