"""Failures of the contract tests say what was measured, what is true, and which way it is off."""

from __future__ import annotations

import pytest
import torch

from orbit_conformance.contract.fixtures import assert_near


@pytest.mark.parametrize(("measured", "way"), [(0.25, "0.05 above the truth 0.2"), (0.1, "0.1 below the truth 0.2")])
def test_a_miss_is_told_with_its_direction(measured: float, way: str) -> None:
    with pytest.raises(AssertionError, match=rf"element \[1\] is {measured}.*{way} where 0.01 is allowed; 1 of 2"):
        assert_near(torch.tensor([1.0, measured]).double(), torch.tensor([1.0, 0.2]).double(), atol=0.01)


def test_what_is_not_a_number_is_never_near() -> None:
    with pytest.raises(AssertionError, match="not a number"):
        assert_near(torch.tensor([torch.nan]), torch.tensor([0.0]), atol=torch.inf)


def test_what_is_near_passes() -> None:
    assert_near(torch.tensor([1.009, 2.0]), torch.tensor([1.0, 2.0]), rtol=0.01)
