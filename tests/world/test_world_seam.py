"""Worlds are a seam: who uses one knows the contract alone."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("orbit_core", "orbit_tasks", "plugins", "tests", "examples", "docs", "benchmarks", "tools")
CLASSES = ("SimulatedWorld", "SimulatedObject", "SimulatedRobot", "SimulatedMarker", "SimulatedDeformable")


def test_nothing_outside_of_its_folder_names_the_simulated_world() -> None:
    files = [path for name in FOLDERS for kind in ("*.py", "*.md") for path in (ROOT / name).rglob(kind)]
    assert len(files) > 200
    outside = [path for path in files if ROOT / "orbit_core/world" not in path.parents and path != Path(__file__)]
    wrong = {
        f"{path.relative_to(ROOT)} names {name}" for path in outside for name in CLASSES if name in path.read_text()
    }
    assert not wrong
