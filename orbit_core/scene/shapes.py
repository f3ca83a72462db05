"""Geometry of collision and visual shapes, with their surfaces: contact, colour, finish and texture.

Sizes are half sizes; round shapes have their axis along z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import numpy.typing as npt

from orbit_core.scene.pose import Pose, Vector3

Color = tuple[float, float, float, float]
"""Red, green, blue and opacity, each in [0, 1]."""


@dataclass(frozen=True)
class Compliance:
    """A contact that gives way: a spring (N/m) and damper (N s/m) along the contact normal."""

    stiffness: float
    """N/m."""
    damping: float
    """N s/m."""


@dataclass(frozen=True)
class PhysicsMaterial:
    """Contact properties of a shape.

    Where two shapes meet, the pair takes the larger of the two values of each coefficient (the contract's one combine
    rule). Torsional and rolling friction are lengths in metres; the other coefficients have no unit. Where an engine
    lacks them, a scene that asks for more than these defaults is refused; the defaults are left out there.
    """

    static_friction: float = 1.0
    """Tangential force by normal force up to which surfaces stick."""
    dynamic_friction: float = 1.0
    """Tangential force by normal force while they slide."""
    torsional_friction: float = 0.005
    """Torque about the normal by normal force, m."""
    rolling_friction: float = 0.0001
    """Torque against rolling by normal force, m."""
    restitution: float = 0.0
    """Speed after an impact by speed before it, 0 to 1."""
    # None is as stiff as the engine allows, which differs between engines.
    compliance: Compliance | None = None
    """Spring and damper along the normal; None is as stiff as the engine allows."""


@dataclass(frozen=True)
class Box:
    """A box, centred."""

    half_extents: Vector3
    """m, half of the edges."""


@dataclass(frozen=True)
class Sphere:
    """A ball, centred."""

    radius: float
    """m."""


@dataclass(frozen=True)
class Capsule:
    """A capsule along z, centred; ``half_length`` leaves out the round caps."""

    radius: float
    """m."""
    half_length: float


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z, centred."""

    radius: float
    """m."""
    half_length: float
    """m."""


@dataclass(frozen=True)
class Plane:
    """The half space z <= 0 of the shape's frame. Only static."""


class MeshCollision(Enum):
    """Collision geometry that is made of a mesh; a visual mesh ignores it."""

    CONVEX_HULL = "convex_hull"
    """The smallest convex solid around the mesh; fast on every engine."""
    CONVEX_DECOMPOSITION = "convex_decomposition"
    """Several convex pieces, into which the world splits it before an engine sees it."""
    SIGNED_DISTANCE = "signed_distance"
    """The surface itself, closed, by a field of signed distances to it; it may move and be hollow."""
    TRIANGLES = "triangles"
    """The surface itself, as it is. Most engines take this for static shapes only."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh: vertices (V, 3) in metres, faces (F, 3) of indices, counter-clockwise seen from outside."""

    vertices: npt.NDArray[np.floating]
    """(V, 3) m."""
    faces: npt.NDArray[np.integer]
    """(F, 3) indices of vertices."""
    collision: MeshCollision = MeshCollision.CONVEX_HULL
    """Geometry for contacts; visual meshes ignore it."""
    coordinates: npt.NDArray[np.floating] | None = None
    """(V, 2) texture coordinates, in pictures of width and height 1 from the lower left corner; for looks only."""

    def __eq__(self, other: object) -> bool:
        return (
            # Comparing arrays with == gives an array, which a generated __eq__ cannot use.
            isinstance(other, Mesh)
            and self.collision == other.collision
            and np.array_equal(self.vertices, other.vertices)
            and np.array_equal(self.faces, other.faces)
            and np.array_equal(_or_none(self.coordinates), _or_none(other.coordinates))
        )

    def __hash__(self) -> int:
        # Hashing all vertices would be slow; equal meshes have equal shapes, which is all that a hash needs.
        return hash((self.vertices.shape, self.faces.shape, self.collision))


