"""A release has one version everywhere, changes, and all archives; what is missing is named with its remedy."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from orbit_core import __version__
from tools import release


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A folder with what of the checkout states versions."""
    shown = [project.path for project in release.projects()]
    shown += [release.ROOT / name for name in ("orbit_core/__init__.py", "CITATION.cff", "CHANGELOG.md")]
    shown += [release.ROOT / name for name in map(str, release.FOLLOWING)]
    for path in shown:
        place = tmp_path / path.relative_to(release.ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, place)
    return tmp_path


def archives(folder: Path, version: str, *, core_bytes: int = 10) -> Path:
    dist = folder / "dist"
    dist.mkdir()
    for project in release.projects():
        for name in project.archives(version):
            (dist / name).write_bytes(b"0" * (core_bytes if name.startswith("orbit_core-") else 10))
    return dist


def test_every_place_of_the_checkout_states_the_cores_version() -> None:
    assert release.version_of() == __version__
    assert release.version_faults() == []


def test_every_distribution_is_known_and_stands_after_what_it_needs() -> None:
    projects = release.projects()
    names = [project.name for project in projects]
    assert {"orbit-core", "orbit-tasks", "orbit-conformance", "orbit-mujoco"} <= {*names}
    assert len(names) == len({*names})
    for position, project in enumerate(projects):
        assert {*project.needs} <= {*names[:position]}


def test_a_version_is_set_in_all_places_at_once(copy: Path) -> None:
    release.set_version("0.3.0rc1", copy)
    assert release.version_of(copy) == "0.3.0rc1"
    assert release.version_faults(copy) == []
    assert '"orbit-newton[sim]~=0.3.0rc1"' in (copy / "pyproject.toml").read_text()
    assert "\nversion: 0.3.0rc1\n" in (copy / "CITATION.cff").read_text()
    example = (copy / "examples/orbit-torch/pyproject.toml").read_text()
    assert '"orbit-core~=0.3.0rc1"' in example
    assert 'version = "0.1.0"' in example
    assert '"orbit-core~=0.3.0rc1"' in (copy / "docs/write-a-backend.md").read_text()
    with pytest.raises(SystemExit, match=r"'next' is no version such as 0\.2\.0"):
        release.set_version("next", copy)


def test_a_place_that_states_another_version_is_named(copy: Path) -> None:
    path = copy / "plugins/orbit-mujoco/pyproject.toml"
    path.write_text(path.read_text().replace(f"orbit-core~={__version__}", "orbit-core~=0.0.1"))
    (fault,) = release.version_faults(copy)
    assert fault.startswith('plugins/orbit-mujoco/pyproject.toml states "orbit-core~=0.0.1"')
    assert fault.endswith(f"python tools/release.py set {__version__}")


def test_a_complete_release_passes_and_is_shown(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dist = archives(copy, __version__)
    assert release.check(dist, copy) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert f"orbit_core-{__version__}-py3-none-any.whl" in shown.out
    assert f"git tag --annotate v{__version__}" in shown.out


def test_what_a_release_lacks_is_named(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dist = archives(copy, __version__, core_bytes=release.LARGEST_CORE + 1)
    (dist / f"orbit_data-{__version__}.tar.gz").unlink()
    (dist / "orbit_data-0.0.1.tar.gz").touch()
    changes = re.sub(r"^## .*", "", (copy / "CHANGELOG.md").read_text(), flags=re.MULTILINE | re.DOTALL)
    (copy / "CHANGELOG.md").write_text(changes + "## Unreleased\n\n## 0.0.1\n\n* Add it.\n")
    assert release.check(dist, copy) == 1
    faults = capsys.readouterr().err
    assert f"orbit_data-{__version__}.tar.gz is missing: make wheels" in faults
    assert "orbit_data-0.0.1.tar.gz is of another version" in faults
    assert "orbit_core-" in faults
    assert "bytes, more than 1,000,000" in faults
    assert f"CHANGELOG.md has no changes under '## {__version__}' or '## Unreleased'" in faults
