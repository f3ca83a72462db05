"""Pages of the API reference: one for each public module of every distribution, and a list of all packages.

The pages hold mkdocstrings directives and tables made from the syntax tree; no module is imported.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = (
    "orbit_core", "orbit_tasks", "packages/*/orbit_*", "tests/conformance/orbit_conformance", "plugins/*/orbit_*",
    "bridges/*/orbit_*", "packs/*/orbit_*",
)  # fmt: skip
"""Where packages are, below the root of the checkout."""


@dataclass(frozen=True)
class Module:
    """A public module, read without importing it."""

    name: str
    """Full name."""
    path: Path
    summary: str
    """First line of the docstring."""
    own: frozenset[str] = field(default_factory=frozenset)
    """Names that the module defines."""
    imported: dict[str, str] = field(default_factory=dict)
    """Full names behind the names that it imports."""
    exported: tuple[str, ...] = ()
    """Names of ``__all__``."""

    @property
    def is_package(self) -> bool:
        """True for the ``__init__`` of a package."""
        return self.path.name == "__init__.py"


@cache
def package_folders() -> tuple[Path, ...]:
    """Return the folders of all top-level packages, the core first."""
    found = [path for pattern in FOLDERS for path in sorted(ROOT.glob(pattern)) if (path / "__init__.py").exists()]
    return tuple(found)


@cache
def modules() -> dict[str, Module]:
    """Return all public modules by full name; a package precedes what is in it."""
    found: dict[str, Module] = {}
    for folder in package_folders():
        paths = sorted(folder.rglob("*.py"), key=lambda path: (path.parent, path.name != "__init__.py", path.name))
        for path in paths:
            name = ".".join(path.relative_to(folder.parent).with_suffix("").parts).removesuffix(".__init__")
            if not any(part.startswith(("_", "test_")) or part in ("conftest", "tests") for part in name.split(".")):
                found[name] = _read(name, path)
    return found


def module_at(path: Path) -> str:
    """Return the full name of the public module in a file, empty if there is none."""
    return next((module.name for module in modules().values() if module.path == path), "")


@cache
def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of a source file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def _read(name: str, path: Path) -> Module:
    tree = tree_of(path)
    own: set[str] = set()
    imported: dict[str, str] = {}
    exported: tuple[str, ...] = ()
    for node in _statements(tree.body):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                own.add(node.name)
            case ast.ImportFrom(module=str(module), level=0):
                imported |= {alias.asname or alias.name: f"{module}.{alias.name}" for alias in node.names}
            case ast.Assign(targets=[ast.Name(id="__all__")], value=value):
                exported = tuple(ast.literal_eval(value)) if isinstance(value, ast.List | ast.Tuple) else ()
            case ast.Assign(targets=targets):
                own |= {target.id for target in targets if isinstance(target, ast.Name)}
            case ast.AnnAssign(target=ast.Name(id=variable)):
                own.add(variable)
            case _:
                pass
    docstring = ast.get_docstring(tree) or ""
    summary = " ".join(docstring.partition("\n\n")[0].split())
    return Module(name, path, summary, frozenset(own), imported, exported)


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements of a module, and those of its ``if`` blocks, such as ``if TYPE_CHECKING``."""
    for node in body:
        yield node
        if isinstance(node, ast.If):
            yield from _statements(node.body)


def resolve(name: str) -> tuple[str, str] | None:
    """Return the module and the anchor at which a dotted name is documented; None if there is no such name.

    Args:
        name: full name of a module, or of a name that a module defines or exports, or of a member of a class.
    """
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        module = modules().get(".".join(parts[:count]))
        if module is None:
            continue
        if count == len(parts):
            return module.name, ""
        own, *rest = parts[count:]
        if own in module.own:
            return module.name, "" if own.startswith("_") else ".".join([module.name, own])
        return resolve(".".join([module.imported[own], *rest])) if own in module.imported else None
    return None


def docstring_of(name: str) -> str:
    """Return the docstring of a function, class or value of a module by its full name; empty if there is none."""
    module, anchor = resolve(name) or ("", "")
    inside = anchor.removeprefix(f"{module}.")
    return _docstrings(module).get(inside, "") if anchor else ""


@cache
def _docstrings(module: str) -> dict[str, str]:
    tree = tree_of(modules()[module].path)
    found: dict[str, str] = {}
    for node, following in zip(tree.body, [*tree.body[1:], ast.Pass()], strict=True):
        match node, following:
            case ((ast.FunctionDef() | ast.ClassDef()), _):
                found[node.name] = ast.get_docstring(node) or ""
            case ast.Assign(targets=[ast.Name(id=name)]), ast.Expr(value=ast.Constant(value=str(text))):
                found[name] = text
            case _:
                pass
    return found


