"""Tests of the core run on one backend: the deterministic one that does most things exactly.

``tests/conformance`` runs on all.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import pytest

from orbit_core.active.laws import active_laws
from orbit_core.actuators import actuator_models
from orbit_core.backends import backend, backend_names
from orbit_core.interfaces import Capability, Level
from orbit_core.registry import Registry
from orbit_core.sensors.factory import sensor_types


def _most_exact() -> str:
    def exact(name: str) -> tuple[bool, int]:
        levels = backend(name).capabilities()
        deterministic = levels[Capability.DETERMINISTIC].level is Level.EXACT
        return deterministic, sum(levels[capability].level is Level.EXACT for capability in Capability)

    return max(backend_names(), key=exact)


os.environ.setdefault("ORBIT_BACKEND", _most_exact())


@pytest.fixture
def forgotten_names() -> Iterator[None]:
    """Take what a test registers out of the registries again: others of the same process may use these names."""
    registries: tuple[Registry[Any], ...] = (actuator_models(), active_laws(), sensor_types())
    before = [set(registry.names) for registry in registries]
    yield
    for registry, names in zip(registries, before, strict=True):
        for name in set(registry.names) - names:
            del registry._loads[name], registry._origins[name]
