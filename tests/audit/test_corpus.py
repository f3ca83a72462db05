"""Every published model that is installed reads as another reader reads it, or the page of the corpus says why not.

URDF files are read without their shapes, whose meshes take minutes; ``tools/asset_corpus.py`` reads them whole.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from orbit_assets import load_articulation
from orbit_assets.audit.audit import INERTIA_TOLERANCE, KINEMATICS_TOLERANCE, MASS_TOLERANCE, reference_of
from orbit_assets.audit.mjcf_reference import urdf_without_shapes
from orbit_assets.audit.reference import compare
from orbit_assets.options import ReadOptions
from orbit_assets.scene_files import load_scene
from orbit_core.interfaces.errors import AssetError

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "measured" / "assets-corpus.md").read_text(encoding="utf-8")


def tool() -> ModuleType:
    """``tools/asset_corpus.py``, which is in no package."""
    spec = importlib.util.spec_from_file_location("asset_corpus", ROOT / "tools" / "asset_corpus.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def listed(heading: str) -> set[str]:
    """Names in the first column of the page's table under a heading."""
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)
    return set(re.findall(r"^\| (\S+) \|", section, re.MULTILINE)) - {"file"}


TOOL = tool()
CORPUS: dict[str, Path] = TOOL.corpus()
READ, LENIENT, REFUSED = (listed(heading) for heading in ("Read", "Read with drop and repair", "Refused"))
SLOW = {name for name in REFUSED if "/flex/" in name or "collision_sdf" in name}
"""Meshes of these take seconds to compile, before they are refused."""


@pytest.mark.parametrize("name", sorted(CORPUS.keys() - SLOW))
def test_a_model_reads_as_another_reader_reads_it(name: str, tmp_path: Path) -> None:
    path = CORPUS[name]
    options: ReadOptions = TOOL.options_for(path, lenient=name in LENIENT)
    try:
        if path.suffix == ".urdf":
            bare = tmp_path / path.name
            bare.write_text(urdf_without_shapes(path), encoding="utf-8")
            path = bare
        read = load_articulation(path, merge=False, options=options)
    except AssetError as refusal:
        assert name in REFUSED
        if "several articulations" in str(refusal):
            scene = load_scene(path, options=TOOL.options_for(path, lenient=True))
            assert len((*scene.robots, *scene.objects)) > 1
        return
    try:
        reference = reference_of(path, read.root.name)
    except AssetError:  # the other reader refuses what this one reads; the page says so
        return
    assert reference is not None
    found = compare(read, reference)
    assert found.mass <= MASS_TOLERANCE
    assert max(found.kinematics, found.rotation) <= KINEMATICS_TOLERANCE
    assert found.mass_matrix <= INERTIA_TOLERANCE or name in LENIENT
    assert name in READ | LENIENT | REFUSED


@pytest.mark.parametrize("word", ["double_pendulum_description", "simple_humanoid", "pybullet_data/cube"])
def test_the_page_is_what_the_command_finds(word: str) -> None:
    """On a sample, with all shapes: else ``python tools/asset_corpus.py --page docs/measured/assets-corpus.md``."""
    names = [name for name in CORPUS if word in name]
    if not names:
        pytest.skip("the package of these models is not installed")
    for name in names:
        outcome = TOOL.examine(name, CORPUS[name])
        assert outcome.exact
        assert not outcome.foreign
        column = READ if not outcome.strict else LENIENT if not outcome.refusal else REFUSED
        assert name in column, TOOL.line(outcome)
