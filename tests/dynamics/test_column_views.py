"""Columns that are viewed once, and vectors that are turned together, against the plain operations."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch

from orbit_core.dynamics.indexing import ColumnView, columns_of
from orbit_tasks import walking

CPU = torch.device("cpu")


@pytest.mark.parametrize("indices", [[1, 2], [2, 0]])
def test_columns_follow_the_tensor_that_is_given(indices: list[int]) -> None:
    view, first = ColumnView(columns_of(indices, CPU)), torch.arange(8.0).reshape(2, 4)
    assert torch.equal(view.read(first), first[:, indices])
    first += 1.0
    assert torch.equal(view.read(first), first[:, indices])
    second = torch.zeros(2, 4)
    view.write(second, torch.ones(2, 2))
    assert torch.equal(second[:, indices], torch.ones(2, 2))
    assert second.sum() == 4.0
    assert torch.equal(view.read(first), first[:, indices])


@pytest.mark.parametrize("num_envs", [1, 7])
def test_a_trunk_s_vectors_are_turned_together_to_the_same_bits(num_envs: int) -> None:
    generator = torch.Generator().manual_seed(0)
    pose = torch.nn.functional.normalize(torch.randn(num_envs, 7, generator=generator), dim=1)
    robot = cast(Any, SimpleNamespace(root_pose=pose, root_velocity=torch.randn(num_envs, 6, generator=generator)))
    together = walking.trunk_motion(robot)
    alone = [walking.linear_velocity(robot), walking.angular_velocity(robot), walking.projected_gravity(robot)]
    assert torch.equal(together, torch.stack(alone, 1))
