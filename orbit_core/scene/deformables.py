"""Matter that bends or flows. A world whose backend and matter solver lack a kind refuses the scene before it is built.

Stiffnesses are those of the material and not of a mesh's edges, so that a finer mesh is the same thing.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from orbit_core.scene.pose import Pose, Vector3
from orbit_core.scene.shapes import Color, Mesh


@dataclass(frozen=True)
class KeyPoint:
    """A named point of a deformable: the mean of some particles, weighted.

    Raises:
        ValueError: there are other numbers of weights than of particles, or none.
    """

    name: str
    """Unique among the deformable's key points."""
    particles: tuple[int, ...]
    """Indices of the particles."""
    weights: tuple[float, ...] = ()
    """Barycentric, whose sum is 1; equal ones if empty."""

    def __post_init__(self) -> None:
        # Empty weights mean the plain mean; a wrong number of them would otherwise fail far from here, in torch.
        if not self.particles or (self.weights and len(self.weights) != len(self.particles)):
            raise ValueError(
                f"key point '{self.name}' has {len(self.weights)} weights of {len(self.particles)} particles"
            )


@dataclass(frozen=True)
class Attachment:
    """Particles held where a reset puts them: to a link of a robot or an object, or to the world without one."""

    particles: tuple[int, ...]
    """Indices of the particles."""
    entity: str | None = None
    """Name of the robot or object; None for the world."""
    link: str | None = None
    """Link of that entity."""


@dataclass(frozen=True)
class Region:
    """A box, fixed to a frame of an entity or standing in the environment, in which matter is counted."""

    half_extents: Vector3
    """m, half of the box's edges."""
    pose: Pose = field(default_factory=Pose)
    """Of the box's middle, in the frame."""
    entity: str | None = None
    """Name of the robot or object that carries it; None for the environment."""
    frame: str | None = None
    """Link or frame of ``entity``."""


