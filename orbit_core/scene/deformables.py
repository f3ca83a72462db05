"""Bodies that bend. A backend that lacks one refuses the scene before it is built."""

from __future__ import annotations

from dataclasses import dataclass, field

from orbit_core.scene.materials import Color
from orbit_core.scene.pose import Pose
from orbit_core.scene.shapes import Mesh


@dataclass(frozen=True)
class Cloth:
    """A thin sheet of particles joined by springs; ``mesh`` is its rest shape, one particle a vertex."""

    name: str
    mesh: Mesh
    mass: float
    pose: Pose = field(default_factory=Pose)
    stretch_stiffness: float = 1000.0
    """N/m, along an edge."""
    bend_stiffness: float = 1e-4
    """N m/rad, across an edge."""
    thickness: float = 0.002
    friction: float = 0.5
    color: Color = (0.8, 0.3, 0.3, 1.0)
    semantic_label: str = "cloth"


@dataclass(frozen=True)
class SoftBody:
    """An elastic solid; ``mesh`` is its closed surface at rest."""

    name: str
    mesh: Mesh
    density: float
    """kg/m^3."""
    pose: Pose = field(default_factory=Pose)
    youngs_modulus: float = 1e5
    """Pa."""
    poissons_ratio: float = 0.4
    friction: float = 0.5
    color: Color = (0.3, 0.8, 0.4, 1.0)
    semantic_label: str = "soft"
