"""Mesh files that say one thing and hold another, and COLLADA files mended where only looks suffer."""

from __future__ import annotations

import struct
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from orbit_core.interfaces.errors import AssetError

_STL_HEADER, _STL_TRIANGLE = 84, 50
"""Bytes, of a binary STL file."""
_LEAST_WORDS = {b"v": 4, b"f": 4, b"vn": 4, b"vt": 2}
"""Least number of words in a line of an OBJ file, by its first word."""
_COLLADA = "http://www.collada.org/2005/11/COLLADASchema"
_GREY = "0.7 0.7 0.7 1"


def check_stl(data: bytes, path: Path) -> None:
    """Hold a binary STL file to the triangles that it says it has.

    Raises:
        AssetError: it has fewer.
    """
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
    """Hold the end of an OBJ file to be a whole line; one that a writer or a copy did not finish ends within one.

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
    """Hold the faces of an OBJ file to vertices that it has.

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
    """A COLLADA file with a grey in place of each texture that names a picture which the file does not describe.

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
    """Whether a texture, a sampler or a surface leads to a picture."""
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
    """Take out the samplers and surfaces that lead to no picture, over which decoders stumble; how many there were."""
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
