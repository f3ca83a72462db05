"""Makes the fuzz's calls on one backend, in a process of its own: `python -m tests.fuzz.worker mujoco --calls 500`.

Each call draws its arguments from the seed and its own number, and is printed before it is made: so what crashes or
hangs is named, and ``--first N --calls 1`` repeats it.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import io
import sys
import traceback

from orbit_core.interfaces import SimulationError
from tests.fuzz.doors import Door, Doors, refused_well
from tests.fuzz.pool import Pool, shown

LONGEST = 60.0
"""Seconds that a call may take: one that builds a world on a busy machine, and no more."""


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("backend")
    parser.add_argument("--calls", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    doors = Doors(options.backend)
    failures = 0
    for number in range(options.first, options.first + options.calls):
        pool = Pool(f"{options.seed}:{number}")
        door = doors.draw(pool)
        arguments = door.arguments(pool)
        print(f"call {number}: {door.name}({', '.join(map(shown, arguments))})", flush=True)
        faulthandler.dump_traceback_later(LONGEST, exit=True)
        problem = _problem(doors, door, arguments)
        faulthandler.cancel_dump_traceback_later()
        if problem:
            failures += 1
            print(f"FAILED call {number} of seed {options.seed}: {problem}", flush=True)
    doors.close()
    print(f"{options.calls} calls, {failures} failures", flush=True)
    return 1 if failures else 0


def _problem(doors: Doors, door: Door, arguments: tuple[object, ...]) -> str:
    """What is wrong with how the call went; empty if nothing."""
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            door.call(*arguments)
    except BaseException as error:
        if not refused_well(error):
            return "".join(traceback.format_exception(error)[-3:])
    if fault := doors.fault():
        doors.recover()
        return f"{fault} not finite after it"
    try:
        doors.world.step(1)
    except SimulationError:
        doors.recover()
    if fault := doors.fault():
        doors.recover()
        return f"{fault} not finite a step after it"
    return ""


if __name__ == "__main__":
    sys.exit(main())
