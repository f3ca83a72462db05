"""MJCF files written out as one document, held to what the caller allows before MuJoCo sees it."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from orbit_assets.archives import check_picture
from orbit_assets.naming import naming
from orbit_assets.options import ReadOptions
from orbit_assets.outside import resolve_file
from orbit_assets.source_text import read_xml
from orbit_core.interfaces.errors import AssetError

_COUNTS = {
    "composite": ("count", "copies"),
    "flexcomp": ("count", "copies"),
    "numeric": ("size", "elements"),
    "hfield": ("nrow", "vertices"),
    "texture": ("width", "pixels"),
}
_CORNERS = 10
"""Corners of faces that a built-in mesh has for each of its squares, and that MuJoCo makes of them meanwhile."""
_SECOND = {"nrow": "ncol", "width": "height"}


@dataclass(frozen=True)
class MjcfText:
    """An MJCF model as one document, which includes nothing and names files by absolute paths.

    ``models`` are the documents of the models that it attaches, by the paths that it names.
    """

    text: str
    models: dict[str, bytes]


def read_whole(path: Path | str, options: ReadOptions) -> MjcfText:
    """Read an MJCF file with all that it includes, and hold it to the files, sizes and copies that the caller allows.

    MuJoCo is given this text in place of the files: its own parser finds other elements than ours in some (a comment
    within an attribute or a CDATA section, another encoding), and could open files that were never checked.

    Raises:
        AssetError: a file named is missing or outside, an element asks for more than the limits allow, or a file is no
            well-formed XML.
    """
    model = _Model(Path(path).absolute(), options)
    return MjcfText(ElementTree.tostring(model.read(), encoding="unicode"), model.models)


class _Model:
    """One model's main file, and what it includes."""

    def __init__(self, path: Path, options: ReadOptions, above: tuple[Path, ...] = ()) -> None:
        self.path = path
        self.options = options
        self.above = above
        """The files that led here, the main model's first."""
        self.folders = {"mesh": "", "texture": "", "model": ""}
        """Folders of assets; the last setting in the document's order counts."""
        self.searched = {"asset": "", "mesh": "", "texture": ""}
        """Folders in which MuJoCo looks for assets of included files before it takes those next to the file."""
        self.strip = False
        self.origin: dict[Element, Path] = {}
        """The file that holds each element which names a file."""
        self.included: set[Path] = set()
        self.models: dict[str, bytes] = {}
        self.largest = 0
        """Size of the largest model that it attaches."""
        self.size = 0
        """Elements that MuJoCo makes of the model, copies and attached models included."""

    def read(self) -> Element:
        """Return the model's root element, checked, with includes written out and absolute paths."""
        root = self._collect(self.path, self.above)
        if root.tag == "mujocoinclude":
            raise AssetError(f"{self.path} is a part that other MJCF files include: read one of those")
        if root.tag != "mujoco":
            raise AssetError(f"{self.path} does not compile: it is a <{root.tag}> and no <mujoco> model")
        for compiler in root.iter("compiler"):
            self._set_folders(compiler)
        own = sum(1 for _ in root.iter())
        self.size = self._check_elements(root)
        made = self.size - own
        if made > self.options.limits.copies:
            raise AssetError(
                f"{self.path} replicates its elements to {made} more: lower its counts, or raise ReadLimits.copies "
                f"from {self.options.limits.copies}"
            )
        return root

    def _collect(self, path: Path, above: tuple[Path, ...]) -> Element:
        """Read a file, with the children of files that it includes in the place of each ``<include>``."""
        if path in above:
            raise AssetError(f"{path} includes itself: remove the <include>")
        if len(above) > self.options.limits.nesting:
            raise AssetError(f"{path} is included by {len(above)} files, one in another: include it in the first")
        root = read_xml(path, self.options)
        own = list(root.iter())
        for element in own:
            if any(key.startswith("file") for key in element.keys()):  # noqa: SIM118 an element has no iterator of keys
                self.origin[element] = path
            if element.tag != "include" and element.tag.lower() == "include":
                raise AssetError(f"{path} has an element <{element.tag}>, which MJCF lacks: write <include>")
        for element in own:
            if element.find("include") is not None:
                element[:] = [part for child in element for part in self._written_out(child, path, above)]
        return root

    def _written_out(self, element: Element, path: Path, above: tuple[Path, ...]) -> list[Element]:
        """Return an element, or the elements that stand for it if it is an ``<include>``."""
        if element.tag != "include":
            return [element]
        with naming(f"{path}, <include>"):
            found = self._found(element.get("file", ""), path)
            if found in self.included:
                raise AssetError(f"'{found}' is included twice: include it once")
        self.included.add(found)
        return list(self._collect(found, (*above, path)))

    def _set_folders(self, compiler: Element) -> None:
        """Take over where a ``<compiler>`` says that assets are; ``assetdir`` sets all kinds, others override it."""
        folder = compiler.get("assetdir")
        if folder is not None:
            self.folders |= {"mesh": folder, "texture": folder}
        for kind in ("mesh", "texture"):
            self.folders[kind] = compiler.get(f"{kind}dir", self.folders[kind])
        for kind in self.searched:
            self.searched[kind] = compiler.get(f"{kind}dir", self.searched[kind])
        if "strippath" in compiler.attrib:
            self.strip = compiler.get("strippath") == "true"
            compiler.set("strippath", "false")  # of paths that are absolute from here on

    def _check_elements(self, root: Element) -> int:
        """Check all elements and make their paths absolute; return how many they are, copies included."""
        total = attached = 0
        waiting = [(root, 1)]
        while waiting:
            element, copies = waiting.pop()
            if element.tag == "replicate":
                copies *= max(int(_number(element.get("count", "1"))), 1)
            total += copies
            attached += copies if element.tag == "attach" else 0
            source = self.origin.get(element, self.path)
            with naming(f"{source}, <{element.tag}> '{element.get('name', '')}'"):
                self._check_size(element)
                self._check_files(element, source)
            waiting += [(child, copies) for child in element]
        return total + attached * self.largest

    def _check_size(self, element: Element) -> None:
        if element.tag == "size":
            for key in (key for key in element.keys() if key.startswith("nuser")):  # noqa: SIM118
                self._within(key, _number(element.get(key, "")), "elements")
            self._within("nkey", _number(element.get("nkey", "")), "copies")
        if element.tag == "mesh" and element.get("builtin"):
            first, second, *_ = (*map(_number, element.get("params", "").split()), 0.0, 0.0)
            self._within("params", _CORNERS * first * max(first, second), "vertices")
        if element.tag == "texture" and element.get("type", "cube") != "2d":
            self._within("width", 6.0 * _number(element.get("width", "")) ** 2, "pixels")
        if element.tag not in _COUNTS:
            return
        attribute, limit = _COUNTS[element.tag]
        counts = [*element.get(attribute, "1").split(), element.get(_SECOND.get(attribute, ""), "1")]
        self._within(attribute, math.prod(_number(each) for each in counts), limit)

    def _within(self, attribute: str, value: float, limit: str) -> None:
        most = getattr(self.options.limits, limit)
        if value > most:
            raise AssetError(f"{attribute} asks for {value:g}: give {most} at most, or raise ReadLimits.{limit}")

    def _check_files(self, element: Element, source: Path) -> None:
        kind = element.tag if element.tag in self.folders else "mesh"
        searched = "" if kind == "model" else self.searched[kind] or self.searched["asset"]
        for key, reference in element.items():
            if not key.startswith("file") or not reference:
                continue
            found = self._found(reference, source, self.folders[kind], searched, strip=self.strip)
            element.set(key, str(found))
            if element.tag == "model":
                attached = _Model(found, self.options, (*self.above, self.path))
                text = ElementTree.tostring(attached.read(), encoding="unicode")
                self.models |= {str(found): text.encode(), **attached.models}
                self.largest = max(self.largest, attached.size)
            elif element.tag in ("texture", "hfield"):
                with found.open("rb") as file:
                    check_picture(file.read(24), str(found), self.options)

    def _found(
        self, reference: str, source: Path, folder: str = "", searched: str = "", *, strip: bool = False
    ) -> Path:
        """Return the file that MuJoCo opens: in the main model's folder, or else next to the file that names it.

        Args:
            reference: as the file has it.
            source: the file that holds the reference.
            folder: in the main model's folder, from which MuJoCo opens the file.
            searched: in the main model's folder, where MuJoCo looks for what an included file names; the two differ
                where several compilers set folders, and a file that is found there may then be missing.
            strip: whether only the last part of the reference counts, which is then never next to its source.
        """
        reference = reference.replace("\\", "/")
        # Paths are reduced as text, as MuJoCo does it, and not by links in the file system.
        place = Path(os.path.normpath(self.path.parent / folder / (Path(reference).name if strip else reference)))
        if source != self.path and not strip:
            looked = Path(os.path.normpath(self.path.parent / searched / reference))
            if not looked.exists():
                place = Path(os.path.normpath(source.parent / reference))
        return resolve_file(place, self.path, self.options, model=(*self.above, self.path)[0])


def _number(text: str) -> float:
    """A number, or zero for what is none: the compiler then says so."""
    try:
        return float(text)
    except ValueError:
        return 0.0
