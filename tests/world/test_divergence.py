"""Numbers that no simulation can mean count as diverged."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_core.interfaces import diverged, divergence_error


@pytest.mark.parametrize("bad", [math.nan, math.inf, 2e6, -2e6])
def test_positions_beyond_the_bounds_and_no_numbers_are_found(bad: float) -> None:
    positions = torch.zeros(3, 4, 7)
    positions[1, 2, 0] = bad
    assert diverged(positions, torch.full((3, 4, 6), 9e3)).tolist() == [False, True, False]


def test_velocities_beyond_the_bounds_are_found_and_what_has_no_joints_is_fine() -> None:
    velocities = torch.zeros(2, 5)
    velocities[0, 4] = -2e4
    assert diverged(torch.zeros(2, 5), velocities).tolist() == [True, False]
    assert not diverged(torch.zeros(2, 0), torch.zeros(2, 0)).any()


def test_the_error_names_the_environments_and_the_remedy() -> None:
    assert "environments 3, 5 diverged" in str(divergence_error([3, 5]))
    assert "environments that were reset since diverged" in str(divergence_error([]))
    assert "0, 1, 2, 3, 4, 5, 6, 7, ..." in str(divergence_error(range(20)))
