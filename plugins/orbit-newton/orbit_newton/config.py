"""Settings of Newton's solvers, a dataclass each. Those that Newton has too are described in its references."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.interfaces import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class NewtonConfig:
    """The settings that all of Newton's solvers share."""

    substeps: int = 1
    """Solver steps in each physics step; contacts are found once in a physics step."""
    contact_gap: float = 0.005
    """Metres around a shape within which contacts are found before it touches."""
    speculative_gap: float = 0.1
    """Most metres beyond that gap within which contacts are found of shapes that would meet before the next search."""
    contacts_per_env: int = 0
    """Size of the contact buffer per environment, on average over the environments; 0 lets Newton estimate it."""
    capture: bool = True
    """Whether the launches of a step are recorded once and replayed as a graph; without, each is issued by Python."""

    def __post_init__(self) -> None:
        self._positive("substeps")
        for name in ("contact_gap", "speculative_gap", "contacts_per_env"):
            if getattr(self, name) < 0:
                raise ConfigurationError(f"{name} must not be negative, as {getattr(self, name)} is")

    def _positive(self, *names: str) -> None:
        for name in names:
            if getattr(self, name) <= 0:
                raise ConfigurationError(f"{name} must be positive, not {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class FeatherstoneConfig(NewtonConfig):
    """Reduced coordinates, explicit contact forces.

    A contact is a spring and a damper whose size follows from the masses that meet and from the solver step h, so that
    the integrator always resolves them.
    """

    substeps: int = 20
    contact_stiffness: float = 0.03
    """``k h^2 / m`` of a contact: its stiffness against the most that the integrator could follow."""
    contact_damping: float = 1.3
    """Damping ratio of contacts that do not rebound."""
    friction_slope: float = 0.7
    """``c h / m`` of a contact: how steeply friction rises with the speed of slip until it reaches Coulomb's limit."""
    joint_friction_speed: float = 0.005
    """Speed (rad/s or m/s) at which the friction of a joint is fully developed."""
    limit_stiffness: float = 1e4
    """Stiffness of joint limits in N m/rad or N/m; integrated implicitly."""
    limit_damping: float = 1e2
    """Damping of joint limits in N m s/rad or N s/m."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._positive("contact_stiffness", "contact_damping", "friction_slope", "joint_friction_speed")
        self._positive("limit_stiffness", "limit_damping")


@dataclass(frozen=True, kw_only=True)
class XpbdConfig(NewtonConfig):
    """Positions corrected constraint by constraint."""

    substeps: int = 4
    iterations: int = 24
    """Sweeps over the constraints in a solver step."""
    joint_linear_relaxation: float = 0.7
    """Share of a joint's error in position that a sweep corrects."""
    joint_angular_relaxation: float = 0.4
    """Share of its error in rotation that a sweep corrects."""
    contact_relaxation: float = 0.8
    """Share of a contact's error that a sweep corrects."""
    contact_weighting: bool = True
    """Whether a body's corrections are divided by its number of contacts."""
    joint_friction_speed: float = 0.005
    """Speed (rad/s or m/s) at which the friction of a joint is fully developed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._positive("iterations", "joint_linear_relaxation", "joint_angular_relaxation", "contact_relaxation")