def term_docstring(annotation: str, value: str, module: str) -> str:
    """Return the docstring of the function or class that the default of a task's term is made of.

    Args:
        annotation: source of the field's annotation, such as ``RewardTerm | None``.
        value: source of its default, such as ``RewardTerm(reaching, 1.0)`` or ``LiftGoal()``.
        module: full name of the module that defines the field.

    Returns:
        Docstring; the term's own ``Meaning`` or reason if it has one; empty if the field is no term, or a lambda's.
    """
    if "Term" not in annotation:  # the documentation's parser writes some other values, such as `{**a}`, wrongly
        return ""
    call = ast.parse(value, mode="eval").body
    if not isinstance(call, ast.Call):
        return ""
    made = ast.unparse(call.func)
    if made.endswith("Term"):
        texts = [keyword.value for keyword in call.keywords if keyword.arg == "meaning"] + call.args[1:2]
        for text in texts:
            match text:
                case ast.Call(args=[ast.Constant(value=str(said)), *_]) | ast.Constant(value=str(said)):
                    return f"{said[:1].upper()}{said[1:]}."
                case _:
                    pass
        function = call.args[0]
        # A function that makes the term's function, such as `reaching("middle")`, says what it makes.
        made = ast.unparse(function.func if isinstance(function, ast.Call) else function)
    return docstring_of(f"{module}.{made}") if re.fullmatch(r"[\w.]+", made) else ""


def import_path(name: str) -> str:
    """Return the full name by which a class is imported: from a package that exports it, else from its module.

    Empty if no class has that name, or several have.
    """
    return _import_paths().get(name, "")


@cache
def _import_paths() -> dict[str, str]:
    found: dict[str, set[tuple[str, str]]] = {}
    for module in modules().values():
        for name in module.own:
            found.setdefault(name, set()).add((module.name, name))
    exported = {
        (name, resolve(f"{m.name}.{name}")): m.name for m in reversed(modules().values()) for name in m.exported
    }
    paths: dict[str, str] = {}
    for name, places in found.items():
        if len(places) == 1:
            ((module, _),) = places
            paths[name] = f"{exported.get((name, (module, f'{module}.{name}')), module)}.{name}"
    return paths


def page_of(module: str) -> str:
    """Return the path of a module's page, below the folder of the pages."""
    return f"api/{module}.md"


def write_pages(folder: Path) -> None:
    """Write the page of every module and the list of packages below the folder of the pages."""
    (folder / "api").mkdir(parents=True, exist_ok=True)
    for module in modules().values():
        (folder / page_of(module.name)).write_text(_page(module), encoding="utf-8")
    (folder / "api/index.md").write_text(_index(), encoding="utf-8")


def navigation() -> list[object]:
    """Return the navigation of the reference: packages, in each its packages and modules."""
    tops = [module.name for module in modules().values() if "." not in module.name]
    return ["api/index.md", *({top: _branch(top)} for top in tops)]


def _branch(package: str) -> list[object]:
    entries: list[object] = [page_of(package)]
    for module in _members(package):
        own = module.name.rpartition(".")[2]
        entries.append({own: _branch(module.name) if module.is_package else page_of(module.name)})
    return entries


def _members(package: str) -> list[Module]:
    """Return the packages and modules directly in a package."""
    return _children().get(package, [])


@cache
def _children() -> dict[str, list[Module]]:
    found: dict[str, list[Module]] = {}
    for module in modules().values():
        found.setdefault(module.name.rpartition(".")[0], []).append(module)
    return found


def _page(module: Module) -> str:
    lines = [f"# {module.name}\n"]
    if module.is_package and module.exported:
        members = [name for name in sorted(module.own) if not name.startswith("_") and name in module.exported]
        shown = f"[{', '.join(members)}]" if members else "false"
        lines.append(f"::: {module.name}\n    options:\n      members: {shown}\n")
    else:
        lines.append(f"::: {module.name}\n")
    lines += _exports(module)
    if below := _members(module.name):
        lines += ["## Modules\n", "| module | content |", "|---|---|"]
        lines += [f"| [`{other.name}`]({other.name}.md) | {_cell(other.summary)} |" for other in below]
    return "\n".join(lines) + "\n"


def _exports(module: Module) -> Iterator[str]:
    """Yield a table of the names that a package exports from its modules."""
    names = [name for name in module.exported if name in module.imported]
    if not names:
        return
    yield from ("## Names to import\n", f"`from {module.name} import NAME`\n", "| name | defined in |", "|---|---|")
    for name in names:
        place = resolve(f"{module.name}.{name}")
        if place is None:
            yield f"| `{name}` | `{module.imported[name].rpartition('.')[0]}` |"
        else:
            yield f"| [`{name}`]({place[0]}.md#{place[1]}) | [`{place[0]}`]({place[0]}.md) |"
    yield ""


def _index() -> str:
    lines = [
        "# API reference\n",
        "Every public package and module, made from the docstrings of the sources.\n",
        "| package | content |",
        "|---|---|",
    ]
    for module in modules().values():
        if module.is_package and module.name.count(".") <= 1:
            lines.append(f"| [`{module.name}`]({module.name}.md) | {_cell(module.summary)} |")
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("``", "`")
