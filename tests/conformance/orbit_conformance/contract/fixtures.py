"""Fixtures of the contract tests: engines of the backend under test, read on the host."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_core import backends
from orbit_core.interfaces import Backend, Capability, Engine, RayHits, SceneLayout, UnsupportedCapabilityError
from orbit_core.scene import Scene

# Measured against true, with an error that says both and which way it is off ------------------------------------------


def assert_near(measured: Tensor, truth: Tensor, *, rtol: float = 0.0, atol: float = 0.0) -> None:
    """Every element within ``atol + rtol |truth|``; NaN never is.

    Raises:
        AssertionError: names the element that is furthest off, what was measured, the truth, by how much it is above
            or below, and what was allowed.
    """
    measured, truth = torch.broadcast_tensors(measured.detach().cpu().double(), truth.detach().cpu().double())
    allowed = atol + rtol * truth.abs()
    excess = ((measured - truth).abs() - allowed).nan_to_num(nan=torch.inf)
    if not excess.numel() or not (excess > 0.0).any():
        return
    place = tuple(int(i) for i in torch.unravel_index(excess.argmax(), excess.shape))
    got, true = float(measured[place]), float(truth[place])
    way = "not a number" if got != got else f"{abs(got - true):.4g} {'above' if got > true else 'below'}"
    count = int((excess > 0.0).sum())
    raise AssertionError(
        f"element {list(place)} is {got:.7g}, {way} the truth {true:.7g} where {float(allowed[place]):.3g} is allowed; "
        f"{count} of {excess.numel()} elements are off"
    )


_COMMANDS = ("position_targets", "velocity_targets", "efforts")


class OnHost:
    """Proxy of an engine. Commands are written here in place, and handed over before each call."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        for name in _COMMANDS:
            setattr(self, name, getattr(engine, name).cpu())

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._engine, name)
        return self._called(value) if callable(value) else _host(value)

    def step(self, steps: int) -> None:
        """Step the engine, and raise what its device reports."""
        self._called(self._engine.step)(steps)
        # An engine that does not wait for its device reports errors only when it is asked.
        getattr(self._engine, "check", lambda: None)()

    def _called(self, method: Any) -> Any:
        def call(*arguments: Any) -> Any:
            for name in _COMMANDS:
                getattr(self._engine, name).copy_(getattr(self, name))
            given = [a.to(self._engine.device) if isinstance(a, Tensor) else a for a in arguments]
            result = _host(method(*given))
            for name in _COMMANDS:
                getattr(self, name).copy_(getattr(self._engine, name))
            return result

        return call


def _host(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.cpu()
    if isinstance(value, RayHits):
        return RayHits(**{field.name: getattr(value, field.name).cpu() for field in dataclasses.fields(value)})
    return torch.device("cpu") if isinstance(value, torch.device) else value


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
        # A refusal with its reason is what the contract asks for: the scene's other promises cannot be tested.
        except UnsupportedCapabilityError as error:
            pytest.skip(str(error))
        made.append(engine)
        return engine if device.type == "cpu" else OnHost(engine)  # pyright: ignore[reportReturnType]

    yield make
    # Engines hold threads and memory of the device, which the next test needs.
    for engine in made:
        engine.close()
