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
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_assets.cache import cache_folder, digest_arrays, write_cached
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import ArgumentError, AssetError, StorageError
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_core.preparation.scene_data import check_mesh, extents
from orbit_core.scene import Mesh

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
