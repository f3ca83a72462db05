"""Traced stages repeat what ran, also where tensors that one stage makes share memory in the next."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_core.capture.trace import CapturedTrace, NotTraceable, Stage, Tracer

ENGINE: Any = SimpleNamespace()


def traced(given: Tensor, function: Callable[[Tensor, Tensor], Tensor]) -> CapturedTrace:
    """Two stages: one makes a tensor and two views of it, the other a function of the views."""
    tracer = Tracer(ENGINE)
    with tracer.tracing():
        made = given + 1.0
        left, right = made[:, :3], made[:, 1:]
        tracer.stages.append(Stage())
        result = function(left, right)
    return CapturedTrace(ENGINE, tracer.stages, [result], lambda graph, inputs, fixed: graph)


def test_views_made_by_one_stage_are_read_in_the_next() -> None:
    given = torch.zeros(2, 4)
    trace = traced(given, lambda left, right: torch.cat((left, 2.0 * right), -1))
    given.copy_(torch.arange(8.0).view(2, 4))
    left, right = given[:, :3] + 1.0, given[:, 1:] + 1.0
    assert torch.equal(trace()[0], torch.cat((left, 2.0 * right), -1))


def test_a_view_made_by_one_stage_and_written_in_the_next_is_refused() -> None:
    with pytest.raises(NotTraceable, match="share memory that the next one writes"):
        traced(torch.zeros(2, 4), lambda left, right: left.mul_(2.0) + right)
    with pytest.raises(NotTraceable, match="share memory that the next one writes"):
        traced(torch.zeros(2, 4), lambda left, right: torch.add(left, 1.0, out=left) + right)
