"""Pytest plugin: marks slow tests, leaves most of them out of the quick tier, and reports where a run's time went."""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Callable, Generator
from pathlib import Path

import pytest

from tests.tiers.revision import current_revision
from tests.tiers.selection import Selection, select
from tests.tiers.slow_list import SLOW_SECONDS, read_slow_list
from tests.tiers.spread import Spread
from tests.tiers.touched import touched_tests

_GROWN = 7.5
"""A test is called grown from this many times the threshold on, so that a busy machine names none."""
_OF_MANY = 0.5
"""Seconds that a test of many alike, or of a run that is made once, counts in its turn, where it is not slow."""
_MADE_ONCE = ("finished_run", "broken_run", "report_page")
"""Runs of the conformance suite that a session makes once, for whichever test asks first: tests of any share a turn."""
_REAL_TIME = (
    "tests/deploy/",
    "tests/ros/",
    "tests/teleoperation/",
    "tests/viewer/",
    "tests/learning/test_policy_server",
)
"""Tests that talk to other processes by the wall clock: a machine that stood still for a second makes them fail, so one
fails that fails three times."""
_COLLECTED, _GONE = "tiers_collected", "tiers_gone"


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("tiers")
    group.addoption("--tier", choices=("quick", "all"), default="all", help="quick: a sixtieth of the slow tests")
    group.addoption("--durations-to", metavar="FILE", type=Path, help="write the seconds of each test, as JSON")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "slow: measured to be slow (tests/tiers/slow.txt); one commit in sixty runs it")
    config.addinivalue_line("markers", "rotates: one of many alike; one commit in sixty runs each, slow or not")
    config.pluginmanager.register(Tiers(config), "orbit-tiers")
    config.pluginmanager.register(Spread(os.environ.get("PYTEST_XDIST_WORKER", "")), "orbit-spread")


def waited_seconds() -> float:
    """Return the seconds for which this process could run and had no core; 0 where the system does not count them."""
    try:
        return int(Path("/proc/self/schedstat").read_text(encoding="utf-8").split()[1]) / 1e9
    except (OSError, IndexError):
        return 0.0


class Tiers:
    """Choice of a run's tests in its workers, and report of its controller.

    Args:
        config: of the run.
        waited: clock that counts the seconds for which this process had no core.
    """

    def __init__(self, config: pytest.Config, waited: Callable[[], float] = waited_seconds) -> None:
        self._config = config
        self._listed = read_slow_list()
        self._seconds: dict[str, float] = defaultdict(float)
        self._lines: list[str] = []
        self._gone: set[str] = set()
        self._clock, self._waited = waited, waited()

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        """Mark the slow tests, and in the quick tier keep those of this commit."""
        collected = {item.nodeid for item in items}
        files = {item.nodeid.partition("::")[0] for item in items}
        named = {name for name in self._listed if name.partition("::")[0] in files}
        # Of a file of which only some tests were asked for, nobody can say which others it still has.
        whole = not any("::" in argument for argument in config.args) and not config.getoption("keyword")
        # `make example` alone has the example backend, so that its tests seem gone elsewhere.
        self._gone = {name for name in named - collected if "[torch" not in name} if whole else set()
        listed = {name: self._listed[name] for name in named & collected}
        together = {item.nodeid: "made once" for item in items if {*_MADE_ONCE} & {*getattr(item, "fixturenames", ())}}
        for item in items:
            if item.nodeid.startswith(_REAL_TIME):
                item.add_marker(pytest.mark.flaky(reruns=2))
            if item.nodeid in listed:
                item.add_marker("slow")
            elif item.get_closest_marker("rotates") or item.nodeid in together:
                listed[item.nodeid] = _OF_MANY
        if config.getoption("tier") == "all":
            self._lines = [f"{len(listed)} of {len(listed)} slow ones: the whole list"]
            return
        revision = current_revision()
        selection = select(listed, revision, touched_tests(listed, revision.changed), together)
        self._lines = [selection.describe(revision.turn), *filter(None, [revision.note])]
        self._keep(config, items, selection)

    @staticmethod
    def _keep(config: pytest.Config, items: list[pytest.Item], selection: Selection) -> None:
        left_out = [item for item in items if item.nodeid in selection.listed and item.nodeid not in selection.chosen]
        config.hook.pytest_deselected(items=left_out)
        gone = {id(item) for item in left_out}
        items[:] = [item for item in items if id(item) not in gone]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Leave out of a phase's seconds those that it waited for a core, so that a busy machine makes no test slow."""
        report = yield
        before, self._waited = self._waited, self._clock()
        report.duration = max(report.duration - (self._waited - before), 0.0)
        return report

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Hand what a worker chose to the controller."""
        output = getattr(session.config, "workeroutput", None)
        if output is not None:
            output[_COLLECTED], output[_GONE] = self._lines, sorted(self._gone)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: object) -> None:
        """Take over what a worker chose; all choose the same."""
        output = getattr(node, "workeroutput", {})
        self._lines = output.get(_COLLECTED, self._lines)
        self._gone = {*output.get(_GONE, self._gone)}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up a test's set-up, call and tear-down."""
        self._seconds[report.nodeid] += report.duration

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Report the slowest tests, the time of each folder, and how much of the slow list ran."""
        if getattr(self._config, "workerinput", None) is not None or not self._seconds:
            return
        if path := self._config.getoption("durations_to"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps({"seconds": self._seconds, "gone": sorted(self._gone)}), encoding="utf-8")
        write = terminalreporter.write_line
        terminalreporter.section("tiers", sep="-")
        for name in sorted(self._seconds, key=self._seconds.__getitem__, reverse=True)[:10]:
            write(f"{self._seconds[name]:7.1f} s  {name}")
        folders: dict[str, float] = defaultdict(float)
        for name, seconds in self._seconds.items():
            folders["/".join(Path(name.partition("::")[0]).parts[:2])] += seconds
        write(
            "by folder: "
            + ", ".join(f"{name} {folders[name]:.0f} s" for name in sorted(folders, key=folders.get, reverse=True))
        )
        for line in self._lines:
            write(line)
        grown = {n: s for n, s in self._seconds.items() if s > _GROWN * SLOW_SECONDS and n not in self._listed}
        for name in sorted(grown, key=grown.__getitem__, reverse=True):
            write(f"grown slow, {grown[name]:.1f} s: {name}: make it faster, or `make slow-list`")
        if self._gone:
            first = min(self._gone)
            write(f"the slow list names {len(self._gone)} tests that are gone (`make slow-list`): {first} ...")
