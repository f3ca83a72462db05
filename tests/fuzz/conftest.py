from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--calls", type=int, default=None, help="calls of the fuzz on each backend")
    parser.addoption("--fuzz-seed", type=int, default=None, help="of the fuzz; printed with a failure")
