"""Memory that the Warp backend counts before it makes its arrays, against the arrays that it makes."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.preparation.scenes import prepared
from orbit_core.scene import Box, ObjectSpec, Pose, Scene, Shape, single_link
from orbit_tasks.lift import Lift
from orbit_warp import WarpBackend, WarpConfig
from orbit_warp.engine import WarpEngine
from orbit_warp.memory import bytes_per_environment

_MAKERS = ("empty", "zeros", "full", "ones", "empty_like", "zeros_like")


def cubes() -> Scene:
    """Three cubes on the ground."""
    shape = Shape(Box((0.05, 0.05, 0.05)))
    cube = single_link("cube", shape, 1.0, np.eye(3) / 600)
    return Scene(
        objects=tuple(ObjectSpec(name=f"cube{i}", articulation=cube, pose=Pose((0.2 * i, 0.0, 0.05))) for i in range(3))
    )


def lift() -> Scene:
    """An arm with meshes, a table and a cube."""
    return Lift().scene()


def engine_of(scene: Scene, num_envs: int) -> WarpEngine:
    layout = SceneLayout.of(prepared(scene))
    engine = WarpBackend().create_engine(layout, num_envs, torch.device("cpu"), WarpConfig())
    assert isinstance(engine, WarpEngine)
    return engine


class Allocations:
    """Bytes of Warp's arrays that are alive, and the most so far.

    Args:
        monkeypatch: replaces Warp's functions that make arrays.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = self.most = 0
        for name in _MAKERS:
            monkeypatch.setattr(wp, name, self._noted(getattr(wp, name)))

    def _noted(self, make: Callable[..., Any]) -> Callable[..., Any]:
        def noted(*arguments: Any, **keywords: Any) -> Any:
            array = make(*arguments, **keywords)
            self._add(array.capacity)
            weakref.finalize(array, self._add, -array.capacity)
            return array

        return noted

    def _add(self, size: int) -> None:
        self.now += size
        self.most = max(self.most, self.now)


@pytest.mark.parametrize("scene", [cubes, lift])
def test_the_memory_of_an_environment_is_what_its_arrays_take(
    scene: Callable[[], Scene], monkeypatch: pytest.MonkeyPatch
) -> None:
    counted, most = 0, []
    for num_envs in (2, 4):
        with monkeypatch.context() as patched:
            allocations = Allocations(patched)
            engine = engine_of(scene(), num_envs)
            allocations.most = allocations.now  # the count at build makes arrays as well, which are gone
            engine.step(1)
            most.append(allocations.most)
        counted = bytes_per_environment(engine._native.host_model, engine._native.model, engine.buffer_sizes)
    assert counted == pytest.approx((most[1] - most[0]) / 2, rel=0.2)


def test_more_environments_than_memory_are_refused_with_how_many_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orbit_core.plugin_kit.memory.free_bytes", lambda device: 10_000_000)
    with pytest.raises(ConfigurationError, match=r"1000 environments take .* at most \d+ fit.*nconmax=\d+ and njmax="):
        engine_of(cubes(), 1000)
