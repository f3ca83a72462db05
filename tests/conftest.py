"""Tests of the core run on one backend: that which does most things exactly. ``tests/conformance`` runs on all."""

from __future__ import annotations

import os

from orbit_core.backends import backend, backend_names
from orbit_core.interfaces import Capability, Level


def _most_exact() -> str:
    def exact(name: str) -> int:
        return sum(backend(name).capabilities()[capability].level is Level.EXACT for capability in Capability)

    return max(backend_names(), key=exact)


os.environ.setdefault("ORBIT_BACKEND", _most_exact())
