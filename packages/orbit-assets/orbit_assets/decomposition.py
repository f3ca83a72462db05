"""Convex decomposition of meshes, which every engine collides exactly; each is computed once and cached on disk.

By CoACD: Wei, Liu, Ling and Su, Approximate convex decomposition for 3D meshes with collision-aware concavity and tree
search, ACM Transactions on Graphics, 2022.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_assets.cache import cache_folder, digest_arrays, write_cached
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import ArgumentError, AssetError, StorageError
from orbit_core.interfaces.layout import home_positions
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.scene_data import check_mesh, extents
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Articulation, Box, Capsule, Cylinder, Entity, Mesh, Pose, Shape, Sphere
from orbit_core.scene.pose import FloatArray

# Distances between convex shapes, by the algorithm of Gilbert, Johnson and Keerthi ------------------------------------
# Gilbert, Johnson and Keerthi, A fast procedure for computing the distance between complex objects in three-dimensional
# space, IEEE Journal on Robotics and Automation, 1988. The nearest point of a simplex is found among all its faces
# (Johnson's subalgorithm).

# GJK converges in fewer than ten rounds on the shapes of robots; this bound stops numerical cycles.
_ROUNDS = 64
# Metres below which a distance counts as none, and to which distances are found.
_EXACT = 1e-9


@dataclass(frozen=True, eq=False)
class Convex:
    """The points within ``radius`` of a convex core.

    The core is the hull of ``points`` (P, 3), each the centre of a disc with the normal ``axis`` and the radius
    ``disc`` where that is not zero. A ball's core is a point, a capsule's two, a cylinder's two discs.
    """

    points: FloatArray
    radius: float = 0.0
    disc: float = 0.0
    axis: FloatArray | None = None

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the greatest corner (3,) of the box along the axes that holds the shape."""
        reach = np.full(3, self.radius)
        if self.axis is not None:
            # Support of a disc along each axis: its radius times the sine of the angle to its normal.
            reach = reach + self.disc * np.sqrt(np.clip(1.0 - np.square(self.axis), 0.0, 1.0))
        return self.points.min(0) - reach, self.points.max(0) + reach

    def support(self, direction: FloatArray) -> FloatArray:
        """Return the point (3,) of the core that is farthest along ``direction``."""
        farthest = self.points[int(np.argmax(self.points @ direction))]
        if self.axis is None:
            return farthest
        across = direction - (direction @ self.axis) * self.axis
        length = float(np.linalg.norm(across))
        return farthest + (self.disc / length) * across if length > 0.0 else farthest


def convex_shape(shape: Shape, place: Pose) -> Convex | None:
    """Return the shape of a link at ``place``, a mesh as its hull; ``None`` for ground and terrain."""
    pose = place @ shape.pose
    match shape.geometry:
        case Box(half_extents=half):
            corners = np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * half
            return Convex(pose.transform(corners))
        case Sphere(radius=radius):
            return Convex(pose.transform(np.zeros((1, 3))), radius)
        case Capsule(radius=radius, half_length=half):
            return Convex(pose.transform(_ends(half)), radius)
        case Cylinder(radius=radius, half_length=half):
            return Convex(pose.transform(_ends(half)), disc=radius, axis=pose.rotation_matrix()[:, 2])
        case Mesh(vertices=vertices):
            return Convex(pose.transform(np.asarray(vertices, dtype=np.float64)))
        case _:
            return None


def distance(first: Convex, second: Convex) -> float:
    """Return the distance (m) between two shapes; zero where they overlap, however deep."""
    return max(0.0, _core_distance(first, second, np.inf) - first.radius - second.radius)


def within(first: Convex, second: Convex, reach: float) -> bool:
    """Return True if two shapes come within ``reach`` (m) of each other; quicker than their distance."""
    # Bounding boxes first: most pairs of links are far apart.
    (low, high), (least, most) = first.bounds(), second.bounds()
    if np.any(high + reach < least) or np.any(most + reach < low):
        return False
    between = reach + first.radius + second.radius
    return _core_distance(first, second, between) <= between


def _core_distance(first: Convex, second: Convex, enough: float) -> float:
    """Return the distance (m) of the cores, or a lower bound of it that exceeds ``enough``."""
    simplex = (first.points[0] - second.points[0])[None]
    nearest = simplex[0]
    for _ in range(_ROUNDS):
        length = float(np.linalg.norm(nearest))
        if length < _EXACT:
            return 0.0
        support = first.support(-nearest) - second.support(nearest)
        bound = float(support @ nearest) / length
        # The separating plane alone proves the distance: no need for the exact one.
        if bound > enough:
            return bound
        if length - bound < _EXACT:
            return length
        nearest, simplex = _nearest(np.concatenate([simplex, support[None]]))
    return float(np.linalg.norm(nearest))


