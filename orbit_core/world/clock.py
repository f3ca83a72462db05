"""Counts changes of a world's state, so that what is derived from it is computed once per state."""

from __future__ import annotations


class Clock:
    """``version`` differs whenever the state may have changed; ``steps`` counts physics steps."""

    def __init__(self) -> None:
        self.version = 0
        self.steps = 0

    def touch(self) -> None:
        """The state was written."""
        self.version += 1

    def advance(self, steps: int) -> None:
        """The state was stepped."""
        self.steps += steps
        self.version += 1
