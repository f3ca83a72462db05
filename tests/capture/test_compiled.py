"""Compiled graphs and the cache of their code on disk."""

from collections.abc import Callable, Sequence
from functools import partial

import pytest
import torch
from torch import Tensor, fx
from torch._dynamo.utils import counters
from torch._inductor.utils import fresh_cache

from orbit_core.capture.replay import _by_inductor, compiled


class _Doubled(torch.nn.Module):
    def forward(self, given: Tensor, kept: Tensor) -> tuple[Tensor]:
        kept.copy_(given * 2.0)
        return (torch.sin(kept) + torch.arange(3.0),)


Compile = Callable[[fx.GraphModule, list[Tensor]], Callable[..., Sequence[Tensor]]]


@pytest.mark.parametrize(
    "compile",
    [partial(compiled, fixed=False), partial(compiled, fixed=True), _by_inductor],
    ids=["cpu", "cpu_fixed", "gpu"],  # the way of a GPU, which takes tensors of any device
)
def test_code_compiled_once_is_taken_from_disk(compile: Compile) -> None:
    found: list[tuple[int, int]] = []
    with fresh_cache():
        for _ in range(2):
            torch._dynamo.reset()
            counters.clear()
            given, kept = torch.tensor([0.1, 0.2, 0.3]), torch.zeros(3)
            (result,) = compile(fx.symbolic_trace(_Doubled()), [given, kept])(given, kept)
            found.append((counters["inductor"]["fxgraph_cache_miss"], counters["inductor"]["fxgraph_cache_hit"]))
            assert torch.equal(kept, 2.0 * given)
            assert torch.allclose(result, torch.sin(kept) + torch.arange(3.0))
    assert found == [(1, 0), (0, 1)]
