"""Mesh files decoded by trimesh, which opens no other file and makes no more of one than the caller allows."""

from __future__ import annotations

import io
import json
import re
import struct
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from orbit_assets.archives import check_archive, check_picture
from orbit_assets.mesh_faults import check_obj, check_obj_faces, check_stl, without_broken_textures
from orbit_assets.options import ReadOptions
from orbit_assets.outside import check_file, resolve_file
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError

SUFFIXES = ("stl", "obj", "dae", "zae", "glb", "gltf", "ply", "off", "3mf")
"""Suffixes of the formats that are read; what else trimesh decodes has not been held to any limits."""
_ENTITY = re.compile(rb"<!\s*(ENTITY|DOCTYPE)")


def open_mesh(path: Path, options: ReadOptions, model: Path) -> Any:
    """A mesh file as a trimesh scene.

    Args:
        path: the file; what it names besides, such as pictures, must lie where ``model`` may name files.
        options: the limits, and what files may be opened.
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
        scene: Any = trimesh.load_scene(io.BytesIO(data), file_type=suffix, resolver=neighbours, process=False)
        _check_size(scene, path, options)
        return scene
    except AssetError:
        raise
    except ImportError as error:
        raise AssetError(
            f"mesh file '{path}' needs a decoder that is not installed ({error}): {install_extra('robots')}"
        ) from error
    except Exception as error:  # a decoder's own errors are of any class
        if suffix == "obj":
            check_obj_faces(data, path)
        raise AssetError(f"mesh file '{path}' cannot be read ({error}): re-export it") from error


@contextmanager
def bounded_pictures(options: ReadOptions) -> Iterator[None]:
    """Keep Pillow from pictures of too many pixels, and from running Ghostscript, which it does for PostScript.

    trimesh opens pictures wherever a mesh holds some, and copies decode them: all reading of a mesh belongs within.
    """
    from PIL import EpsImagePlugin, Image

    program, pixels = EpsImagePlugin.gs_binary, Image.MAX_IMAGE_PIXELS
    EpsImagePlugin.gs_binary, Image.MAX_IMAGE_PIXELS = False, options.limits.pixels
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            yield
    finally:
        EpsImagePlugin.gs_binary, Image.MAX_IMAGE_PIXELS = program, pixels


class _Neighbours:
    """The files that a mesh names, by their names."""

    def __init__(self, path: Path, options: ReadOptions, model: Path) -> None:
        self.path = path
        self.options = options
        self.model = model

    def get(self, name: Any) -> bytes:
        """The bytes of a file.

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
        """An instance of the class that trimesh asks for, which is not imported before a mesh is read."""
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
    """Refuse more triangles than the limits allow, each instance of a mesh counted, before they are set out."""
    instances = scene.graph.geometry_nodes
    faces = sum(len(instances.get(name, ())) * len(getattr(each, "faces", ())) for name, each in scene.geometry.items())
    if faces > options.limits.vertices:
        raise AssetError(
            f"mesh file '{path}' holds {faces} triangles: make it smaller, or raise ReadLimits.vertices from "
            f"{options.limits.vertices}"
        )


def _check_content(data: bytes, suffix: str, path: Path, options: ReadOptions) -> None:
    """Refuse what is cut short, and what makes a decoder ask for memory out of proportion to the file."""
    if any(_ENTITY.search(document.replace(b"\0", b"")) for document in _documents(data, suffix)):
        raise AssetError(f"mesh file '{path}' declares XML entities: export it again without")
    if suffix == "stl":
        check_stl(data, path)
    if suffix == "obj":
        check_obj(data, path)
    if suffix in ("glb", "gltf"):
        _check_accessors(_gltf_header(data, path), path, options)


def _documents(data: bytes, suffix: str) -> Iterator[bytes]:
    """The XML of a mesh file, and all that an archive holds, for its own tables say which of that is XML."""
    if suffix == "dae":
        yield data
    elif suffix in ("zae", "3mf"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            yield from map(archive.read, archive.namelist())


def _gltf_header(data: bytes, path: Path) -> Any:
    """The JSON of a glTF file, text or binary."""
    if data[:4] == b"glTF" and len(data) >= 20:
        (length,) = struct.unpack("<I", data[12:16])
        data = data[20 : 20 + length]
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise AssetError(f"mesh file '{path}' is no glTF ({error}): export it again") from None


def _check_accessors(header: Any, path: Path, options: ReadOptions) -> None:
    """An accessor without data stands for as many zeros as it says."""
    accessors = header.get("accessors", []) if isinstance(header, dict) else []
    for accessor in accessors if isinstance(accessors, list) else []:
        count = accessor.get("count", 0) if isinstance(accessor, dict) else 0
        if not isinstance(count, int) or not 0 <= count <= 3 * options.limits.vertices:
            raise AssetError(
                f"mesh file '{path}' has an accessor of {count} elements: give {3 * options.limits.vertices} at most, "
                "or raise ReadLimits.vertices"
            )
