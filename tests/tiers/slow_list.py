"""The list of slow tests, with the seconds that each was measured to take, and their turns."""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

SLOW_LIST = Path(__file__).with_name("slow.txt")
SLOW_SECONDS = 0.1
"""A test of the suite is slow from here on, and so is a job of the conformance suite, over all its backends."""
TURNS = 60
"""Consecutive commits that together run every slow test once."""

_HEADER = """\
# Slow tests and their seconds, each run by one commit in sixty and by `make test-all`. Refreshed by `make slow-list`.
"""


def read_slow_list(path: Path = SLOW_LIST) -> dict[str, float]:
    """Return the measured seconds of each slow test by its name; empty if there is no list.

    A name is a test's node id, or ``scenario/NAME``, ``robot/NAME`` or ``task/NAME`` of the conformance suite.
    """
    if not path.exists():
        return {}
    entries = (line.split(maxsplit=1) for line in path.read_text(encoding="utf-8").splitlines())
    return {entry[1]: float(entry[0]) for entry in entries if len(entry) == 2 and entry[0] != "#"}


def write_slow_list(seconds: Mapping[str, float], path: Path = SLOW_LIST) -> None:
    """Write the list, sorted by name so that a refresh changes few lines."""
    lines = [f"{seconds[name]:7.1f} {name}\n" for name in sorted(seconds)]
    path.write_text(_HEADER + "".join(lines), encoding="utf-8")


def refreshed(listed: Mapping[str, float], measured: Mapping[str, float], gone: Iterable[str]) -> dict[str, float]:
    """Return the list after a run: what it measured replaces old entries, what it did not run stays.

    A test leaves the list only below three quarters of the threshold, so that none comes and goes with each refresh.

    Args:
        listed: seconds by name before the run.
        measured: seconds by name of all tests that ran.
        gone: listed names that no test has any more.
    """
    kept = {name: seconds for name, seconds in listed.items() if name not in measured}
    for name, seconds in measured.items():
        if seconds >= SLOW_SECONDS * (0.75 if name in listed else 1.0):
            kept[name] = seconds
    return {name: seconds for name, seconds in kept.items() if name not in {*gone}}


def turns(seconds: Mapping[str, float], together: Mapping[str, str] | None = None) -> dict[str, int]:
    """Return the turn of each test, 0 to ``TURNS`` - 1, such that every turn takes about the same time.

    The longest first, each to the turn that has the least so far (Graham's rule); ties go by name, so that the result
    depends on the list alone.

    Args:
        seconds: by test.
        together: name of the group of each test that shares its turn with others.
    """
    groups: dict[str, list[str]] = defaultdict(list)
    for name in seconds:
        groups[(together or {}).get(name, name)].append(name)
    sums = {group: sum(seconds[name] for name in names) for group, names in groups.items()}
    loads = [(0.0, turn) for turn in range(TURNS)]
    turn_of: dict[str, int] = {}
    for group in sorted(groups, key=lambda group: (-sums[group], group)):
        load, turn = heapq.heappop(loads)
        turn_of |= dict.fromkeys(groups[group], turn)
        heapq.heappush(loads, (load + sums[group], turn))
    return turn_of
