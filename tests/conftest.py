"""Tests of the core run on one backend: the deterministic one that does most things exactly.

``tests/conformance`` runs on all.
"""

from __future__ import annotations

import os

from orbit_core.backends import backend, backend_names
from orbit_core.interfaces import Capability, Level


def _most_exact() -> str:
    def exact(name: str) -> tuple[bool, int]:
        levels = backend(name).capabilities()
        deterministic = levels[Capability.DETERMINISTIC].level is Level.EXACT
        return deterministic, sum(levels[capability].level is Level.EXACT for capability in Capability)

    return max(backend_names(), key=exact)


os.environ.setdefault("ORBIT_BACKEND", _most_exact())
