"""Matrix products whose rows do not depend on how many there are."""

from __future__ import annotations

import os

import pytest
import torch

from orbit_core.dynamics.linear import products_ignore_other_rows
from orbit_core.scene import Scene
from orbit_core.world import simulate


@pytest.mark.skipif(not torch.backends.mkl.is_available(), reason="no MKL: its strict mode is what this holds")
def test_a_row_of_a_product_is_the_same_among_any_number_of_rows() -> None:
    assert "STRICT" in os.environ["MKL_CBWR"]
    if not products_ignore_other_rows():
        pytest.skip("MKL has no strict mode on this processor")
    generator = torch.Generator().manual_seed(0)
    for inner, outer in ((3, 3), (7, 6), (21, 13), (38, 256), (256, 256)):
        rows, weights, bias = (
            torch.randn(*shape, generator=generator) for shape in ((33, inner), (inner, outer), (outer,))
        )
        whole, shifted, turned = rows @ weights, torch.addmm(bias, rows, weights), weights.T @ rows.T
        for count in (1, 2, 3, 5, 8, 16):
            few = rows[:count].contiguous()
            assert torch.equal(few @ weights, whole[:count])
            assert torch.equal(torch.addmm(bias, few, weights), shifted[:count])
            assert torch.equal(weights.T @ few.T.contiguous(), turned[:, :count])


def test_a_world_warns_where_products_depend_on_the_number_of_environments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orbit_core.world.world.products_ignore_other_rows", lambda: False)
    with pytest.warns(UserWarning, match="import orbit_core before torch multiplies anything"):
        simulate(Scene(), 1, "mujoco").close()
