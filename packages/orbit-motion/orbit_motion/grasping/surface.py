"""The surface of a thing as points with normals: of its collision shapes, or of what a depth camera saw of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import ArgumentError
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import HeightField, Link, Plane

_NEIGHBOURS = 16


@dataclass(frozen=True, eq=False)
class Surface:
    """Points (M, 3) in metres and unit normals (M, 3) out of the thing, in one frame."""

    points: Tensor
    normals: Tensor

    def __post_init__(self) -> None:
        if self.points.shape != self.normals.shape or self.points.ndim != 2 or self.points.shape[1] != 3:
            raise ArgumentError(
                f"a surface has points {tuple(self.points.shape)} and normals {tuple(self.normals.shape)}: "
                "give (M, 3) each"
            )


def surface_of(link: Link, count: int = 2000, seed: int = 0) -> Surface:
    """``count`` points drawn evenly from a link's collision shapes, in the link's frame.

    Raises:
        ArgumentError: the link has no collision shape of finite size.
    """
    import trimesh

    shapes = [shape for shape in link.collisions if not isinstance(shape.geometry, Plane | HeightField)]
    if not shapes:
        raise ArgumentError(f"link '{link.name}' has no collision shapes of finite size: there is nothing to grasp")
    meshes = []
    for shape in shapes:
        mesh = triangles(shape.geometry)
        mesh.apply_transform(shape.pose.matrix())
        meshes.append(mesh)
    joined: Any = trimesh.util.concatenate(meshes)
    points, faces, *_ = trimesh.sample.sample_surface(joined, count, seed=seed)
    return Surface(
        torch.as_tensor(np.asarray(points), dtype=torch.float32),
        torch.as_tensor(np.asarray(joined.face_normals[faces]), dtype=torch.float32),
    )


def surface_of_cloud(points: Tensor, eye: Tensor) -> Surface:
    """Return points (M, 3) that a camera at ``eye`` (3,) saw, with normals towards it.

    A normal is the direction in which a point's 16 nearest vary least: Hoppe et al., Surface Reconstruction from
    Unorganized Points (SIGGRAPH 1992).

    Raises:
        ArgumentError: there are fewer points than a neighbourhood has.
    """
    if len(points) < _NEIGHBOURS:
        raise ArgumentError(f"a cloud of {len(points)} points has no normals: give {_NEIGHBOURS} or more")
    nearest = torch.cdist(points, points).topk(_NEIGHBOURS, largest=False).indices
    around = points[nearest]
    spread = around - around.mean(1, keepdim=True)
    _, axes = torch.linalg.eigh(spread.transpose(1, 2) @ spread)
    normals = axes[:, :, 0]
    away = ((points - eye) * normals).sum(1, keepdim=True) > 0.0
    return Surface(points, torch.where(away, -normals, normals))
