"""Scans as scenes: collision by triangles or by boxes, and the floor that a robot can stand on."""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import ArgumentError, AssetError
from orbit_core.scene import Articulation, Box, Color, Link, ObjectSpec, PhysicsMaterial, Plane, Pose, Scene, Shape
from orbit_core.scene.pose import FloatArray
from orbit_scenes.scan.mesh import Scan

Cells = npt.NDArray[np.bool_]
# Metres above the floor below which a surface is the floor itself, noise and carpet included.
_FLOOR = 0.04
# Points of a surface that are sampled at most: some 2 GB, and ten times those of a floor of 1,000 m^2 with its walls.
_MOST_POINTS = 5e7
_MATERIAL = PhysicsMaterial(0.8, 0.8)
# Colours of labelled parts, dull ones that differ.
_SHADES: tuple[Color, ...] = (
    (0.72, 0.70, 0.67, 1.0), (0.55, 0.42, 0.30, 1.0), (0.40, 0.50, 0.58, 1.0), (0.62, 0.60, 0.48, 1.0),
    (0.52, 0.55, 0.45, 1.0), (0.60, 0.45, 0.42, 1.0),
)  # fmt: skip


class ScanCollision(Enum):
    """Collision geometry of a scan."""

    BOXES = "boxes"
    """Boxes of whole voxels around the surface, off by up to a voxel; every engine and planner takes them."""
    TRIANGLES = "triangles"
    """The triangles themselves; planners of motion see the box around them."""


@dataclass(frozen=True, eq=False)
class FloorMap:
    """Cells of the floor where a robot, as an upright cylinder, can stand."""

    low: tuple[float, float]
    """Corner of least coordinates of the first cell, m."""
    resolution: float
    """Edge of a cell, m."""
    floor: Cells
    """(X, Y) where the scan shows its floor."""
    taken: Cells
    """(X, Y) where something is above the floor and below the robot's top."""
    free: Cells
    """(X, Y) where the robot's middle may be."""
    holes: float
    """Area (m^2) of floor that the scan does not show, surrounded by floor and things that it shows."""

    @property
    def area(self) -> float:
        """Area (m^2) where the robot's middle may be."""
        return float(self.free.sum()) * self.resolution**2

    def is_free(self, x: float, y: float) -> bool:
        """Return True if the robot's middle may be at a place."""
        i, j = int((x - self.low[0]) // self.resolution), int((y - self.low[1]) // self.resolution)
        inside = 0 <= i < self.free.shape[0] and 0 <= j < self.free.shape[1]
        return bool(inside and self.free[i, j])


def floor_map(
    scan: Scan, radius: float, height: float, *, resolution: float = 0.05, fill_holes: bool = False
) -> FloorMap:
    """Return the floor of a scan where a robot can stand.

    Args:
        scan: on its floor (:func:`~orbit_scenes.scan.mesh.on_floor`).
        radius: of the robot, m.
        height: of the robot, m; what hangs higher is no obstacle.
        resolution: edge of a cell, m.
        fill_holes: whether floor that the scan does not show counts as floor where it is surrounded by what is shown.

    Raises:
        ArgumentError: a length is not above zero.
        AssetError: no floor is free.
    """
    # Its stubs know neither what comes back without an output array nor that masks are arrays.
    ndimage: Any = importlib.import_module("scipy.ndimage")
    for name, value in (("radius", radius), ("height", height), ("resolution", resolution)):
        if not 0.0 < value < np.inf:
            raise ArgumentError(f"{name} of a floor map is {value}: give metres above zero")
    points = _sampled(scan, resolution / 2.0)
    low = points[:, :2].min(0) - resolution
    cells = ((points[:, :2] - low) / resolution).astype(np.int64)
    shape = tuple(int(value) for value in cells.max(0) + 2)
    floor, taken = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    ground = np.abs(points[:, 2]) <= _FLOOR
    above = (points[:, 2] > _FLOOR) & (points[:, 2] < height)
    floor[tuple(cells[ground].T)] = True
    taken[tuple(cells[above].T)] = True
    # Single cells between samples are no holes.
    shown = ndimage.binary_closing(np.pad(floor | taken, 2), iterations=1)[2:-2, 2:-2] | floor | taken
    hole = ndimage.binary_fill_holes(shown) & ~shown
    ground_cells = (shown & ~taken) | (hole if fill_holes else False)
    away = ndimage.distance_transform_edt(np.pad(ground_cells, 1), sampling=resolution)[1:-1, 1:-1]
    free: Cells = np.asarray(away) > radius
    if not free.any():
        raise AssetError(
            f"no floor of the scan is free for a robot of {radius} m radius: it shows "
            f"{floor.sum() * resolution**2:.1f} m^2 of floor, and {hole.sum() * resolution**2:.2f} m^2 of holes"
        )
    corner = (float(low[0]), float(low[1]))
    return FloorMap(corner, resolution, floor, taken, free, float(hole.sum()) * resolution**2)


def scan_object(
    scan: Scan,
    name: str = "scan",
    *,
    collision: ScanCollision = ScanCollision.BOXES,
    voxel: float = 0.05,
    color: Color = (0.72, 0.70, 0.67, 1.0),
    label: str = "scan",
) -> ObjectSpec:
    """Build a fixed object that is drawn as the scan and collides as its triangles or boxes.

    Args:
        scan: on its floor; floor itself is left to the scene's ground plane where it collides as boxes.
        name: of the object.
        collision: geometry.
        voxel: edge of the voxels that boxes are made of, m.
        color: of the surface.
        label: semantic label.
    """
    surface = Shape(scan.mesh(), material=_MATERIAL, color=color, name="surface")
    collisions = (surface,)
    if collision is ScanCollision.BOXES:
        pairs = voxel_boxes(scan, voxel)
        collisions = tuple(
            Shape(Box(tuple(half)), Pose(tuple(middle)), _MATERIAL, color, f"box_{index}")
            for index, (middle, half) in enumerate(pairs)
        )
    link = Link(name, collisions=collisions, visuals=(surface,), semantic_label=label)
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), fixed_base=True, semantic_label=label)