@dataclass(frozen=True)
class Cloth:
    """A thin elastic sheet of triangles; ``mesh`` is its flat shape at rest, one particle a vertex."""

    name: str
    """Unique in the scene."""
    mesh: Mesh
    # Densities are per area, per length and per volume, so that a finer mesh has the same mass.
    area_density: float
    """kg/m^2; cotton has 0.1 to 0.3."""
    pose: Pose = field(default_factory=Pose)
    """Pose of the mesh in the environment's frame at a reset."""
    membrane_stiffness: float = 2000.0
    """Young's modulus times thickness, N/m."""
    poissons_ratio: float = 0.3
    """Contraction across a pull, as a part of the stretch along it."""
    bending_stiffness: float = 2e-5
    """Moment per width and curvature, N m: Peirce's flexural rigidity. Cotton has 1e-6 to 1e-4."""
    damping: float = 0.2
    """Rate at which still air slows it, 1/s."""
    thickness: float = 0.004
    """Metres between surfaces that touch it from both sides."""
    friction: float = 0.5
    """Coefficient with everything; the larger one of a pair counts."""
    self_collisions: bool = True
    """True if it keeps itself apart."""
    color: Color = (0.8, 0.3, 0.3, 1.0)
    """RGBA in [0, 1]."""
    semantic_label: str = "cloth"
    """Kind of thing in segmentation images."""
    attachments: tuple[Attachment, ...] = ()
    """Particles that are held from the start."""
    # Tasks refer to particles by key point, because indices change with the resolution of the mesh.
    key_points: tuple[KeyPoint, ...] = ()
    """Points that tasks refer to by name."""

    @property
    def rest_positions(self) -> npt.NDArray[np.float64]:
        """Rest positions (P, 3) m, in the frame of ``pose``."""
        return np.asarray(self.mesh.vertices, dtype=np.float64)

    @property
    def mass(self) -> float:
        """Kilograms."""
        # Half the cross product of two edges is the area of a triangle.
        a, b, c = (self.rest_positions[np.asarray(self.mesh.faces)[:, k]] for k in range(3))
        return float(self.area_density * 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


@dataclass(frozen=True, eq=False)
class Rope:
    """A thin elastic rod, straight at rest, that does not resist twist; ``points`` (P, 3) are its particles."""

    name: str
    """Unique in the scene."""
    # An array, because ropes have hundreds of particles; equality by identity (eq=False) follows from it.
    points: npt.NDArray[np.floating]
    """In metres and the frame of ``pose``: where a reset puts it. Their distances are its lengths at rest."""
    linear_density: float
    """kg/m"""
    pose: Pose = field(default_factory=Pose)
    """Pose of the points in the environment's frame at a reset."""
    radius: float = 0.005
    """m."""
    axial_stiffness: float = 2000.0
    """Young's modulus times section, N."""
    bending_stiffness: float = 1e-4
    """Young's modulus times second moment of area, N m^2."""
    damping: float = 0.2
    """Rate at which still air slows it, 1/s."""
    friction: float = 0.5
    """Coefficient with everything; the larger one of a pair counts."""
    self_collisions: bool = True
    """True if it keeps itself apart."""
    color: Color = (0.85, 0.7, 0.35, 1.0)
    """RGBA in [0, 1]."""
    semantic_label: str = "rope"
    """Kind of thing in segmentation images."""
    attachments: tuple[Attachment, ...] = ()
    """Particles that are held from the start."""
    key_points: tuple[KeyPoint, ...] = ()
    """Points that tasks refer to by name."""

    @property
    def rest_positions(self) -> npt.NDArray[np.float64]:
        """Rest positions (P, 3) m, in the frame of ``pose``."""
        return np.asarray(self.points, dtype=np.float64)

    @property
    def mass(self) -> float:
        """Kilograms."""
        return float(self.linear_density * np.linalg.norm(np.diff(self.rest_positions, axis=0), axis=1).sum())


@dataclass(frozen=True)
class SoftBody:
    """An elastic solid; ``mesh`` is its closed surface at rest."""

    name: str
    """Unique in the scene."""
    mesh: Mesh
    density: float
    """kg/m^3."""
    pose: Pose = field(default_factory=Pose)
    """Pose of the mesh in the environment's frame at a reset."""
    youngs_modulus: float = 1e5
    """Pa."""
    poissons_ratio: float = 0.4
    """Contraction across a pull, as a part of the stretch along it; below 0.5, which keeps the volume."""
    damping: float = 0.002
    """Seconds by which its strain lags behind its stress: of a material that resists strain ``e`` and its rate with
    ``E (e + damping de/dt)``."""
    friction: float = 0.5
    """Coefficient with everything; the larger one of a pair counts."""
    resolution: float | None = None
    """Metres of the largest element that a solver may compute it with; None takes what the solver thinks fit."""
    color: Color = (0.3, 0.8, 0.4, 1.0)
    """RGBA in [0, 1]."""
    semantic_label: str = "soft"
    """Kind of thing in segmentation images."""
    attachments: tuple[Attachment, ...] = ()
    """Vertices that are held from the start."""
    key_points: tuple[KeyPoint, ...] = ()
    """Points that tasks refer to by name."""

    @property
    def rest_positions(self) -> npt.NDArray[np.float64]:
        """Rest positions (P, 3) m, in the frame of ``pose``."""
        return np.asarray(self.mesh.vertices, dtype=np.float64)

    @property
    def volume(self) -> float:
        """Cubic metres within the surface."""
        points = self.rest_positions - self.rest_positions.mean(axis=0)
        a, b, c = (points[np.asarray(self.mesh.faces)[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    @property
    def mass(self) -> float:
        """Kilograms."""
        return self.density * self.volume


@dataclass(frozen=True)
class Fluid:
    """A liquid that fills a box at rest, as particles on a grid."""

    name: str
    """Unique in the scene."""
    half_extents: Vector3
    """m, half of the box's edges."""
    density: float = 1000.0
    """kg/m^3"""
    pose: Pose = field(default_factory=Pose)
    """Pose of the box's middle in the environment's frame at a reset."""
    viscosity: float = 1e-3
    """Pa s"""
    spacing: float = 0.01
    """Metres between particles at rest."""
    color: Color = (0.3, 0.5, 0.9, 0.6)
    """RGBA in [0, 1]."""
    semantic_label: str = "fluid"
    """Kind of thing in segmentation images."""
    attachments: tuple[Attachment, ...] = ()
    """Empty: nothing holds a liquid but its vessel."""
    key_points: tuple[KeyPoint, ...] = ()
    """Points that tasks refer to by name: means of particles, which flow apart."""

    @property
    def rest_positions(self) -> npt.NDArray[np.float64]:
        """Rest positions (P, 3) m, in the frame of ``pose``: the middles of cubes of ``spacing`` that fill the box."""
        # At least one layer, so that a thin film is not lost; the grid is centred in the box.
        counts = [max(1, round(2.0 * half / self.spacing)) for half in self.half_extents]
        axes = [(np.arange(count) - 0.5 * (count - 1)) * self.spacing for count in counts]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        return np.asarray(grid.reshape(-1, 3), dtype=np.float64)


# A union and no base class: solvers match on the kind, and type checkers see a missing case.
DeformableSpec = Cloth | Rope | SoftBody | Fluid
