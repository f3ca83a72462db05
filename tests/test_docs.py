"""The documentation tells the truth: generated parts are current, links resolve, and code that is shown runs."""

from __future__ import annotations

import ast
import importlib.util
import pkgutil
import re
import runpy
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from orbit_core.cli import COMMANDS, OTHERS
from orbit_core.envs import task_entries
from orbit_core.moved import new_name
from tests.distributions import DISTRIBUTIONS

ROOT = Path(__file__).parents[1]
SITE = runpy.run_path(str(ROOT / "tools" / "docs_site.py"))
GENERATOR = runpy.run_path(str(ROOT / "tools" / "readme_tables.py"))
PAGES: list[Path] = GENERATOR["pages"]()
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
_LINK = re.compile(r"\]\((?!https?:|#)([^)\s#]+)(?:#([^)\s]+))?\)")
_PYTHON = re.compile(r"^```python[^\n]*\n(.*?)^```", re.DOTALL | re.MULTILINE)
_RUNNABLE = re.compile(r"^```python runnable\n(.*?)^```", re.DOTALL | re.MULTILINE)


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def anchors(page: Path) -> set[str]:
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".html":
        return {*re.findall(r'\bid="([^"]+)"', text)}
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def shown_imports(page: Path) -> list[str]:
    """Import statements of the distributions in a page's blocks of Python, one name each."""
    statements: set[str] = set()
    for block in _PYTHON.findall(page.read_text(encoding="utf-8")):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.Import):
                statements |= {f"import {name.name}" for name in node.names}
            elif isinstance(node, ast.ImportFrom):
                statements |= {f"from {node.module} import {name.name}" for name in node.names}
    return sorted(line for line in statements if re.match(r"(?:import|from) orbit_(?!runtime\b|torch\b)", line))


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


@pytest.mark.parametrize("page", [page for page in PAGES if shown_imports(page)], ids=name_of)
def test_shown_imports_are_of_names_as_they_are_today(page: Path) -> None:
    """A name that has moved still imports, with a warning: newcomers shall not learn the old one."""
    for statement in shown_imports(page):
        assert new_name(".".join(re.findall(r"(?:from|import) (\S+)", statement))) is None  # not cached by another test
        with warnings.catch_warnings():
            warnings.simplefilter("error", FutureWarning)
            exec(statement, {})


def test_the_page_of_the_command_line_has_every_command() -> None:
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    assert [name for name in (*COMMANDS, *OTHERS) if f"| `orbit {name} " not in page] == ["conformance"]
    assert "| `orbit conformance` |" in page


def test_the_gallery_shows_every_task() -> None:
    """Else: add it to a group of tools/task_gallery.py, and run that with --only NAME."""
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert [name for name in task_entries() if f"**{name}**" not in page] == []


def test_renamed_names_are_those_of_today() -> None:
    rows = (ROOT / "docs" / "renamed.md").read_text(encoding="utf-8").splitlines()
    today = [name for row in rows if row.startswith("|") for name in re.findall(r"`(orbit_[\w.]+)`", row.split("|")[2])]
    packages = {distribution.package for distribution in DISTRIBUTIONS}  # without plugins, which need their engines
    assert len(today) > 50
    with warnings.catch_warnings():
        warnings.simplefilter("error", FutureWarning)
        for name in today:
            if name.partition(".")[0] in packages:
                pkgutil.resolve_name(name)


def navigated(entry: object) -> Iterator[str]:
    """Pages of an entry of the navigation."""
    match entry:
        case dict():
            for content in entry.values():
                yield from navigated(content)
        case list():
            for content in entry:
                yield from navigated(content)
        case _:
            yield str(entry)


def test_the_navigation_has_every_page() -> None:
    nav = tomllib.loads((ROOT / "docs" / "zensical.toml").read_text(encoding="utf-8"))["project"]["nav"]
    pages = {str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")}
    assert {*navigated(nav)} - {"api"} == pages


def test_the_sites_links_and_names_lead_somewhere(tmp_path: Path) -> None:
    """As `make docs` finds them before it builds: links to sources become pages, full names links to the reference."""
    stage = SITE["Stage"](tmp_path)
    stage.write()
    assert not stage.problems
    assert "(api/orbit_core.envs.making.md#orbit_core.envs.making.make)" in (tmp_path / "tutorials.md").read_text()
    assert '"orbit_core.scene.CameraSpec")' in (tmp_path / "sensors.md").read_text()
    assert (tmp_path / "source/examples/lift.py.md").exists()
    assert (tmp_path / "api/orbit_core.world.world.md").exists()


def test_a_name_that_does_not_exist_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "docs").mkdir()
    text = (
        "`orbit_core.envs.make`, `orbit_core.envs.nope`, [here](nowhere.md)\n\n```python\norbit_core.envs.nope\n```\n"
    )
    (tmp_path / "docs" / "page.md").write_text(text, encoding="utf-8")
    monkeypatch.setitem(SITE["Stage"].write.__globals__, "ROOT", tmp_path)
    monkeypatch.setitem(SITE["Stage"].write.__globals__, "DOCS", tmp_path / "docs")
    stage = SITE["Stage"](tmp_path / "out")
    stage.write()
    assert stage.problems == [
        "docs/page.md: link to nowhere.md leads nowhere",
        "docs/page.md: there is no orbit_core.envs.nope",
    ]


def test_pages_that_load_from_another_host_are_found(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text(
        '<a href="https://a.example">text</a> <script src="https://b.example/c.js"></script>'
    )
    (tmp_path / "page.css").write_text("@import 'https://d.example'; p { background: url(e.png) }")
    assert SITE["loaded_from_elsewhere"](tmp_path) == [
        "page.css: @import 'https://d.example", 'page.html: <script src="https://b.example/c.js',
    ]  # fmt: skip


@pytest.mark.skipif(importlib.util.find_spec("zensical") is None, reason="the extra 'docs' is not installed")
def test_the_site_builds_strictly() -> None:
    done = subprocess.run(
        [sys.executable, "tools/docs_site.py", "build"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (ROOT / "out" / "site" / "api" / "orbit_core.envs.environment.html").exists()


@pytest.mark.usefixtures("forgotten_names")
@pytest.mark.parametrize("code", [pytest.param(code, id=name) for name, code in runnable_blocks()])
def test_shown_code_runs(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "shown.py"
    script.write_text(code, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")


@pytest.mark.usefixtures("forgotten_names")
@pytest.mark.parametrize("example", EXAMPLES, ids=name_of)
def test_examples_run(example: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(example), run_name="__main__")
