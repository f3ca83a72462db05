"""Options of pytest for tests that run on backends, in every environment that has the suite."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("orbit", "ORBIT's conformance suite")
    group.addoption(
        "--backend", action="append", default=[], metavar="NAME",
        help="run the contract tests on this backend alone; repeatable (all installed ones by default)",
    )  # fmt: skip
    group.addoption("--device", default="cpu", metavar="NAME", help="torch device of the engines under test")
