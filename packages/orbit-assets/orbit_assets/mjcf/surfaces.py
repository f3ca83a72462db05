"""Finishes of MJCF's materials: textures with the coordinates by which MuJoCo lays them, roughness and metals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_assets.meshes import textured_mesh
from orbit_assets.mjcf.model import Compiled
from orbit_core.scene import Box, Capsule, Finish, Geometry, Mesh, Plane, Shape, Texture
from orbit_core.scene.shapes import DULL

# Pixels of a texture's side up to which it is stretched where its two directions are scaled differently.
_FINEST = 1024
# Share of a geometry's size below which triangles need no splitting to follow the faces of a cube.
_FINE = 0.125
# Signed axes of s and t of each face of OpenGL's cube, in its order +x, -x, +y, -y, +z, -z (OpenGL 4.6, table 8.19).
_FACES = np.array(
    (
        ((0, 0, -1), (0, -1, 0)),
        ((0, 0, 1), (0, -1, 0)),
        ((1, 0, 0), (0, 0, 1)),
        ((1, 0, 0), (0, 0, -1)),
        ((1, 0, 0), (0, -1, 0)),
        ((-1, 0, 0), (0, -1, 0)),
    )
)


class Surfaces:
    """Looks of a compiled model's geoms; equal textures and meshes are one object.

    Args:
        compiled: the model.
    """

    def __init__(self, compiled: Compiled) -> None:
        self._model: Any = compiled.model
        roles, kinds = compiled.mujoco.mjtTextureRole, compiled.mujoco.mjtTexture
        self._role, self._flat, self._cube = int(roles.mjTEXROLE_RGB), kinds.mjTEXTURE_2D, kinds.mjTEXTURE_CUBE
        self._mesh_kind = compiled.mujoco.mjtGeom.mjGEOM_MESH
        self._pixels: dict[int, npt.NDArray[np.uint8]] = {}
        self._textures: dict[tuple[float, ...], Texture] = {}
        self._sides: dict[tuple[int, Geometry], Texture] = {}
        self._meshes: dict[tuple[Any, ...], Mesh] = {}

    @property
    def unread(self) -> int:
        """Number of textures that no material takes as its colour: of the sky, and of roles such as normals."""
        used = set(self._model.mat_texid[:, self._role].tolist())
        return sum(texture not in used for texture in range(self._model.ntex))

    def drawn(self, geom: int, shape: Shape) -> Shape:
        """Return the shape of a geom as it is drawn, in its material's finish."""
        model, material = self._model, int(self._model.geom_matid[geom])
        if material < 0:
            return shape
        # MuJoCo marks what a file does not say by -1.
        roughness, metallic = float(model.mat_roughness[material]), float(model.mat_metallic[material])
        finish = Finish(roughness if 0 <= roughness <= 1 else 1.0, metallic if 0 <= metallic <= 1 else 0.0)
        texture = int(model.mat_texid[material, self._role])
        if texture < 0:
            return shape if finish == DULL else replace(shape, finish=finish)
        by_mesh = model.geom_type[geom] == self._mesh_kind and self._has_coordinates(int(model.geom_dataid[geom]))
        kind = model.tex_type[texture]
        if kind == self._flat and by_mesh:
            return self._unwrapped(geom, material, texture, replace(shape, finish=finish))
        if kind == self._flat:
            return replace(shape, finish=replace(finish, texture=self._laid(geom, material, texture)))
        # MuJoCo draws no cube on a mesh that has coordinates on a picture.
        if kind == self._cube and not by_mesh and not isinstance(shape.geometry, Plane):
            return self._wrapped(material, texture, replace(shape, finish=finish))
        return replace(shape, finish=finish)

    def _has_coordinates(self, mesh: int) -> bool:
        return int(self._model.mesh_texcoordadr[mesh]) >= 0

    def _unwrapped(self, geom: int, material: int, texture: int, shape: Shape) -> Shape:
        """Return a mesh with the file's own coordinates."""
        model, mesh = self._model, int(self._model.geom_dataid[geom])
        repeat = model.mat_texrepeat[material] * (model.geom_size[geom][:2] if model.mat_texuniform[material] else 1.0)
        key = (mesh, *repeat.tolist())
        if key not in self._meshes:
            first, count = int(model.mesh_texcoordadr[mesh]), int(model.mesh_texcoordnum[mesh])
            face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
            # MuJoCo counts rows of a picture from its top.
            coordinates = model.mesh_texcoord[first : first + count] * repeat * (1.0, -1.0) + (0.0, 1.0)
            corners = model.mesh_facetexcoord[face : face + faces]
            vertex, vertices = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
            points = model.mesh_vert[vertex : vertex + vertices]
            indices = model.mesh_face[face : face + faces]
            self._meshes[key] = textured_mesh(points[indices], coordinates[corners])
        finish = replace(shape.finish, texture=self._texture(texture))
        return replace(shape, geometry=self._meshes[key], finish=finish)

    def _laid(self, geom: int, material: int, texture: int) -> Texture:
        """Return a picture that is laid on a shape from above, by its own size in metres."""
        model = self._model
        # An endless plane has the size zero, and counts as one of a metre.
        half = np.where(model.geom_size[geom][:2] > 0.0, model.geom_size[geom][:2], 1.0)
        unit = np.ones(2) if model.mat_texuniform[material] else half
        size = 2.0 * unit / np.maximum(model.mat_texrepeat[material], 1e-6)
        key = (texture, *size.tolist(), *half.tolist())
        if key not in self._textures:
            pixels = _stretched(self._picture(texture), float(size[1] / size[0]))
            # MuJoCo begins a picture at the upper left corner of the shape, and a texture has its middle at the origin.
            columns, rows = np.round((half / size - 0.5) * (pixels.shape[1], pixels.shape[0])).astype(int).tolist()
            self._textures[key] = Texture(np.roll(pixels, (-rows, -columns), axis=(0, 1)), float(size[0]))
        return self._textures[key]

    def _texture(self, texture: int) -> Texture:
        """Return a picture as it is, for a mesh with coordinates on it."""
        if (texture,) not in self._textures:
            self._textures[texture,] = Texture(self._picture(texture))
        return self._textures[texture,]

    def _picture(self, texture: int) -> npt.NDArray[np.uint8]:
        if texture not in self._pixels:
            model = self._model
            shape = (int(model.tex_height[texture]), int(model.tex_width[texture]), int(model.tex_nchannel[texture]))
            first = int(model.tex_adr[texture])
            pixels = model.tex_data[first : first + int(np.prod(shape))].reshape(shape)
            # Grey pictures have one channel, and opaque ones three; opacity of a texture is not drawn.
            colored = np.repeat(pixels, 3, axis=2) if shape[2] < 3 else pixels[..., :3].copy()
            # A cube has one square for all of its faces, or six.
            alike = model.tex_type[texture] == self._cube and shape[0] == shape[1]
            self._pixels[texture] = np.tile(colored, (6, 1, 1)) if alike else colored
        return self._pixels[texture]

    def _wrapped(self, material: int, texture: int, shape: Shape) -> Shape:
        """Return a shape as a mesh with coordinates on the six faces of a cube, one above another in one picture."""
        pixels = self._picture(texture)
        if (pixels == pixels[0, 0]).all():
            tint = pixels[0, 0] / 255.0
            red, green, blue = (float(own * part) for own, part in zip(shape.color[:3], tint, strict=True))
            return replace(shape, color=(red, green, blue, shape.color[3]))
        uniform = bool(self._model.mat_texuniform[material])
        if (pixels.reshape(6, -1) == pixels.reshape(6, -1)[0]).all() and not isinstance(shape.geometry, Box):
            # A round shape stays what it is, with the one picture laid on each of its sides: nearly what a cube shows.
            face = (texture, shape.geometry)
            if face not in self._sides:
                width = float(np.ptp(_surface(shape.geometry)[0], axis=0).max())
                self._sides[face] = Texture(np.ascontiguousarray(pixels[: len(pixels) // 6]), width)
            return replace(shape, finish=replace(shape.finish, texture=self._sides[face]))
        key = (shape.geometry, uniform)
        if key not in self._meshes:
            self._meshes[key] = _on_cube(shape.geometry, uniform)
        finish = replace(shape.finish, texture=self._texture(texture))
        return replace(shape, geometry=self._meshes[key], finish=finish)


def _surface(geometry: Geometry) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.integer]]:
    """Return vertices (V, 3) and faces (F, 3) of a geometry."""
    from orbit_core.plugin_kit.meshes import triangles

    surface = triangles(geometry)
    return np.asarray(surface.vertices, np.float64), np.asarray(surface.faces)


def _on_cube(geometry: Geometry, uniform: bool) -> Mesh:
    """Return the surface of a geometry, each triangle on the face of the cube around it that its middle points to."""
    from trimesh.remesh import subdivide_to_size

    points, faces = _surface(geometry)
    half = 0.5 * np.ptp(points, axis=0)
    if isinstance(geometry, Capsule):
        # MuJoCo's size of a capsule leaves out its caps.
        half[2] = max(geometry.half_length, 1e-9)
    # The sides of a box are the faces of its cube; other triangles reach over several of them.
    if uniform or not isinstance(geometry, Box):
        points, faces = subdivide_to_size(points, faces, _FINE * float(half.max()), max_iter=20)[:2]
    corners = points[faces]
    ways = corners if uniform else corners / np.maximum(half, 1e-9)
    middle = ways.mean(axis=1)
    axis = np.abs(middle).argmax(axis=1)
    rows = np.arange(len(faces))
    face = 2 * axis + (middle[rows, axis] < 0.0)
    depth = np.maximum(np.abs(ways[rows, :, axis]), 1e-9)
    across = np.einsum("fcx,fsx->fcs", ways, _FACES[face]) / depth[..., None]
    s, t = np.moveaxis(np.clip(0.5 * (across + 1.0), 0.0, 1.0), -1, 0)
    # The first face is the picture's uppermost sixth, and t grows downwards.
    return textured_mesh(corners, np.stack((s, 1.0 - (face[:, None] + t) / 6.0), axis=-1))


def _stretched(pixels: npt.NDArray[np.uint8], ratio: float) -> npt.NDArray[np.uint8]:
    """Return a picture whose rows over columns are ``ratio``, for its pixels cover squares."""
    from PIL import Image

    rows, columns = pixels.shape[:2]
    if abs(ratio * columns / rows - 1.0) < 0.01:
        return pixels
    # The shorter direction grows, so that nothing of the picture is lost.
    wide, high = (columns, columns * ratio) if columns * ratio >= rows else (rows / ratio, rows)
    shrink = min(1.0, _FINEST / max(wide, high))
    size = (max(1, round(wide * shrink)), max(1, round(high * shrink)))
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))
