"""What an MJCF file would have its compiler open and make, held to what the caller allows before that sees it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element

from orbit_core.assets.archives import check_picture
from orbit_core.assets.naming import naming
from orbit_core.assets.options import ReadOptions
from orbit_core.assets.outside import resolve_file
from orbit_core.assets.source_text import read_xml
from orbit_core.interfaces.errors import AssetError

_FILES = {
    "mesh": ("meshdir", "assetdir"),
    "skin": ("meshdir", "assetdir"),
    "hfield": ("meshdir", "assetdir"),
    "flexcomp": ("meshdir", "assetdir"),
    "texture": ("texturedir", "assetdir"),
    "model": ("meshdir", "assetdir"),
    "include": (),
}
"""Elements that name files, and the attributes of ``<compiler>`` that say where those are, besides the model's folder.
"""
_COUNTS = {
    "composite": ("count", "elements"),
    "flexcomp": ("count", "elements"),
    "numeric": ("size", "elements"),
    "hfield": ("nrow", "vertices"),
    "texture": ("width", "pixels"),
}
_SECOND = {"nrow": "ncol", "width": "height"}


def check_references(path: Path | str, options: ReadOptions) -> None:
    """Hold an MJCF file, and those that it includes, to the files, sizes and copies that the caller allows.

    Raises:
        AssetError: a file named is missing or lies outside, an element asks for more than the limits allow, or a file
            is no well-formed XML.
    """
    _Model(Path(path).absolute(), options).check()


class _Model:
    """One model's main file, and what it includes."""

    def __init__(self, path: Path, options: ReadOptions, above: tuple[Path, ...] = ()) -> None:
        self.path = path
        self.options = options
        self.above = above
        """The files that led here, the main model's first."""
        self.folders: dict[str, list[str]] = {}
        """All that the files give for each setting, for which of them counts depends on their order."""
        self.strip = False
        self.sources: list[tuple[Path, Element]] = []

    def check(self) -> None:
        self._collect(self.path, self.above)
        kind = self.sources[0][1].tag
        if kind == "mujocoinclude":
            raise AssetError(f"{self.path} is a part that other MJCF files include: read one of those")
        if kind != "mujoco":
            raise AssetError(f"{self.path} does not compile: it is a <{kind}> and no <mujoco> model")
        made = 0
        for source, root in self.sources:
            with naming(str(source)):
                made += self._check_elements(source, root)
        if made > self.options.limits.elements:
            raise AssetError(
                f"{self.path} replicates its elements to {made}: lower its counts, or raise ReadLimits.elements"
            )

    def _collect(self, path: Path, above: tuple[Path, ...]) -> None:
        """Read a file and those that it includes; settings of ``<compiler>`` hold for all of them."""
        if path in above:
            raise AssetError(f"{path} includes itself: remove the <include>")
        if len(above) > self.options.limits.nesting:
            raise AssetError(f"{path} is included by {len(above)} files, one in another: include it in the first")
        root = read_xml(path, self.options)
        self.sources.append((path, root))
        for compiler in root.iter("compiler"):
            for key in (key for key in compiler.attrib if key.endswith("dir")):
                self.folders.setdefault(key, []).append(compiler.get(key, ""))
            self.strip = compiler.get("strippath", str(self.strip)).lower() == "true"
        for element in root.iter("include"):
            with naming(f"{path}, <include>"):
                included = self._allowed(element.get("file", ""), (self.path.parent, path.parent))
            self._collect(included, (*above, path))

    def _check_elements(self, source: Path, root: Element) -> int:
        """How many elements the file makes, copies included."""
        total = 0
        waiting = [(root, 1)]
        while waiting:
            element, copies = waiting.pop()
            if element.tag == "replicate":
                copies *= max(int(_number(element.get("count", "1"))), 1)
            total += copies
            with naming(f"{source}, <{element.tag}> '{element.get('name', '')}'"):
                self._check_size(element)
                self._check_files(element)
            waiting += [(child, copies) for child in element]
        return total

    def _check_size(self, element: Element) -> None:
        if element.tag == "size":
            asked = {key: _number(value) for key, value in element.items() if key.startswith("nuser") or key == "nkey"}
            for key, value in asked.items():
                self._within(key, value, "elements")
        if element.tag not in _COUNTS:
            return
        attribute, limit = _COUNTS[element.tag]
        counts = [*element.get(attribute, "1").split(), element.get(_SECOND.get(attribute, ""), "1")]
        self._within(attribute, math.prod(_number(each) for each in counts), limit)

    def _within(self, attribute: str, value: float, limit: str) -> None:
        most = getattr(self.options.limits, limit)
        if value > most:
            raise AssetError(f"{attribute} asks for {value:g}: give {most} at most, or raise ReadLimits.{limit}")

    def _check_files(self, element: Element) -> None:
        if element.tag not in _FILES or element.tag == "include":
            return
        for key, reference in element.items():
            if not key.startswith("file") or not reference:
                continue
            name = Path(reference.replace("\\", "/")).name if self.strip else reference
            folders = [self.path.parent / each for key in _FILES[element.tag] for each in self.folders.get(key, [])]
            found = self._allowed(name, (*folders, self.path.parent))
            if element.tag == "model":
                _Model(found, self.options, (*self.above, self.path)).check()
            elif element.tag in ("texture", "hfield"):
                with found.open("rb") as file:
                    check_picture(file.read(24), str(found), self.options)

    def _allowed(self, reference: str, folders: Iterable[Path]) -> Path:
        """The file, looked for in each folder; all that are found must be allowed, for the compiler may take any."""
        main = (*self.above, self.path)[0]
        candidates = list(dict.fromkeys(folder / reference for folder in folders))
        there = [path for path in candidates if path.exists()] or candidates[:1]
        allowed = [resolve_file(path, self.path, self.options, model=main) for path in there]
        return allowed[0]


def _number(text: str) -> float:
    """A number, or zero for what is none: the compiler then says so."""
    try:
        return float(text)
    except ValueError:
        return 0.0
