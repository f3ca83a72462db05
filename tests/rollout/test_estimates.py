"""Estimates hold the truth behind a sample as often as they say."""

from __future__ import annotations

import math

import pytest

from orbit_core.rollout.estimates import mean, proportion


def test_wilsons_interval_is_the_published_one() -> None:
    """Newcombe, Two-sided confidence intervals for the single proportion, Statistics in Medicine 17 (1998), table I."""
    for successes, trials, low, high in ((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611)):
        found = proportion(successes, trials)
        assert (found.low, found.high) == pytest.approx((low, high), abs=6e-5)


def test_the_interval_of_a_mean_shrinks_with_the_sample() -> None:
    values = [math.sin(7.0 * n) for n in range(400)]
    few, many = mean(values[:25]), mean(values)
    assert few.low < few.value < few.high
    assert many.high - many.low < 0.5 * (few.high - few.low)
    # Half the interval is about two standard errors: sqrt(1/2) / sqrt(400) each.
    assert many.high - many.low == pytest.approx(4 * 0.7071 / 20, rel=0.15)
