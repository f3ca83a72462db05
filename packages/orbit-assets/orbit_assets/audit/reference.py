"""What another reader makes of a file, and how far a description is from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from orbit_assets.audit.mechanics import FloatArray, Posture, mass_matrix, posture
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation

_SEED = 0
_REACH = 2.0
"""Radians or metres: joints without limits are moved within so much of zero."""


class Reference(Protocol):
    """A model that another reader made of the same file."""

    @property
    def reader(self) -> str:
        """The reader's name, for tables."""
        ...

    @property
    def joints(self) -> frozenset[str]:
        """Names of the joints with one coordinate, by which it can be moved as the description is."""
        ...

    def masses(self, articulation: Articulation) -> Mapping[str, float]:
        """Mass in kg by link of the description, which is without fixed joints."""
        ...

    def move(self, positions: Mapping[str, float], at: Posture) -> None:
        """Take a posture: its own joints of one coordinate by name, all others as the description's links stand."""
        ...

    def links(self) -> Mapping[str, FloatArray]:
        """Poses (4, 4) of links and fixed frames by name, in the root's frame."""
        ...

    def mass_matrix(self, joints: tuple[str, ...]) -> FloatArray:
        """The mass matrix (J, J) of the joints named, all else held."""
        ...


@dataclass(frozen=True)
class Comparison:
    """The largest differences between a description and another reader's model of the same file."""

    reader: str
    mass: float
    """Of a link, in kg."""
    kinematics: float
    """Of a link's origin, in metres, over random postures."""
    rotation: float
    """Of an entry of a link's rotation matrix, over random postures."""
    mass_matrix: float
    """Of an entry (i, j), relative to the root of the product of diagonal entries i and j."""
    links: int
    """How many links were compared."""
    joints: int
    """How many joints were compared."""


def compare(articulation: Articulation, reference: Reference, postures: int = 3) -> Comparison:
    """Hold a description, fixed joints merged or not, against a reference in random postures, the same at each call."""
    merged = merge_fixed_links(articulation)
    generator = np.random.default_rng(_SEED)
    masses = reference.masses(merged)
    mass = max((abs(link.mass - masses[link.name]) for link in merged.links if link.name in masses), default=0.0)
    names = tuple(name for name in merged.joint_names if name in reference.joints)
    kinematics = rotation = inertia = 0.0
    compared: set[str] = set()
    for _ in range(postures):
        positions = _random_positions(merged, generator)
        at = posture(merged, positions)
        reference.move(positions, at)
        own, other = {**at.frames, **at.links}, reference.links()
        compared = own.keys() & other.keys()
        for name in compared:
            difference = np.abs(own[name] - other[name])
            kinematics = max(kinematics, float(np.linalg.norm(difference[:3, 3])))
            rotation = max(rotation, float(difference[:3, :3].max()))
        rows = [merged.joint_names.index(name) for name in names]
        inertia = max(inertia, _relative(mass_matrix(merged, at)[np.ix_(rows, rows)], reference.mass_matrix(names)))
    return Comparison(reference.reader, mass, kinematics, rotation, inertia, len(compared), len(names))


def _random_positions(articulation: Articulation, generator: np.random.Generator) -> dict[str, float]:
    positions: dict[str, float] = {}
    for joint in articulation.movable_joints:
        lower, upper = np.clip((joint.lower_limit, joint.upper_limit), -_REACH, _REACH)
        positions[joint.name] = float(generator.uniform(min(lower, upper), max(lower, upper)))
    return positions


def _relative(own: FloatArray, other: npt.NDArray[np.float64]) -> float:
    if not own.size:
        return 0.0
    scale = np.sqrt(np.maximum(np.diag(other), 1e-9))
    return float((np.abs(own - other) / np.outer(scale, scale)).max())
