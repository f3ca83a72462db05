"""The slow tests that a change concerns, by the folders that tests mirror and by the modules that tests import."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from tests.distributions import module_of
from tests.tiers.revision import ROOT

_TESTS = {"orbit-learn": "learning"}
"""Folders of tests whose names differ from their distributions'."""


def touched_tests(names: Iterable[str], changed: Iterable[str], root: Path = ROOT) -> set[str]:
    """Return the node ids, of those given, that a change of these paths concerns.

    These are the tests in a changed file; the tests of a changed package, which lie in the folder of its name; all
    tests of a changed plugin or example, the contract's tests on its backend among them; and tests whose file imports
    a changed module of the core or the tasks.
    """
    changed = [*changed]
    paths = [PurePosixPath(path) for path in changed]
    folders = {folder for path in paths if (folder := _tests_of(path))}
    files = {str(path) for path in paths}
    modules = changed_modules(changed)
    backends = touched_backends(changed)
    found: set[str] = set()
    for name in names:
        file, _, test = name.partition("::")
        near = file in files or any(file.startswith(f"{folder}/") for folder in folders)
        contract = file.startswith("tests/conformance/") and backends & {*re.split(r"[\[\]-]", test)}
        if near or contract or modules & imported_modules(root / file):
            found.add(name)
    return found


def changed_modules(changed: Iterable[str]) -> set[str]:
    """Return the full names of the modules of ORBIT's distributions among the changed paths."""
    return {module for path in changed if (module := module_of(PurePosixPath(path)))}


def touched_backends(changed: Iterable[str]) -> set[str]:
    """Return the backends whose plugin, or whose shared package, changed."""
    plugins = {
        path.split("/")[1].removeprefix("orbit-")
        for path in changed
        if _tests_of(PurePosixPath(path)) and "/orbit-" in path
    }
    shared = {"mjmodel": {"mujoco", "warp"}, "warpkit": {"warp", "newton"}}
    return {backend for plugin in plugins for backend in shared.get(plugin, {plugin})}


def _tests_of(path: PurePosixPath) -> str:
    """Return the folder of the tests of a path's package or plugin; empty if it has none of its own."""
    match path.parts:
        case ("orbit_core", package, _, *_):
            return f"tests/{package}"
        case ("packages", package, _, *_) if path.suffix in (".py", ".toml"):
            return f"tests/{_TESTS.get(package, package.removeprefix('orbit-'))}"
        case ("plugins" | "examples" as kind, package, _, *_) if path.suffix in (".py", ".toml"):
            return f"{kind}/{package}"
        case _:
            return ""


@functools.cache
def imported_modules(path: Path) -> frozenset[str]:
    """Return the modules that a file imports by name, and for ``from a import b`` both ``a`` and ``a.b``."""
    if not path.is_file():
        return frozenset()
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return frozenset(found)
