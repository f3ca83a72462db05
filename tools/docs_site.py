"""Build the documentation site: stage the pages, write the API reference, run Zensical strictly, check the result.

    python tools/docs_site.py check            links and names only, in seconds
    python tools/docs_site.py build            into out/site; every warning is an error
    python tools/docs_site.py serve [ADDRESS]  build, and serve at http://127.0.0.1:8000

Pages are written for GitHub and for the site alike. Staging copies docs/ to out/docs/pages. In the copies, links to
sources and other files of the checkout lead to pages of the site, and full names such as `orbit_core.envs.make` to the
API reference. A name or a link that leads nowhere fails the build.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import tomlkit

sys.path.insert(0, str(Path(__file__).parent))  # for runpy, which loads this file from elsewhere
import docs_api

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
STAGE = ROOT / "out" / "docs"
SITE = ROOT / "out" / "site"
CODE_PAGES = "source"
"""Folder of the pages that show a source file which has no page of the API reference."""

_FENCE = re.compile(r"(^ *```.*?^ *```[^\n]*\n)", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"(\]\()(?!https?:|mailto:|#)([^)\s#]+)(#[^)\s]+)?(\))")
_NAME = re.compile(r"(?<![\[`])`(orbit_\w+(?:\.\w+)+)`(?!\])")
_RESOURCE = re.compile(
    r"<(?:script|img|source|iframe|video|link)\b[^>]*?\b(?:src|srcset|href)=[\"']?(?:https?:)?//[^\"'\s>]+",
    re.IGNORECASE,
)
_STYLE = re.compile(r"(?:url\(|@import\s+)[\"']?(?:https?:)?//[^\"')\s]+")


@dataclass
class Stage:
    """The pages of the site as they are handed to the generator."""

    folder: Path
    """Folder that becomes the generator's ``docs_dir``."""
    problems: list[str] = field(default_factory=list)
    """Links and names that lead nowhere."""
    wanted: dict[PurePosixPath, PurePosixPath] = field(default_factory=dict)
    """Files of the checkout outside docs/ that pages link to, and their place in the site."""

    def write(self) -> None:
        """Copy docs/, then what its pages link to, then write the API reference."""
        shutil.rmtree(self.folder, ignore_errors=True)
        for path in sorted(DOCS.rglob("*")):
            if path.is_file() and path.suffix != ".toml":
                self._copy(PurePosixPath(path.relative_to(ROOT)), PurePosixPath(path.relative_to(DOCS)))
        written: set[PurePosixPath] = set()
        while missing := {*self.wanted} - written:
            for source in sorted(missing):
                self._copy(source, self.wanted[source])
            written |= missing
        docs_api.write_pages(self.folder)

    def _copy(self, source: PurePosixPath, target: PurePosixPath) -> None:
        place = self.folder / target
        place.parent.mkdir(parents=True, exist_ok=True)
        if source.suffix == ".md":
            place.write_text(self._page(source, target), encoding="utf-8")
        elif target.suffix == ".md":
            text = (ROOT / source).read_text(encoding="utf-8")
            place.write_text(f"# {source}\n\n```{_LANGUAGES.get(source.suffix, '')}\n{text}```\n", encoding="utf-8")
        else:
            shutil.copyfile(ROOT / source, place)

    def _page(self, source: PurePosixPath, target: PurePosixPath) -> str:
        text = (ROOT / source).read_text(encoding="utf-8").replace("```python runnable\n", "```python\n")
        parts = _FENCE.split(text)
        for index in range(0, len(parts), 2):  # what is between the blocks of code
            parts[index] = _LINK.sub(lambda link: self._link(link, source, target), parts[index])
            parts[index] = _NAME.sub(lambda name: self._name(name, source, target), parts[index])
        return (_FRONT if source == PurePosixPath("docs/index.md") else "") + "".join(parts)

    def _link(self, link: re.Match[str], source: PurePosixPath, target: PurePosixPath) -> str:
        path = PurePosixPath(os.path.normpath(source.parent / link[2]))
        place = self._place(path)
        if place is None:
            self.problems.append(f"{source}: link to {link[2]} leads nowhere")
            return link[0]
        return f"{link[1]}{_relative(place, target)}{link[3] or ''}{link[4]}"

    def _place(self, path: PurePosixPath) -> PurePosixPath | None:
        """Return where a file or folder of the checkout is in the site; None if it does not exist."""
        if (ROOT / path).is_dir():
            names = (path / name for name in ("index.md", "README.md", "__init__.py"))
            found = next((name for name in names if (ROOT / name).exists()), None)
            return found and self._place(found)
        if not (ROOT / path).exists():
            return None
        if path.is_relative_to("docs"):
            return path.relative_to("docs")
        if path.suffix == ".py" and (module := docs_api.module_at(ROOT / path)):
            return PurePosixPath(docs_api.page_of(module))
        place = path if path.suffix == ".md" else PurePosixPath(CODE_PAGES) / f"{path}.md"
        self.wanted[path] = place
        return place

    def _name(self, name: re.Match[str], source: PurePosixPath, target: PurePosixPath) -> str:
        if name[1].partition(".")[0] not in docs_api.modules() or _is_history(source):
            return name[0]
        place = docs_api.resolve(name[1])
        if place is None:
            self.problems.append(f"{source}: there is no {name[1]}")
            return name[0]
        page = _relative(PurePosixPath(docs_api.page_of(place[0])), target)
        return f"[{name[0]}]({page}{'#' if place[1] else ''}{place[1]})"


