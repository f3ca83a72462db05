"""Mesh files read into triangles in metres, with one colour per surface, and hulls small enough for fast contact."""

from __future__ import annotations

import io
import json
import re
import struct
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from orbit_assets.options import ReadOptions
from orbit_assets.outside import check_archive, check_file, check_picture, resolve_file
from orbit_assets.source_text import names_file, naming
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Color, Finish, Mesh, Shape, Texture
from orbit_core.scene.pose import Vector3

# Mesh files decoded by trimesh, which opens no other file and allocates no more than the caller allows.
# Files are checked before they are decoded, for the decoders take a truncated file for a smaller mesh. COLLADA files
# with no other fault than a missing texture are repaired.

# Bytes, of a binary STL file.
_STL_HEADER, _STL_TRIANGLE = 84, 50
# Least number of words in a line of an OBJ file, by its first word.
_LEAST_WORDS = {b"v": 4, b"f": 4, b"vn": 4, b"vt": 2}
_COLLADA = "http://www.collada.org/2005/11/COLLADASchema"
_GREY = "0.7 0.7 0.7 1"


def check_stl(data: bytes, path: Path) -> None:
    """Check that a binary STL file holds as many triangles as its header says.

    Raises:
        AssetError: it has fewer.
    """
    # ASCII files begin with "solid", but so do some binary ones: the word "facet" decides.
    if data[:5].lower() == b"solid" and b"facet" in data[:1024].lower():
        return
    if len(data) < _STL_HEADER:
        raise AssetError(f"mesh file '{path}' has {len(data)} bytes, fewer than an STL file's header: export it again")
    (count,) = struct.unpack("<I", data[80:84])
    held = (len(data) - _STL_HEADER) // _STL_TRIANGLE
    if count > held:
        raise AssetError(
            f"mesh file '{path}' says {count} triangles and holds {held}: it is cut short, export it again"
        )


def check_obj(data: bytes, path: Path) -> None:
    """Check that the last line of an OBJ file is complete; a truncated file ends within one.

    Raises:
        AssetError: the last line lacks words.
    """
    if data.endswith(b"\n"):
        return
    last = data.rpartition(b"\n")[2].split()
    if last and len(last) < _LEAST_WORDS.get(last[0], 0):
        said = b" ".join(last)[:80].decode("utf-8", "replace")
        raise AssetError(f"mesh file '{path}' ends within a line, '{said}': it is cut short, export it again")


def check_obj_faces(data: bytes, path: Path) -> None:
    """Check that the faces of an OBJ file refer to vertices that it has.

    Raises:
        AssetError: a face names another.
    """
    lines = [line.split() for line in data.splitlines()]
    vertices = sum(words[:1] == [b"v"] for words in lines)
    for words in lines:
        numbers = (word.partition(b"/")[0] for word in words[1:] if words[0] == b"f")
        highest = max((int(number) for number in numbers if number.isdigit()), default=0)
        if highest > vertices:
            raise AssetError(
                f"mesh file '{path}' has a face of vertex {highest} and {vertices} vertices: it is cut short or mixed "
                "up, export it again"
            )


def without_broken_textures(data: bytes) -> bytes:
    """Replace textures of a COLLADA file that name no picture of it by grey.

    Samplers and surfaces that lead to none are taken out. Decoders drop the material over them, and with it the
    geometry that bears it. A file without such is given back as it is.
    """
    root = ElementTree.fromstring(data)
    images = {image.get("id") for image in root.iter(_tag("image"))}
    broken = 0
    for effect in root.iter(_tag("effect")):
        parameters = {parameter.get("sid"): parameter for parameter in effect.iter(_tag("newparam"))}
        for slot in list(effect.iter()):
            for texture in slot.findall(_tag("texture")):
                if not _leads_to(texture.get("texture"), parameters, images):
                    slot.remove(texture)
                    ElementTree.SubElement(slot, _tag("color")).text = _GREY
                    broken += 1
        broken += _remove_dangling(effect, parameters, images)
    if not broken:
        return data
    ElementTree.register_namespace("", _COLLADA)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _leads_to(name: str | None, parameters: dict[str | None, Element], images: set[str | None]) -> bool:
    """Return True if a texture, a sampler or a surface leads to a picture."""
    met: set[str | None] = set()
    while name not in images:
        parameter = parameters.get(name)
        if parameter is None or name in met:
            return False
        met.add(name)
        further = next((each for tag in ("source", "init_from") for each in parameter.iter(_tag(tag))), None)
        name = (further.text or "").strip() if further is not None else None
    return True