def _nearest(simplex: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the point of a simplex (P, 3) nearest to the origin, and the corners of the face that contains it."""
    best, face, least = simplex[-1], simplex[-1:], np.inf
    # At most 4 corners span a face in three dimensions.
    for count in range(1, min(len(simplex), 4) + 1):
        for chosen in combinations(range(len(simplex)), count):
            corners = simplex[list(chosen)]
            point = _foot(corners)
            if point is not None and (square := float(point @ point)) < least:
                best, face, least = point, corners, square
    return best, face


def _foot(corners: FloatArray) -> FloatArray | None:
    """Return the point of the plane, line or space through ``corners`` nearest to the origin, if it is between them."""
    if len(corners) == 1:
        return corners[0]
    edges = corners[1:] - corners[0]
    gram = edges @ edges.T
    scale = np.trace(gram)
    if np.linalg.det(gram) <= 1e-14 * scale ** len(edges):
        return None  # a flat simplex: one of its faces holds the point as well
    weights = np.linalg.solve(gram, -edges @ corners[0])
    if np.any(weights < 0.0) or weights.sum() > 1.0:
        return None
    return corners[0] + weights @ edges


def _ends(half_length: float) -> FloatArray:
    return np.array([[0.0, 0.0, -half_length], [0.0, 0.0, half_length]])


# Links of one robot that touch each other at home ---------------------------------------------------------------------
# A robot that collides with itself must not do so at home: contact would push its links apart from the first step on.
# Files often have such pairs, for their collision shapes are wider than the parts (hulls of a wrist and the link before
# the last), or for the real thing is built into a recess. These pairs are taken out of collision, and noted.

# Metres between links that count as touching: a drive that holds home lets them move by as much.
_CLEARANCE = 1e-3


def without_home_contacts(articulation: Articulation, home: Mapping[str, float]) -> Articulation:
    """Exclude collision of each pair of links that touch at home, with a note of them.

    Links touch where their collision shapes come within a millimetre of each other; meshes count as their convex
    hulls. Links that a joint connects never collide anyway. Whether the links collide with each other at all is left
    to ``self_collisions``.

    Args:
        articulation: the description.
        home: joint positions (rad, m) by regular expression over joint names (full match), zero or the nearest limit
            elsewhere.

    Raises:
        UnknownNameError: a key of ``home`` matches no joint.
        ConfigurationError: a position is outside its joint's limits.
    """
    merged = merge_fixed_links(articulation)  # links that fixed joints connect are one body
    at_home = home_positions(Entity(name=articulation.name, articulation=merged, home=home))
    positions = dict(zip(merged.joint_names, at_home.tolist(), strict=True))
    pairs = tuple(touching_links(merged, positions))
    if not pairs:
        return articulation
    told = ", ".join(f"{first} with {second}" for first, second in pairs)
    note = f"links that touch each other at home do not collide: {told}"
    return replace(
        articulation,
        collision_exclusions=(*articulation.collision_exclusions, *pairs),
        notes=(*articulation.notes, note),
    )


def touching_links(articulation: Articulation, positions: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """Yield pairs of links that touch at joint positions (rad, m), without joined and excluded ones.

    Links must be in topological order.
    """
    apart = {frozenset(pair) for pair in (*articulation.joined_links, *articulation.collision_exclusions)}
    shapes = _placed(articulation, positions)
    for first, second in combinations(shapes, 2):
        if frozenset((first, second)) not in apart and any(
            within(one, other, _CLEARANCE) for one in shapes[first] for other in shapes[second]
        ):
            yield first, second


def _placed(articulation: Articulation, positions: Mapping[str, float]) -> dict[str, list[Convex]]:
    """Return the collision shapes in the root's frame, of the links that have any."""
    poses = link_poses(articulation, positions)
    placed = {
        link.name: [convex_shape(shape, poses[link.name]) for shape in link.collisions] for link in articulation.links
    }
    return {name: found for name, shapes in placed.items() if (found := [shape for shape in shapes if shape])}


_Pieces = list[tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]]


@dataclass(frozen=True, kw_only=True)
class ConvexDecomposition:
    """Settings of a convex decomposition."""

    concavity: float = 0.05
    """The most by which pieces may differ from the surface, as a share of half the mesh's longest side: 0.01 to 1."""
    max_pieces: int | None = None
    """Pieces are merged until no more are left, whatever the concavity then is."""
    time_limit: float = 600.0
    """Seconds that a split may take; what the cache holds takes none."""


