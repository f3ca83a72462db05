"""An engine on another device as the tests see it: every tensor that goes in or comes out is on the host."""

from __future__ import annotations

import dataclasses
from typing import Any

import torch
from torch import Tensor

from orbit_core.interfaces import Engine, RayHits

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
