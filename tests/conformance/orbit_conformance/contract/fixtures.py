"""Fixtures of tests that run on every installed backend."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch

from orbit_conformance.contract.on_host import OnHost
from orbit_core import backends
from orbit_core.interfaces import Backend, Capability, Engine, SceneLayout, UnsupportedCapabilityError
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
def device(request: pytest.FixtureRequest) -> torch.device:
    """Torch device of the engines under test."""
    return torch.device(str(request.config.getoption("--device", "cpu")))


@pytest.fixture
def make_engine(backend: Backend, device: torch.device) -> Iterator[MakeEngine]:
    """An engine of a scene: ``make_engine(scene, num_envs=1, **settings)``; closed after the test.

    A scene that the backend refuses, by what it declares or when it builds, skips the test with the reason.
    """
    made: list[Engine] = []

    def make(scene: Scene, num_envs: int = 1, **settings: Any) -> Engine:
        config = backends.backend_config(backend, settings)
        try:
            backends.check_scene(backend, scene)
            engine = backend.create_engine(SceneLayout.of(scene), num_envs, device, config)
        except UnsupportedCapabilityError as error:
            pytest.skip(str(error))
        made.append(engine)
        return engine if device.type == "cpu" else OnHost(engine)  # pyright: ignore[reportReturnType]

    yield make
    for engine in made:
        engine.close()