def _remove_dangling(effect: Element, parameters: dict[str | None, Element], images: set[str | None]) -> int:
    """Remove samplers and surfaces that lead to no picture, over which decoders stumble; return their number."""
    dangling = {id(each) for name, each in parameters.items() if _holds_picture(each)}
    dangling -= {id(each) for name, each in parameters.items() if _leads_to(name, parameters, images)}
    for holder in list(effect.iter()):
        for parameter in holder.findall(_tag("newparam")):
            if id(parameter) in dangling:
                holder.remove(parameter)
    return len(dangling)


def _holds_picture(parameter: Element) -> bool:
    return parameter.find(_tag("surface")) is not None or parameter.find(_tag("sampler2D")) is not None


def _tag(name: str) -> str:
    return f"{{{_COLLADA}}}{name}"


SUFFIXES = ("stl", "obj", "dae", "zae", "glb", "gltf", "ply", "off", "3mf")
"""Suffixes of the formats that are read; other formats of trimesh have not been tested against the limits."""
_ENTITY = re.compile(rb"<!\s*(ENTITY|DOCTYPE)")


def open_mesh(path: Path, options: ReadOptions, model: Path) -> Any:
    """Decode a mesh file as a trimesh scene.

    Args:
        path: the file; files that it names, such as pictures, must be where ``model`` may name files.
        options: the limits, and the files that may be opened.
        model: the file that names the mesh.

    Raises:
        AssetError: the file is missing, of another format, cannot be decoded, or goes beyond the limits.
    """
    import trimesh

    check_file(path, options)
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in SUFFIXES:
        raise AssetError(f"mesh file '{path}' is of no format that is read: export it as {', '.join(SUFFIXES)}")
    if suffix in ("zae", "3mf"):
        check_archive(path, options)
    data = path.read_bytes()
    _check_content(data, suffix, path, options)
    try:
        if suffix == "dae":
            data = without_broken_textures(data)
        neighbours = _Neighbours(path, options, model).as_trimesh()
        # From memory: given a path, trimesh would open neighbouring files itself, past the resolver.
        scene: Any = trimesh.load_scene(io.BytesIO(data), file_type=suffix, resolver=neighbours, process=False)
        _check_size(scene, path, options)
        return scene
    except AssetError:
        raise
    except ImportError as error:
        raise AssetError(
            f"mesh file '{path}' needs a decoder that is not installed ({error}): {install_extra('robots')}"
        ) from error
    except Exception as error:  # decoders raise errors of any class
        if suffix == "obj":
            check_obj_faces(data, path)
        raise AssetError(f"mesh file '{path}' cannot be read ({error}): re-export it") from error


@contextmanager
def bounded_pictures(options: ReadOptions) -> Iterator[None]:
    """Limit the pixels of pictures that Pillow opens, and keep it from running Ghostscript, which it does for
    PostScript.

    trimesh opens pictures at any time while a mesh is read or copied: all reading of a mesh belongs in this context.
    """
    from PIL import EpsImagePlugin, Image

    program, pixels = EpsImagePlugin.gs_binary, Image.MAX_IMAGE_PIXELS
    EpsImagePlugin.gs_binary, Image.MAX_IMAGE_PIXELS = False, options.limits.pixels
    try:
        with warnings.catch_warnings():
            # Pillow only warns between one and two times the limit: the warning must be an error.
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            yield
    finally:
        EpsImagePlugin.gs_binary, Image.MAX_IMAGE_PIXELS = program, pixels