def _or_none(array: npt.NDArray[np.floating] | None) -> npt.NDArray[np.floating]:
    """Return the array, or an empty one, so that two optional arrays compare."""
    return np.empty(0) if array is None else array


@dataclass(frozen=True, eq=False)
class HeightField:
    """Terrain heights (rows, columns) in metres over a centred rectangle; rows run along y, columns along x.

    ``size`` is the full extent (x, y) in metres. Only static.
    """

    heights: npt.NDArray[np.floating]
    """(rows, columns) m."""
    size: tuple[float, float]


# A closed union: engines match on it, and a type checker finds a geometry that one of them forgets.
Geometry = Box | Sphere | Capsule | Cylinder | Plane | Mesh | HeightField


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture that is repeated over the surfaces of a link, in the link's frame, as if each side were a wall.

    A point takes the colour that the picture has there when it is laid on the two axes of the frame that the surface
    faces least, its middle at the origin; on upright sides its rows run downwards. Colours multiply the surface's own:
    what is white shows the picture as it is.
    """

    pixels: npt.NDArray[np.uint8]
    """(H, W, 3) red, green and blue, the uppermost row first."""
    width: float = 0.2
    """Metres that its width spans; its height follows from the shape of ``pixels``."""

    def __post_init__(self) -> None:
        """Look at the numbers.

        Raises:
            ValueError: pixels of another shape or type, or none; a width that is not above zero.
        """
        # Renderers take the bytes as they are: other types would be read as noise.
        pixels = self.pixels
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8 or pixels.size == 0:
            raise ValueError(f"a texture's pixels are (H, W, 3) of uint8, not {pixels.shape} of {pixels.dtype}")
        if not 0.0 < self.width < np.inf:
            raise ValueError(f"a texture's width must be above zero metres, not {self.width:g}")

    def __eq__(self, other: object) -> bool:
        # As of meshes: comparing arrays with == gives an array.
        return isinstance(other, Texture) and self.width == other.width and np.array_equal(self.pixels, other.pixels)

    def __hash__(self) -> int:
        return hash((self.pixels.shape, self.width))

    @property
    def height(self) -> float:
        """Metres that its height spans."""
        return self.width * self.pixels.shape[0] / self.pixels.shape[1]


@dataclass(frozen=True)
class Finish:
    """Look of a surface besides its colour, in colour images; a renderer shows as much of it as it declares."""

    roughness: float = 1.0
    """From 0, which reflects lights as sharp spots, to 1, which has no highlight and is as the lighting law says."""
    metallic: float = 0.0
    """Share of a highlight that takes the surface's own colour, as on bare metal."""
    texture: Texture | None = None
    """Multiplies the colour. Its axes are the shape's own; a mesh with texture coordinates takes it by those, once
    across the picture."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ValueError: roughness or metallic is not within 0 and 1.
        """
        for name in ("roughness", "metallic"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} of a finish must be from 0 to 1, not {getattr(self, name)}")


DULL = Finish()
"""Finish of a surface without texture and highlight."""


@dataclass(frozen=True)
class Shape:
    """A geometry placed in its link's frame.

    ``material`` matters where it collides, ``color`` and ``finish`` where it is drawn.

    ``contact_distance`` is for tight fits: the distance (m) from which an engine that makes contacts ahead of touch may
    make them between this shape and another, half of it from each. Made from further away they stop a block at the rim
    of a hole that it fits into. None leaves it to the engine.
    """

    geometry: Geometry
    """Form and extents."""
    pose: Pose = field(default_factory=Pose)
    """Pose in the link's frame; of terrain, in the environment's."""
    material: PhysicsMaterial = field(default_factory=PhysicsMaterial)
    color: Color = (0.7, 0.7, 0.7, 1.0)
    name: str = ""
    """Name for messages and lookups; may be empty."""
    contact_distance: float | None = None
    finish: Finish = DULL

    def __post_init__(self) -> None:
        # Zero would make engines detect contacts only after penetration.
        if self.contact_distance is not None and not 0.0 < self.contact_distance < math.inf:
            raise ValueError(
                f"shape '{self.name}': contact_distance must be metres above zero, not {self.contact_distance}"
            )
