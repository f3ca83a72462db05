"""The liquids of all environments: their particles, their state as tensors, and how it is read and written."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import MAX_DISTANCE, MAX_SPEED, Approximation, ConfigurationError
from orbit_core.plugin_kit.rows import take_rows, write_rows
from orbit_core.scene import Fluid, Scene

SMOOTHING = 1.3
"""Spacings of the smoothing length: 74 particles are within the kernel."""
SKIN = 0.2
"""Spacings by which neighbours are searched further than the kernel reaches."""
SKIN_OF_GPU = 0.3
"""The same on a GPU, where a search costs more than a pass over neighbours; 0.4 and 0.2 made 1 and 10 % fewer steps."""
PASSED = 0.5
"""Spacings that all particles may move together before all are searched for: by then a wall may be between two. Those
that a CPU searched for on the way have gone twice of it at most since then."""
PASSED_OF_GPU = 1.0
"""The same on a GPU, which always searches for all."""
NEIGHBOURS = 160
"""Most that one particle has."""
ROUGHNESS = 0.0014
"""Least viscosity, as a part of ``length * sound``: enough against noise between particles. Water of 1 cm ones at rest
moves at 7.5 mm/s in the mean, and a slosh loses 12 % of its amplitude in half a period; 15 % with twice as much."""
SMOOTHNESS = 0.03
"""Diffusion of densities, as a part of ``length * sound``; the usual value."""
RENEWED = 0.04
"""Seconds in which densities follow where particles are."""
COUNTED = 1.003
"""Times what packing is counted: a liquid of six layers is compressed by its weight, by 0.4 % in the mean."""
NOWHERE = 1e9
"""Metres; where particles are taken to have been that were not searched yet."""
STAYED = 0.01
"""Spacings that a particle may move along the shapes near it and keep its walls."""
EASED = 0.1
"""Part of gravity by which walls may go on with another gradient of the pressure than a particle keeps them with."""
KEPT = 24
"""Substeps that a particle keeps its walls at most."""
WALLS = 6
"""Most walls that act on a particle at a time: in a narrow vessel all of its sides do."""
MACH = 6.0
"""Speed of sound over the speed of free fall through the liquid's height: densities differ by 0.8 % at rest."""
LEAST_HEIGHT = 0.1
"""Metres of fall that the speed of sound is made for at least: what is poured falls further than what stands."""
COURANT = 1.2
"""Spacings that sound goes in a substep."""
DIFFUSIVE = 0.06
"""``nu h / length^2`` at most: friction along the lines between particles on a grid overshoots above 0.079."""

MOST_SUBSTEPS = 200
"""In a physics step; a second of 1,000 particles then takes minutes of a core."""


@dataclass(frozen=True, eq=False)
class FluidModel:
    """P particles of all liquids of a scene, one liquid after another; the same in every environment."""

    deformables: tuple[int, ...]
    """Index in the scene of each liquid."""
    slices: tuple[slice, ...]
    """Columns of each."""
    rest: npt.NDArray[np.float32]
    """(P, 3) m in the environment's frame."""
    owners: npt.NDArray[np.int32]
    """(P,) index in the scene."""
    densities: npt.NDArray[np.float32]
    """(P,) kg/m^3"""
    viscosities: npt.NDArray[np.float32]
    """(P,) Pa s"""
    spacing: float
    """m between particles at rest; one for all liquids of a scene."""
    sound: float
    """m/s"""

    @property
    def length(self) -> float:
        """Smoothing length in metres."""
        return SMOOTHING * self.spacing

    @property
    def roughness(self) -> float:
        """Least kinematic viscosity between particles, m^2/s."""
        return ROUGHNESS * self.length * self.sound

    @property
    def least_viscosity(self) -> npt.NDArray[np.float32]:
        """(P,) Pa s below which a particle's viscosity is this."""
        return self.densities * self.roughness

    @property
    def longest_substep(self) -> float:
        """Longest stable substep in seconds: by the speed of sound, and by viscosity."""
        thickest = float((self.viscosities / self.densities).max(initial=1e-9))
        return min(COURANT * self.spacing / self.sound, DIFFUSIVE * self.length**2 / thickest)