class _Neighbours:
    """Files that a mesh names, by their names."""

    def __init__(self, path: Path, options: ReadOptions, model: Path) -> None:
        self.path = path
        self.options = options
        self.model = model

    def get(self, name: Any) -> bytes:
        """Return the bytes of a file.

        Raises:
            AssetError: the model may not name it, or it is a picture of too many pixels.
            FileNotFoundError: it is missing, which most decoders take for a mesh without a picture.
        """
        text = name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
        text = text.strip().replace("\\", "/")
        if "://" not in text and not (self.path.parent / text).is_file():
            raise FileNotFoundError(text)
        data = resolve_file(text, self.path, self.options, model=self.model).read_bytes()
        check_picture(data[:24], text, self.options)
        return data

    def as_trimesh(self) -> Any:
        """Return an instance of trimesh's own resolver class, which is imported only when a mesh is read."""
        from trimesh.resolvers import Resolver

        neighbours = self

        class Neighbours(Resolver):
            def __init__(self) -> None:
                pass

            def get(self, key: Any) -> bytes:
                return neighbours.get(key)

            def write(self, name: str, data: Any) -> None:
                raise AssetError(f"reading a mesh writes no file '{name}'")

            def namespaced(self, namespace: str) -> Any:
                return self

            def keys(self) -> Any:
                return ()

        return Neighbours()


def _check_size(scene: Any, path: Path, options: ReadOptions) -> None:
    """Reject more triangles than the limits allow, each instance of a mesh counted, before instances are copied."""
    instances = scene.graph.geometry_nodes
    faces = sum(len(instances.get(name, ())) * len(getattr(each, "faces", ())) for name, each in scene.geometry.items())
    if faces > options.limits.vertices:
        raise AssetError(
            f"mesh file '{path}' holds {faces} triangles: make it smaller, or raise ReadLimits.vertices from "
            f"{options.limits.vertices}"
        )


def _check_content(data: bytes, suffix: str, path: Path, options: ReadOptions) -> None:
    """Reject truncated files, and files that make a decoder allocate memory out of proportion to their size."""
    # NUL bytes are removed so that UTF-16 does not hide a declaration.
    if any(_ENTITY.search(document.replace(b"\0", b"")) for document in _documents(data, suffix)):
        raise AssetError(f"mesh file '{path}' declares XML entities: export it again without")
    if suffix == "stl":
        check_stl(data, path)
    if suffix == "obj":
        check_obj(data, path)
    if suffix in ("glb", "gltf"):
        _check_accessors(_gltf_header(data, path), path, options)


