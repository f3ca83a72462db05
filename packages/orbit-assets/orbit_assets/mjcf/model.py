"""MJCF files joined into one document under the caller's limits, and compiled by MuJoCo."""

from __future__ import annotations

import importlib
import math
import os
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.outside import check_picture, resolve_file
from orbit_assets.source_text import naming, one_line, read_xml
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Pose
from orbit_core.scene.pose import Vector3, canonical

# Attributes by which few characters make many elements, and the limit that applies to each.
_COUNTS = {
    "composite": ("count", "copies"),
    "flexcomp": ("count", "copies"),
    "numeric": ("size", "elements"),
    "hfield": ("nrow", "vertices"),
    "texture": ("width", "pixels"),
}
# Corners of faces that a built-in mesh has per square; MuJoCo allocates as many while it builds the mesh.
_CORNERS = 10
# Second factors of the counts above.
_SECOND = {"nrow": "ncol", "width": "height"}


@dataclass(frozen=True)
class MjcfText:
    """An MJCF model as one document, which includes nothing and names files by absolute paths.

    ``models`` are the documents of the models that it attaches, by the paths that it names.
    """

    text: str
    """XML of the document."""
    models: dict[str, bytes]


def read_whole(path: Path | str, options: ReadOptions) -> MjcfText:
    """Read an MJCF file with all that it includes, and check files, sizes and copies against the limits.

    MuJoCo is given this text in place of the files: its own parser finds other elements than ours in some (a comment
    within an attribute or a CDATA section, another encoding), and could open files that were never checked.

    Raises:
        AssetError: a file named is missing or outside, an element asks for more than the limits allow, or a file is no
            well-formed XML.
    """
    model = _Model(Path(path).absolute(), options)
    return MjcfText(ElementTree.tostring(model.read(), encoding="unicode"), model.models)


class _Model:
    """Main file of one model, with the files that it includes."""

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
        # Elements that are written out in the file are limited by read_xml; only copies are counted here.
        made = self.size - own
        if made > self.options.limits.copies:
            raise AssetError(
                f"{self.path} replicates its elements to {made} more: lower its counts, or raise ReadLimits.copies "
                f"from {self.options.limits.copies}"
            )
        return root

    def _collect(self, path: Path, above: tuple[Path, ...]) -> Element:
        """Read a file, and replace each ``<include>`` by the children of the file that it names."""
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
        # The list is taken before: elements of included files were already expanded by the recursion.
        for element in own:
            if element.find("include") is not None:
                element[:] = [part for child in element for part in self._written_out(child, path, above)]
        return root

    def _written_out(self, element: Element, path: Path, above: tuple[Path, ...]) -> list[Element]:
        """Return an element, or the elements of the included file if it is an ``<include>``."""
        if element.tag != "include":
            return [element]
        with naming(f"{path}, <include>"):
            found = self._found(element.get("file", ""), path)
            if found in self.included:
                raise AssetError(f"'{found}' is included twice: include it once")
        self.included.add(found)
        return list(self._collect(found, (*above, path)))

    def _set_folders(self, compiler: Element) -> None:
        """Read the asset folders of a ``<compiler>``; ``assetdir`` sets all kinds, others override it."""
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
                # Copies multiply through nested <replicate> elements.
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
            # A cube texture has six square faces.
            self._within("width", 6.0 * _number(element.get("width", "")) ** 2, "pixels")
        if element.tag not in _COUNTS:
            return
        attribute, limit = _COUNTS[element.tag]
        counts = [*element.get(attribute, "1").split(), element.get(_SECOND.get(attribute, ""), "1")]
        self._within(attribute, math.prod(_number(each) for each in counts), limit)

    def _within(self, attribute: str, value: float, limit: str) -> None:
        # Limits are compared before anything is allocated.
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
    """Return a number, or zero for other text: the compiler reports that with its place."""
    try:
        return float(text)
    except ValueError:
        return 0.0


PARSER = "mujoco"
"""The package that reads MJCF."""
# Name that MuJoCo gives to a model without one.
_UNNAMED = "MuJoCo Model"


