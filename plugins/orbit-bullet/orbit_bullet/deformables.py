"""Cloth and soft bodies in a Bullet world of one environment.

Cloth is a net of springs along the edges of its mesh; a soft body is a Neo-Hookean solid on tetrahedra that fill its
surface. Both are integrated explicitly, so that stiffness, step and mass have to fit; this is checked when built.
Bullet can set positions of particles but not velocities, so a reset loads the body again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet.buffers import Buffers
from orbit_bullet.stage import Stage
from orbit_bullet.tetrahedra import fill, smallest_height, volume_of, write_vtk
from orbit_bullet.urdf import write_obj
from orbit_core.interfaces import Approximation, ConfigurationError, SceneLayout, UnsupportedCapabilityError
from orbit_core.scene import Cloth, SoftBody

FloatArray = npt.NDArray[np.float64]
# Damping ratio of a spring between two particles.
_SPRING_DAMPING = 0.05
# Damping over stiffness of a soft body, per second.
_SOLID_DAMPING = 0.01
# Times its size at rest, beyond which a deformable counts as diverged.
_GREATEST_SPAN = 10.0


def check_stability(layout: SceneLayout) -> None:
    """Refuse deformables that explicit integration cannot hold.

    Cloth: ``k h^2 / m <= 1`` with the mass m of a particle. Soft bodies: a pressure wave crosses no tetrahedron in one
    step, ``h <= height sqrt(density / (lambda + 2 mu))``.

    Raises:
        ConfigurationError: names the deformable and the step that would do.
    """
    step = layout.scene.physics_dt
    for deformable in _simulated(layout):
        bound = _greatest_step(deformable)
        if step > bound:
            raise ConfigurationError(
                f"'{deformable.name}' is too stiff for Bullet's explicit integration at a physics_dt of {step:g} s: "
                f"use at most {bound:.2g} s, a softer material, more mass or a coarser mesh"
            )


def _simulated(layout: SceneLayout) -> tuple[Cloth | SoftBody, ...]:
    """The deformables of a scene, which has no others: its needs were held against what the backend declares."""
    return tuple(spec for spec in layout.scene.deformables if isinstance(spec, Cloth | SoftBody))


def spring_stiffness(cloth: Cloth) -> float:
    """N/m of each edge, as equilateral triangles of springs have the cloth's membrane stiffness.

    Seung and Nelson, "Defects in flexible membranes with crystalline order", Physical Review A 38 (1988): ``E t = 2 k /
    sqrt(3)``, at a Poisson's ratio of 1/3.
    """
    return 0.5 * math.sqrt(3.0) * cloth.membrane_stiffness


def _greatest_step(deformable: Cloth | SoftBody) -> float:
    if isinstance(deformable, Cloth):
        particle = deformable.mass / len(deformable.mesh.vertices)
        return math.sqrt(particle / max(spring_stiffness(deformable), 1e-12))
    mu, lame = lame_parameters(deformable)
    height = smallest_height(*fill(deformable.mesh, deformable.name))
    return height * math.sqrt(deformable.density / (lame + 2 * mu))


def lame_parameters(soft: SoftBody) -> tuple[float, float]:
    """Shear modulus and Lame's first parameter in Pa."""
    e, nu = soft.youngs_modulus, soft.poissons_ratio
    return e / (2 * (1 + nu)), e * nu / ((1 + nu) * (1 - 2 * nu))


def deformable_report(layout: SceneLayout) -> list[Approximation]:
    """List the approximations in Bullet of deformables."""
    found: list[Approximation] = []
    for deformable in _simulated(layout):
        subject = f"'{deformable.name}'"
        why = "Bullet multiplies it by that of what touches"
        found.append(Approximation(subject, f"friction {deformable.friction}, the larger of a pair", "a factor", why))
        if isinstance(deformable, Cloth):
            why = "Bullet bends cloth with springs between second neighbours"
            asked = f"bending stiffness {deformable.bending_stiffness} N m"
            found.append(Approximation(subject, asked, "springs of that stiffness over the edge length squared", why))
            asked = (
                f"membrane stiffness {deformable.membrane_stiffness} N/m, Poisson's ratio {deformable.poissons_ratio}"
            )
            got = f"springs of {spring_stiffness(deformable):.4g} N/m along edges"
            found.append(Approximation(subject, asked, got, "exact for equilateral triangles, at a ratio of 1/3"))
    return found


