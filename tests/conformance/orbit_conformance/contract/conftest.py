"""Every chosen backend x every test; what a backend declares unsupported is skipped with its reason."""

from __future__ import annotations

import pytest

from orbit_conformance.contract.fixtures import backend, device, make_engine, needs
from orbit_core.backends import backend as find_backend
from orbit_core.interfaces import OrbitError

__all__ = ["backend", "device", "make_engine", "needs"]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the tests on other backends than those of ``--backend``."""
    chosen: list[str] = [*(config.getoption("--backend", None) or ())]
    if not chosen:
        return
    try:
        for name in chosen:
            find_backend(name)
    except OrbitError as error:
        raise pytest.UsageError(str(error)) from error
    own = {item: getattr(item, "callspec", None) for item in items}
    others = [item for item, call in own.items() if call and call.params.get("backend", chosen[0]) not in chosen]
    config.hook.pytest_deselected(items=others)
    items[:] = [item for item in items if item not in {*others}]
