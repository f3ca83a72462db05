"""The documentation tells the truth: generated parts are current, links resolve, and code that is shown runs."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
GENERATOR = runpy.run_path(str(ROOT / "tools" / "readme_tables.py"))
PAGES: list[Path] = GENERATOR["pages"]()
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
_LINK = re.compile(r"\]\((?!https?:|#)([^)\s#]+)(?:#([^)\s]+))?\)")
_RUNNABLE = re.compile(r"^```python runnable\n(.*?)^```", re.DOTALL | re.MULTILINE)


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def anchors(page: Path) -> set[str]:
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".html":
        return {*re.findall(r'\bid="([^"]+)"', text)}
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def runnable_blocks() -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for page in PAGES:
        blocks = _RUNNABLE.findall(page.read_text(encoding="utf-8"))
        found += [(f"{name_of(page)}-{number}", block) for number, block in enumerate(blocks, 1)]
    return found


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_generated_parts_are_current(page: Path) -> None:
    """Else: python tools/readme_tables.py."""
    text = page.read_text(encoding="utf-8")
    assert GENERATOR["updated"](text) == text


def test_the_page_of_backends_shows_every_backends_capabilities() -> None:
    assert GENERATOR["capability_table"]() in (ROOT / "docs" / "backends.md").read_text(encoding="utf-8")


def test_arms_at_their_tasks_are_shown_with_the_figures_kept() -> None:
    """Else: python tools/robot_tasks.py."""
    tool = runpy.run_path(str(ROOT / "tools" / "robot_tasks.py"))
    text = tool["PAGE"].read_text(encoding="utf-8")
    assert tool["page"](text, tool["kept"]()) == text


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_resolve(page: Path) -> None:
    for target, anchor in _LINK.findall(page.read_text(encoding="utf-8")):
        path = page.parent / target
        assert path.exists(), target
        assert not anchor or anchor in anchors(path), f"{target}#{anchor}"


def test_the_index_links_every_page() -> None:
    linked = {target for target, _ in _LINK.findall((ROOT / "docs" / "index.md").read_text(encoding="utf-8"))}
    assert {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"} <= linked


@pytest.mark.parametrize("code", [pytest.param(code, id=name) for name, code in runnable_blocks()])
def test_shown_code_runs(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "shown.py"
    script.write_text(code, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")


@pytest.mark.parametrize("example", EXAMPLES, ids=name_of)
def test_examples_run(example: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(example), run_name="__main__")
