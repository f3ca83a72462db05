"""Stages that multiply by referring to themselves are refused before they are composed."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from pxr import UsdUtils

from orbit_assets import load_articulation
from orbit_assets.catalogue import robot
from orbit_assets.options import ReadLimits, ReadOptions
from orbit_assets.usd import write_usd
from orbit_core.interfaces.errors import AssetError

BODY = (
    'def Cube "ball" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])\n{\n    double size = 1\n}\n'
)


def stage(path: Path, levels: int, copies: int, arc: str = "references") -> Path:
    """Of ``copies`` to the power of ``levels`` prims, as composed."""
    text = ["#usda 1.0", BODY, 'class Xform "level0"\n{\n}']
    for level in range(1, levels + 1):
        parts = [f'def Xform "part{copy}" (prepend {arc} = </level{level - 1}>)\n{{\n}}' for copy in range(copies)]
        text.append("\n".join((f'class Xform "level{level}"\n{{', *parts, "}")))
    text.append(f'def Xform "all" (prepend {arc} = </level{levels}>)\n{{\n}}\n')
    path.write_text("\n".join(text))
    return path


@pytest.mark.parametrize("arc", ["references", "payload", "inherits", "specializes"])
def test_a_stage_of_a_hundred_million_prims_is_refused_at_once(tmp_path: Path, arc: str) -> None:
    begin = time.process_time()
    with pytest.raises(AssetError, match=r"bomb\.usda composes to some \d{9} prims: .*ReadLimits\.elements"):
        load_articulation(stage(tmp_path / "bomb.usda", 8, 10, arc))
    assert time.process_time() - begin < 10.0


def test_the_bound_is_of_what_is_composed(tmp_path: Path) -> None:
    path = stage(tmp_path / "small.usda", 2, 10)
    assert load_articulation(path).link_names == ("ball",)
    with pytest.raises(AssetError, match="composes to some"):
        load_articulation(path, options=ReadOptions(limits=ReadLimits(elements=100)))


def test_layers_that_multiply_each_other_are_counted(tmp_path: Path) -> None:
    stage(tmp_path / "part.usda", 4, 10)
    outer = [f'def Xform "x{index}" (prepend references = @./part.usda@</all>)\n{{\n}}' for index in range(300)]
    (tmp_path / "outer.usda").write_text("\n".join(("#usda 1.0", BODY, *outer, "")))
    with pytest.raises(AssetError, match="composes to some"):
        load_articulation(tmp_path / "outer.usda")


def test_an_archive_is_read_under_the_limits(tmp_path: Path) -> None:
    asked = robot("cartpole").articulation
    write_usd(asked, tmp_path / "cart.usdc")
    archive = tmp_path / "cart.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "cart.usdc"), str(archive))
    (tmp_path / "cart.usdc").unlink()
    got = load_articulation(archive)
    assert (got.link_names, got.mass) == (asked.link_names, pytest.approx(asked.mass))
    small = ReadOptions(limits=ReadLimits(expanded_bytes=1000))
    with pytest.raises(AssetError, match=r"unpacks to .* bytes: make it smaller, or raise ReadLimits\.expanded_bytes"):
        load_articulation(archive, options=small)
    archive.write_bytes(archive.read_bytes()[:200])
    with pytest.raises(AssetError, match=r"cart\.usdz is no zip archive"):
        load_articulation(archive)
