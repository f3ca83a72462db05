"""Shader packs without the table that SAPIEN's own rasterisers compute for 16-21 s before their first picture.

``fast`` is this project's; it takes only vertex shaders from the installed package. ``pbr`` is the package's
``minimal`` pack with the table's one look-up replaced by Karis's analytic fit (Physically Based Shading on Mobile,
2014), and with light where the shadow map ends. Both are put together in a temporary folder, so that no shader of
SAPIEN's is part of this distribution.
"""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import functools
import re
import shutil
import tempfile
from pathlib import Path

from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_core.scene import Rgb, Sky
from orbit_sapien.native import sapien

_OWN = Path(__file__).parent / "shaders"
_TABLE = re.compile(r"^layout\(.*samplerBRDFLUT;\s*$", re.MULTILINE)
_LOOK_UP = "vec2 envBRDF = texture(samplerBRDFLUT, vec2(roughness, dotNV)).xy;"
_SHADOW = "float shadow = 0.0f;"
_LIT_OUTSIDE = "if (projCoord.xy != clamp(projCoord.xy, 0.0f, 1.0f)) return 1.0f;"
_FIT = """
  vec4 fit = roughness * vec4(-1, -0.0275, -0.572, 0.022) + vec4(1, 0.0425, 1.04, -0.04);
  float edge = min(fit.x * fit.x, exp2(-9.28 * dotNV)) * fit.x + fit.y;
  vec2 envBRDF = vec2(-1.04, 1.04) * edge + fit.zw;
"""


@functools.cache
def shader_pack(tier: str, sky: Sky) -> str:
    """The folder of a tier's shaders under a sky, made once a process.

    Raises:
        ConfigurationError: the installed SAPIEN has other shaders than those that this was written for.
    """
    installed = Path(str(sapien.__file__)).parent / "vulkan_shader"
    if tier == "rt":
        return str(installed / "rt")
    folder = _root().path
    if not (folder / "common").exists():
        shutil.copytree(installed / "common", folder / "common")
        shadows = folder / "common" / "shadow.glsl"
        shadows.write_text(shadows.read_text().replace(_SHADOW, f"{_LIT_OUTSIDE}\n  {_SHADOW}"))
    pack = Path(tempfile.mkdtemp(prefix=f"{tier}-", dir=folder))
    shutil.copytree(installed / "minimal", pack, dirs_exist_ok=True)
    composite = (_OWN / "composite0.frag").read_text()
    (pack / "composite0.frag").write_text(
        composite.replace("SKY_ABOVE", _vector(sky.above)).replace("SKY_BELOW", _vector(sky.below))
    )
    if tier == "fast":
        shutil.copy(_OWN / "gbuffer.frag", pack)
    else:
        source = (pack / "gbuffer.frag").read_text()
        if _LOOK_UP not in source or not _TABLE.search(source):
            raise ConfigurationError(
                "the installed SAPIEN has unknown shaders: install sapien==3.0.3, or use tier 'fast'"
            )
        (pack / "gbuffer.frag").write_text(_TABLE.sub("", source).replace(_LOOK_UP, _FIT))
    return str(pack)


def _vector(color: Rgb) -> str:
    red, green, blue = (float(part) for part in color)
    return f"vec3({red!r}, {green!r}, {blue!r})"


@functools.cache
def _root() -> ScratchFolder:
    """Removed when the process ends."""
    return ScratchFolder("orbit-sapien-shaders-")
