"""Shapes to draw, each a body without mass."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet.urdf import write_obj
from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.plugin_kit.surfaces import TexturedSurface, bounded, textured_surface
from orbit_core.scene import (
    Box,
    Capsule,
    Cylinder,
    HeightField,
    Mesh,
    Plane,
    Shape,
    Sphere,
    Texture,
)

# Rows of faces from pole to pole.
_BALL_ROWS = 32
# Bullet's specular colour of the smoothest surface.
_HIGHLIGHT = 0.6
# Texture of a box that has none: only the normals of its sides are wanted.
_BLANK = Texture(np.zeros((1, 1, 3), np.uint8))
# Pixels on a side: Bullet's OpenGL draws larger textures white without a word, and others skewed and grey.
_TEXTURE = 512
# Half extent in metres of the square that is drawn for a plane.
_GROUND = 1000.0


class VisualShapes:
    """Adds bodies to a client; meshes go through files of a folder."""

    def __init__(self, client: Any, folder: Path) -> None:
        self._client = client
        self._folder = folder
        self._files = 0
        self._textures: dict[Texture, int] = {}

    def add(self, shape: Shape) -> int:
        """The number of the body, which stands at the origin."""
        client = self._client
        gloss = 3 * [_HIGHLIGHT * (1.0 - shape.finish.roughness)]
        number = client.createVisualShape(rgbaColor=shape.color, specularColor=gloss, **self._form(shape))
        body = client.createMultiBody(0, -1, number)
        if (texture := shape.finish.texture) is not None:
            client.changeVisualShape(body, -1, textureUniqueId=self._texture(texture))
        return body

    def _texture(self, texture: Texture) -> int:
        """Return Bullet's number of a texture, which is loaded once."""
        if texture not in self._textures:
            path = self._folder / f"texture{len(self._textures)}.tga"
            _write_tga(path, _drawable(texture.pixels))
            self._textures[texture] = self._client.loadTexture(str(path))
        return self._textures[texture]

    def _form(self, shape: Shape) -> dict[str, Any]:
        if (texture := shape.finish.texture) is not None:
            return self._surface(textured_surface(bounded(shape, _GROUND), texture))
        match shape.geometry:
            case Box():
                # Bullet's OpenGL shades its own boxes as if they were round.
                return self._surface(textured_surface(shape, _BLANK))
            case Sphere(radius):
                return self._mesh(*_turned(*_capsule_profile(radius, 0.0)))
            case Capsule(radius, half_length):
                return self._mesh(*_turned(*_capsule_profile(radius, half_length)))
            case Cylinder(radius, half):
                return self._mesh(*_turned((0.0, radius, radius, 0.0), (half, half, -half, -half)))
            case Plane():
                corners = _GROUND * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
                return self._mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
            case Mesh() as mesh:
                return self._mesh(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces))
            case HeightField() as field:
                return self._mesh(*height_field_mesh(field))

    def _surface(self, surface: TexturedSurface) -> dict[str, Any]:
        path = self._folder / f"visual{self._files}.obj"
        self._files += 1
        _write_surface(path, surface)
        return {"shapeType": self._client.GEOM_MESH, "fileName": str(path)}

    def _mesh(self, vertices: Any, faces: Any) -> dict[str, Any]:
        path = self._folder / f"visual{self._files}.obj"
        self._files += 1
        write_obj(path, vertices, faces)
        return {"shapeType": self._client.GEOM_MESH, "fileName": str(path)}


def _write_surface(path: Path, surface: TexturedSurface) -> None:
    """Write triangles with normals and texture coordinates in Wavefront's format."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in surface.vertices]
    lines += [f"vt {u:.7g} {v:.7g}" for u, v in surface.coordinates]
    lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in surface.normals]
    lines += [f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in surface.faces + 1]
    path.write_text("\n".join(lines) + "\n")


def _drawable(pixels: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return a picture (H, W, 3) in a size that Bullet's OpenGL draws: at most _TEXTURE, and whole rows of 4 bytes."""
    by = -(-max(pixels.shape[:2]) // _TEXTURE)
    if by > 1:
        # Means of whole squares: the edge is repeated where they do not fit.
        wide = np.pad(pixels, [(0, -size % by) for size in pixels.shape[:2]] + [(0, 0)], mode="edge")
        height, width, _ = wide.shape
        pixels = wide.reshape(height // by, by, width // by, by, 3).mean((1, 3)).round().astype(np.uint8)
    # Stretched and not padded, because textures repeat.
    rows, columns = (np.arange(-(-size // 4) * 4) * size // (-(-size // 4) * 4) for size in pixels.shape[:2])
    return pixels[rows[:, None], columns]


def _write_tga(path: Path, pixels: npt.NDArray[np.uint8]) -> None:
    """Write a picture (H, W, 3) as an uncompressed Targa file, the simplest that Bullet reads."""
    height, width, _ = pixels.shape
    upright = 0x20  # rows from the top
    header = struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, width, height, 24, upright)
    path.write_bytes(header + pixels[..., ::-1].tobytes())


def _capsule_profile(radius: float, half_length: float) -> tuple[Any, Any]:
    """Profile of a capsule; a sphere's where it has no length."""
    cap = np.linspace(0.0, 0.5 * np.pi, _BALL_ROWS // 2 + 1)
    up = np.concatenate((cap, cap + 0.5 * np.pi if half_length else cap[1:] + 0.5 * np.pi))
    middle = np.where(np.arange(len(up)) < len(cap), half_length, -half_length)
    return radius * np.sin(up), middle + radius * np.cos(up)


def _turned(radii: Any, heights: Any) -> tuple[Any, Any]:
    """The surface that a profile, from top to bottom, sweeps about z: finer than Bullet's own round shapes."""
    columns = 2 * _BALL_ROWS + 1
    around = np.linspace(0.0, 2 * np.pi, columns)
    level = np.broadcast_to(np.asarray(heights)[:, None], (len(heights), columns))
    vertices = np.stack((np.outer(radii, np.cos(around)), np.outer(radii, np.sin(around)), level), -1)
    corner = (np.arange(len(heights) - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    first = np.stack((corner, corner + columns, corner + columns + 1), -1)
    second = np.stack((corner, corner + columns + 1, corner + 1), -1)
    return vertices.reshape(-1, 3), np.concatenate((first, second))
