"""Meshes of scanned rooms: read with their unit and up axis, cleaned, put on their floor, decimated, cut."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from orbit_assets.meshes import load_surfaces, merge_vertices
from orbit_assets.options import ReadOptions
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import ArgumentError, AssetError, ConfigurationError
from orbit_core.scene import Box, Mesh, MeshCollision, Pose
from orbit_core.scene.pose import FloatArray
from orbit_scenes.scan.upright import better_up

Up = Literal["x", "y", "z"]
# Axes of the file that become x, y and z; cyclic, so that no surface is reflected.
_ORDERS: dict[Up, tuple[int, int, int]] = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}
# The only formats whose specification fixes metres and y up.
_GLTF = (".glb", ".gltf")
# Properties of faces or vertices by which PLY files of scans label them (ScanNet, Replica, Matterport3D).
_LABELS = ("label", "category_id", "object_id", "class", "segment")
# Metres: bins of height in which a floor is sought, and distance from it within which triangles belong to it.
_BIN, _NEAR = 0.02, 0.03
# Cosine of the steepest floor; least area (m^2) of a floor, and its share of the fullest level.
_LEVEL, _LEAST_FLOOR, _SHARE = math.cos(math.radians(15.0)), 1.0, 0.3


@dataclass(frozen=True, eq=False)
class Scan:
    """A scanned surface in metres, z up."""

    vertices: FloatArray
    """(V, 3)"""
    faces: npt.NDArray[np.integer]
    """(F, 3)"""
    tilt: float = 0.0
    """Angle (rad) by which :func:`on_floor` turned it to make its floor level."""
    labels: npt.NDArray[np.integer] | None = None
    """(F,) index of each triangle's label in ``names``, -1 for none; None where the file has no labels."""
    names: tuple[str, ...] = ()
    """Semantic labels."""

    def part(self, label: int) -> Scan:
        """Return the triangles of one label, without labels."""
        rows = self.labels == label if self.labels is not None else np.full(len(self.faces), label < 0)
        return replace(_compact(replace(self, labels=None), self.faces[rows]), names=())

    @property
    def corners(self) -> FloatArray:
        """Corners (F, 3, 3) of all triangles, m."""
        return self.vertices[self.faces]

    @property
    def doubled_normals(self) -> FloatArray:
        """Normals (F, 3) of all triangles, as long as twice their area, m^2."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return np.cross(b - a, c - a)

    @property
    def size(self) -> FloatArray:
        """Extent (3,) along the axes, m."""
        return np.ptp(self.vertices, axis=0)

    def mesh(self) -> Mesh:
        """Return the surface as a mesh that collides as it is."""
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float32)
        return Mesh(vertices, np.ascontiguousarray(self.faces, dtype=np.int32), MeshCollision.TRIANGLES)


def read_scan(
    path: str | Path,
    *,
    unit: float | None = None,
    up: Up | None = None,
    names: Mapping[int, str] | None = None,
    check_up: bool = True,
    options: ReadOptions = ReadOptions(),
) -> Scan:
    """Read a scan from an OBJ, PLY, glTF or other mesh file.

    Labels by face are kept: of PLY, a property of faces or vertices; of a file of several named surfaces, such as
    glTF's meshes, their names.

    Args:
        path: the file.
        unit: metres of one unit of the file; glTF is in metres.
        up: the file's axis that points up; y in glTF.
        names: of a PLY file's numbers; "label_7" for others.
        check_up: whether a scan whose floor clearly faces another axis is refused.
        options: limits on size; a scan of more triangles than ``ReadLimits.vertices`` is refused before it is decoded.

    Raises:
        AssetError: the file cannot be read, is too large, its unit or up axis is neither given nor fixed by its
            format, or another axis is clearly the one that points up.
    """
    path = Path(path)
    gltf = path.suffix.lower() in _GLTF
    read = labelled(load_surfaces(path, options=options), names or {})
    vertices = read.vertices
    if not gltf and (unit is None or up is None):
        extent = " x ".join(f"{length:.4g}" for length in np.ptp(vertices, axis=0))
        raise AssetError(
            f"scan '{path}' does not state its {'unit' if unit is None else 'up axis'}: give the metres of one unit "
            "and the axis that points up, read_scan(..., unit=0.001, up='z') or --unit 0.001 --up z; it extends over "
            f"{extent} units"
        )
    scale = 1.0 if unit is None else unit
    if not 0.0 < scale < math.inf:
        raise AssetError(f"the unit of scan '{path}' is {unit} m: give a number above zero")
    scan = replace(read, vertices=scale * _upright(vertices, up or "y"))
    if check_up:
        _check_up(scan, path, up or "y")
    return scan


def _check_up(scan: Scan, path: Path, up: Up) -> None:
    """Reject a scan whose floor clearly faces another axis of its file than the one that was given."""
    found = better_up(scan.vertices, scan.corners)
    if found is None:
        return
    given, better = found
    number = next(index for index, part in enumerate(better.direction) if part)
    axis = "xyz"[_ORDERS[up][number]]
    remedy = f"give up='{axis}' (--up {axis})"
    if better.direction[number] < 0:
        remedy = f"it is upside down: turn the file over, for its {axis} axis points down"
    raise AssetError(
        f"scan '{path}' is read with {up} up, where its floor has {given.floor:.1f} m^2 and {given.height:.1f} m above "
        f"it; along {'-' if better.direction[number] < 0 else ''}{axis} these are {better.floor:.1f} m^2 and "
        f"{better.height:.1f} m: {remedy}, or keep {up} by read_scan(..., check_up=False) or --no-check-up"
    )


def labelled(surfaces: Sequence[Any], names: Mapping[int, str]) -> Scan:
    """Join trimesh surfaces to one scan, in their own units, with the labels that they have.

    Args:
        surfaces: of one file.
        names: of the numbers that label faces.
    """
    first = 0
    found: dict[str, int] = {}
    vertices: list[FloatArray] = []
    faces: list[npt.NDArray[np.int64]] = []
    labels: list[npt.NDArray[np.int64]] = []
    for surface in surfaces:
        own = np.asarray(surface.faces, dtype=np.int64)
        numbers = _numbers(surface)
        kinds = [names.get(int(number), f"label_{number}") for number in numbers]
        if numbers.size == 0 and len(surfaces) > 1:
            kinds = [str(surface.metadata.get("name", ""))] * len(own)
        rows = [found.setdefault(kind, len(found)) if kind else -1 for kind in kinds] or [-1] * len(own)
        vertices.append(np.asarray(surface.vertices, dtype=np.float64))
        faces.append(own + first)
        labels.append(np.asarray(rows, dtype=np.int64))
        first += len(vertices[-1])
    joined = Scan(np.concatenate(vertices), np.concatenate(faces))
    return replace(joined, labels=np.concatenate(labels), names=tuple(found)) if found else joined


def _numbers(surface: Any) -> npt.NDArray[np.integer]:
    """Return (F,) the numbers that a PLY file labels its faces by; none where it does not."""
    raw = surface.metadata.get("_ply_raw", {})
    for element in ("face", "vertex"):
        data = raw.get(element, {}).get("data")
        if data is None:
            continue
        held = getattr(getattr(data, "dtype", None), "names", None) or data or ()
        for name in _LABELS:
            if name in held:
                values = np.asarray(data[name]).reshape(-1).astype(np.int64)
                # A triangle has the label of its first corner where corners have them.
                return values if element == "face" else values[np.asarray(surface.faces)[:, 0]]
    return np.zeros(0, dtype=np.int64)


def _relabelled(scan: Scan, source: Scan) -> Scan:
    """Return a scan whose triangles have the labels of the nearest ones of another."""
    if source.labels is None:
        return replace(scan, labels=None)
    from scipy.spatial import KDTree

    nearest = KDTree(source.corners.mean(1)).query(scan.corners.mean(1))[1]
    return replace(scan, labels=source.labels[nearest], names=source.names)


def _upright(vertices: FloatArray, up: Up) -> FloatArray:
    """Return vertices with ``up`` turned to z."""
    return vertices[:, _ORDERS[up]]


def cleaned(scan: Scan, least_area: float = 0.02) -> Scan:
    """Merge equal vertices, and remove flat triangles and loose bits of surface.

    Args:
        scan: as it was read.
        least_area: area (m^2) below which a connected bit of surface is noise.
    """
    from scipy import sparse
    from scipy.sparse import csgraph

    vertices, faces = merge_vertices(scan.vertices.astype(np.float32), scan.faces)
    edges = np.concatenate((faces[:, :2], faces[:, 1:]))
    joined = sparse.coo_matrix((np.ones(len(edges)), edges.T), shape=(len(vertices),) * 2)
    labels = csgraph.connected_components(joined, directed=False)[1]
    whole = replace(scan, vertices=vertices.astype(np.float64), faces=faces, labels=None)
    areas = np.bincount(labels[faces[:, 0]], np.linalg.norm(whole.doubled_normals, axis=1) / 2.0)
    kept = faces[areas[labels[faces[:, 0]]] >= least_area]
    if not len(kept):
        raise AssetError(f"the scan has no connected surface of {least_area} m^2: check its unit")
    return _relabelled(_compact(whole, kept), scan)


def on_floor(scan: Scan) -> Scan:
    """Find the floor, make it level and move it to z = 0.

    The floor is the lowest level that holds at least 30 % of the area of the fullest one, of triangles that face up
    within 15 degrees.

    Raises:
        AssetError: there is no level surface of a square metre: the up axis or the unit is wrong.
    """
    # Twice: triangles of a tilted floor fill several bins of height, and the second time all of them count.
    return _levelled(_levelled(scan))


def _levelled(scan: Scan) -> Scan:
    """Return the scan with its floor moved to z = 0 and turned level by the plane that fits it best."""
    normals = scan.doubled_normals
    lengths = np.linalg.norm(normals, axis=1)
    level = normals[:, 2] > _LEVEL * np.maximum(lengths, 1e-12)
    middles = scan.corners.mean(1)
    if not level.any():
        raise AssetError("the scan has no surface that faces up: check its up axis, and that its faces look inwards")
    heights, areas = middles[level, 2], lengths[level] / 2.0
    first = heights.min()
    bins = ((heights - first) / _BIN).astype(np.int64)
    filled = np.bincount(bins, areas)
    # A floor may straddle two bins: sums of neighbours decide.
    sums = filled + np.concatenate((filled[1:], [0.0]))
    if sums.max() < _LEAST_FLOOR:
        raise AssetError(
            f"the scan has no floor: its fullest level surface is {sums.max():.2f} m^2 of {areas.sum():.2f}: check its "
            "unit and up axis"
        )
    lowest = int(np.flatnonzero(sums >= _SHARE * sums.max())[0])
    height = first + (lowest + 1) * _BIN
    near = np.abs(heights - height) < _NEAR
    points, weights = middles[level][near], areas[near]
    middle = np.average(points, axis=0, weights=weights)
    arms = (points - middle) * np.sqrt(weights)[:, None]
    # The direction of least spread is the plane's normal.
    normal = np.linalg.svd(arms, full_matrices=False)[2][2] if len(points) > 2 else np.array((0.0, 0.0, 1.0))
    normal = normal * np.sign(normal[2] or 1.0)
    axis = np.cross(normal, (0.0, 0.0, 1.0))
    sine = float(np.linalg.norm(axis))
    turn = Pose()
    if sine > 1e-9:
        x, y, z = (float(value) for value in axis)
        turn = Pose.from_axis_angle((x, y, z), math.asin(min(sine, 1.0)))
    moved = turn.transform(scan.vertices - middle) + np.array((middle[0], middle[1], 0.0))
    return replace(scan, vertices=moved, tilt=scan.tilt + math.asin(min(sine, 1.0)))


def decimated(scan: Scan, triangles: int) -> Scan:
    """Return the scan with about as many triangles, by quadric edge collapse (Garland and Heckbert, SIGGRAPH 1997).

    Args:
        scan: with merged vertices (:func:`cleaned`).
        triangles: number that is wanted; a scan that has fewer is returned as it is.

    Raises:
        ArgumentError: the number is below four.
        ConfigurationError: the package fast-simplification is not installed.
    """
    if triangles < 4:
        raise ArgumentError(f"a scan cannot be decimated to {triangles} triangles: give four or more")
    if len(scan.faces) <= triangles:
        return scan
    try:
        fast_simplification = importlib.import_module("fast_simplification")
    except ImportError:
        raise ConfigurationError(
            f"decimating a scan needs the package fast-simplification: {install_extra('scan')}"
        ) from None
    points = np.ascontiguousarray(scan.vertices, dtype=np.float32)
    faces = np.ascontiguousarray(scan.faces, dtype=np.int32)
    vertices, kept = fast_simplification.simplify(points, faces, target_count=triangles)
    coarse = replace(scan, vertices=np.asarray(vertices, dtype=np.float64), labels=None)
    return _relabelled(_compact(coarse, np.asarray(kept)), scan)


def cut_out(scan: Scan, pose: Pose, half_extents: tuple[float, float, float]) -> Scan:
    """Remove what is within a box, where an object of one's own is to stand.

    Triangles that reach into the box by a corner or their middle go as a whole: the edge is as fine as they are.

    Args:
        scan: to be cut.
        pose: of the box's middle.
        half_extents: of the box, m.
    """
    inverse, half = pose.inverse(), np.asarray(Box(half_extents).half_extents)
    within = (np.abs(inverse.transform(scan.vertices)) <= half).all(1)
    middles = (np.abs(inverse.transform(scan.corners.mean(1))) <= half).all(1)
    reached = np.asarray(within)[scan.faces].any(1) | middles
    left = _compact(replace(scan, labels=None), scan.faces[~reached])
    return left if scan.labels is None else replace(left, labels=scan.labels[~reached])


def _compact(scan: Scan, faces: npt.NDArray[np.integer]) -> Scan:
    """Return the scan with these faces, and the vertices that they use."""
    used, numbers = np.unique(faces, return_inverse=True)
    return replace(scan, vertices=scan.vertices[used], faces=numbers.reshape(-1, 3))
