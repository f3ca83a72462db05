"""Choice of the slow tests that a run of `make test` takes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from tests.tiers.revision import Revision
from tests.tiers.slow_list import TURNS, turns

CHANGE_SECONDS = 60.0
"""Most seconds of slow tests that run because of the change; a change of many packages concerns nearly all of them."""


@dataclass(frozen=True)
class Selection:
    """Slow tests of one kind: all that are listed, and those of them that run."""

    listed: Mapping[str, float]
    """Measured seconds by name."""
    by_turn: frozenset[str]
    by_change: frozenset[str]
    left: int = 0
    """Number of tests that the change concerns and that do not run, because they take too long in all."""

    @property
    def chosen(self) -> frozenset[str]:
        """Names that run."""
        return self.by_turn | self.by_change

    def describe(self, turn: int) -> str:
        """Return how much of the list runs, in one line."""
        seconds = sum(self.listed[name] for name in self.chosen)
        left = f" ({self.left} more wait for their turn or for `make test-all`)" if self.left else ""
        return (
            f"{len(self.chosen)} of {len(self.listed)} slow ones, {seconds:.0f} of {sum(self.listed.values()):.0f} s: "
            f"turn {turn} of {TURNS}, and {len(self.by_change - self.by_turn)} more that the change concerns{left}"
        )


def select(
    listed: Mapping[str, float],
    revision: Revision,
    touched: Collection[str],
    together: Mapping[str, str] | None = None,
) -> Selection:
    """Return the tests of this revision's turn and those that its change concerns.

    Where the latter take more than ``CHANGE_SECONDS``, those of the coming turns run first: a wide change is covered
    by the commits after it as by itself, and no change makes the run longer than that. Tests of one group of
    ``together`` share a turn.
    """
    turn_of = turns(listed, together)
    by_turn = frozenset(name for name, turn in turn_of.items() if turn == revision.turn)
    concerned = [name for name in touched if name in listed and name not in by_turn]
    concerned.sort(key=lambda name: ((turn_of[name] - revision.turn) % TURNS, name))
    chosen: list[str] = []
    seconds = 0.0
    for name in concerned:
        if seconds + listed[name] <= CHANGE_SECONDS:
            chosen.append(name)
            seconds += listed[name]
    by_change = frozenset(chosen) | (by_turn & frozenset(touched))
    return Selection(listed, by_turn, by_change, len(concerned) - len(chosen))
