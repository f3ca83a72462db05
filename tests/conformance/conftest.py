"""Every installed backend x every test; what a backend declares unsupported is skipped with its reason."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch

from orbit_core import backends
from orbit_core.interfaces import Backend, Capability, Engine, SceneLayout
from orbit_core.scene import Scene

MakeEngine = Callable[..., Engine]
Needs = Callable[..., None]


@pytest.fixture(params=backends.backend_names())
def backend(request: pytest.FixtureRequest) -> Backend:
    return backends.backend(request.param)


@pytest.fixture
def needs(backend: Backend) -> Needs:
    """Skip unless the backend declares all of these capabilities."""

    def check(*capabilities: Capability) -> None:
        for capability in capabilities:
            if not backend.capabilities().has(capability):
                pytest.skip(f"{backend.name}: no {capability.value}: {backend.capabilities()[capability].reason}")

    return check


@pytest.fixture
def make_engine(backend: Backend) -> Iterator[MakeEngine]:
    """An engine of a scene: ``make_engine(scene, num_envs=1, **settings)``; closed after the test."""
    made: list[Engine] = []

    def make(scene: Scene, num_envs: int = 1, **settings: Any) -> Engine:
        backends.check_scene(backend, scene)
        config = backends.backend_config(backend, settings)
        made.append(backend.create_engine(SceneLayout.of(scene), num_envs, torch.device("cpu"), config))
        return made[-1]

    yield make
    for engine in made:
        engine.close()
