"""``python -m tests.tiers conformance``: run this commit's share of the conformance suite.

``types`` checks the types of this commit's share of the files, ``refresh`` brings the slow list up to the last
measurement, ``turn`` prints this commit's turn, and ``share WORD ...`` prints every sixtieth word from the turn-th on,
or all where the change touches the example backend.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from tests.tiers.revision import current_revision
from tests.tiers.slow_list import SLOW_LIST, TURNS, read_slow_list, refreshed, write_slow_list

DURATIONS = Path("out/durations")
"""Folder of the seconds that the last runs of tests measured."""


def refresh(durations: Path = DURATIONS, path: Path = SLOW_LIST) -> int:
    """Bring the slow list up to what the last runs measured, and return the exit code."""
    from tests.tiers.conformance import OUTPUT, measured_jobs, suite_names

    tests = [json.loads(file.read_text(encoding="utf-8")) for file in sorted(durations.glob("*.json"))]
    jobs = measured_jobs(OUTPUT.rglob("result.json"))
    if not tests and not jobs:
        print("nothing was measured yet: run `make test` or `make test-all` first", file=sys.stderr)
        return 1
    measured = jobs | {name: seconds for run in tests for name, seconds in run["seconds"].items()}
    listed = read_slow_list(path)
    gone = {name for run in tests for name in run["gone"]}
    gone |= {name for name in listed if "::" not in name} - {*suite_names()}
    after = refreshed(listed, measured, gone)
    write_slow_list(after, path)
    new, left = len({*after} - {*listed}), len({*listed} - {*after})
    print(f"{len(after)} slow tests of {sum(after.values()):.0f} s; {new} new, {left} left the list")
    return 0


def main() -> int:
    """Run one of the commands and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.tiers", description=__doc__)
    parser.add_argument("command", choices=("conformance", "types", "refresh", "turn", "share"))
    parser.add_argument("words", nargs="*", help="of share")
    options = parser.parse_args()
    match options.command:
        case "conformance":
            from tests.tiers.conformance import run_quick

            return run_quick()
        case "types":
            from tests.tiers.types import check_types

            return check_types()
        case "refresh":
            return refresh()
        case "turn":
            print(current_revision().turn)
            return 0
        case _:
            revision = current_revision()
            whole = any(path.startswith("examples/") for path in revision.changed)
            print(*(options.words if whole else options.words[revision.turn :: TURNS]))
            return 0


if __name__ == "__main__":
    sys.exit(main())
