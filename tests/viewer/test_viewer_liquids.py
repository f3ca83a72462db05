"""Surfaces of liquids that the browser draws."""

from __future__ import annotations

import numpy as np
import pytest

from orbit_core.scene import Fluid
from orbit_viewer.liquids import liquid_surface

WATER = Fluid("water", (0.05, 0.05, 0.05), spacing=0.01)


def _volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, corner]].astype(float) for corner in range(3))
    return float((np.cross(a, b) * c).sum()) / 6.0


def test_the_surface_of_a_liquid_is_closed_faces_outwards_and_holds_its_volume() -> None:
    shaken = WATER.rest_positions + np.random.default_rng(0).normal(0.0, 0.0015, (1000, 3))
    vertices, faces = liquid_surface(shaken.astype(np.float32), WATER.spacing)
    sides = np.sort(np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]])), axis=1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] % 2 == 0).all(), "each side has another on its other hand"
    assert _volume(vertices, faces) == pytest.approx(1e-3, rel=0.06)


def test_drops_far_away_are_drawn_at_their_places() -> None:
    particles = np.array([[0.0, 0.0, 0.0], [50.0, -20.0, 3.0]], dtype=np.float32)
    vertices, _ = liquid_surface(particles, 0.01)
    for drop in particles:
        near = vertices[np.abs(vertices - drop).max(axis=1) < 0.02]
        assert len(near) == len(vertices) // 2
        assert near.mean(axis=0) == pytest.approx(drop, abs=2e-5)


def test_nothing_is_drawn_of_what_has_diverged() -> None:
    vertices, faces = liquid_surface(np.full((4, 3), np.nan, dtype=np.float32), 0.01)
    assert len(vertices) == len(faces) == 0
