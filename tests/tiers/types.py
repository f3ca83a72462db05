"""Choose the files whose types a commit checks: a sixth in turn, those that it changed and those that import these."""

from __future__ import annotations

import fnmatch
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from tests.tiers.revision import ROOT, Revision, current_revision
from tests.tiers.touched import changed_modules, imported_modules

TYPE_TURNS = 6
"""Consecutive commits that together check every file once."""


def check_types(root: Path = ROOT) -> int:
    """Check this commit's share of the files and return the checker's exit code."""
    revision = current_revision(root)
    files = checked_files(root)
    chosen, left = share(files, revision, concerned(files, revision.changed, root))
    waiting = f" ({left} more that the change concerns wait for their turn or for `make types`)" if left else ""
    print(f"types: {len(chosen)} of {len(files)} files, turn {revision.turn % TYPE_TURNS} of {TYPE_TURNS}{waiting}")
    sys.stdout.flush()
    return subprocess.run([Path(sys.executable).with_name("basedpyright"), *chosen], cwd=root, check=False).returncode


def checked_files(root: Path = ROOT) -> list[str]:
    """Return the paths from ``root`` of all files that the settings of the checker name, sorted."""
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["basedpyright"]
    paths = [
        PurePosixPath(path.relative_to(root))
        for folder in settings["include"]
        for path in (root / folder).rglob("*.py")
    ]
    left_out = settings["exclude"]
    return sorted(
        str(path)
        for path in paths
        if not any(fnmatch.fnmatch(str(part), pattern) for part in (path, *path.parents) for pattern in left_out)
    )


def concerned(files: Iterable[str], changed: Iterable[str], root: Path = ROOT) -> set[str]:
    """Return the files that changed, those of a changed plugin, and importers of a changed module or of its package."""
    changed = {*changed}
    modules = changed_modules(changed)
    modules |= {module.rpartition(".")[0] for module in modules if module.count(".") > 1}
    plugins = {"/".join(path.split("/")[:2]) + "/" for path in changed if path.startswith("plugins/")}
    return {
        file
        for file in files
        if file in changed or file.startswith(tuple(plugins)) or (modules and modules & imported_modules(root / file))
    }


def share(files: list[str], revision: Revision, touched: set[str]) -> tuple[list[str], int]:
    """Return the files of a turn with what a change concerns, and how many of the latter must wait.

    A turn's files are neighbours, which need the same libraries. What changed is always checked; of what else the
    change concerns, a turn's number at the most, those of the coming turns first.
    """
    turn_of = {file: TYPE_TURNS * i // len(files) for i, file in enumerate(files)}
    turn = revision.turn % TYPE_TURNS
    chosen = {file for file in files if turn_of[file] == turn} | (touched & revision.changed)
    others = sorted(touched - chosen, key=lambda file: ((turn_of[file] - turn) % TYPE_TURNS, file))
    now = others[: -(-len(files) // TYPE_TURNS)]
    return sorted(chosen | {*now}), len(others) - len(now)