def scan_objects(
    scan: Scan, *, collision: ScanCollision = ScanCollision.BOXES, voxel: float = 0.05
) -> tuple[ObjectSpec, ...]:
    """Build a fixed object of each label of a scan, and one, ``scan``, of what has none.

    Args:
        scan: on its floor.
        collision: geometry of each object.
        voxel: edge of the voxels that boxes are made of, m.
    """
    if scan.labels is None:
        return (scan_object(scan, collision=collision, voxel=voxel),)
    built: list[ObjectSpec] = []
    for label in np.unique(scan.labels).tolist():
        kind = scan.names[label] if label >= 0 else "scan"
        name = re.sub(r"\W+", "_", kind)
        shade = _SHADES[label % len(_SHADES)]
        built.append(scan_object(scan.part(label), name, collision=collision, voxel=voxel, color=shade, label=kind))
    return tuple(built)


def scan_scene(
    scan: Scan,
    objects: tuple[ObjectSpec, ...] = (),
    *,
    collision: ScanCollision = ScanCollision.BOXES,
    voxel: float = 0.05,
    fill_floor: bool = True,
) -> Scene:
    """Build the scene of a scan with objects of one's own.

    Args:
        scan: on its floor, with cut-outs where the objects stand.
        objects: that stand in it.
        collision: of the scan.
        voxel: of its boxes, m.
        fill_floor: whether a ground plane at z = 0 closes holes in the scan's floor.

    Raises:
        AssetError: the floor is not filled, and has holes or is left out of the boxes.
    """
    if not fill_floor:
        holes = floor_map(scan, 0.05, 2.0).holes
        if holes > 0.0:
            raise AssetError(f"the scan's floor has holes of {holes:.2f} m^2 in all: fill them, fill_floor=True")
        if collision is ScanCollision.BOXES:
            raise AssetError("a scan that collides as boxes leaves its floor to the ground: fill_floor=True")
    ground = (Shape(Plane(), material=_MATERIAL, color=(0.35, 0.38, 0.42, 1.0), name="ground"),)
    built = scan_objects(scan, collision=collision, voxel=voxel)
    return Scene(objects=(*built, *objects), terrain=ground if fill_floor else ())


def voxel_boxes(scan: Scan, voxel: float) -> list[tuple[FloatArray, FloatArray]]:
    """Return boxes (middle, half extents) of whole voxels that hold the surface above the floor.

    Voxels grow into boxes greedily: along x, then y, then z, as far as all of them hold surface.

    Raises:
        ArgumentError: the voxel's edge is not above zero.
    """
    if not 0.0 < voxel < np.inf:
        raise ArgumentError(f"voxels of {voxel} m: give an edge above zero")
    points = _sampled(scan, voxel / 2.0)
    points = points[points[:, 2] > _FLOOR]
    if not len(points):
        return []
    low = np.array((*points[:, :2].min(0), 0.0))
    cells = np.unique(((points - low) / voxel).astype(np.int64), axis=0)
    filled = np.zeros(cells.max(0) + 2, dtype=bool)
    filled[tuple(cells.T)] = True
    found: list[tuple[FloatArray, FloatArray]] = []
    for cell in cells:
        if not filled[tuple(cell)]:
            continue
        end = cell + 1
        for axis in (2, 0, 1):
            while True:
                slab = [slice(int(a), int(b)) for a, b in zip(cell, end, strict=True)]
                slab[axis] = slice(int(end[axis]), int(end[axis]) + 1)
                part = filled[tuple(slab)]
                if not part.size or not part.all():
                    break
                end[axis] += 1
        filled[tuple(slice(int(a), int(b)) for a, b in zip(cell, end, strict=True))] = False
        half = (end - cell) * voxel / 2.0
        found.append((low + cell * voxel + half, half))
    return found


def _sampled(scan: Scan, spacing: float) -> FloatArray:
    """Return points (P, 3) on all triangles, no two neighbours further apart than about ``spacing`` m."""
    corners = scan.corners
    longest = np.max([np.linalg.norm(corners[:, i] - corners[:, i - 1], axis=1) for i in range(3)], axis=0)
    parts = np.maximum(1, np.ceil(longest / spacing).astype(np.int64))
    # In floating point: a scan in a wrong unit has more points than an integer counts.
    count = float((parts.astype(np.float64) ** 2).sum() / 2.0)
    if count > _MOST_POINTS:
        extent = " x ".join(f"{length:.4g}" for length in scan.size)
        raise AssetError(
            f"the scan extends over {extent} m and takes {count:.1e} samples {spacing:g} m apart, of which "
            f"{_MOST_POINTS:.0e} are the most: check its unit, or take larger voxels"
        )
    found = [scan.vertices]
    # Triangles of one number of parts share a lattice of barycentric coordinates.
    for count in np.unique(parts):
        u, v = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
        inside = u + v < count
        a, b = (u[inside] + 1 / 3) / count, (v[inside] + 1 / 3) / count
        some = corners[parts == count]
        weights = np.stack((1 - a - b, a, b), 1)
        found.append(np.einsum("lk,tkc->ltc", weights, some).reshape(-1, 3))
    return np.concatenate(found)
