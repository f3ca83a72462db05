"""Imports point one way, plugins see the contract and the kit alone, and the core knows no engine."""

from __future__ import annotations

import ast
import graphlib
import re
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path

import importlib_metadata
import pytest

from tests.distributions import DISTRIBUTIONS, Distribution

ROOT = Path(__file__).parents[1]
CORE = ROOT / "orbit_core"

# Each package may import those of lower rank, and its own.
RANKS = {
    "scene": 0,
    "exports": 0.5,
    "interfaces": 1,
    "files": 1.5,
    "distributions": 1.4,
    "registry": 1.5,
    "plugin_kit": 1.5,
    "configuration": 1.5,
    "installing": 1.3,
    "moved": 1.6,
    "backends": 2,
    "objects": 2,
    "dynamics": 2,
    "preparation": 2.5,
    "active": 3,
    "actuators": 3,
    "sensors": 3,
    "agent": 3,
    "actions": 3.2,
    "capture": 3,
    "world": 4,
    "envs": 5,
    "mdp": 5.5,
    "rollout": 5.5,
    "cli": 9,
}
# Newton is also a person and a unit: only the module or the name in quotes is the engine.
ENGINES = re.compile(
    r"""(?i:\b(mujoco|bullet|pybullet|sapien|warp|physx)\b)|import newton\b|\bnewton\.|["']newton["']"""
)


def imported_packages(path: Path) -> set[str]:
    """Names below ``orbit_core`` that a file imports, types included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            modules = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        else:
            continue
        found |= {module.split(".")[1] for module in modules if module.startswith("orbit_core.")}
    return found & {*RANKS}


def core_files() -> list[Path]:
    return sorted(CORE.rglob("*.py"))


def imported_tops(node: ast.AST) -> set[str]:
    """The packages of ORBIT that the import statements below a node name."""
    found: set[str] = set()
    for each in ast.walk(node):
        if isinstance(each, ast.ImportFrom) and each.module:
            found.add(each.module.partition(".")[0])
        elif isinstance(each, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in each.names}
    return {name for name in found if name.startswith("orbit_")}


@pytest.mark.parametrize("distribution", DISTRIBUTIONS, ids=lambda each: each.package)
def test_a_distribution_imports_what_it_says_that_it_needs(distribution: Distribution) -> None:
    allowed = {distribution.package, *distribution.needs, *distribution.optional}
    wrong = {
        f"{path.relative_to(ROOT)} imports {name}"
        for path in distribution.files
        for name in imported_tops(ast.parse(path.read_text())) - allowed
    }
    assert not wrong


@pytest.mark.parametrize("distribution", DISTRIBUTIONS, ids=lambda each: each.package)
def test_what_a_distribution_needs_is_in_its_metadata(distribution: Distribution) -> None:
    asked = importlib_metadata.requires(distribution.package.replace("_", "-")) or []
    named = {re.split(r"[^\w-]", line)[0].replace("-", "_") for line in asked if "extra ==" not in line}
    assert {name for name in named if name.startswith("orbit_")} <= distribution.needs
    imported = {name for path in distribution.files for name in imported_tops(ast.parse(path.read_text()))}
    assert (imported & distribution.needs) - {distribution.package} <= named | distribution.optional


def test_every_package_of_the_core_has_a_rank() -> None:
    packages = {path.relative_to(CORE).parts[0].removesuffix(".py") for path in core_files()} - {"__init__"}
    assert packages == set(RANKS)


@pytest.mark.parametrize("package", RANKS)
def test_imports_point_down(package: str) -> None:
    files = [path for path in core_files() if path.relative_to(CORE).parts[0].removesuffix(".py") == package]
    wrong = {
        f"{path.relative_to(ROOT)} imports {other}"
        for path in files
        for other in imported_packages(path)
        if other != package and RANKS[other] >= RANKS[package]
    }
    assert not wrong


def test_a_plugin_imports_the_contract_and_the_kit_alone() -> None:
    wrong = {
        f"{path.relative_to(ROOT)} imports {package}"
        for folder in ("plugins", "examples")
        for path in (ROOT / folder).glob("orbit-*/orbit_*/**/*.py")
        for package in imported_packages(path)
        if package not in {"interfaces", "scene", "plugin_kit"}
    }
    assert not wrong


def test_a_plugin_imports_no_other_but_what_is_shared() -> None:
    wrong = {
        f"{path.relative_to(ROOT)} imports {module}"
        for path in (ROOT / "plugins").glob("orbit-*/orbit_*/**/*.py")
        for module in re.findall(r"^\s*(?:from|import) (orbit_\w+)", path.read_text(), re.MULTILINE)
        if module not in {"orbit_core", "orbit_mjmodel", "orbit_warpkit", path.relative_to(ROOT).parts[2]}
    }
    assert not wrong


def test_neither_core_nor_tasks_name_an_engine() -> None:
    # A file format is no engine, though one is named after its parser; the schemas of USD bear their maker's name; and
    # a package of robots' models may be an engine's.
    models = re.compile(r'"pybullet[^"]*"')
    formats = {"mjcf", "usd", "urdf"}
    named = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for distribution in DISTRIBUTIONS
        if distribution.package != "orbit_conformance"  # which says of engines what holds of each
        for path in distribution.files
        if not formats & {path.stem.partition("_")[0], path.parent.name}
        for number, line in enumerate(path.read_text().splitlines(), start=1)
        if ENGINES.search(models.sub("", line))
    ]
    assert not named


def modules() -> dict[str, Path]:
    """Every module of ORBIT's distributions, the plugins and the examples' packages, by its full name."""
    packages = [
        *(ROOT / distribution.folder for distribution in DISTRIBUTIONS),
        *ROOT.glob("plugins/orbit-*/orbit_*"),
        *ROOT.glob("examples/orbit-*/orbit_*"),
    ]
    return {
        ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__"): path
        for package in packages
        for path in package.rglob("*.py")
    }


def imported_modules(path: Path, known: Collection[str]) -> set[str]:
    """Those of the known modules that a file imports, wherever it does so, types included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            # A name that is no module is the package's own, and it alone is asked for.
            found |= {name if name in known else node.module for name in full}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & {*known}


