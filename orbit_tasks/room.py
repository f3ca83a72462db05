"""A room drawn for each episode: furniture along its walls, a crate in its way, and places on the furniture.

Furniture stands with its back to a wall. In its own frame, whose origin is the middle of its top, x leads from the room
towards the wall, so that a robot that uses it faces along x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_assets.objects import DENSITY, WOOD, box, solid_link, table
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import Articulation, Box, ObjectSpec, Pose, Shape
from orbit_core.scene.pose import Vector3

# Metres of the floor along x and y; its middle is the origin.
LENGTH, WIDTH = 6.0, 5.0
# Thickness and height of the walls, m: low, so that one sees what goes on.
WALL, WALL_HEIGHT = 0.1, 0.4
# Metres of its edges.
CRATE = 0.5
# Metres from the middle of the room within which the crate stands, along x and y.
CRATE_PLACES = (0.5, 0.3)


@dataclass(frozen=True)
class Furniture:
    """One piece: how large it is, at which wall it stands, and where along it."""

    name: str
    """Name of its object in the scene."""
    depth: float
    """Metres from its front to the wall."""
    width: float
    """Metres along the wall."""
    yaw: float
    """rad: the direction of the wall."""
    along: tuple[float, float]
    """Lowest and highest coordinate (x or y) of its middle along the wall, m."""
    slots: tuple[float, ...]
    """Metres along its own y at which things stand on it."""

    def pose(self, along: Tensor, height: float) -> Tensor:
        """(n, 7) of its top's middle, ``along`` (n,) metres along its wall."""
        ahead = (math.cos(self.yaw), math.sin(self.yaw))
        wall = 0.5 * (LENGTH if abs(ahead[0]) > 0.5 else WIDTH) - 0.5 * self.depth
        across = torch.full_like(along, wall)
        x, y = (across * ahead[0], along) if abs(ahead[0]) > 0.5 else (along, across * ahead[1])
        place = torch.stack((x, y, torch.full_like(x, height), torch.full_like(x, self.yaw)), 1)
        return common.standing(place)

    def local(self, x: Tensor | float, y: Tensor, pose: Tensor) -> Tensor:
        """(n, 2) in the environment's frame, of places on the piece at ``pose`` (n, 7)."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return pose[:, :2] + torch.stack((cos * x - sin * y, sin * x + cos * y), 1)


DESK = Furniture("desk", 0.6, 1.2, 0.5 * math.pi, (-1.2, 1.2), (-0.3, 0.3))
SIDEBOARD = Furniture("sideboard", 0.5, 0.9, math.pi, (-0.8, 0.4), (-0.2, 0.2))
SHELF = Furniture("shelf", 0.4, 1.0, 0.0, (-0.8, 0.4), (-0.27, 0.0, 0.27))
PIECES = (DESK, SIDEBOARD, SHELF)


def shelf(name: str, size: Vector3, pose: Pose) -> ObjectSpec:
    """Two sides, a back, a board below and one on top, whose middle is the frame; ``size`` is depth, width, height."""
    depth, width, height = size
    board, half = 0.02, 0.5 * height
    parts = {
        "top": ((depth, width, 2 * board), (0.0, 0.0, -board)),
        "board": ((depth, width, board), (0.0, 0.0, -half)),
        "left": ((depth, board, height - 2 * board), (0.0, 0.5 * (width - board), -half - board)),
        "right": ((depth, board, height - 2 * board), (0.0, -0.5 * (width - board), -half - board)),
        "back": ((board, width, height - 2 * board), (0.5 * (depth - board), 0.0, -half - board)),
    }
    shapes = tuple(
        Shape(Box((0.5 * x, 0.5 * y, 0.5 * z)), Pose(middle), color=WOOD, name=part)
        for part, ((x, y, z), middle) in parts.items()
    )
    body = Articulation(name, (solid_link(name, shapes, DENSITY),))
    return ObjectSpec(name=name, articulation=body, pose=pose, fixed_base=True, semantic_label=name)


def furniture(heights: dict[str, float]) -> tuple[ObjectSpec, ...]:
    """All pieces as objects whose tops are so high (m, by name), and the crate."""
    built = []
    for piece in PIECES:
        height = heights[piece.name]
        middle = piece.pose(torch.tensor([0.5 * sum(piece.along)]), height)[0].tolist()
        pose = Pose((middle[0], middle[1], middle[2]), (middle[3], middle[4], middle[5], middle[6]))
        make = shelf if piece is SHELF else table
        built.append(make(piece.name, (piece.depth, piece.width, height), pose=pose))
    crate = box("crate", (CRATE, CRATE, CRATE), fixed_base=True, pose=Pose((0.0, 0.0, 0.5 * CRATE)), color=WOOD)
    return (*built, crate)


def walls() -> tuple[Shape, ...]:
    """Four of them."""
    sides = (
        ("north", (0.5 * LENGTH + WALL, 0.5 * WALL), (0.0, 0.5 * (WIDTH + WALL))),
        ("south", (0.5 * LENGTH + WALL, 0.5 * WALL), (0.0, -0.5 * (WIDTH + WALL))),
        ("east", (0.5 * WALL, 0.5 * WIDTH), (0.5 * (LENGTH + WALL), 0.0)),
        ("west", (0.5 * WALL, 0.5 * WIDTH), (-0.5 * (LENGTH + WALL), 0.0)),
    )
    half = 0.5 * WALL_HEIGHT
    return tuple(
        Shape(Box((*size, half)), Pose((*middle, half)), color=(0.8, 0.78, 0.74, 1.0), name=f"{name}_wall")
        for name, size, middle in sides
    )


def place_furniture(world: World, env_ids: Tensor) -> None:
    """Put every piece somewhere along its wall, and the crate somewhere about the middle, turned by any angle."""
    for piece in PIECES:
        along = world.random.uniform((), *piece.along, env_ids)
        height = world.objects[piece.name].spec.pose.position[2]
        world.objects[piece.name].set_root_pose(piece.pose(along, height), env_ids)
    x, y = CRATE_PLACES
    bounds = (-x, -y, 0.5 * CRATE, -math.pi), (x, y, 0.5 * CRATE, math.pi)
    world.objects["crate"].set_root_pose(common.standing(world.random.uniform((4,), *bounds, env_ids)), env_ids)
