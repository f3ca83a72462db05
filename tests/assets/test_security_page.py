"""The security page's sections on model files say what the readers do."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from orbit_assets import load_articulation
from orbit_assets.options import ReadLimits, ReadOptions
from orbit_assets.xacro import functions as expressions
from orbit_assets.xacro import process, values
from orbit_assets.xacro import process as expansion
from orbit_core.interfaces.errors import AssetError
from tests.fuzz.mutations import MUTATIONS
from tests.fuzz.run import MEMORY, SECONDS
from tests.fuzz.test_fuzz import FILES
from tests.fuzz.watch import watched

PAGE = " ".join((Path(__file__).parents[2] / "docs" / "security.md").read_text(encoding="utf-8").split())
LIMITS = ReadLimits()
MEBI = 2**20
STATED = (
    f"bytes of a file ({LIMITS.file_bytes // MEBI} MiB)",
    f"unpacks to ({LIMITS.expanded_bytes // 2**30} GiB)",
    f"elements and prims ({LIMITS.elements // 10**6} million)",
    f"makes of a count and files that an SDFormat world includes ({LIMITS.copies:,})",
    f"nesting ({LIMITS.nesting:,})",
    f"triangles of a mesh ({LIMITS.vertices // 10**6} million)",
    f"pixels of a picture ({LIMITS.pixels // MEBI} Mi)",
    f"integer has at most {values._BITS:,} bits, a value at most {values.LARGEST:,} characters and items",
    f"an expression {expressions._LONGEST:,} characters",
    f"at most {values.LARGEST:,} values, its aliases written out, nested at most {process._DEEPEST} deep",
    f"for {expansion._SECONDS} s at most, with {expansion._MEMORY // 2**30} GiB of memory",
    f"at most {expansion._CHARACTERS // MEBI} Mi characters of URDF",
    f"in {len(set(MUTATIONS))} ways",
    f"within {SECONDS:g} s and {MEMORY // 2**30} GiB",
    f"the tests read {FILES})",
)


@pytest.mark.parametrize("sentence", STATED)
def test_numbers_on_the_page_are_those_of_the_code(sentence: str) -> None:
    assert sentence in PAGE


URDF = """<robot name="r"><link name="l"><visual><geometry><box size="1 1 1"/></geometry>
<material name="m"><texture filename="skin.png"/></material></visual></link></robot>"""
SDF = """<sdf version="1.7"><model name="m"><link name="l">
<visual name="v"><geometry><sphere><radius>1</radius></sphere></geometry>
<material><script><uri>skin.png</uri><name>m</name></script><pbr><metal><albedo_map>skin.png</albedo_map></metal></pbr>
</material></visual></link></model></sdf>"""
USD = """#usda 1.0
def Cube "c" (
    prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]
)
{
    rel material:binding = </c/m>
    def Material "m"
    {
        token outputs:surface.connect = </c/m/s.outputs:surface>
        def Shader "s"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </c/m/t.outputs:rgb>
            token outputs:surface
        }
        def Shader "t"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @skin.png@
            float3 outputs:rgb
        }
    }
}
"""


@pytest.mark.parametrize(("suffix", "text"), [("urdf", URDF), ("sdf", SDF)])
def test_textures_of_materials_are_not_opened(tmp_path: Path, suffix: str, text: str) -> None:
    (tmp_path / "skin.png").write_bytes(b"\x89PNG")
    path = tmp_path / f"robot.{suffix}"
    path.write_text(text)
    with watched([tmp_path / "skin.png", path]) as opened:
        assert len(load_articulation(path).links) == 1
    assert opened == [str(path)]


def test_pictures_of_usd_materials_are_opened_in_the_models_folder_alone(tmp_path: Path) -> None:
    (tmp_path / "model").mkdir()
    (tmp_path / "skin.png").write_bytes(b"\x89PNG")
    path = tmp_path / "model" / "robot.usda"
    path.write_text(USD.replace("@skin.png@", "@../skin.png@"))
    with watched([tmp_path / "skin.png"]) as opened, pytest.raises(AssetError, match="outside"):
        load_articulation(path)
    assert opened == []
    (tmp_path / "model" / "skin.png").write_bytes(b"\x89PNG")
    path.write_text(USD)
    with pytest.raises(AssetError, match=r"'skin\.png' cannot be read as a picture"):
        load_articulation(path)


def test_devices_that_a_model_names_are_not_opened(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(re.sub(r"<box[^>]*>", '<mesh filename="zero.stl"/>', URDF))
    (tmp_path / "zero.stl").symlink_to("/dev/zero")
    with pytest.raises(AssetError, match="is no regular file"):
        load_articulation(path, options=ReadOptions(allow_outside=True))