def _documents(data: bytes, suffix: str) -> Iterator[bytes]:
    """Yield the XML of a mesh file, and all files of an archive, for its own tables say which of them are XML."""
    if suffix == "dae":
        yield data
    elif suffix in ("zae", "3mf"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            yield from map(archive.read, archive.namelist())


def _gltf_header(data: bytes, path: Path) -> Any:
    """Return the JSON of a glTF file, text or binary."""
    # GLB: 12 bytes of header, then the JSON chunk with its length and type in 8 bytes.
    if data[:4] == b"glTF" and len(data) >= 20:
        (length,) = struct.unpack("<I", data[12:16])
        data = data[20 : 20 + length]
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise AssetError(f"mesh file '{path}' is no glTF ({error}): export it again") from None


def _check_accessors(header: Any, path: Path, options: ReadOptions) -> None:
    """Limit the size of glTF accessors: one without data makes a decoder allocate as many zeros as it says."""
    accessors = header.get("accessors", []) if isinstance(header, dict) else []
    for accessor in accessors if isinstance(accessors, list) else []:
        count = accessor.get("count", 0) if isinstance(accessor, dict) else 0
        # Three numbers per vertex or corner are the most that an accessor needs.
        if not isinstance(count, int) or not 0 <= count <= 3 * options.limits.vertices:
            raise AssetError(
                f"mesh file '{path}' has an accessor of {count} elements: give {3 * options.limits.vertices} at most, "
                "or raise ReadLimits.vertices"
            )


# Directions, in addition to the six along the axes, in which a simplified hull keeps the farthest point of the exact
# one.
_DIRECTIONS = 32


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Part of a mesh file that has one colour or texture; the colour is None where the file gives none."""

    mesh: Mesh
    """Triangles of that colour."""
    color: Color | None
    """RGBA in [0, 1]; of a surface with a picture, the median of what it shows."""
    textured: bool = False
    """True if the colour is computed from a picture."""
    texture: Texture | None = None
    """The picture, where ``mesh`` has coordinates on it."""

    def shown(self, shape: Shape) -> Shape:
        """Return a shape of this mesh in its own colour or texture."""
        if self.texture is not None:
            return replace(shape, color=(1.0, 1.0, 1.0, 1.0), finish=Finish(texture=self.texture))
        return shape if self.color is None else replace(shape, color=self.color)


@names_file
def load_mesh(
    path: Path | str,
    scale: Vector3 = (1.0, 1.0, 1.0),
    *,
    options: ReadOptions = ReadOptions(),
) -> Mesh:
    """Read the triangles of an STL, OBJ, DAE, GLB or other mesh file, placed by its scene graph, in metres.

    A DAE file's unit is honoured and its up axis is not, as in ROS. ``scale`` may reflect: faces then turn round, so
    that they still look outward. Vertices that are equal in single precision are merged.

    Raises:
        AssetError: the file is missing, cannot be decoded or holds no triangle.
    """
    return MeshFiles(options, Path(path)).mesh(Path(path), scale)


@names_file
def load_parts(
    path: Path | str,
    scale: Vector3 = (1.0, 1.0, 1.0),
    *,
    options: ReadOptions = ReadOptions(),
) -> tuple[MeshPart, ...]:
    """Read the file's triangles as :func:`load_mesh` does, one part per colour or picture.

    Raises:
        AssetError: as :func:`load_mesh`.
    """
    return MeshFiles(options, Path(path)).parts(Path(path), scale)


@names_file
def load_surfaces(path: Path | str, *, options: ReadOptions = ReadOptions()) -> list[Any]:
    """Return the trimesh surfaces of a file as they are in it, placed by its scene graph, in metres.

    Raises:
        AssetError: as :func:`load_mesh`.
    """
    with naming(str(path)), bounded_pictures(options):
        return _decoded(Path(path), options, Path(path))


class MeshFiles:
    """The mesh files of one model: each is decoded once, however many shapes and scales use it.

    Args:
        options: the limits, and what files may be opened.
        model: the file that names the meshes.
    """

    def __init__(self, options: ReadOptions, model: Path) -> None:
        self.options = options
        self.model = model
        self._decoded: dict[Path, list[Any]] = {}
        self._meshes: dict[tuple[Path, Vector3], Mesh] = {}
        self._parts: dict[tuple[Path, Vector3], tuple[MeshPart, ...]] = {}
        self._textures: dict[int, tuple[Any, Texture]] = {}

    def mesh(self, path: Path, scale: Vector3 = (1.0, 1.0, 1.0)) -> Mesh:
        """Return the triangles of a file, as :func:`load_mesh` reads them.

        Raises:
            AssetError: as :func:`load_mesh`.
        """
        key = (path, scale)
        if key not in self._meshes:
            with naming(str(path)), bounded_pictures(self.options):
                parts = self._parts.get(key, ())
                # One part is the whole: its visual and its collision shape then share one mesh.
                shared = len(parts) == 1 and parts[0].texture is None
                self._meshes[key] = parts[0].mesh if shared else _mesh(self._geometries(path), scale, path)
        return self._meshes[key]

    def parts(self, path: Path, scale: Vector3 = (1.0, 1.0, 1.0)) -> tuple[MeshPart, ...]:
        """Return the parts of a file, as :func:`load_parts` reads them.

        Raises:
            AssetError: as :func:`load_mesh`.
        """
        key = (path, scale)
        if key not in self._parts:
            with naming(str(path)), bounded_pictures(self.options):
                self._parts[key] = self._split(path, scale)
        return self._parts[key]

    def _split(self, path: Path, scale: Vector3) -> tuple[MeshPart, ...]:
        by_color: dict[tuple[Color | None, bool], list[Any]] = {}
        textured: list[MeshPart] = []
        for geometry in self._geometries(path):
            color = surface_color(geometry)
            if (coordinates := _coordinates(geometry)) is None:
                by_color.setdefault(color, []).append(geometry)
            else:
                mesh = replace(_mesh([geometry], scale, path, merge=False), coordinates=coordinates)
                textured.append(MeshPart(mesh, *color, self._texture(_picture(geometry))))
        # Most files have one colour: the whole mesh is then shared with the collision shape.
        if len(by_color) == 1 and not textured:
            ((color, median),) = by_color
            return (MeshPart(self.mesh(path, scale), color, median),)
        plain = [MeshPart(_mesh(group, scale, path), color, median) for (color, median), group in by_color.items()]
        return (*plain, *textured)

    def _texture(self, picture: Any) -> Texture:
        """Return a picture as a texture, the same one for each of its surfaces."""
        if id(picture) not in self._textures:
            whole = picture.convert("RGB")
            whole.thumbnail((_FINEST, _FINEST))
            # Kept with its picture, whose number must not be given to another one.
            self._textures[id(picture)] = (picture, Texture(np.asarray(whole, dtype=np.uint8)))
        return self._textures[id(picture)][1]

    def _geometries(self, path: Path) -> list[Any]:
        if path not in self._decoded:
            self._decoded[path] = _decoded(path, self.options, self.model)
        return self._decoded[path]


def simplified_hull(mesh: Mesh) -> Mesh:
    """Return the convex hull of the points of ``mesh`` that are farthest in each of evenly spread directions.

    It is within the exact hull, has at most :data:`_DIRECTIONS` + 6 vertices, and touches the exact hull's bounding
    box on all sides. Directions are the axes and a Fibonacci lattice (Gonzalez, Measurement of areas on a sphere,
    2010).
    """
    from trimesh.convex import convex_hull

    # The Fibonacci lattice turns by the golden angle from one point to the next.
    index = np.arange(_DIRECTIONS) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / _DIRECTIONS), np.pi * (1 + 5**0.5) * index
    spread = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    spread = np.concatenate([spread, np.eye(3), -np.eye(3)])
    points = np.asarray(mesh.vertices, dtype=np.float64)
    hull = convex_hull(points[np.unique(np.argmax(points @ spread.T, axis=0))])
    return Mesh(np.ascontiguousarray(hull.vertices, dtype=np.float32), np.ascontiguousarray(hull.faces, dtype=np.int32))


def _decoded(path: Path, options: ReadOptions, model: Path) -> list[Any]:
    """Decode the file's surfaces, placed by its scene graph, in metres."""
    import trimesh

    scene = open_mesh(path, options, model)
    # trimesh knows a unit for some formats only; without one the numbers are taken as metres.
    if scene.units not in (None, "meters"):
        scene = scene.convert_units("meters")
    geometries = [
        geometry for geometry in scene.dump() if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces)
    ]
    if not geometries:
        raise AssetError(f"mesh file '{path}' holds no triangle: export it as a triangle mesh")
    return geometries


