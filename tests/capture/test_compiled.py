"""Compiled graphs and the cache of their code on disk."""

import pytest
import torch
from torch import Tensor, fx
from torch._dynamo.utils import counters
from torch._inductor.utils import fresh_cache

from orbit_core.capture.replay import compiled


class _Doubled(torch.nn.Module):
    def forward(self, given: Tensor, kept: Tensor) -> tuple[Tensor]:
        kept.copy_(given * 2.0)
        return (torch.sin(kept) + torch.arange(3.0),)


@pytest.mark.parametrize("fixed", [False, True])
def test_code_compiled_once_is_taken_from_disk(fixed: bool) -> None:
    found: list[tuple[int, int]] = []
    with fresh_cache():
        for _ in range(2):
            torch._dynamo.reset()
            counters.clear()
            given, kept = torch.tensor([0.1, 0.2, 0.3]), torch.zeros(3)
            (result,) = compiled(fx.symbolic_trace(_Doubled()), [given, kept], fixed)(given, kept)
            found.append((counters["inductor"]["fxgraph_cache_miss"], counters["inductor"]["fxgraph_cache_hit"]))
            assert torch.equal(kept, 2.0 * given)
            assert torch.allclose(result, torch.sin(kept) + torch.arange(3.0))
    assert found == [(1, 0), (0, 1)]
