"""Coverage of a task's starts: the area and the yaw angles over which things begin an episode."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import yaw_angle
from orbit_core.envs import Environment

# m: least edge of the cells that are counted.
_CELL = 0.02
# Samples expected in each cell of the bounding rectangle: cells grow until it is reached.
_SAMPLES_PER_CELL = 4
# Sectors of a whole turn.
_SECTORS = 36


@dataclass(frozen=True)
class Coverage:
    """Area and angles over which one thing begins its episodes."""

    name: str
    area: float
    """m^2 of the grid's cells, seen from above, that hold a start."""
    yaw: float
    """Share of 36 sectors of a whole turn that hold a start; 0 where it is never turned."""


def sample_starts(environment: Environment, resets: int) -> tuple[Coverage, ...]:
    """Reset all environments some times and measure what their starts cover.

    Returns:
        The coverage of each robot, object, deformable (by the middle of its points) and marker whose place or yaw
        differs, the widest first.
    """
    world = environment.world
    drawn: dict[str, list[Tensor]] = {}
    for _ in range(resets):
        environment.reset()
        for name, entity in {**world.robots, **world.objects}.items():
            drawn.setdefault(name, []).append(entity.root_pose.clone())
        for name, deformable in world.deformables.items():
            middle = deformable.positions.mean(dim=1)
            poses = torch.cat(
                (middle, torch.tensor([1.0, 0.0, 0.0, 0.0], device=middle.device).expand(len(middle), 4)), 1
            )
            drawn.setdefault(name, []).append(poses)
        for index, marker in enumerate(world.scene.markers):
            drawn.setdefault(f"marker {marker.name}", []).append(world.marker_poses[:, index].clone())
    found = [coverage(name, torch.cat(poses)) for name, poses in drawn.items()]
    return tuple(sorted((one for one in found if one.area or one.yaw), key=lambda one: (-one.area, -one.yaw)))


def coverage(name: str, poses: Tensor) -> Coverage:
    """Measure what poses (S, 7) cover, seen from above."""
    places = poses[:, :2].double()
    extent = places.amax(0) - places.amin(0)
    area = 0.0
    # Starts at one place cover nothing; their spread is rounding.
    if bool((extent > 1e-4).any()):
        edge = max(_CELL, math.sqrt(float(extent.prod()) * _SAMPLES_PER_CELL / len(poses)))
        cells = ((places - places.amin(0)) / edge).floor().long()
        # A line of starts covers no more than its own width, which a cell would round up.
        area = len(cells.unique(dim=0)) * float(extent.clamp_max(edge).prod())
    yaw = yaw_angle(poses[:, 3:])
    # Counted sectors instead of a range, so that two narrow fans are no full turn.
    sectors = ((yaw + math.pi) / (2.0 * math.pi) * _SECTORS).floor().clamp(0, _SECTORS - 1).unique()
    return Coverage(name, area, len(sectors) / _SECTORS if float(yaw.amax() - yaw.amin()) > 1e-3 else 0.0)
