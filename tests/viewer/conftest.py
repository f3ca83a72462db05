"""The environment without physics, for every test here."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


@pytest.fixture(scope="session")
def fakes() -> ModuleType:
    """The module ``fake_environment`` beside this file."""
    return _beside("fake_environment")


@pytest.fixture(scope="session")
def person() -> ModuleType:
    """The module ``person`` beside this file."""
    return _beside("person")


@pytest.fixture
def page(person: ModuleType) -> Iterator[Any]:
    """An empty page of a real browser."""
    with person.opened_page() as opened:
        yield opened


def _beside(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"viewer_{name}", Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