@dataclass
class _Body:
    """The data of one deformable."""

    spec: Cloth | SoftBody
    file: Path
    mass: float
    columns: slice
    """Columns of the particle buffers."""
    number: int = -1
    particles: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """Bullet's node of each particle."""
    positions: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    anchors: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Entity and link (Bullet's) that hold a particle; entity -1 is the world."""
    constraints: dict[int, int] = field(default_factory=dict)
    """Bullet's number of the anchor of a particle."""


class Deformables:
    """Deformables of a world's one environment; ``buffers`` receive their particles."""

    def __init__(self, stage: Stage, buffers: Buffers) -> None:
        self._stage = stage
        self._client = stage.client
        self._buffers = buffers
        self._bodies: list[_Body] = []
        start = 0
        for index, spec in enumerate(_simulated(stage.layout)):
            stop = start + len(spec.mesh.vertices)
            file, mass = self._write(index, spec)
            self._bodies.append(_Body(spec, file, mass, slice(start, stop)))
            start = stop

    def _write(self, index: int, spec: Cloth | SoftBody) -> tuple[Path, float]:
        if isinstance(spec, Cloth):
            file = self._stage.files.folder / f"cloth{index}.obj"
            write_obj(file, np.asarray(spec.mesh.vertices, dtype=np.float64), np.asarray(spec.mesh.faces))
            return file, spec.mass
        file = self._stage.files.folder / f"soft{index}.vtk"
        nodes, cells = fill(spec.mesh, spec.name)
        write_vtk(file, nodes, cells)
        return file, spec.density * volume_of(nodes, cells)

    # Loading ---------------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Put every deformable back to rest, with its anchors."""
        for body in self._bodies:
            self._load(body)
            self._attach(body)
        self.read(still=True)

    def _load(self, body: _Body) -> None:
        client, spec = self._client, body.spec
        if body.number >= 0:
            client.removeBody(body.number)
        w, x, y, z = spec.pose.orientation
        place = tuple(self._stage.origins[0] + spec.pose.position)
        body.number = client.loadSoftBody(
            str(body.file), basePosition=place, baseOrientation=(x, y, z, w), mass=body.mass,
            frictionCoeff=spec.friction, **self._material(body),
        )  # fmt: skip
        nodes = self._nodes(body)
        # Bullet reorders and splits the mesh's vertices as it loads them, always alike: matched once, the nodes stay
        # the same.
        if not len(body.particles):
            body.particles = _match(spec.pose.transform(spec.mesh.vertices) + self._stage.origins[0], nodes)
        body.positions = nodes[body.particles]

    def _material(self, body: _Body) -> dict[str, Any]:
        spec = body.spec
        if isinstance(spec, Cloth):
            edge = _mean_edge(spec)
            particle = spec.mass / len(spec.mesh.vertices)
            return {
                "useMassSpring": 1,
                "useBendingSprings": int(spec.bending_stiffness > 0),
                "springElasticStiffness": spring_stiffness(spec),
                "springDampingStiffness": 2 * _SPRING_DAMPING * math.sqrt(spring_stiffness(spec) * particle),
                # Bullet's bending springs resist distances between second neighbours: a moment over the square of a
                # length.
                "springBendingStiffness": spec.bending_stiffness / edge**2,
                "springDampingAllDirections": 1,
                "useSelfCollision": 0,
                "collisionMargin": spec.thickness / 2,
            }
        mu, lame = lame_parameters(spec)
        return {
            "useNeoHookean": 1,
            "NeoHookeanMu": mu,
            "NeoHookeanLambda": lame,
            "NeoHookeanDamping": _SOLID_DAMPING,
            "useSelfCollision": 0,
            "collisionMargin": 0.002,
        }

    def _attach(self, body: _Body) -> None:
        for particle in body.anchors:
            self._hold(body, particle)

    def _hold(self, body: _Body, particle: int) -> None:
        entity, link = body.anchors[particle]
        other = -1 if entity < 0 else self._stage.bodies[0][entity]
        node = int(body.particles[particle])
        body.constraints[particle] = self._client.createSoftBodyAnchor(body.number, node, other, link)

    def anchor(self, deformable: int, particles: npt.NDArray[np.int64], entity: int, link: int) -> None:
        """Hold particles to a link of an entity, or with entity -1 to the world, where they are; kept over resets."""
        self.release(deformable, particles)
        body = self._bodies[deformable]
        for particle in particles.tolist():
            body.anchors[particle] = entity, link
            self._hold(body, particle)

    def release(self, deformable: int, particles: npt.NDArray[np.int64]) -> None:
        """Let particles go, those of them that are held."""
        body = self._bodies[deformable]
        for particle in particles.tolist():
            if body.anchors.pop(particle, None) is not None:
                self._client.removeConstraint(body.constraints.pop(particle))

    # State -----------------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Before the last step: the positions that it starts from."""
        for body in self._bodies:
            body.positions = self._nodes(body)[body.particles]

    def read(self, still: bool = False) -> None:
        """Fill the buffers; velocities are what the last step moved, or none."""
        step = self._stage.layout.scene.physics_dt
        for body in self._bodies:
            positions = self._nodes(body)[body.particles]
            # Bullet gives no velocities of nodes.
            velocities = 0.0 if still else (positions - body.positions) / step
            self._buffers.particle_positions[0, body.columns] = positions - self._stage.origins[0]
            self._buffers.particle_velocities[0, body.columns] = velocities

    def sound(self) -> bool:
        """Return True if every deformable still has about its initial size."""
        for body in self._bodies:
            positions = self._buffers.particle_positions[0, body.columns]
            rest = np.ptp(np.asarray(body.spec.mesh.vertices), axis=0).max()
            # Springs that gain energy blow a body up within a few steps, and its size shows that for all particles at
            # once.
            if not np.ptp(positions, axis=0).max() < _GREATEST_SPAN * rest:  # NaN too
                return False
        return True

    def write(self, deformable: int, positions: FloatArray, velocities: FloatArray) -> None:
        """Put particles (P, 3) somewhere, at rest.

        Raises:
            UnsupportedCapabilityError: a velocity is asked for.
        """
        body = self._bodies[deformable]
        if np.any(velocities):
            raise UnsupportedCapabilityError(
                f"Bullet cannot set velocities of particles, as asked for '{body.spec.name}': write zero velocities"
            )
        self._load(body)
        nodes = self._nodes(body)
        if len(nodes) != len(body.particles):
            raise UnsupportedCapabilityError(
                f"Bullet's soft body '{body.spec.name}' has nodes inside that would stay behind: reset it instead"
            )
        nodes[body.particles] = positions + self._stage.origins[0]
        self._client.resetMeshData(body.number, nodes.tolist())
        self._attach(body)
        self.read(still=True)

    def _nodes(self, body: _Body) -> FloatArray:
        found = self._client.getMeshData(body.number, -1, flags=self._client.MESH_DATA_SIMULATION_MESH)[1]
        return np.array(found, dtype=np.float64).reshape(-1, 3)


def _match(vertices: FloatArray, nodes: FloatArray) -> npt.NDArray[np.int64]:
    """The node at each vertex."""
    from scipy.spatial import KDTree

    return np.asarray(KDTree(nodes).query(vertices)[1], dtype=np.int64)


def _mean_edge(cloth: Cloth) -> float:
    corners = np.asarray(cloth.mesh.vertices)[np.asarray(cloth.mesh.faces)]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean())
