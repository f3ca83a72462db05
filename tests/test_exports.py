"""Packages show what they hold: ``dir()`` and ``help()`` list exported names, or modules where none are exported."""

from __future__ import annotations

import importlib
import pydoc
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from orbit_core.exports import lazy_modules, lazy_names
from tests.distributions import DISTRIBUTIONS, ROOT

PACKAGES = sorted(
    ".".join(path.parent.relative_to((ROOT / each.folder).parent).parts)
    for each in DISTRIBUTIONS
    for path in (ROOT / each.folder).rglob("__init__.py")
    if "cli" not in path.parts and "contract" not in path.parts
)


PLUGINS = sorted(
    ".".join(path.parent.relative_to(folder.parent).parts)
    for folder in ROOT.glob("plugins/orbit-*/orbit_*")
    for path in folder.rglob("__init__.py")
)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """An empty package of two modules, one of which needs what is not installed."""
    folder = tmp_path / "shown_package"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "near.py").write_text("VALUE = 1\n", encoding="utf-8")
    (folder / "far.py").write_text("import not_installed_at_all\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("shown_package")
    for name in [name for name in sys.modules if name.startswith("shown_package")]:
        del sys.modules[name]


@pytest.mark.parametrize("name", PACKAGES)
@pytest.mark.filterwarnings("error::FutureWarning")  # of a name that has moved
def test_every_exported_name_is_shown_and_found(name: str) -> None:
    package = importlib.import_module(name)
    exported = set(getattr(package, "__all__", ()))
    assert exported <= {*dir(package)}
    assert all(getattr(package, each) is not None for each in exported)


@pytest.mark.parametrize("name", [*(each for each in PACKAGES if each != "orbit_policies"), *PLUGINS])
def test_every_package_shows_what_it_holds_and_no_imports_of_its_own(name: str) -> None:
    shown = {each for each in dir(importlib.import_module(name)) if not each.startswith("_")}
    assert shown
    assert not shown & {"importlib", "moved_name"}


def test_a_package_without_exports_shows_its_modules(package: ModuleType) -> None:
    package.__getattr__, package.__dir__ = lazy_modules("shown_package")  # pyright: ignore[reportAttributeAccessIssue]
    assert [name for name in dir(package) if not name.startswith("_")] == ["far", "near"]
    assert package.near.VALUE == 1
    with pytest.raises(AttributeError, match=r"'shown_package\.far' needs 'not_installed_at_all', which is not"):
        _ = package.far
    with pytest.raises(AttributeError, match="has no attribute 'nowhere'"):
        _ = package.nowhere
    assert "near" in pydoc.render_doc(package)


def test_a_name_loads_the_module_that_defines_it_on_first_use(package: ModuleType) -> None:
    package.__getattr__, package.__dir__ = lazy_names(  # pyright: ignore[reportAttributeAccessIssue]
        "shown_package", {"near": ("VALUE",)}
    )
    assert "VALUE" in dir(package)
    assert "shown_package.near" not in sys.modules
    assert package.VALUE == 1


def test_the_core_and_its_packages_load_without_torch() -> None:
    code = "import sys, orbit_core as o; o.envs, o.interfaces, o.scene; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