def build(scene: Scene) -> FluidModel | None:
    """Return what the liquids of a scene are made of; None where it has none.

    Raises:
        ConfigurationError: liquids of different spacings, two that overlap, one that
            needs too many substeps, or one with attachments.
    """
    chosen = [(n, spec) for n, spec in enumerate(scene.deformables) if isinstance(spec, Fluid)]
    if not chosen:
        return None
    spacings = {spec.spacing for _, spec in chosen}
    if len(spacings) > 1:
        names = ", ".join(f"'{spec.name}' {spec.spacing:g} m" for _, spec in chosen)
        raise ConfigurationError(f"the liquids of a scene have one spacing of particles, and these differ: {names}")
    for _, spec in chosen:
        if spec.attachments:
            raise ConfigurationError(f"'{spec.name}' is a liquid, which nothing holds: leave out its attachments")
    for (_, first), (_, second) in permutations(chosen, 2):
        _check_apart(first, second)
    rest = [spec.pose.transform(spec.rest_positions) for _, spec in chosen]
    counts = [len(points) for points in rest]
    ends = np.cumsum([0, *counts])
    pull = np.asarray(scene.gravity)
    gravity = max(float(np.linalg.norm(pull)), 1.0)
    # Free fall through the liquid's height is the fastest flow to expect, and sound must be several times faster.
    height = max(float(np.ptp(np.concatenate(rest) @ pull)) / gravity, LEAST_HEIGHT)
    made = FluidModel(
        tuple(n for n, _ in chosen),
        tuple(slice(int(a), int(b)) for a, b in pairwise(ends)),
        np.concatenate(rest).astype(np.float32),
        np.repeat([n for n, _ in chosen], counts).astype(np.int32),
        np.repeat([spec.density for _, spec in chosen], counts).astype(np.float32),
        np.repeat([spec.viscosity for _, spec in chosen], counts).astype(np.float32),
        spacings.pop(),
        MACH * math.sqrt(2.0 * gravity * height),
    )
    _check_substeps(made, scene)
    return made


def thickened(scene: Scene, model: FluidModel | None) -> tuple[Approximation, ...]:
    """Report liquids that are computed with more viscosity than they have."""
    if model is None:
        return ()
    found: list[Approximation] = []
    for index, columns in zip(model.deformables, model.slices, strict=True):
        asked, least = float(model.viscosities[columns.start]), float(model.least_viscosity[columns.start])
        if asked < least:
            why = f"less leaves noise between particles of {model.spacing:g} m: it falls with the spacing"
            viscosities = (f"a viscosity of {asked:.2g} Pa s", f"{least:.2g} Pa s")
            found.append(Approximation(f"'{scene.deformables[index].name}'", *viscosities, why))
    return tuple(found)


def _check_substeps(model: FluidModel, scene: Scene) -> None:
    """Refuse liquids that are too thick or too fine to be computed in a reasonable time."""
    needed, most = scene.physics_dt / model.longest_substep, float(MOST_SUBSTEPS)
    if needed <= most:
        return
    thickest = int((model.viscosities / model.densities).argmax())
    name = scene.deformables[model.owners[thickest]].name
    viscosity = DIFFUSIVE * model.length**2 * float(model.densities[thickest]) * most / scene.physics_dt
    raise ConfigurationError(
        f"'{name}' needs {needed:.3g} substeps in a physics step of {scene.physics_dt:g} s, and {MOST_SUBSTEPS} are "
        f"the most: at a spacing of {model.spacing:g} m its viscosity may be {viscosity:.3g} Pa s; take a "
        "smaller one, a larger spacing or a shorter physics_dt"
    )


def _check_apart(first: Fluid, second: Fluid) -> None:
    """Refuse two liquids that fill the same place."""
    points = first.pose.inverse().transform(second.pose.transform(second.rest_positions))
    count = int((np.abs(points) < first.half_extents).all(1).sum())
    if count:
        raise ConfigurationError(
            f"{count} of the {len(points)} particles of '{second.name}' are inside '{first.name}' at the start: move "
            "one of these liquids"
        )


def kernel_of(spacing: float) -> tuple[float, float]:
    """Return the slope of the kernel (1/m^5) and the height of the one whose sum is ``packed``, for a spacing in m."""
    length = SMOOTHING * spacing
    peak = 3465.0 / (512.0 * math.pi * (2.0 * length) ** 3) * spacing**3 * COUNTED
    return 105.0 / (16.0 * math.pi * length**5), peak


