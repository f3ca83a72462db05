"""Fill in the parts of the documentation that come from the code and the committed report: tables and quoted files.

    python tools/readme_tables.py          rewrite the README and the pages of docs/

A part starts with ``<!-- capabilities -->``, ``<!-- pages -->``, ``<!-- exact: BACKEND -->``,
``<!-- settings: BACKEND -->``, ``<!-- declarations: BACKEND -->`` or ``<!-- file: PATH -->``, and ends with
``<!-- end -->``.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import pkgutil
import re
import textwrap
import tomllib
from pathlib import Path
from typing import Any

from orbit_conformance.report.declared import declarations_of
from orbit_core.interfaces import Backend, Capability, Level

ROOT = Path(__file__).parents[1]
_PART = re.compile(
    r"(?P<start><!-- (?P<kind>capabilities|pages|exact|settings|declarations|file)(?:: (?P<of>\S+))? -->\n)"
    r".*?(?P<end><!-- end -->)",
    re.DOTALL,
)


def pages() -> list[Path]:
    """Return the README files and all pages."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted(ROOT.glob("plugins/*/README.md"))]


def updated(text: str) -> str:
    """Return a page with its generated parts as the code has them now."""

    def part(match: re.Match[str]) -> str:
        match match["kind"]:
            case "file":
                content = quoted_file(match["of"])
            case "exact":
                content = exact_capabilities(match["of"])
            case "settings":
                content = settings(match["of"])
            case "declarations":
                content = declarations(match["of"])
            case "pages":
                content = page_table()
            case _:
                content = capability_table()
        return match["start"] + content + match["end"]

    return _PART.sub(part, text)


def offered_backends() -> list[str]:
    """Names of the backends that an extra of their name brings."""
    extras = _project(ROOT)["optional-dependencies"].items()
    plugins = {path.name for path in (ROOT / "plugins").iterdir()}
    brought = [
        name for name, needs in extras if f"orbit-{name}" in plugins & {need.partition("~")[0] for need in needs}
    ]
    registered = {name: _project(ROOT / f"plugins/orbit-{name}")["entry-points"] for name in brought}
    return [name for name in brought if name in registered[name].get("orbit.backends", {})]


def page_table() -> str:
    """Return a table of all pages by section, as the site's navigation has them."""
    nav = tomllib.loads((ROOT / "docs" / "zensical.toml").read_text(encoding="utf-8"))["project"]["nav"]
    rows = ["| section | pages |", "|---|---|"]
    for entry in nav:
        for section, content in entry.items() if isinstance(entry, dict) else ():
            if isinstance(content, list):
                rows += [f"| {title} | {', '.join(links)} |" for title, links in _sections(section, content)]
    return "\n".join(rows) + "\n"


def _sections(title: str, entries: list[Any]) -> list[tuple[str, list[str]]]:
    """Return the links of a section of the navigation, and after them those of the sections within it.

    A section with an index page is that page only, which lists the others.
    """
    if index := [entry for entry in entries if isinstance(entry, str)]:
        return [(title, [f"[{title}]({index[0]})"])]
    own: list[str] = []
    within: list[tuple[str, list[str]]] = []
    for entry in entries:
        for name, content in entry.items():
            if isinstance(content, list):
                within += _sections(name, content)
            else:
                own.append(f"[{name}]({content})")
    return [(title, own), *within] if own else within


def _project(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def capability_table() -> str:
    """Return every capability with each offered backend's level."""
    names = offered_backends()
    rows = [f"| capability | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for capability in Capability:
        cells = [_cell(name, capability) for name in names]
        rows.append(f"| {capability.value} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def declarations(name: str) -> str:
    """Return what a backend declares, with what the committed report measured."""
    return declarations_of([plugin_backend(name)], ROOT / "docs" / "conformance")


def plugin_backend(name: str) -> Backend:
    """Return a backend of the checkout's plugins; its declarations can be read where its engine is not installed.

    Raises:
        KeyError: no plugin registers that name.
    """
    registered: dict[str, str] = {}
    for folder in sorted((ROOT / "plugins").iterdir()):
        if (folder / "pyproject.toml").exists():
            registered |= _project(folder).get("entry-points", {}).get("orbit.backends", {})
    return pkgutil.resolve_name(registered[name].partition("[")[0].strip())()


def exact_capabilities(name: str) -> str:
    """Return the capabilities that a backend declares exact, as one sentence."""
    capabilities = plugin_backend(name).capabilities()
    exact = [capability.value for capability in Capability if capabilities[capability].level is Level.EXACT]
    return "; ".join(exact) + ".\n"


def settings(name: str) -> str:
    """Return a table of a backend's settings, with the docstrings of their fields."""
    config = plugin_backend(name).config_type
    documented: dict[str, str] = {}
    for owner in reversed(config.__mro__):
        if dataclasses.is_dataclass(owner):
            documented |= field_docs(owner)
    rows = ["| setting | default | meaning |", "|---|---|---|"]
    for field in dataclasses.fields(config):
        default = field.default if field.default is not dataclasses.MISSING else field.default_factory()  # pyright: ignore[reportCallIssue]
        meaning = _ROLE.sub(r"`\1`", documented.get(field.name, "")).replace("``", "`").replace("|", "\\|")
        rows.append(f"| `{field.name}` | `{default!r}` | {meaning} |")
    return "\n".join(rows) + "\n"


_ROLE = re.compile(r":\w+:`~?([^`]+)`")


def field_docs(owner: type) -> dict[str, str]:
    """Return the docstrings that follow the fields of a class, each as one line."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(owner))).body
    assert isinstance(tree, ast.ClassDef)
    documented: dict[str, str] = {}
    for statement, after in zip(tree.body, tree.body[1:], strict=False):
        match statement, after:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                documented[name] = " ".join(text.split())
            case _:
                pass
    return documented


def quoted_file(path: str) -> str:
    """Return a Python file of the repository as a block of code."""
    return f"```python\n{(ROOT / path).read_text(encoding='utf-8')}```\n"


_WORDS = {Level.EXACT: "yes", Level.APPROXIMATE: "approximate", Level.UNSUPPORTED: "**no**"}


def _cell(name: str, capability: Capability) -> str:
    return _WORDS[plugin_backend(name).capabilities()[capability].level]


def main() -> None:
    """Rewrite all pages."""
    for page in pages():
        page.write_text(updated(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