ENVIRONMENT = "orbit_core.envs.environment"
# An environment is made of these, and terms are functions of the environment: to say so in their types they name the
# class that imports them. Nothing else may.
PARTS_OF_AN_ENVIRONMENT = tuple(
    f"orbit_core.envs.{name}"
    for name in (
        "command_manager", "event_manager", "expert_phase", "multi_agent", "observation_manager",
        "premises", "reward_manager", "state", "task",
    )
)  # fmt: skip


def imports_for_types_alone(path: Path, module: str) -> bool:
    """Return True if every import of a module in a file is below ``if TYPE_CHECKING``."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    guarded = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and isinstance(block.test, ast.Name) and block.test.id == "TYPE_CHECKING"
        for node in ast.walk(block)
    }
    found = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == module]
    return bool(found) and all(id(node) in guarded for node in found)


def test_no_module_imports_itself_through_others() -> None:
    files = modules()
    assert len(files) > 200
    arrows = {name: imported_modules(path, files) - {name} for name, path in files.items()}
    for name in PARTS_OF_AN_ENVIRONMENT:
        assert imports_for_types_alone(files[name], ENVIRONMENT), f"{name} imports {ENVIRONMENT} for more than types"
        arrows[name] -= {ENVIRONMENT}
    try:
        graphlib.TopologicalSorter(arrows).prepare()
    except graphlib.CycleError as error:
        pytest.fail("circular import: " + " <- ".join(error.args[1]))


def test_a_circular_import_for_types_alone_is_found(tmp_path: Path) -> None:
    one, other = tmp_path / "one.py", tmp_path / "other.py"
    one.write_text("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from other import Other\n")
    other.write_text("def late():\n    import one\n")
    arrows = {path.stem: imported_modules(path, {"one", "other"}) for path in (one, other)}
    with pytest.raises(graphlib.CycleError):
        graphlib.TopologicalSorter(arrows).prepare()


@pytest.mark.parametrize("module", ["orbit_core", "orbit_core.scene", "orbit_core.backends", "orbit_core.envs"])
def test_importing_is_light(module: str) -> None:
    heavy = ["torch", "mujoco", "pxr", "trimesh", "viser", "tyro", "gymnasium", "imageio", "matplotlib"]
    code = f"import sys, {module}; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
