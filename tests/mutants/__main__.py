"""Breaks the example backend in every named way and holds each mutant to the tests that must catch it.

The example, ``examples/orbit-torch``, must be installed. ``--turn N`` takes every sixtieth mutant from the N-th on,
``--only`` those named.
The exit code is 1 if a test does not fail for a mutant, or, unless ``--turn`` is given, fails for the unbroken example.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from . import catalogue
from .judge import caught, passes
from .mutant import Mutant


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--turn", type=int, metavar="N", help="every sixtieth mutant from the N-th on, 0 to 59")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="mutants of these names")
    options = parser.parse_args(arguments)
    chosen = catalogue.chosen(options.only, options.turn)
    # What is not broken runs beside a share, as tests and scenarios of their own.
    tried = [] if options.turn is not None else chosen
    checks = {(check, mutant.of_example): mutant for mutant in tried for check in mutant.caught_by}
    unbroken = (key[0] for key in _shown([*checks]) if not passes(key[0], checks[key]))
    complaints = [f"{check} fails for what is not broken" for check in unbroken]
    complaints += [complaint for mutant in _shown(chosen) for complaint in _survived(mutant)]
    print("\n".join(complaints) or f"{len(chosen)} mutants, each caught by every one of its tests")
    return 1 if complaints else 0


def _survived(mutant: Mutant) -> list[str]:
    missed = [check for check in mutant.caught_by if not caught(mutant, check)]
    return [f"{mutant.group}.{mutant.name} ({mutant.broken}) gets past {check}" for check in missed]


def _shown(things: Sequence):
    """Yield the things, with a bar where standard error is a terminal."""
    if not sys.stderr.isatty():
        yield from things
        return
    for count, thing in enumerate(things):
        name = thing.name if isinstance(thing, Mutant) else thing[0]
        done = 30 * count // len(things)
        print(f"\r[{'#' * done:<30}] {count + 1}/{len(things)} {name:<90.90}", end="", file=sys.stderr, flush=True)
        yield thing
    print("\r" + " " * 132, end="\r", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