def _mesh(geometries: list[Any], scale: Vector3, path: Path, merge: bool = True) -> Mesh:
    """Join several surfaces into one mesh, scaled; merge vertices in one place unless they differ in coordinates."""
    if 0.0 in scale or not np.isfinite(scale).all():
        raise AssetError(f"mesh file '{path}' is scaled by {scale}: give finite factors that are not zero")
    vertices: list[npt.NDArray[np.float32]] = []
    faces: list[npt.NDArray[np.int64]] = []
    first = 0
    for geometry in geometries:
        vertices.append((np.asarray(geometry.vertices) * scale).astype(np.float32))
        faces.append(np.asarray(geometry.faces, dtype=np.int64) + first)
        first += len(vertices[-1])
    joined = np.concatenate(faces)
    # A reflection turns triangles inside out: the reversed order of corners makes them face outward again.
    if np.prod(np.sign(scale)) < 0:
        joined = joined[:, ::-1]
    if not merge:
        return Mesh(np.concatenate(vertices), joined.astype(np.int32))
    return Mesh(*merge_vertices(np.concatenate(vertices), joined))


def textured_mesh(corners: npt.NDArray[np.floating], coordinates: npt.NDArray[np.floating]) -> Mesh:
    """Return a mesh of triangles whose corners each have their own texture coordinates.

    Args:
        corners: (F, 3, 3) m.
        coordinates: (F, 3, 2), in pictures from the lower left corner.
    """
    # Corners are one vertex where they agree in place and coordinates; seams keep two.
    rows = np.concatenate((corners.reshape(-1, 3), coordinates.reshape(-1, 2)), axis=1).astype(np.float32)
    distinct, indices = np.unique(rows, axis=0, return_inverse=True)
    return Mesh(
        np.ascontiguousarray(distinct[:, :3]),
        np.ascontiguousarray(indices.reshape(-1, 3), dtype=np.int32),
        coordinates=distinct[:, 3:].astype(np.float64),
    )


def without_coordinates(shape: Shape) -> Shape:
    """Return a shape for contact: vertices that only texture coordinates hold apart are merged, so that it closes."""
    mesh = shape.geometry
    if not isinstance(mesh, Mesh) or mesh.coordinates is None:
        return shape
    vertices, faces = merge_vertices(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces))
    return replace(shape, geometry=Mesh(vertices, faces, mesh.collision), finish=replace(shape.finish, texture=None))


