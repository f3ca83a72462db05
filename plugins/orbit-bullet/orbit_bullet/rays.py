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
# Shapes that a ray may meet, its own links among them, before what else it meets is not looked at.
_MOST_SURFACES = 32
# Body, link and share of the ray's length, as of a hit.
_MISS = (-1, -1, 1.0)
# Part of a stretch that the next repeats: a ray meets no height field that its stretch ends or begins on.
_OVERLAP = 1e-3


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
        # Rays that met something are done; with few left the later stretches cost little.
        searching, begun = searching[~met], begun + (1.0 - _OVERLAP) * length


def _cast_past(stage: Stage, start: FloatArray, end: FloatArray, mask: int, past: range) -> list[Any]:
    """The nearest hit of each ray that is not on a link of ``past``.

    A ray that begins within a shape does not leave it, so that no second ray can go on behind the first one's hit.
    Bullet numbers what a ray meets in no order: of rays that meet their own links first, all hits are looked at.
    """
    hits = _cast(stage.client, start, end, mask)
    searching = [ray for ray, hit in enumerate(hits) if _link(stage, hit) in past]
    for ray in searching:
        hits[ray] = _MISS
    for number in range(_MOST_SURFACES):
        if not searching:
            break
        numbered = dict(
            zip(searching, _cast(stage.client, start[searching], end[searching], mask, number), strict=True)
        )
        searching = [ray for ray, hit in numbered.items() if hit[0] >= 0]
        for ray in searching:
            if numbered[ray][2] < hits[ray][2] and _link(stage, numbered[ray]) not in past:
                hits[ray] = numbered[ray]
    return hits


def _cast(client: Any, start: FloatArray, end: FloatArray, mask: int, number: int = -1) -> list[Any]:
    """The nearest hit of each ray, or that of a number, in no order; one of body -1 is none."""
    hits: list[Any] = []
    for first in range(0, len(start), RAYS_PER_CALL):
        part = slice(first, first + RAYS_PER_CALL)
        ends = start[part].tolist(), end[part].tolist()
        hits += client.rayTestBatch(*ends, collisionFilterMask=mask, reportHitNumber=number)
    return hits


def _link(stage: Stage, hit: Any) -> int:
    return stage.places.get((hit[0], hit[1]), (0, BACKGROUND))[1]
