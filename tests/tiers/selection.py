"""Choice of the slow tests that a run of `make test` takes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from tests.tiers.revision import Revision
from tests.tiers.slow_list import turns


@dataclass(frozen=True)
class Selection:
    """Slow tests of one kind: all that are listed, and those of them that run."""

    listed: Mapping[str, float]
    """Measured seconds by name."""
    by_turn: frozenset[str]
    by_change: frozenset[str]

    @property
    def chosen(self) -> frozenset[str]:
        """Names that run."""
        return self.by_turn | self.by_change

    def describe(self, turn: int) -> str:
        """Return how much of the list runs, in one line."""
        seconds = sum(self.listed[name] for name in self.chosen)
        return (
            f"{len(self.chosen)} of {len(self.listed)} slow ones, {seconds:.0f} of {sum(self.listed.values()):.0f} s: "
            f"tenth {turn}, and {len(self.by_change - self.by_turn)} more that the change concerns"
        )


def select(listed: Mapping[str, float], revision: Revision, touched: Collection[str]) -> Selection:
    """Return the tests of this revision's turn and those that its change concerns."""
    by_turn = frozenset(name for name, turn in turns(listed).items() if turn == revision.turn)
    return Selection(listed, by_turn, frozenset(touched) & frozenset(listed))