_FRONT = "---\nhide: [navigation, toc]\n---\n\n"
"""Head of the front page, which takes the whole width."""
_LANGUAGES = {".py": "python", ".toml": "toml", ".sh": "sh", ".json": "json"}


def _is_history(source: PurePosixPath) -> bool:
    """Return True for pages that name what no longer exists."""
    return source.name in ("renamed.md", "CHANGELOG.md")


def _relative(place: PurePosixPath, page: PurePosixPath) -> str:
    return os.path.relpath(place, page.parent)


def check() -> None:
    """Write the pages below out/docs.

    Raises:
        SystemExit: a link or a name leads nowhere.
    """
    pages = Stage(STAGE / "pages")
    pages.write()
    if pages.problems:
        sys.exit("\n".join(pages.problems))


def stage() -> Path:
    """Write pages and configuration below out/docs, and return the configuration's path.

    Raises:
        SystemExit: a link or a name leads nowhere.
    """
    check()
    config = tomlkit.parse((DOCS / "zensical.toml").read_text(encoding="utf-8"))
    project = config["project"]
    project["docs_dir"], project["site_dir"] = "pages", "site"
    project["nav"] = [{"API": docs_api.navigation()} if entry == "api" else entry for entry in project["nav"].unwrap()]
    python = project["plugins"]["mkdocstrings"]["handlers"]["python"]
    python["paths"] = [str(folder) for folder in dict.fromkeys(folder.parent for folder in docs_api.package_folders())]
    python["options"]["extensions"] = [str(Path(docs_api.__file__).with_name("docs_roles.py"))]
    path = STAGE / "zensical.toml"
    path.write_text(tomlkit.dumps(config), encoding="utf-8")
    return path


def build() -> None:
    """Build the site into out/site.

    Raises:
        SystemExit: the generator warns, or a page loads something from elsewhere.
    """
    config = stage()
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--config-file", str(config)]
    done = subprocess.run(command, cwd=STAGE, capture_output=True, text=True, check=False)
    output = done.stdout + done.stderr
    # Zensical does not count the warnings of mkdocstrings' parser.
    warnings = [line for line in output.splitlines() if line.startswith("griffe:")]
    if done.returncode or warnings:
        sys.exit(output)
    shutil.rmtree(SITE, ignore_errors=True)
    (STAGE / "site").rename(SITE)  # the generator writes only below its configuration
    if foreign := loaded_from_elsewhere(SITE):
        sys.exit("\n".join(foreign))
    print(f"{len([*SITE.rglob('*.html')])} pages in {os.path.relpath(SITE)}")


def loaded_from_elsewhere(site: Path) -> list[str]:
    """Return a line for each resource that a page or a style sheet would load from another host."""
    found: list[str] = []
    for path in sorted([*site.rglob("*.html"), *site.rglob("*.css")]):
        if "conformance" in path.relative_to(site).parts[:1]:
            continue  # a report is a page of its own, checked by tests/conformance
        pattern = _RESOURCE if path.suffix == ".html" else _STYLE
        found += [
            f"{path.relative_to(site)}: {match[0]}" for match in pattern.finditer(path.read_text(encoding="utf-8"))
        ]
    return found


def serve(address: str = "127.0.0.1:8000") -> None:
    """Serve the site and rebuild the pages that change below out/docs."""
    command = [sys.executable, "-m", "zensical", "serve", "--config-file", str(stage()), "--dev-addr", address]
    subprocess.run(command, cwd=STAGE, check=False)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["check"]:
            check()
        case ["build"]:
            build()
        case ["serve", *rest]:
            serve(*rest)
        case _:
            sys.exit(__doc__)
