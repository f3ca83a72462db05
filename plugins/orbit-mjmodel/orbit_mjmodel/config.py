"""Settings of a model. Each is described in MuJoCo's XML reference under ``option`` and ``geom``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from orbit_core.interfaces import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class ModelConfig:
    """Settings of the integrator, of the constraints, and of contacts between shapes that ask for nothing special."""

    CHOICES: ClassVar[dict[str, tuple[str, ...]]] = {"cone": ("elliptic", "pyramidal")}
    """What settings given by a word may be; a backend adds its own."""

    integrator: str = "implicitfast"
    """``implicitfast`` and ``implicit`` integrate drive and joint damping implicitly, ``euler`` joint damping only.
    ``discrete`` solves the constraints with the drives as well: mimic joints, loops and contacts hold under stiff ones.
    It is taken in any case with cloth and rope, and with strong velocity drives of wheels without an effort limit."""
    iterations: int = 100
    """Most iterations of the solver per step."""
    ls_iterations: int = 50
    """Most iterations per line search."""
    cone: str = "elliptic"
    """``pyramidal`` weakens friction by up to 30 % in directions between the axes of a contact."""
    impratio: float | None = None
    """Stiffness of friction over that of the normal; larger values creep less under load. None: 1, or 10 where the
    scene asks for firm friction."""
    contact_solref: tuple[float, float] = (0.02, 1.0)
    """Time constant (s) and damping ratio of contacts. MuJoCo takes at least two steps for the time constant."""
    limit_solref: tuple[float, float] = (0.02, 1.0)
    """Time constant (s) and damping ratio of joint limits, as of contacts. A joint that runs into its limit passes it
    by its speed times the time constant over e; (0.01, 2.0) in steps of 5 ms stops it within one step's way."""
    contact_solimp: tuple[float, float, float, float, float] = (0.9, 0.99, 0.001, 0.5, 2.0)
    """Impedance of contacts: least, greatest, width (m), midpoint, power."""

    def __post_init__(self) -> None:
        for name, known in self.CHOICES.items():
            if getattr(self, name) not in known:
                raise ConfigurationError(f"{name} '{getattr(self, name)}' is not one of {', '.join(known)}")
        for name in ("iterations", "ls_iterations", "impratio"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise ConfigurationError(f"{name} must be positive, not {value}")
        for name, length in (("contact_solref", 2), ("limit_solref", 2), ("contact_solimp", 5)):
            if len(getattr(self, name)) != length:
                raise ConfigurationError(f"{name} takes {length} numbers, not {len(getattr(self, name))}")
