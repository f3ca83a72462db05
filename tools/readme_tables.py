"""Fill in the parts of the documentation that come from the code and the committed report: tables and quoted files.

    python tools/readme_tables.py          rewrite the README and the pages of docs/

A part stands between ``<!-- capabilities -->``, ``<!-- declarations -->`` or ``<!-- file: PATH -->``, and
``<!-- end -->``.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from orbit_conformance.report.declared import declarations_of
from orbit_core.backends import backend
from orbit_core.interfaces import Capability, Level

ROOT = Path(__file__).parents[1]
_PART = re.compile(
    r"(?P<start><!-- (?P<kind>capabilities|declarations|file: (?P<path>\S+)) -->\n).*?(?P<end><!-- end -->)", re.DOTALL
)


def pages() -> list[Path]:
    """The README files and all pages."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted(ROOT.glob("plugins/*/README.md"))]


def updated(text: str) -> str:
    """A page with its generated parts as the code has them now."""

    def part(match: re.Match[str]) -> str:
        if match["path"]:
            content = quoted_file(match["path"])
        else:
            content = capability_table() if match["kind"] == "capabilities" else declarations()
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


def _project(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def capability_table() -> str:
    """Every capability, and each offered backend's level.

    Raises:
        BackendNotInstalledError: one is not installed.
    """
    names = offered_backends()
    rows = [f"| capability | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for capability in Capability:
        cells = [_cell(name, capability) for name in names]
        rows.append(f"| {capability.value} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def declarations() -> str:
    """What each offered backend declares, with what the committed report measured.

    Raises:
        BackendNotInstalledError: one is not installed.
    """
    return declarations_of(offered_backends(), ROOT / "docs" / "conformance")


def quoted_file(path: str) -> str:
    """A Python file of the repository as a block of code."""
    return f"```python\n{(ROOT / path).read_text(encoding='utf-8')}```\n"


_WORDS = {Level.EXACT: "yes", Level.APPROXIMATE: "approximate", Level.UNSUPPORTED: "**no**"}


def _cell(name: str, capability: Capability) -> str:
    return _WORDS[backend(name).capabilities()[capability].level]


def main() -> None:
    """Rewrite all pages."""
    for page in pages():
        page.write_text(updated(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
