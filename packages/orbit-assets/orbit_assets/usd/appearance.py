"""Finishes of USD's preview surfaces: roughness, metallic share, pictures, and texture coordinates of meshes."""

from __future__ import annotations

import hashlib
import io
import zipfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_assets.outside import check_file, check_picture, resolve_file
from orbit_assets.textures import decoded_texture
from orbit_assets.usd.library import assign_custom, define, pxr
from orbit_assets.usd.stage import Reading
from orbit_core.files import storage_faults, written_whole
from orbit_core.scene import Color, Finish, Mesh, Shape, Texture
from orbit_core.scene.shapes import DULL

WIDTH = "orbit:textureWidth"
"""Attribute of a picture that is laid on a shape without coordinates: the metres that it spans."""
_COORDINATES = "st"
# Inputs that hold the picture of a colour: of preview surfaces by a connection, of NVIDIA's by the file itself.
_CONNECTED, _FILES = ("diffuseColor", "baseColor"), ("diffuse_texture",)


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture of a surface's colour, and the coordinates by which it is laid."""

    texture: Texture
    """Its pixels; the width is that of :data:`WIDTH`, or the default."""
    laid: bool
    """True if it is laid by metres; False if a mesh has coordinates on it."""
    coordinates: str
    """Name of the primvar with the coordinates."""
    placement: npt.NDArray[np.float64]
    """(2, 3) matrix from coordinates of the mesh to those of the picture."""
    tint: Color | None
    """Colour that multiplies the picture; None without one."""


class Pictures:
    """Pictures of one stage's materials; each is decoded once.

    Args:
        reading: the stage, the options and the notes.
    """

    def __init__(self, reading: Reading) -> None:
        self._reading = reading
        self._read: dict[str, Picture | None] = {}
        self._textures: dict[tuple[str, float], Texture] = {}

    def of(self, surface: Any) -> Picture | None:
        """Return the picture that colours a surface's shader; None without one, or where its file is missing.

        Raises:
            AssetError: the file is where the model may not read, or no picture, or too large.
        """
        path = str(surface.GetPath())
        if path not in self._read:
            self._read[path] = self._of(surface)
        return self._read[path]

    def _of(self, surface: Any) -> Picture | None:
        for name in _FILES:
            found = surface.GetInput(name)
            if found and (asset := found.Get()) is not None:
                return self._picture(surface, asset, _COORDINATES, np.eye(2, 3), 0.0, None)
        for name in _CONNECTED:
            source = _source(surface.GetInput(name))
            if source is not None and source.GetIdAttr().Get() == "UsdUVTexture":
                return self._connected(source)
        return None

    def _connected(self, shader: Any) -> Picture | None:
        file = shader.GetInput("file")
        asset = file.Get() if file else None
        if asset is None:
            return None
        width = shader.GetPrim().GetAttribute(WIDTH)
        coordinates, placement = _coordinates(shader)
        return self._picture(shader, asset, coordinates, placement, float(width.Get()) if width else 0.0, _tint(shader))

    def _picture(
        self,
        shader: Any,
        asset: Any,
        coordinates: str,
        placement: npt.NDArray[np.float64],
        width: float,
        tint: Color | None,
    ) -> Picture | None:
        key = (asset.resolvedPath or asset.path, width)
        if key not in self._textures:
            data = self._bytes(asset)
            if data is None:
                self._reading.note(f"the picture '{asset.path}' of {shader.GetPath()} is missing, and left out")
                return None
            texture = decoded_texture(data, asset.path, self._reading.options.limits.pixels)
            self._textures[key] = replace(texture, width=width) if width > 0.0 else texture
        return Picture(self._textures[key], width > 0.0, coordinates, placement, tint)

    def _bytes(self, asset: Any) -> bytes | None:
        """Return the file's content, of a plain file or of one within an archive that the model may open."""
        outer, _, inner = asset.resolvedPath.partition("[")
        if not outer:
            return None
        path, options = self._reading.path, self._reading.options
        file = resolve_file(outer, path, options, model=path)
        if not inner:
            data = file.read_bytes()
        else:
            check_file(file, options)
            with zipfile.ZipFile(file) as archive:
                name = inner.removesuffix("]")
                if name not in archive.namelist():
                    return None
                data = archive.read(name)
        check_picture(data[:24], asset.path, options)
        return data


def _source(found: Any) -> Any:
    """Return the shader that an input is connected to, through the interfaces of materials; None without one."""
    if not found:
        return None
    attributes = pxr().UsdShade.Utils.GetValueProducingAttributes(found)
    shader = pxr().UsdShade.Shader(attributes[0].GetPrim()) if attributes else None
    return shader if shader and shader.GetPrim() != found.GetPrim() else None


def _coordinates(shader: Any) -> tuple[str, npt.NDArray[np.float64]]:
    """Return the primvar by which a picture is laid, and the transform (2, 3) of its values."""
    matrix = np.eye(2, 3)
    source = _source(shader.GetInput("st"))
    if source is not None and source.GetIdAttr().Get() == "UsdTransform2d":
        values = {name: source.GetInput(name) for name in ("scale", "rotation", "translation")}
        given = {name: found.Get() for name, found in values.items() if found and found.Get() is not None}
        angle = np.radians(float(given.get("rotation", 0.0)))
        turn = np.array(((np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))))
        # Scaled, turned and moved, in this order.
        matrix[:, :2] = turn * np.asarray(given.get("scale", (1.0, 1.0)), dtype=float)
        matrix[:, 2] = np.asarray(given.get("translation", (0.0, 0.0)), dtype=float)
        source = _source(source.GetInput("in"))
    name = source.GetInput("varname").Get() if source is not None and source.GetInput("varname") else None
    return str(name or _COORDINATES), matrix