class Fluids:
    """State of the liquids of N environments.

    Args:
        scene: that they are in.
        num_envs: N.
        device: of their memory.
        shapes: that an environment has.
    """

    def __init__(self, scene: Scene, num_envs: int, device: torch.device, shapes: int) -> None:
        self.model = build(scene)
        """Particles and materials, or None if the scene has no liquid."""
        self.tensors: dict[str, Tensor] = {}
        """State; snapshots hold it, and kernels its memory."""
        self.walls: dict[str, Tensor] = {}
        """Walls of particles. A CPU keeps them from one physics step to the next, so that they are state there."""
        self._index: dict[int, slice] = {}
        if self.model is None:
            return
        model = self.model
        self._index = dict(zip(model.deformables, model.slices, strict=True))
        make = {"dtype": torch.float32, "device": device}
        count = len(model.rest)
        self._rest = torch.as_tensor(model.rest, **make)
        self.tensors = {
            "fluid_x": self._rest.repeat(num_envs, 1, 1),
            "fluid_v": torch.zeros(num_envs, count, 3, **make),
            "fluid_s": torch.ones(num_envs, count, **make),
            "fluid_packed": torch.zeros(num_envs, count, **make),
            "fluid_searched": torch.full((num_envs, count, 3), NOWHERE, **make),
            "fluid_carried": torch.zeros(num_envs, 3, **make),
            "fluid_shielded": torch.zeros(num_envs, count, WALLS, 4, **make),
        }
        whole = {"dtype": torch.int32, "device": device}
        self.walls = {
            "fluid_drift": torch.full((num_envs, count), NOWHERE, **make),
            "fluid_held": torch.zeros(num_envs, count, **make),
            "fluid_filled": torch.zeros(num_envs, count, **make),
            "fluid_walls": torch.zeros(num_envs, count, **whole),
            "fluid_shape": torch.zeros(num_envs, count, WALLS, **whole),
            "fluid_plane": torch.zeros(num_envs, count, WALLS, 4, **make),
            "fluid_given": torch.zeros(num_envs, count, WALLS, 3, **make),
            "fluid_pull": torch.zeros(num_envs, count, WALLS, 3, **make),
            "fluid_left": torch.zeros(num_envs, shapes, 7, **make),
        }
        if device.type == "cpu":
            self.tensors |= self.walls

    def has(self, deformable: int) -> bool:
        """Return True if a deformable of the scene is a liquid."""
        return deformable in self._index

    def positions(self, deformable: int) -> Tensor:
        """Return (N, P, 3) m."""
        return self.tensors["fluid_x"][:, self._index[deformable]]

    def velocities(self, deformable: int) -> Tensor:
        """Return (N, P, 3) m/s."""
        return self.tensors["fluid_v"][:, self._index[deformable]]

    def write(self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None) -> None:
        """Set (n, P, 3) positions and velocities; densities are those at rest from now on."""
        columns = self._index[deformable]
        write_rows(self.tensors["fluid_x"][:, columns], positions, env_ids)
        write_rows(self.tensors["fluid_v"][:, columns], velocities, env_ids)
        write_rows(self.tensors["fluid_s"][:, columns], 1.0, env_ids)
        write_rows(self.tensors["fluid_searched"], NOWHERE, env_ids)
        write_rows(self.walls["fluid_drift"], NOWHERE, env_ids)

    def reset(self, env_ids: Tensor | None) -> None:
        """Put liquids where the scene has them, at rest."""
        if self.model is None:
            return
        rest = self._rest.expand(len(self.tensors["fluid_x"]), -1, -1)
        write_rows(self.tensors["fluid_x"], take_rows(rest, env_ids), env_ids)
        write_rows(self.tensors["fluid_v"], 0.0, env_ids)
        write_rows(self.tensors["fluid_s"], 1.0, env_ids)
        write_rows(self.tensors["fluid_searched"], NOWHERE, env_ids)
        write_rows(self.walls["fluid_drift"], NOWHERE, env_ids)

    def diverged(self, deformable: int) -> Tensor:
        """Return (N,) bool: where a liquid is beyond the bounds of matter."""
        near = (self.positions(deformable).abs() <= MAX_DISTANCE).all(-1)
        slow = (self.velocities(deformable).abs() <= MAX_SPEED).all(-1)
        return ~(near & slow).all(1)
