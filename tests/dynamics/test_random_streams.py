"""Random streams draw the same numbers in NumPy's memory, as on the CPU, and in torch's, as on a GPU."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from orbit_core.dynamics import random
from orbit_core.dynamics.random import RandomStreams

CPU = torch.device("cpu")


def drawn() -> list[Tensor]:
    streams = RandomStreams(5, 3, CPU)
    streams.reset()
    some = torch.tensor([3, 1])
    streams.reset(some)
    numbers = [streams.uniform((2, 3)), streams.uniform((), -1.0, (2.0,), some), streams.integers(2, 9)]
    state = streams.save_state()
    numbers.append(streams.normal((4,), env_ids=some))
    streams.load_state(state)
    numbers.append(streams.normal((4,), env_ids=some))
    streams.seed(2**40, some)
    return [*numbers, streams.uniform((2,))]


def test_memory_of_the_streams_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    in_numpy = drawn()
    random._increments.cache_clear()
    monkeypatch.setattr(random, "_array", lambda tensor: tensor)
    in_torch = drawn()
    random._increments.cache_clear()
    assert all(torch.equal(a, b) for a, b in zip(in_numpy, in_torch, strict=True))
    assert torch.equal(in_numpy[3], in_numpy[4])


def test_bounds_given_as_a_tuple_hold_for_each_number() -> None:
    numbers = RandomStreams(1000, 0, CPU).uniform((3,), (0.4, -0.25, 7.0), (0.6, 0.25, 7.0))
    torch.testing.assert_close(numbers.amin(0), torch.tensor([0.4, -0.25, 7.0]), rtol=0.0, atol=0.005)
    torch.testing.assert_close(numbers.amax(0), torch.tensor([0.6, 0.25, 7.0]), rtol=0.0, atol=0.005)
