"""All mutants, and which of them a run takes."""

from __future__ import annotations

from collections.abc import Sequence

from orbit_core.interfaces import UnknownNameError
from tests.tiers.slow_list import TURNS

from . import commands, contacts, frames, masks, readings, snapshots, time  # noqa: F401 - each registers its mutants
from .mutant import MUTANTS, Mutant


def chosen(names: Sequence[str] | None = None, turn: int | None = None) -> list[Mutant]:
    """Return the mutants of these names, every sixtieth from the ``turn``-th on, or all.

    Raises:
        UnknownNameError: no mutant has one of the names.
    """
    if names is None:
        return list(MUTANTS) if turn is None else MUTANTS[turn::TURNS]
    known = {mutant.name: mutant for mutant in MUTANTS}
    for name in names:
        if name not in known:
            raise UnknownNameError("mutant", name, known)
    return [known[name] for name in names]
