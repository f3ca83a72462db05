"""Crumpled cloth to begin with: dropped once by simulation, and kept on disk."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from orbit_assets.cache import cache_folder, write_cached
from orbit_core.dynamics.transforms import quat_from_rotation_vector, quat_multiply, quat_rotate
from orbit_core.interfaces import World
from orbit_core.scene import Scene
from orbit_core.world import simulate

# Seconds after which a dropped cloth is at rest.
_SECONDS = 2.0
# rad by which it leans at most as it begins to fall on its edge.
_LEAN = 0.5


def crumpled(world: World, name: str, count: int = 16) -> Tensor:
    """(count, P, 3) m, positions of a cloth's particles at rest, each time crumpled otherwise, around x = y = 0.

    The cloth falls on one of its edges or corners, upright and turned at random, on the scene's fixed objects, on a CPU
    in the world's backend; of twice as many falls those count after which it covers least. What comes of it is kept in
    the folder ``crumpled`` of the cache, by the cloth, the fixed objects, this recipe, and the matter solvers that are
    installed and their versions; every world of such a scene begins with it.

    Raises:
        StorageError: the cache cannot be written.
    """
    fixed = tuple(thing for thing in world.scene.objects if thing.fixed_base)
    own = tuple(thing for thing in world.scene.deformables if thing.name == name)
    scene = replace(world.scene, robots=(), objects=fixed, deformables=own, sensors=(), markers=())
    path = cache_folder() / "crumpled" / f"{_key(scene, count)}.npy"
    if not path.exists():
        made = _dropped(scene, 2 * count, world)[:count].cpu().numpy()
        write_cached(path, lambda file: np.save(file, made, allow_pickle=False))
    return torch.as_tensor(np.load(path, allow_pickle=False), device=world.device)


def _key(scene: Scene, count: int) -> str:
    solvers = sorted(
        f"{point.name} {point.dist and point.dist.version}" for point in entry_points(group="orbit.matter")
    )
    with np.printoptions(threshold=2**31):
        told = repr((scene.objects, scene.deformables, scene.gravity, scene.physics_dt, solvers, count))
    told += Path(__file__).read_text(encoding="utf-8")
    return hashlib.sha256(told.encode()).hexdigest()[:32]


def _dropped(scene: Scene, count: int, world: World) -> Tensor:
    """(count, P, 3) after so many falls, the least covered area first."""
    # On a CPU, where falls repeat bit for bit: on a GPU each machine would crumple cloth in ways of its own, and counts
    # of two engines would begin differently.
    falling = simulate(scene, count, world.backend)
    (cloth,) = falling.deformables.values()
    rest = torch.as_tensor(cloth.spec.rest_positions, dtype=torch.float32)
    offset = torch.tensor(cloth.spec.pose.position, dtype=torch.float32)
    spin = falling.random.uniform((2,), (-math.pi, -_LEAN), (math.pi, _LEAN))
    zero = torch.zeros_like(spin[:, 0])
    upright = quat_from_rotation_vector(torch.stack((0.5 * math.pi + spin[:, 1], zero, zero), dim=1))
    turn = quat_multiply(upright, quat_from_rotation_vector(torch.stack((zero, zero, spin[:, 0]), dim=1)))
    points = quat_rotate(turn[:, None].expand(-1, len(rest), -1), rest.expand(count, -1, -1))
    points[..., 2] -= points[..., 2].amin(1, keepdim=True) - 0.01
    cloth.set_state(points + offset)
    falling.step(round(_SECONDS / scene.physics_dt))
    settled = cloth.positions[cloth.covered_area.argsort()].clone()
    falling.close()
    settled[..., :2] -= settled[..., :2].mean(1, keepdim=True)
    return settled