def _tint(shader: Any) -> Color | None:
    found = shader.GetInput("scale")
    value = found.Get() if found else None
    if value is None:
        return None
    red, green, blue, alpha = (min(max(float(part), 0.0), 1.0) for part in value)
    return (red, green, blue, alpha)


def finish_of(surface: Any) -> Finish:
    """Return the roughness and the metallic share of a preview surface, where they are numbers of the file."""

    def share(name: str, default: float) -> float:
        found = surface.GetInput(name)
        value = found.Get() if found and _source(found) is None else None
        return value if isinstance(value, float) and 0.0 <= value <= 1.0 else default

    return Finish(share("roughness", Finish.roughness), share("metallic", Finish.metallic))


def corner_coordinates(
    prim: Any, picture: Picture, points: npt.NDArray[np.integer], corners: npt.NDArray[np.integer]
) -> npt.NDArray[np.float64] | None:
    """Return coordinates (F, 3, 2) on a picture of the corners of a mesh's triangles; None where it has none.

    Args:
        prim: the mesh.
        picture: says where the coordinates are.
        points: (F, 3) indices of the triangles' points.
        corners: (F, 3) indices of the triangles' corners among those of all polygons.
    """
    primvar = pxr().UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(picture.coordinates)
    values = primvar.ComputeFlattened() if primvar else None
    if values is None:
        return None
    found = np.asarray(values, dtype=np.float64)
    which = points if primvar.GetInterpolation() in ("vertex", "varying") else corners
    if found.ndim != 2 or found.shape[1] != 2 or len(found) <= int(which.max()) or not np.isfinite(found).all():
        return None
    return found[which] @ picture.placement[:, :2].T + picture.placement[:, 2]


@dataclass(eq=False)
class FinishWriter:
    """Writer of preview surfaces and of the pictures next to a USD file; equal finishes of a colour share a prim."""

    stage: Any
    """USD stage that is written to."""
    path: Path
    """The USD file, whose pictures are in a folder of its name next to it."""
    materials: dict[tuple[Finish, Color, bool], Any] = field(default_factory=dict)
    """Prims of the materials that have been written."""

    def write(self, prim: Any, shape: Shape) -> None:
        """Bind the finish of a shape to its prim, with the coordinates of a mesh."""
        if shape.finish == DULL:
            return
        mesh = shape.geometry if isinstance(shape.geometry, Mesh) else None
        unwrapped = mesh is not None and mesh.coordinates is not None and shape.finish.texture is not None
        if unwrapped and mesh is not None:
            kind = pxr().Sdf.ValueTypeNames.TexCoord2fArray
            primvar = pxr().UsdGeom.PrimvarsAPI(prim).CreatePrimvar(_COORDINATES, kind, "vertex")
            primvar.Set(np.asarray(mesh.coordinates, dtype=np.float32))
        key = (shape.finish, shape.color, unwrapped)
        if key not in self.materials:
            self.materials[key] = self._material(*key)
        pxr().UsdShade.MaterialBindingAPI.Apply(prim).Bind(self.materials[key])

    def _material(self, finish: Finish, color: Color, unwrapped: bool) -> Any:
        usd, types = pxr().UsdShade, pxr().Sdf.ValueTypeNames
        top = self.stage.GetDefaultPrim()
        scope = self.stage.GetPrimAtPath(top.GetPath().AppendChild("finishes")) or define(
            self.stage, top, "finishes", "Scope"
        )
        prim = define(self.stage, scope, f"finish_{len(self.materials)}", "Material")
        surface = usd.Shader(define(self.stage, prim, "surface", "Shader"))
        surface.CreateIdAttr("UsdPreviewSurface")
        for name, value in (("roughness", finish.roughness), ("metallic", finish.metallic), ("opacity", color[3])):
            surface.CreateInput(name, types.Float).Set(value)
        diffuse = surface.CreateInput("diffuseColor", types.Color3f)
        diffuse.Set(pxr().Gf.Vec3f(*map(float, color[:3])))
        material = usd.Material(prim)
        material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
        if finish.texture is not None:
            picture = usd.Shader(define(self.stage, prim, "picture", "Shader"))
            picture.CreateIdAttr("UsdUVTexture")
            picture.CreateInput("file", types.Asset).Set(self._file(finish.texture))
            picture.CreateInput("scale", types.Float4).Set(pxr().Gf.Vec4f(*map(float, color)))
            for wrap in ("wrapS", "wrapT"):
                picture.CreateInput(wrap, types.Token).Set("repeat")
            reader = usd.Shader(define(self.stage, prim, "coordinates", "Shader"))
            reader.CreateIdAttr("UsdPrimvarReader_float2")
            reader.CreateInput("varname", types.String).Set(_COORDINATES)
            picture.CreateInput("st", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
            diffuse.ConnectToSource(picture.ConnectableAPI(), "rgb")
            if not unwrapped:
                assign_custom(picture.GetPrim(), {WIDTH: float(finish.texture.width)})
        return material

    def _file(self, texture: Texture) -> str:
        """Return the path of a picture from the USD file; it is written where it is not there yet."""
        from PIL import Image

        data = io.BytesIO()
        Image.fromarray(texture.pixels).save(data, "PNG")
        folder = self.path.with_name(f"{self.path.stem}_textures")
        file = folder / f"{hashlib.sha256(data.getvalue()).hexdigest()[:12]}.png"
        with storage_faults(folder):
            folder.mkdir(parents=True, exist_ok=True)
        if not file.is_file():
            with written_whole(file) as written:
                written.write_bytes(data.getvalue())
        return f"./{folder.name}/{file.name}"
