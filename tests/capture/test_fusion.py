"""Functions made into one kernel give what torch gives."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from orbit_core.capture.fusion import Fused, fusing
from orbit_core.dynamics.linear import solve_spd
from orbit_core.dynamics.transforms import pose_error, quat_from_matrix, quat_to_matrix

Given = Callable[..., tuple[Tensor, ...]]


def compared(function: Given, **inputs: Tensor) -> Fused:
    """Both ways, on all rows and on ten, which do not fill the registers."""
    for count in (37, 10):
        fused = Fused(function)
        rows = {name: tensor[:count] for name, tensor in inputs.items()}
        with fusing(True):
            made = fused(**rows)
        assert not fused.refusal
        for one, other in zip(made, function(**rows), strict=True):
            assert one.shape == other.shape
            torch.testing.assert_close(one, other, rtol=2e-4, atol=2e-4)
    return fused


def random(*shape: int) -> Tensor:
    return torch.randn(37, *shape, generator=torch.Generator().manual_seed(sum(shape)))


def test_parts_of_environments() -> None:
    def function(own: Tensor, env: Tensor, part: Tensor) -> tuple[Tensor, ...]:
        both = own * env + part.square()
        return both, (own.unsqueeze(-1) @ env.unsqueeze(-2)).sum(-1) - part

    own, env, part = random(5, 3), random(1, 3), random(5, 3)[:1]
    fused = Fused(function, in_parts=True)
    with fusing(True):
        made = fused(own=own, env=env, part=part)
    assert fused.operations, fused.refusal
    for one, other in zip(made, function(own, env, part), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5)


_MEMORY = random(3)


def test_elementwise_and_reductions() -> None:
    constant = torch.tensor([[0.0, 1.0, -1.0], [2.5, 0.0, -3.0]])

    def function(a: Tensor, b: Tensor, chosen: Tensor) -> tuple[Tensor, ...]:
        c = a * constant + b.unsqueeze(1) / (1.5 + b.unsqueeze(1).square())
        d = torch.where(chosen, c.sin(), torch.atan2(c, 2.0 - a))
        e = torch.clamp(d, -0.4, 0.5).pow(3) + torch.copysign(a, c) - (a > 0.2) * a.abs().sqrt()
        f = torch.minimum(c, d).amax(1) + torch.linalg.vector_norm(c, dim=(1, 2)).unsqueeze(1)
        return e, f, torch.maximum(a, c).sum(1, keepdim=True), torch.linalg.cross(a, c).cos().amin((1, 2))

    compared(function, a=random(2, 3), b=random(3), chosen=random(2, 3) > 0.0)


def test_matrices() -> None:
    def function(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        spd = a @ a.mT + 3.0 * torch.eye(4)
        return solve_spd(spd, b), torch.diag_embed(spd.diagonal(dim1=1, dim2=2)) @ a - torch.baddbmm(a, a, spd).mT

    compared(function, a=random(4, 4), b=random(4, 2))


def test_rotations() -> None:
    def function(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        first, second = (torch.cat((p[:, :3], p[:, 3:] / p[:, 3:].norm(dim=1, keepdim=True)), 1) for p in (a, b))
        return pose_error(first, second), quat_from_matrix(quat_to_matrix(first[:, 3:]))

    compared(function, a=random(7), b=random(7).flip(0))


def test_what_is_zero_or_occurs_twice_costs_nothing() -> None:
    mask = torch.tensor([0.0, 1.0, 0.0])
    fused = compared(lambda a: ((a * mask).sum(1, keepdim=True) + (mask * a).sum(1, keepdim=True),), a=random(3))
    assert fused.operations == 1


@pytest.mark.parametrize(
    ("function", "told"),
    [
        (lambda a: (a.cumsum(1),), "'cumsum'"),
        (lambda a: (a + _MEMORY,), "for one environment"),
        (lambda a: (a[a > 0.0],), "cannot be followed"),
    ],
    ids=["unknown operation", "memory taken for a constant", "shapes that depend on values"],
)
def test_what_cannot_be_followed_runs_as_it_is(function: Given, told: str) -> None:
    fused, a = Fused(function), random(3)
    with fusing(True):
        made = fused(a=a)
    assert told in fused.refusal
    torch.testing.assert_close(made, function(a=a))
