"""Capabilities of engines: their levels, and declared gaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


class Level(Enum):
    """Levels of support for a capability."""

    EXACT = "exact"
    """As the contract defines it, to the accuracy of the engine's arithmetic."""
    APPROXIMATE = "approximate"
    """Present, and different from the contract by what the reason says."""
    UNSUPPORTED = "unsupported"
    """Absent: a scene that needs it is refused."""


@dataclass(frozen=True)
class Support:
    """A level and, for anything but exact, the reason."""

    level: Level
    """Degree of support."""
    reason: str = ""
    """Difference or cause, for the report; empty for exact support."""

    def __post_init__(self) -> None:
        # Reports and refusals show the reason; without it a user could not choose another engine.
        if self.level is not Level.EXACT and not self.reason:
            raise ValueError(f"a capability declared {self.level.value} needs a reason")


EXACT = Support(Level.EXACT)


def approximate(reason: str) -> Support:
    """Return support that differs from the contract; ``reason`` says how."""
    return Support(Level.APPROXIMATE, reason)


def unsupported(reason: str) -> Support:
    """Return lack of support; ``reason`` says why."""
    return Support(Level.UNSUPPORTED, reason)


class Capability(Enum):
    """One thing that an engine may do. The value is the text that people read."""

    # The order is that of reports: joints, contact, measurements, randomisation, reproducibility, images, matter.
    ARTICULATIONS = "articulated robots and objects"
    FLOATING_BASE = "articulations with a free root"
    IMPLICIT_DRIVES = "native PD drives"
    EFFORT_LIMITS = "joint effort limits"
    VELOCITY_LIMITS = "joint velocity limits"
    JOINT_DAMPING = "joint damping"
    JOINT_SPRINGS = "joint springs"
    JOINT_FRICTION = "joint Coulomb friction"
    ARMATURE = "reflected motor inertia"
    MIMIC_JOINTS = "mimic joints"
    POLYNOMIAL_MIMICS = "mimic joints whose law is no straight line"
    LOOP_JOINTS = "joints that close kinematic loops"
    WELD_LOOPS = "welds that close kinematic loops"
    MASSLESS_LINKS = "links without mass between joints, as in compound joints"
    SELF_COLLISIONS = "self collisions"
    GRAVITY_COMPENSATION = "gravity compensation"
    FRICTION = "Coulomb friction, the larger coefficient of a pair"
    STATIC_FRICTION = "static friction above dynamic friction"
    TORSIONAL_FRICTION = "torsional friction"
    ROLLING_FRICTION = "rolling friction"
    RESTITUTION = "restitution"
    """Bounce by the coefficient of the pair."""
    COMPLIANT_CONTACT = "contact stiffness and damping"
    CONVEX_MESHES = "convex mesh collision"
    TRIANGLE_MESHES = "static triangle mesh collision"
    DYNAMIC_TRIANGLE_MESHES = "moving triangle mesh collision"
    SIGNED_DISTANCE_FIELDS = "mesh collision by signed distance fields"
    HEIGHT_FIELDS = "height field terrain"
    CONTACT_FORCES = "contact forces per link and pair"
    FRICTION_FORCES = "contact forces with those of friction"
    JOINT_WRENCHES = "joint reaction wrenches"
    LOOP_WRENCHES = "joint reaction wrenches in kinematic loops"
    EXTERNAL_WRENCHES = "external wrenches on links"
    RAY_CASTS = "ray casts"
    RANDOMIZE_MASS = "mass per environment"
    RANDOMIZE_CENTER_OF_MASS = "centre of mass per environment"
    RANDOMIZE_FRICTION = "friction per environment"
    RANDOMIZE_GAINS = "drive gains per environment"
    RANDOMIZE_JOINTS = "joint damping, friction, armature and springs per environment"
    RANDOMIZE_LIMITS = "joint limits per environment"
    RANDOMIZE_GRAVITY = "gravity per environment"
    SHAPES_PER_ENVIRONMENT = "different object shapes per environment"
    SNAPSHOTS = "snapshots whose continuation repeats"
    COPIED_STATES = "states copied into other environments, whose continuation repeats"
    DETERMINISTIC = "the same run twice, whatever the number of environments"
    RGB = "colour images"
    LIGHTING = "colour images lit by the scene's lights"
    SHADOWS = "shadows of the scene's lights"
    COLORS_PER_ENVIRONMENT = "colours of links per environment, in images"
    LIGHTS_PER_ENVIRONMENT = "lights per environment, in images"
    TEXTURES = "textures and highlights of surfaces, in images"
    DEPTH = "depth images"
    NORMALS = "surface normal images"
    ALBEDO = "albedo images"
    SEGMENTATION = "instance and semantic segmentation images"
    RAY_TRACED_RGB = "ray-traced colour images"
    GPU = "simulation on a GPU"
    CLOTH = "cloth"
    """Thin elastic sheets, :class:`orbit_core.scene.Cloth`."""
    ROPES = "ropes"
    """Thin elastic rods, :class:`orbit_core.scene.Rope`."""
    SOFT_BODIES = "soft bodies"
    FLUIDS = "fluids"
    """Liquids, :class:`orbit_core.scene.Fluid`."""

    @property
    def key(self) -> str:
        """The name in configuration and reports."""
        return self.name.lower()


