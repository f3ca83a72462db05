"""Spread tests over worker processes such that on a clean machine nothing is compiled by two of them."""

from __future__ import annotations

import re
from collections.abc import Generator

import pytest

_KERNEL_BACKENDS = frozenset({"warp", "newton"})
_KERNEL_FOLDERS = ("plugins/orbit-warp", "plugins/orbit-newton")
_MATTER = "plugins/orbit-matter"
KERNELS, MATTER_KERNELS = "kernels of engines", "kernels of matter"
"""Groups of the tests that compile kernels."""


def group_of(name: str) -> str:
    """Return the group of the test of a node id, whose tests one worker runs one after another.

    Kernels take minutes of a core to compile, and two workers that begin with them at once compile the same.
    """
    file, _, test = name.partition("::")
    if file.startswith(_MATTER):
        return MATTER_KERNELS
    if file.startswith(_KERNEL_FOLDERS) or _KERNEL_BACKENDS & {*re.split(r"[\[\]-]", test)}:
        return KERNELS
    return file


class Spread:
    """Order in which a worker reads the files of tests, and the scheduler of the quick tier.

    Args:
        worker: name of this worker process, ``gw0`` and so on; empty for a process that has none.
    """

    def __init__(self, worker: str) -> None:
        self._backwards = worker.startswith("gw") and int(worker[2:]) % 2 == 1

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(
        self, collector: pytest.Collector
    ) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
        """Let every other worker read a folder's files from last to first, so that each compiles half of them."""
        report = yield
        if self._backwards and isinstance(collector, pytest.Directory):
            report.result = [*reversed(report.result)]
        return report

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Bring the tests into one order, whatever the order in which this worker read their files."""
        items.sort(key=lambda item: item.path.parts)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_make_scheduler(self, config: pytest.Config, log: object) -> object | None:
        """Distribute the quick tier by groups, largest first; the whole suite keeps every worker busy without."""
        if config.getoption("tier") != "quick":
            return None
        from xdist.scheduler import LoadScopeScheduling

        scheduler = LoadScopeScheduling(config, log)
        scheduler._split_scope = group_of
        return scheduler
