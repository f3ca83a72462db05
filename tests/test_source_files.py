"""Source files are of one concept, and every public name and field says what it is."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import runpy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any

import pytest

from tests.distributions import DISTRIBUTIONS, module_of

ROOT = Path(__file__).parents[1]
MOST_LINES = 1000
DOCUMENTED = tuple(distribution.package for distribution in DISTRIBUTIONS)
FIELD_DOCS: dict[str, Any] = runpy.run_path(str(ROOT / "tools" / "field_docs.py"))


def tracked() -> list[Path]:
    """Python files under version control, or all where there is none."""
    done = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode == 0 and done.stdout:
        return [path for line in done.stdout.splitlines() if (path := ROOT / line).exists()]
    return [
        path
        for folder in ("orbit_core", "orbit_tasks", "packages", "plugins", "tests")
        for path in (ROOT / folder).rglob("*.py")
    ]


def test_no_source_file_is_longer_than_1000_lines() -> None:
    files = tracked()
    assert len(files) > 300
    lengths = {str(path.relative_to(ROOT)): path.read_text().count("\n") for path in files}
    assert {name: length for name, length in lengths.items() if length > MOST_LINES} == {}


def module_names() -> list[str]:
    paths = [path.relative_to(ROOT) for distribution in DISTRIBUTIONS for path in distribution.files]
    names = {module_of(PurePosixPath(path)) for path in paths if not path.name.startswith("test_")}
    return sorted(name for name in names if not any(part.startswith("_") for part in name.split(".")))


def test_every_public_name_is_documented() -> None:
    modules, lacking = [], []
    for name in module_names():
        try:
            modules.append(importlib.import_module(name))
        except ImportError as error:  # a learning library or a format's parser that is not installed
            if (error.name or "").startswith(DOCUMENTED):
                raise
    assert len(modules) > 150
    for module in modules:
        lacking += undocumented(module)
    assert not lacking


def undocumented(module: ModuleType) -> Iterator[str]:
    """The module's public functions and classes, and these classes' own methods and properties, that lack a docstring.

    What overrides or fulfils a documented method of a base class has its docstring from there.
    """
    if not module.__doc__:
        yield module.__name__
    for name, value in vars(module).items():
        if name.startswith("_") or getattr(value, "__module__", None) != module.__name__:
            continue
        full = f"{module.__name__}.{name}"
        if inspect.isfunction(value) and not value.__doc__:
            yield full
        elif inspect.isclass(value):
            if not value.__doc__ or value.__doc__.startswith(f"{name}("):  # which dataclasses write of themselves
                yield full
            yield from (f"{full}.{member}" for member in vars(value) if is_silent(value, member))


def is_silent(owner: type, member: str) -> bool:
    """Whether a class defines this public method or property, and neither it nor a base class tells what it is."""
    if member.startswith("_") or not is_callable(vars(owner)[member]):
        return False
    return not any(inspect.getdoc(vars(base)[member]) for base in owner.__mro__ if member in vars(base))


def is_callable(attribute: Any) -> bool:
    if isinstance(attribute, classmethod | staticmethod):
        attribute = attribute.__func__
    return inspect.isfunction(attribute) or isinstance(attribute, property | functools.cached_property)


def test_what_is_not_documented_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("theirs", "A module.")
    monkeypatch.setitem(sys.modules, "theirs", module)  # where dataclasses look
    code = """
from dataclasses import dataclass
class Base:
    "A base."
    def told(self):
        "Told."
class Derived(Base):
    "Derived."
    def told(self): ...
    def untold(self): ...
    @property
    def silent(self): ...
    def _own(self): ...
@dataclass
class Plain:
    number: int
def function(): ...
"""
    exec(code, module.__dict__)
    assert [*undocumented(module)] == [
        "theirs.Derived.untold", "theirs.Derived.silent", "theirs.Plain", "theirs.function"
    ]  # fmt: skip


def test_every_field_of_a_public_class_is_documented() -> None:
    docs = FIELD_DOCS["measure"](ROOT, FIELD_DOCS["classes"]())
    assert docs.fields > 5000
    assert not docs.lacking, "\n".join(docs.lacking)


def test_fields_without_a_doc_are_found() -> None:
    """A string, a section, a mention, a base, a phrase and a function each document a field; nothing else does."""
    code = '''
class Base:
    inherited: int
    "From a base."
class Plain(Base):
    """Mentions ``named``.

    Attributes:
        listed: in a section.
    """
    above: int = 0
    "Below."
    named: int
    listed: int
    inherited: int
    silent: int
    _own: int
    reach: RewardTerm | None = RewardTerm(lambda env: env.reward, 1.0)
    offset: ObservationTerm | None = ObservationTerm(None, meaning=Meaning("way from hand to cube"))
    def __init__(self, given):
        """Build it.

        Args:
            given: in a section.
        """
        self.given = given
        self.made, self._hidden = given, given
class Kind(Enum):
    PHRASE = "moving triangles"
    WORD = "moving"
class Message(IdlStruct):
    foreign: int
class _Private:
    silent: int
'''
    path = ROOT / "orbit_core" / "theirs.py"
    found = FIELD_DOCS["classes_in"](ast.parse(code), "orbit_core.theirs", path)
    lacking = [line.rpartition(" ")[2] for line in FIELD_DOCS["measure"](path, found).lacking]
    assert lacking == [
        f"orbit_core.theirs.{name}" for name in ("Plain.silent", "Plain.reach", "Plain.made", "Kind.WORD")
    ]