def convex_pieces(
    mesh: Mesh, settings: ConvexDecomposition = ConvexDecomposition(), *, where: str = "the mesh"
) -> tuple[Mesh, ...]:
    """Split the mesh into convex pieces in its own frame; use ORBIT's cache where the same mesh was split so before.

    Args:
        mesh: any triangle mesh; one that is not closed is closed first.
        settings: how finely it is split.
        where: its name, for messages.

    Raises:
        AssetError: it is no mesh of finite points, it encloses no volume, the settings cannot be, the split takes
            longer than its limit, or the package ``coacd`` is not installed.
    """
    most = settings.max_pieces
    if not settings.time_limit > 0.0:
        raise AssetError(f"{where} cannot be split by {settings}: give a time limit above zero")
    if not 0.01 <= settings.concavity <= 1.0 or not (most is None or (isinstance(most, int) and most >= 1)):
        raise AssetError(f"{where} cannot be split by {settings}: give a concavity of 0.01 to 1 and at least one piece")
    try:
        check_mesh(mesh, where)  # CoACD does not check indices: it would read memory outside the mesh
    except ArgumentError as error:
        raise AssetError(str(error)) from None
    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float64)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int64)
    # The settings are part of the key, and 0 pieces means no limit.
    limits = np.array((settings.concavity, settings.max_pieces or 0), dtype=np.float64)
    path = cache_folder() / "decompositions" / f"{digest_arrays(vertices, faces, limits)}.npz"
    pieces = _stored(path)
    if pieces is None:
        pieces = _split(vertices, faces, settings, where)
        _store(path, pieces)
    return tuple(Mesh(*piece) for piece in pieces)


def _split(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64], settings: ConvexDecomposition, where: str
) -> _Pieces:
    """Split the mesh, with a status line on the terminal."""
    from rich.console import Console
    from rich.text import Text

    if importlib.util.find_spec("coacd") is None:
        raise AssetError(
            f"{where} asks for convex pieces, which need the package coacd: {install_extra('decomposition')}, "
            "or have it collide as its hull"
        )
    if extents(vertices) < 3:
        raise _failed(where, "it lies in a plane")
    with ScratchFolder("orbit-decomposition-") as folder:
        np.savez(folder / "mesh.npz", vertices=vertices, faces=faces)
        with Console(stderr=True).status(Text(f"splitting {where} into convex pieces ({len(faces)} triangles)")):
            _run(folder, settings, where)
        with np.load(folder / "pieces.npz", allow_pickle=False) as file:
            pieces = _read(file)
    # CoACD sometimes gives flat slivers, which engines reject as hulls.
    solid = [piece for piece in pieces if extents(piece[0]) == 3]
    if not solid:
        raise _failed(where, "no piece has a volume")
    return solid


def _run(folder: Path, settings: ConvexDecomposition, where: str) -> None:
    """Split the mesh of this folder in a separate process, which is ended at the time limit."""
    script = str(Path(__file__).with_name("split_process.py"))
    # A process, for CoACD can neither be interrupted nor survives all meshes; -P keeps the folder of the script off
    # sys.path.
    command = [
        sys.executable,
        "-P",
        script,
        str(folder),
        str(float(settings.concavity)),
        str(settings.max_pieces or -1),
    ]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=settings.time_limit, check=False
        )
    except subprocess.TimeoutExpired:
        raise AssetError(
            f"{where} was not split into convex pieces within {settings.time_limit:g} s: give it fewer triangles, a "
            f"concavity above {settings.concavity:g} or a longer time_limit, or have it collide as its hull"
        ) from None
    if done.returncode != 0:
        told = done.stderr.strip().splitlines()
        raise _failed(where, told[-1] if told else f"the process that splits it ended with {done.returncode}")


def _failed(where: str, reason: str) -> AssetError:
    return AssetError(
        f"{where} could not be split into convex pieces ({reason}): close its surface in its file, or have it collide "
        "as its hull"
    )


def _stored(path: Path) -> _Pieces | None:
    """Return the pieces in the cache; None if there are none, or the file is damaged."""
    try:
        with np.load(path, allow_pickle=False) as file:
            found = _read(file)
        for piece in found:
            check_mesh(Mesh(*piece), "a piece")
    except (
        OSError,
        EOFError,
        ValueError,
        KeyError,
        NotImplementedError,
        zlib.error,
        zipfile.BadZipFile,
        ArgumentError,
    ):
        return None
    return found or None


def _read(file: Mapping[str, npt.NDArray[Any]]) -> _Pieces:
    return [
        (np.asarray(file[f"vertices_{number}"], np.float64), np.asarray(file[f"faces_{number}"], np.int64))
        for number in range(len(file) // 2)
    ]


def _store(path: Path, pieces: _Pieces) -> None:
    arrays: dict[str, npt.NDArray[np.generic]] = {}
    for number, (vertices, faces) in enumerate(pieces):
        arrays |= {f"vertices_{number}": vertices, f"faces_{number}": faces}
    try:
        write_cached(path, lambda file: np.savez(file, allow_pickle=False, **arrays))
    except (StorageError, OSError):
        return  # a cache that cannot be written costs time at the next start, only
