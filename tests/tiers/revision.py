"""The commit under test: whose turn it is among the slow tests, and which files it changes."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

from tests.tiers.slow_list import TURNS

ROOT = Path(__file__).parents[2]
BASE = "ORBIT_TEST_BASE"
TURN = "ORBIT_TEST_TURN"


@dataclass(frozen=True)
class Revision:
    """A commit with what is not committed yet."""

    turn: int
    """Turn of the slow tests that run, 0 to 59."""
    changed: frozenset[str] = field(default_factory=frozenset)
    """Paths that differ from the base, from the root of the tree."""
    note: str = ""
    """What git could not say, in one line; empty if it said everything."""


def current_revision(root: Path = ROOT) -> Revision:
    """Read the revision of the checkout at ``root``.

    The turn is the number of commits modulo sixty, so that sixty commits in a row run every slow test; the
    environment variable ``ORBIT_TEST_TURN`` overrides it. Changes count from the merge base with the upstream's main
    branch, or from the last commit but one where that is the commit itself; ``ORBIT_TEST_BASE`` names another base.
    """
    chosen = os.environ.get(TURN, "")
    turn = int(chosen) % TURNS if chosen.isdecimal() else None
    count = _git(root, "rev-list", "--count", "HEAD")
    if count is None:
        return Revision(turn or 0, note="no git history: the first turn of slow tests runs, changes are unknown")
    note = ""
    if _git(root, "rev-parse", "--is-shallow-repository") == "true":
        count, note = (
            str(int(_git(root, "rev-parse", "HEAD") or "0", 16)),
            "a shallow clone: the turn is drawn by hash",
        )
    base = _base(root)
    changed: set[str] = set()
    for listed in (
        _git(root, "diff", "--name-only", base) if base else None,
        _git(root, "ls-files", "--others", "--exclude-standard"),
    ):
        changed |= {*(listed or "").splitlines()}
    if not base:
        note = "; ".join(part for part in (note, "no base to compare with: changes are unknown") if part)
    return Revision(int(count) % TURNS if turn is None else turn, frozenset(changed), note)


def _base(root: Path) -> str | None:
    """Return the commit that changes count from, or None where history does not reach so far."""
    if named := os.environ.get(BASE):
        return _git(root, "merge-base", "HEAD", named)
    head = _git(root, "rev-parse", "HEAD")
    for upstream in ("@{upstream}", "origin/main", "main"):
        base = _git(root, "merge-base", "HEAD", upstream)
        if base and base != head:
            return base
    return _git(root, "rev-parse", "--verify", "--quiet", "HEAD~1")


def _git(root: Path, *arguments: str) -> str | None:
    """Return what a git command prints, or None where it fails or there is no git."""
    try:
        done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None