@dataclass(eq=False)
class Compiled:
    """A compiled model; parts that are not taken over as they are become lines of ``notes``, or an error."""

    model: Any
    """MuJoCo's ``mjModel``."""
    mujoco: Any
    """Module ``mujoco``, which is imported on use."""
    path: Path
    """File that was read."""
    name: str
    """Name of the model."""
    options: ReadOptions
    """Options of the reader."""
    notes: list[str] = field(default_factory=list)

    def unsupported(self, what: str, remedy: str) -> None:
        """Reject or note something that the description cannot hold, as the options say.

        Raises:
            AssetError: the options have it refused.
        """
        if self.options.unsupported is Unsupported.REFUSE:
            raise AssetError(
                f"{self.path}: {what}: {remedy}, or have it left out by ReadOptions(unsupported=Unsupported.DROP)"
            )
        self.notes.append(f"left out: {what}")

    @cached_property
    def body_names(self) -> list[str]:
        """List of names of all bodies, the world's first; bodies without one are named by their number."""
        return _filled(self.names_of("BODY"), [f"body_{index}" for index in range(self.model.nbody)])

    @cached_property
    def joint_names(self) -> list[str]:
        """List of names of all joints; joints without one are named by their body and number."""
        bodies = [self.body_names[body] for body in self.model.jnt_bodyid]
        return _filled(self.names_of("JOINT"), [f"{body}_joint_{index}" for index, body in enumerate(bodies)])

    @cached_property
    def site_names(self) -> list[str]:
        """List of names of all sites, none of them a body's."""
        names = _filled(self.names_of("SITE"), [f"site_{index}" for index in range(self.model.nsite)])
        bodies = set(self.body_names)
        return [f"{name}_site" if name in bodies else name for name in names]

    @cached_property
    def geom_names(self) -> list[str]:
        """List of names of all geoms, as the file gives them: a name may be empty."""
        return self.names_of("GEOM")

    def names_of(self, kind: str) -> list[str]:
        """Return the file's names of all objects of one kind, such as ``"TENDON"``; empty where it gives none."""
        counts = {
            "BODY": "nbody", "JOINT": "njnt", "SITE": "nsite", "GEOM": "ngeom", "EQUALITY": "neq", "TENDON": "ntendon",
            "ACTUATOR": "nu", "KEY": "nkey",
        }  # fmt: skip
        number = getattr(self.mujoco.mjtObj, f"mjOBJ_{kind}")
        count = getattr(self.model, counts[kind])
        return [self.mujoco.mj_id2name(self.model, number, index) or "" for index in range(count)]

    def joints_of(self, body: int) -> range:
        """Return the body's joints, the outermost first."""
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    def joint_kind(self, joint: int) -> str:
        """Return the type of a joint: ``FREE``, ``BALL``, ``SLIDE`` or ``HINGE``."""
        return self.mujoco.mjtJoint(self.model.jnt_type[joint]).name.removeprefix("mjJNT_")

    def body_pose(self, body: int) -> Pose:
        """Return the pose of a body in its parent, where all joints are at their references."""
        return pose_of(self.model.body_pos[body], self.model.body_quat[body])

    def listed(self, bodies: list[int]) -> str:
        """Return the bodies' names, a few of them where there are many."""
        names = ", ".join(f"'{self.body_names[body]}'" for body in bodies[:12])
        return names if len(bodies) <= 12 else f"{names} and {len(bodies) - 12} more"


def compile_file(path: Path, options: ReadOptions) -> Compiled:
    """Compile an MJCF file after its text is checked against the options.

    Raises:
        AssetError: the file does not compile, opens or makes what the options forbid, or MuJoCo is not installed.
    """
    try:
        mujoco: Any = importlib.import_module(PARSER)
    except ImportError:
        raise AssetError(f"MJCF files need the package {PARSER}: {install_extra('mjcf')}") from None
    whole = read_whole(path, options)
    said: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(
        said.append
    )  # by default they go to the terminal and to MUJOCO_LOG.TXT in the current folder
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            spec = mujoco.MjSpec.from_string(whole.text, include=whole.models)
            spec.modelfiledir = str(path.parent)
            model = spec.compile()
    except ValueError as error:
        raise AssetError(f"{path} does not compile: {one_line(str(error))}") from None
    finally:
        mujoco.set_mju_user_warning(before)
    name = spec.modelname if spec.modelname != _UNNAMED else path.stem
    return Compiled(model, mujoco, path, name, options, [f"MuJoCo: {one_line(line)}" for line in said])


def _filled(names: list[str], fallback: list[str]) -> list[str]:
    """Return the names, with the fallback where one is empty, made unique by underscores."""
    taken = set(names)
    result: list[str] = []
    for name, own in zip(names, fallback, strict=True):
        while not name and own in taken:
            own += "_"
        taken.add(name or own)
        result.append(name or own)
    return result


def pose_of(position: Any, quaternion: Any) -> Pose:
    """Return the pose of arrays (3,) and (4,)."""
    w, x, y, z = (float(value) for value in quaternion)
    return Pose(vector_of(position), canonical((w, x, y, z)))


def vector_of(values: Any) -> Vector3:
    """Convert three numbers to Python floats."""
    x, y, z = np.asarray(values).tolist()
    return (x, y, z)
