"""Shaders of each tier: SAPIEN's, with the scene's sky, and changed where they draw wrongly or coarsely."""

from __future__ import annotations

import functools
import shutil
import tempfile
from pathlib import Path

from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_core.scene import Rgb, Sky
from orbit_sapien.native import sapien

_OWN = Path(__file__).parent / "shaders"
_TABLE = "layout(set = 3, binding = 8) uniform sampler2D samplerBRDFLUT;"
_LOOK_UP = "vec2 envBRDF = texture(samplerBRDFLUT, vec2(roughness, dotNV)).xy;"
_FIT = """
  vec4 fit = roughness * vec4(-1, -0.0275, -0.572, 0.022) + vec4(1, 0.0425, 1.04, -0.04);
  float edge = min(fit.x * fit.x, exp2(-9.28 * dotNV)) * fit.x + fit.y;
  vec2 envBRDF = vec2(-1.04, 1.04) * edge + fit.zw;
"""
# A texture multiplies the colour; SAPIEN's takes its place.
_LAID = {
    "albedo = texture(colorTexture,": "albedo = vec4(materialBuffer.baseColor.rgb, 1.0) * texture(colorTexture,",
}
_LAID_ON_PATHS = {"baseColor = baseColorAlpha.rgb;": "baseColor *= baseColorAlpha.rgb;"}
_SHADOW = "float shadow = 0.0f;"
_LIT_OUTSIDE = "if (projCoord.xy != clamp(projCoord.xy, 0.0f, 1.0f)) return 1.0f;"
_MISSED = "ray.radiance = ambientLight;"
# Seen directly, the sky has its own colours. What it lights, it lights as a dome that is brightest above; a surface
# that faces up receives the ambient light.
_DOME = """
    float up = ray.direction.z;
    ray.radiance = ray.depth == 0 ? pow(mix(SKY_BELOW, SKY_ABOVE, 0.5 + 0.5 * up), vec3(2.2))
                                  : ambientLight * (0.6 + 0.6 * up);
"""
_TOWARD_LIGHT = "vec3 L = normalize(-light.direction);"
# Radius of directional lights as paths see them, rad, as of the studio's.
_WIDTH = 0.02
_ON_DISC = f"""
    float around = 6.2831853 * rnd(ray.seed), wide = {_WIDTH} * sqrt(rnd(ray.seed));
    vec3 across = normalize(cross(L, abs(L.z) < 0.9 ? vec3(0, 0, 1) : vec3(1, 0, 0)));
    L = normalize(L + wide * (cos(around) * across + sin(around) * cross(L, across)));
"""


@functools.cache
def shader_pack(tier: str, sky: Sky) -> str:
    """Return the folder of a tier's shaders under a sky, made once a process.

    Raises:
        ConfigurationError: the installed SAPIEN has other shaders than those that this was written for.
    """
    installed = Path(str(sapien.__file__)).parent / "vulkan_shader"
    folder = _root().path
    pack = Path(tempfile.mkdtemp(prefix=f"{tier}-", dir=folder))
    if tier == "rt":
        shutil.copytree(installed / "rt", pack, dirs_exist_ok=True)
        _change(pack / "camera.rmiss", {_MISSED: _colored(_DOME, sky)})
        _change(pack / "camera.rchit", _LAID_ON_PATHS)
        _change(pack / "shading.glsl", {_TOWARD_LIGHT: f"{_TOWARD_LIGHT}\n{_ON_DISC}"})
        return str(pack)
    if not (folder / "common").exists():
        shutil.copytree(installed / "common", folder / "common")
        _change(folder / "common" / "shadow.glsl", {_SHADOW: f"{_LIT_OUTSIDE}\n  {_SHADOW}"})
    shutil.copytree(installed / "minimal", pack, dirs_exist_ok=True)
    (pack / "composite0.frag").write_text(_colored((_OWN / "composite0.frag").read_text(), sky))
    if tier == "fast":
        shutil.copy(_OWN / "gbuffer.frag", pack)
    else:
        _change(pack / "gbuffer.frag", {_TABLE: "", _LOOK_UP: _FIT, **_LAID})
    return str(pack)


def _change(file: Path, parts: dict[str, str]) -> None:
    """Replace parts of a shader, each of which it must have."""
    source = file.read_text()
    for old, new in parts.items():
        if old not in source:
            raise ConfigurationError(
                f"the installed SAPIEN has an unknown shader {file.name}: install sapien==3.0.3, or use tier 'fast'"
            )
        source = source.replace(old, new)
    file.write_text(source)


def _colored(source: str, sky: Sky) -> str:
    return source.replace("SKY_ABOVE", _vector(sky.above)).replace("SKY_BELOW", _vector(sky.below))


def _vector(color: Rgb) -> str:
    red, green, blue = (float(part) for part in color)
    return f"vec3({red!r}, {green!r}, {blue!r})"


@functools.cache
def _root() -> ScratchFolder:
    """Removed when the process ends."""
    return ScratchFolder("orbit-sapien-shaders-")
