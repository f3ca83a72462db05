"""Prepare a release: set the version everywhere, and check what would be uploaded. Nothing is uploaded.

    python tools/release.py set 0.2.0      write the version into every project, its ranges, the core and CITATION.cff
    python tools/release.py check dist     check version, changes and archives; print the uploads and the tag

The version is that of ``orbit_core.__version__``; all distributions share it.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from datetime import date
from pathlib import Path

ROOT = Path(__file__).parents[1]
LARGEST_CORE = 1_000_000
"""Bytes of orbit-core's wheel, which every user downloads."""

_MODULE = Path("orbit_core/__init__.py")
_IN_MODULE = re.compile(r'(__version__ = ")([^"]+)(")')
_IN_PROJECT = re.compile(r'(^version = ")([^"]+)(")', re.MULTILINE)
_IN_CITATION = re.compile(r"(^version: )(\S+)($)", re.MULTILINE)
_RANGE = re.compile(r'("orbit-[a-z]+(?:\[[\w,-]+\])?~=)([^"]+)(")')
_VERSION = re.compile(r"\d+\.\d+\.\d+((a|b|rc)\d+)?")
# Projects that are no distribution of ORBIT's, and pages that show one: their own versions stay, their ranges follow.
FOLLOWING = (
    Path("examples/orbit-torch/pyproject.toml"),
    Path("examples/lerobot-env-orbit/pyproject.toml"),
    Path("docs/write-a-backend.md"),
)
"""Files whose ranges of ORBIT's distributions follow its version."""


@dataclass(frozen=True)
class Project:
    """A distribution of ORBIT's, by its project file."""

    path: Path
    name: str
    needs: tuple[str, ...]
    """Distributions of ORBIT's that it needs without extras."""

    def archives(self, version: str) -> tuple[str, str]:
        """Return the names of its wheel and its source archive."""
        stem = f"{self.name.replace('-', '_')}-{version}"
        return f"{stem}-py3-none-any.whl", f"{stem}.tar.gz"


def projects(root: Path = ROOT) -> list[Project]:
    """Return all distributions of the workspace, each after those that it needs."""
    workspace = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["uv"]["workspace"]["members"]
    folders = [root, *(folder for pattern in workspace for folder in sorted(root.glob(pattern)))]
    found: dict[str, Project] = {}
    for path in (folder / "pyproject.toml" for folder in folders):
        about = tomllib.loads(path.read_text())["project"]
        needs = tuple(line.partition("~=")[0].partition("[")[0] for line in about["dependencies"] if "orbit-" in line)
        found[about["name"]] = Project(path, about["name"], needs)
    ordered: dict[str, Project] = {}

    def add(project: Project) -> None:
        for name in project.needs:
            add(found[name])
        ordered[project.name] = project

    for project in found.values():
        add(project)
    return list(ordered.values())


def version_of(root: Path = ROOT) -> str:
    """Return the version of the checkout."""
    match = _IN_MODULE.search((root / _MODULE).read_text())
    assert match is not None
    return match[2]


def set_version(version: str, root: Path = ROOT) -> None:
    """Write a version wherever one is stated."""
    if not _VERSION.fullmatch(version):
        raise SystemExit(f"'{version}' is no version such as 0.2.0 or 0.2.0rc1")
    for path, patterns in _places(root).items():
        text = path.read_text()
        for pattern in patterns:
            text = pattern.sub(rf"\g<1>{version}\g<3>", text)
        path.write_text(text)


def version_faults(root: Path = ROOT) -> list[str]:
    """Return one sentence for each place whose version is not that of the core."""
    version = version_of(root)
    return [
        f"{path.relative_to(root)} states {match[0].strip()}, and orbit_core has version {version}: "
        f"python tools/release.py set {version}"
        for path, patterns in _places(root).items()
        for pattern in patterns
        for match in pattern.finditer(path.read_text())
        if match[2] != version
    ]


def changes(version: str, root: Path = ROOT) -> tuple[str, str]:
    """Return heading and text of a version's section of CHANGELOG.md, or of the unreleased one; blanks if none."""
    sections = re.split(r"^## ", (root / "CHANGELOG.md").read_text(), flags=re.MULTILINE)[1:]
    texts = {heading.strip(): text.strip() for heading, _, text in (section.partition("\n") for section in sections)}
    for heading, text in texts.items():
        if heading.split()[0] in (version, "Unreleased") and re.search(r"^\* ", text, re.MULTILINE):
            return heading, text
    return "", ""


def archive_faults(dist: Path, version: str, root: Path = ROOT) -> list[str]:
    """Return one sentence for each archive that is missing, left over or too large."""
    wanted = [name for project in projects(root) for name in project.archives(version)]
    present = {path.name for path in dist.glob("*")}
    faults = [f"{dist}/{name} is missing: make wheels" for name in wanted if name not in present]
    faults += [f"{dist}/{name} is of another version: make wheels" for name in sorted(present - {*wanted})]
    core = dist / wanted[0]
    if core.exists() and core.stat().st_size > LARGEST_CORE:
        faults.append(f"{core} has {core.stat().st_size:,} bytes, more than {LARGEST_CORE:,}")
    return faults


def check(dist: Path, root: Path = ROOT) -> int:
    """Print what a release would upload, and the faults that stand in its way; return the exit code."""
    version, tag = version_of(root), f"v{version_of(root)}"
    heading, text = changes(version, root)
    faults = [*version_faults(root), *archive_faults(dist, version, root)]
    if not heading:
        faults.append(f"CHANGELOG.md has no changes under '## {version}' or '## Unreleased'")
    if _git(root, "tag", "--list", tag):
        faults.append(f"the tag {tag} exists: python tools/release.py set VERSION")
    names = [name for project in projects(root) for name in project.archives(version)]
    for name in names:
        path = dist / name
        print(f"{path.stat().st_size if path.exists() else 0:>12,} bytes  {name}")
    print(f"{len(text.splitlines())} lines of changes under '{heading}'")
    print("\nA release would be:")
    if heading.startswith("Unreleased"):
        print(f"  CHANGELOG.md: rename '## Unreleased' to '## {version} ({date.today()})'")
    if _git(root, "status", "--porcelain"):
        print("  git commit: the working tree has changes that are in no commit")
    print(f"  git tag --annotate {tag} --message 'ORBIT {version}' && git push origin {tag}")
    print(f"  twine upload {dist}/*")
    for fault in faults:
        print(f"fault: {fault}", file=sys.stderr)
    return 1 if faults else 0


def _places(root: Path) -> dict[Path, tuple[re.Pattern[str], ...]]:
    """Return the files that state a version, with the patterns by which each does."""
    places: dict[Path, tuple[re.Pattern[str], ...]] = {
        root / _MODULE: (_IN_MODULE,),
        root / "CITATION.cff": (_IN_CITATION,),
    }
    places |= {project.path: (_IN_PROJECT, _RANGE) for project in projects(root)}
    return places | {root / path: (_RANGE,) for path in FOLLOWING}


def _git(root: Path, *words: str) -> str:
    return subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=False).stdout.strip()


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("set").add_argument("version")
    commands.add_parser("check").add_argument("dist", type=Path)
    words = parser.parse_args()
    if words.command == "check":
        return check(words.dist)
    set_version(words.version)
    return 0


if __name__ == "__main__":
    sys.exit(main())
