"""Rays of several environments in one Bullet world."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet.stage import Stage
from orbit_core.interfaces import BACKGROUND

FloatArray = npt.NDArray[np.floating]
RAYS_PER_CALL = 16_000
"""Bullet's own bound is 16,384."""
_MOST_SURFACES = 32
"""Shapes of links to be passed that a ray may meet before it counts as a miss."""
_OVERLAP = 1e-3
"""Part of a stretch that the next repeats: a ray meets no height field that its stretch ends or begins on."""


def cast_rays(
    stage: Stage, slots: npt.NDArray[np.int64], origins: FloatArray, directions: FloatArray, reach: float, past: range
) -> tuple[npt.NDArray[Any], ...]:
    """Distances (n, R), normals (n, R, 3) and links (n, R) of rays (n, R, 3), each among its own environment.

    Rays pass through the links ``past``. A deformable stops a ray, as a link of no number.
    """
    shape = origins.shape[:2]
    distances, normals = np.full(shape, np.inf, np.float32), np.zeros((*shape, 3), np.float32)
    links = np.full(shape, BACKGROUND, np.int64)
    for row, slot in enumerate(slots):
        start = origins[row] + stage.origins[slot]
        along = directions[row].astype(np.float64)
        for ray, distance, hit in _meet(stage, start, along, reach, stage.ray_mask(slot), past):
            links[row, ray] = _link(stage, hit)
            distances[row, ray] = distance
            normals[row, ray] = hit[4]
    return distances, normals, links


def _meet(
    stage: Stage, start: FloatArray, directions: FloatArray, reach: float, mask: int, past: range
) -> Iterator[tuple[int, float, Any]]:
    """Number, distance and hit of each ray that meets something, looked for in one stretch after another."""
    searching, begun = np.arange(len(start)), 0.0
    while len(searching) and reach - begun > _OVERLAP * min(reach, stage.ray_stretch):
        length = min(reach - begun, stage.ray_stretch)
        along = directions[searching]
        begin = start[searching] + begun * along
        hits = _cast_past(stage, begin, begin + length * along, mask, past)
        met = np.array([hit[0] >= 0 for hit in hits])
        yield from ((searching[n], begun + hits[n][2] * length, hits[n]) for n in met.nonzero()[0])
        searching, begun = searching[~met], begun + (1.0 - _OVERLAP) * length


def _cast_past(stage: Stage, start: FloatArray, end: FloatArray, mask: int, past: range) -> list[Any]:
    """The first hit of each ray that is not on a link of ``past``.

    A ray that begins within a shape does not leave it, so that no second ray can go on behind the first one's hit.
    """
    hits = _cast(stage.client, start, end, mask)
    for number in range(1, _MOST_SURFACES):
        own = [ray for ray, hit in enumerate(hits) if hit[0] >= 0 and _link(stage, hit) in past]
        if not own:
            break
        for ray, hit in zip(own, _cast(stage.client, start[own], end[own], mask, number), strict=True):
            hits[ray] = hit
    return hits


def _cast(client: Any, start: FloatArray, end: FloatArray, mask: int, number: int = -1) -> list[Any]:
    """The first hit of each ray, or that of a number, in the order of distance."""
    hits: list[Any] = []
    for first in range(0, len(start), RAYS_PER_CALL):
        part = slice(first, first + RAYS_PER_CALL)
        ends = start[part].tolist(), end[part].tolist()
        hits += client.rayTestBatch(*ends, collisionFilterMask=mask, reportHitNumber=number)
    return hits


def _link(stage: Stage, hit: Any) -> int:
    return stage.places.get((hit[0], hit[1]), (0, BACKGROUND))[1]