# Most pixels of a texture's sides: finer ones cost memory, and no picture of a robot shows them.
_FINEST = 1024
# Metres of a triangle's height below which it is a line.
_THINNEST = 1e-10
# Odd numbers with evenly mixed bits (those of xxHash), which spread coordinates over 64 bits.
_PRIMES = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)


def merge_vertices(
    vertices: npt.NDArray[np.float32], faces: npt.NDArray[np.integer]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
    """Merge equal points (V, 3), and remove triangles (F, 3) that are points or lines.

    Points keep the order in which they are first met; those of no triangle are left out.
    """
    vertices = vertices + np.float32(0.0)  # minus zero is zero
    first, which = _distinct(vertices)
    faces = which[faces]
    faces = faces[_solid(vertices[first], faces)]
    used = np.zeros(len(first), dtype=bool)
    used[faces] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    return np.ascontiguousarray(vertices[first[used]]), np.ascontiguousarray(number[faces], dtype=np.int32)


def _distinct(vertices: npt.NDArray[np.float32]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Find the distinct points.

    Points are sorted by a hash: three times faster than sorting rows, which remains for the rare collision.

    Returns:
        The index at which each distinct point is first met, ascending, and for every vertex the number of its point.
    """
    keys = np.zeros(len(vertices), dtype=np.uint64)
    for column, prime in zip(vertices.view(np.uint32).T, _PRIMES, strict=True):
        keys = (keys ^ column) * np.uint64(prime)
        keys ^= keys >> np.uint64(29)
    order = np.argsort(keys, kind="stable")
    starts = _starts(keys[order][:, None])
    if not np.array_equal(starts, _starts(vertices[order])):  # two points share a key: sort by what they are
        order = np.lexsort(vertices.T)
        starts = _starts(vertices[order])
    groups = np.cumsum(starts) - 1
    first = order[starts]  # sorting is stable: the first of each group comes first in the file
    rank = np.argsort(np.argsort(first))
    which = np.empty(len(vertices), dtype=np.intp)
    which[order] = rank[groups]
    return np.sort(first), which


def _starts(rows: npt.NDArray[np.generic]) -> npt.NDArray[np.bool_]:
    """Return True for each of the sorted rows that differs from the one before."""
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = np.any(rows[1:] != rows[:-1], axis=1)
    return starts


def _solid(vertices: npt.NDArray[np.float32], faces: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Return True for each triangle that has a height."""
    a, b, c = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    return doubled > _THINNEST * longest


def surface_color(geometry: Any) -> tuple[Color | None, bool]:
    """Find the colour of a trimesh geometry.

    A picture counts as the median of the part that the surface shows, or of all of it where texture coordinates are
    missing.

    Returns:
        The colour, None where the file gives none, and True if it is computed from a picture.
    """
    visual = geometry.visual
    if not visual.defined:
        return None, False
    material = getattr(visual, "material", None)
    if material is None:
        return _color(visual.main_color), False
    picture = _picture(geometry)
    if picture is None:
        return _color(material.main_color), False
    return _color(np.median(_shown(geometry, picture), axis=0)), True


def _picture(geometry: Any) -> Any:
    """Return the picture that a trimesh geometry's surface shows; None without one."""
    material = getattr(geometry.visual, "material", None)
    return getattr(material, "baseColorTexture", None) or getattr(material, "image", None)


def _coordinates(geometry: Any) -> npt.NDArray[np.float64] | None:
    """Return texture coordinates (V, 2) of a surface that shows a picture; None where it has none."""
    coordinates = getattr(geometry.visual, "uv", None)
    if _picture(geometry) is None or coordinates is None:
        return None
    whole = np.shape(coordinates) == (len(geometry.vertices), 2) and np.isfinite(coordinates).all()
    return np.asarray(coordinates, dtype=np.float64) if whole else None


def _shown(geometry: Any, picture: Any) -> Any:
    if _coordinates(geometry) is not None:
        return geometry.visual.to_color().vertex_colors
    return np.asarray(picture.convert("RGBA")).reshape(-1, 4)


def _color(channels: Any) -> Color:
    # Four digits: 8 bits per channel resolve no more, and equal colours must compare equal.
    r, g, b, a = (round(float(channel) / 255.0, 4) for channel in channels)
    return (r, g, b, a)
