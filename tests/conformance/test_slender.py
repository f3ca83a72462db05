"""The truths of ropes and cloths agree with the simpler ones that they end in."""

from __future__ import annotations

import math

import pytest

from orbit_conformance.slender import Edge, catenary, chain_period, elastica_droop, loaded_chain_period

G = 9.81


def test_a_catenary_has_its_length_and_a_tight_one_the_sag_of_a_parabola() -> None:
    a = catenary(0.6, 0.4)
    assert 2 * a * math.sinh(0.2 / a) == pytest.approx(0.6, rel=1e-9)
    assert a * (math.cosh(0.2 / a) - 1.0) == pytest.approx(0.20105, abs=1e-5)
    span, length = 1.0, 1.001
    tight = catenary(length, span)
    assert tight * (math.cosh(0.5 * span / tight) - 1.0) == pytest.approx(
        math.sqrt(3 / 8 * span * (length - span)), rel=1e-3
    )


def test_a_loaded_chain_is_a_chain_without_its_load_and_a_pendulum_with_a_heavy_one() -> None:
    assert loaded_chain_period(0.5, 0.05, 1e-5, G) == pytest.approx(chain_period(0.5, G), rel=2e-3)
    assert loaded_chain_period(0.5, 1e-6, 1.0, G) == pytest.approx(2 * math.pi * math.sqrt(0.5 / G), rel=1e-5)


def test_a_stiff_strip_droops_as_a_beam_and_a_limp_one_nearly_hangs() -> None:
    length, weight = 0.1, 1.962
    assert elastica_droop(length, weight, 1.0) == pytest.approx(weight * length**4 / 8.0, rel=1e-4)
    assert 0.9 * length < elastica_droop(length, weight, 4e-5) < length


def test_a_strip_over_a_sharp_edge_slides_at_the_capstans_ratio() -> None:
    length, friction = 0.4, 0.3
    limit = Edge(length, 1e-6, friction, G).limit
    assert limit / (length - limit) == pytest.approx(friction * math.exp(friction * 0.5 * math.pi), rel=1e-4)


def test_a_strip_over_a_smooth_edge_falls_as_its_hanging_part_pulls() -> None:
    """Without friction ``L a = g (L2 + R)``: gravity pulls at the hanging part, and at the arc along its height."""
    edge = Edge(0.4, 0.03, 0.0, G)
    assert edge.acceleration(0.2, 0.0) == pytest.approx(G * 0.23 / 0.4, rel=1e-6)
    start = 0.01
    assert edge.slid(0.2, [start])[0] == pytest.approx(0.5 * G * 0.23 / 0.4 * start**2, rel=1e-3)