IMAGES = (
    Capability.RGB, Capability.DEPTH, Capability.NORMALS, Capability.ALBEDO, Capability.SEGMENTATION,
    Capability.RAY_TRACED_RGB, Capability.LIGHTING, Capability.SHADOWS, Capability.COLORS_PER_ENVIRONMENT,
    Capability.LIGHTS_PER_ENVIRONMENT, Capability.TEXTURES,
)  # fmt: skip
"""Capabilities that a scene needs of its renderer; it needs all others of the engine."""

MATTER = (Capability.CLOTH, Capability.ROPES, Capability.SOFT_BODIES, Capability.FLUIDS)
"""Capabilities that a scene needs of its matter solver, or of the engine where none is chosen."""


class DriveIntegration(Enum):
    """State within a physics step at which an engine evaluates its native PD drives."""

    IMPLICIT = "implicit"
    """At the end of the step, or with as much damping added as keeps it stable: no gain makes it diverge."""
    EXPLICIT = "explicit"
    """At the beginning of the step, as the core's own actuators do: gains beyond a limit are refused."""


@dataclass(frozen=True)
class Capabilities:
    """Declared capabilities of a backend. Everything else is unsupported."""

    declared: Mapping[Capability, Support]
    """Support by capability; what is missing is unsupported."""

    def __getitem__(self, capability: Capability) -> Support:
        # Undeclared means unsupported, so that a new capability never becomes a false promise of an old plugin.
        return self.declared.get(capability, unsupported("not declared by the backend"))

    def has(self, capability: Capability) -> bool:
        """Return True if the engine supports it, exactly or approximately."""
        return self[capability].level is not Level.UNSUPPORTED


@dataclass(frozen=True)
class Gap:
    """A declared miss of one metric of one conformance scenario, or of one check of robots.

    The conformance suite fails when the miss grows beyond ``limit``, and also when it is gone: a declaration is held to
    be true both ways.
    """

    scenario: str
    """Name of the scenario, or of a check of robots."""
    metric: str
    """Name of the metric in it."""
    limit: float
    """The largest error that the backend admits to, in the metric's unit: what was measured, with a margin.

    ``math.inf`` where the engine diverges and raises :class:`SimulationError`, or refuses the scene at its time step by
    a :class:`ConfigurationError`.
    """
    reason: str
    """Why the engine cannot do better."""
    robots: tuple[str, ...] = ()
    """Names of the robots that miss it, where ``scenario`` is a check of robots."""
