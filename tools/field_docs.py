"""Count documented fields: `python tools/field_docs.py [--list] [PATH...]`.

A field is a public annotated or assigned name in the body of a public class (dataclass fields, enum members, class
attributes), or a public attribute that `__init__` sets. It is documented by a string below it, by a line of the
`Attributes:` or `Args:` section of its class or of `__init__`, or by name, as ``name``, in the text of its class. A
field that overrides one of a base class has the doc of that one. A term of a task (`RewardTerm(reaching, 1.0)`) is
documented by the function or class that it is made of, or by its `Meaning`; a member of an enum whose value is a phrase
by that. Members of messages that others define (`FOREIGN`) do not count: ROS and Unitree document them. Files are
parsed, not imported.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import docs_api

SECTION = re.compile(r"^(?:Attributes|Args):\n((?:(?: +.*)?\n)*)", re.MULTILINE)
ENTRY = re.compile(r"(?:[\w*]+, )*[\w*]+(?= *(?:\([^)]*\))?:)")
FOREIGN = "IdlStruct"
"""Base class of messages in the layout of an interface of others."""
MENTION = re.compile(r"``(\w+)``")


@dataclass(frozen=True)
class Class:
    """A class of the sources and its fields."""

    name: str
    """Full name."""
    module: str
    """Full name of its module."""
    path: Path
    bases: tuple[str, ...]
    """Names of the base classes, without their modules."""
    node: ast.ClassDef

    @cached_property
    def fields(self) -> dict[str, int]:
        """Lines of its public fields by name, in the order of the source."""
        found: dict[str, int] = {}
        for owner, name, line, _ in _assigned(self.node):
            public = not name.startswith("_") and (owner is self.node or name not in self._members)
            if public and name not in found:
                found[name] = line
        return found

    @cached_property
    def documented(self) -> frozenset[str]:
        """Names that a string or a section of a docstring describes."""
        texts = [ast.get_docstring(node) or "" for node in (self.node, *_inits(self.node))]
        sections = {name for text in texts for name in section_names(text)} | set(MENTION.findall(texts[0]))
        properties = {
            node.name for node in self.node.body if isinstance(node, ast.FunctionDef) and ast.get_docstring(node)
        }
        strings = {name for _, name, _, described in _assigned(self.node) if described}
        return frozenset(strings | sections | properties | set(self._described_by_value))

    @property
    def _described_by_value(self) -> Iterator[str]:
        """Names of terms, of members of enums whose value is a phrase, and of further names of methods."""
        for node in self.node.body:
            match node:
                case ast.Assign(targets=[ast.Name(id=name)], value=ast.Constant(value=str(text))) if " " in text:
                    yield name
                case ast.Assign(targets=targets, value=ast.Name(id=alias)) if alias in self._members:
                    yield from (target.id for target in targets if isinstance(target, ast.Name))
                case ast.AnnAssign(target=ast.Name(id=name), annotation=annotation, value=ast.expr() as value):
                    if docs_api.term_docstring(ast.unparse(annotation), ast.unparse(value), self.module):
                        yield name
                case _:
                    pass

    @cached_property
    def _members(self) -> frozenset[str]:
        """Names of methods and properties, which an `__init__` assigns through a setter."""
        return frozenset(node.name for node in self.node.body if isinstance(node, ast.FunctionDef))


def section_names(docstring: str) -> Iterator[str]:
    """Yield the names that the `Attributes:` and `Args:` sections of a docstring describe."""
    for section in SECTION.findall(docstring + "\n"):
        lines = [line for line in section.splitlines() if line.strip()]
        indent = min((len(line) - len(line.lstrip()) for line in lines), default=0)
        for line in lines:
            if line[indent] != " " and (entry := ENTRY.match(line.strip())):
                yield from entry[0].split(", ")


def _inits(node: ast.ClassDef) -> list[ast.FunctionDef]:
    return [entry for entry in node.body if isinstance(entry, ast.FunctionDef) and entry.name == "__init__"]


def _assigned(node: ast.ClassDef) -> Iterator[tuple[ast.AST, str, int, bool]]:
    """Yield the owner, name and line of each assignment to a field, and True if a string below describes it."""
    for owner in (node, *_inits(node)):
        for body in _blocks(owner):
            for statement, following in zip(body, [*body[1:], None], strict=True):
                match following:
                    case ast.Expr(value=ast.Constant(value=str())):
                        described = True
                    case _:
                        described = False
                for name in _targets(statement, of_self=owner is not node):
                    yield owner, name, statement.lineno, described


def _blocks(node: ast.stmt) -> Iterator[list[ast.stmt]]:
    """Yield the statements of a body, and those of the blocks in it, but not of nested functions and classes."""
    for name in ("body", "orelse", "finalbody"):
        if block := getattr(node, name, None):
            yield block
            for statement in block:
                if not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                    yield from _blocks(statement)


def _targets(statement: ast.stmt, of_self: bool) -> Iterator[str]:
    match statement:
        case ast.Assign(targets=targets):
            pass
        case ast.AnnAssign(target=target):
            targets = [target]
        case _:
            return
    for target in targets:
        for part in target.elts if isinstance(target, ast.Tuple) else [target]:
            match part:
                case ast.Name(id=name) if not of_self:
                    yield name
                case ast.Attribute(value=ast.Name(id="self"), attr=name) if of_self:
                    yield name
                case _:
                    pass


def classes() -> dict[str, Class]:
    """Return the classes of all public modules by full name, private ones included for what they pass on."""
    found: dict[str, Class] = {}
    for module in docs_api.modules().values():
        found |= classes_in(docs_api.tree_of(module.path), module.name, module.path)
    return found


def classes_in(tree: ast.Module, module: str, path: Path) -> dict[str, Class]:
    """Return the classes of one module by full name.

    Args:
        tree: syntax tree of the module.
        module: full name of the module.
        path: file of the module.
    """
    found: dict[str, Class] = {}
    for prefix, node in _classes(tree, module):
        name = f"{prefix}.{node.name}"
        found[name] = Class(name, module, path, tuple(map(_base, node.bases)), node)
    return found


def _classes(tree: ast.Module | ast.ClassDef, prefix: str) -> Iterator[tuple[str, ast.ClassDef]]:
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield prefix, node
            yield from _classes(node, f"{prefix}.{node.name}")


def _base(node: ast.expr) -> str:
    if isinstance(node, ast.Subscript):
        node = node.value
    return ast.unparse(node).rpartition(".")[2]


@dataclass
class FieldDocs:
    """Count of the public fields of some classes."""

    fields: int = 0
    lacking: list[str] = field(default_factory=list)
    """Undocumented fields, as ``path:line: full name``."""

    @property
    def documented(self) -> int:
        """Number of documented fields."""
        return self.fields - len(self.lacking)


def measure(path: Path, known: dict[str, Class]) -> FieldDocs:
    """Count the fields of the public classes below a path.

    Args:
        path: file or folder.
        known: all classes, from `classes`.
    """
    path = path.resolve()
    docs = FieldDocs()
    by_name: dict[str, list[Class]] = {}
    for one in known.values():
        by_name.setdefault(one.name.rpartition(".")[2], []).append(one)
    for one in known.values():
        if not one.fields or not one.path.is_relative_to(path) or any(map(_is_private, one.name.split("."))):
            continue
        bases, described = _inherited(one, by_name)
        if FOREIGN in bases:
            continue
        docs.fields += len(one.fields)
        place = os.path.relpath(one.path, docs_api.ROOT)
        docs.lacking += [
            f"{place}:{line}: {one.name}.{name}" for name, line in one.fields.items() if name not in described
        ]
    return docs


def _is_private(name: str) -> bool:
    return name.startswith("_")


def _inherited(one: Class, by_name: dict[str, list[Class]]) -> tuple[set[str], set[str]]:
    """Return the names of a class's bases, and the names of fields that the class or a base documents."""
    bases, described = set[str](), set(one.documented)
    for base in one.bases:
        bases.add(base)
        for other in by_name.get(base, []):
            if other is not one:
                found = _inherited(other, by_name)
                bases, described = bases | found[0], described | found[1]
    return bases, described


def main() -> int:
    """Print the count of each path, all packages by default."""
    parser = argparse.ArgumentParser(description="Count documented fields of public classes.")
    parser.add_argument("paths", nargs="*", type=Path, default=docs_api.package_folders())
    parser.add_argument("--list", action="store_true", help="name each undocumented field")
    options = parser.parse_args()
    known = classes()
    total, documented = 0, 0
    for path in options.paths:
        docs = measure(path, known)
        total, documented = total + docs.fields, documented + docs.documented
        print(f"{os.path.relpath(path)}: {docs.documented} of {docs.fields} fields documented")
        if options.list:
            print("\n".join(docs.lacking))
    print(f"{documented} of {total} fields documented")
    return 0


if __name__ == "__main__":
    sys.exit(main())
