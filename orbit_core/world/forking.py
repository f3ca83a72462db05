"""Worlds and forks: a forked process has a world's memory, and none of the threads and workers that step it.

Without a word, the first step there would wait for ever, or step the parent's environments. So worlds are known here
while they live, and are given up in every process that is forked.
"""

from __future__ import annotations

import multiprocessing.process
import os
import weakref
from typing import Protocol


class Forkable(Protocol):
    """What is to be given up in forked processes."""

    def leave_to_parent(self, parent: int) -> None:
        """Refuse every later use."""
        ...


_made: weakref.WeakSet[Forkable] = weakref.WeakSet()


def give_up_in_forks(thing: Forkable) -> None:
    """Call the thing's ``leave_to_parent`` in every process that is forked from now on."""
    _made.add(thing)


def _leave_all() -> None:
    if _made:  # else this process, when it exits, would end workers that engines have in its parent
        multiprocessing.process._children.clear()  # pyright: ignore[reportAttributeAccessIssue] - nothing public does it
    for thing in list(_made):
        thing.leave_to_parent(os.getppid())


if hasattr(os, "register_at_fork"):  # other systems do not fork
    os.register_at_fork(after_in_child=_leave_all)
