"""Models of SDFormat files before they are read: elements and their values, files, versions, ``<include>``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree.ElementTree import Element

from orbit_assets.options import ReadOptions
from orbit_assets.outside import allowed_path, resolve_file
from orbit_assets.source_text import Findings, read_xml
from orbit_core.scene import Pose
from orbit_core.scene.pose import Vector3, canonical

_TRUE, _FALSE = ("true", "1"), ("false", "0", "")


class SdfFields:
    """Reader of child elements; errors name file, element and remedy.

    ``where`` in all methods is the thing being read, as "link 'arm'".
    """

    def __init__(self, findings: Findings) -> None:
        self.findings = findings
        """Errors and notes so far."""

    def name(self, element: Element, where: str) -> str:
        """Return the element's name.

        Raises:
            AssetError: it has none.
        """
        name = element.get("name")
        if not name:
            raise self.findings.error(f"{where} lacks attribute 'name' of <{element.tag}>", "add it")
        return name

    def text(self, element: Element, tag: str, where: str, default: str | None = None) -> str:
        """Return the text of a child element; ``default`` where there is no such child.

        Raises:
            AssetError: it is missing without a default.
        """
        child = element.find(tag)
        if child is not None:
            return (child.text or "").strip()
        if default is None:
            raise self.findings.error(f"{where} lacks <{tag}> in <{element.tag}>", "add it")
        return default

    def number(self, element: Element, tag: str, where: str, default: float | None = None) -> float:
        """Return the number in a child element.

        Raises:
            AssetError: it is missing without a default, or no number.
        """
        return self.numbers(element, tag, where, 1, None if default is None else repr(default))[0]

    def vector(self, element: Element, tag: str, where: str, default: str | None = None) -> Vector3:
        """Return the three numbers in a child element.

        Raises:
            AssetError: it is missing without a default, or not three numbers.
        """
        x, y, z = self.numbers(element, tag, where, 3, default)
        return (x, y, z)

    def numbers(self, element: Element, tag: str, where: str, count: int, default: str | None = None) -> list[float]:
        """Return ``count`` numbers separated by spaces from a child element.

        Raises:
            AssetError: it is missing without a default, or holds another count or no numbers.
        """
        return self._parsed(self.text(element, tag, where, default), tag, where, count)

    def flag(self, element: Element, tag: str, where: str) -> bool:
        """Return the truth value of a child element; False where there is none.

        Raises:
            AssetError: it says neither.
        """
        text = self.text(element, tag, where, "").lower()
        if text not in (*_TRUE, *_FALSE):
            raise self.findings.error(f"{where} has <{tag}>{text}</{tag}>", "give true or false")
        return text in _TRUE

    def pose(self, element: Element, where: str) -> tuple[Pose, str]:
        """Return the pose of a child ``<pose>``, and the name of the frame that it is given in, empty for the default.

        Raises:
            AssetError: its numbers are not as they should be.
        """
        child = element.find("pose")
        if child is None:
            return Pose(), ""
        # ``frame`` is the attribute's name before version 1.7.
        frame = child.get("relative_to") or child.get("frame") or ""
        text = (child.text or "").strip() or "0 0 0 0 0 0"
        if child.get("rotation_format", "euler_rpy") == "quat_xyzw":
            px, py, pz, x, y, z, w = self._parsed(text, "pose", where, 7)
            return Pose((px, py, pz), canonical((w, x, y, z))), frame
        px, py, pz, roll, pitch, yaw = self._parsed(text, "pose", where, 6)
        unit = math.pi / 180.0 if child.get("degrees", "").lower() in _TRUE else 1.0
        # Without rotation the identity is exact, where Euler angles would leave rounding.
        if not (roll or pitch or yaw):
            return Pose((px, py, pz)), frame
        return Pose.from_euler(roll * unit, pitch * unit, yaw * unit, (px, py, pz)), frame

    def _parsed(self, text: str, tag: str, where: str, count: int) -> list[float]:
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count:
            raise self.findings.error(f"{where} has <{tag}>{text[:80]}</{tag}>", f"give {count} number(s)")
        return values


# Most files that include one another.
_DEEPEST = 8
# A model's folder lists its SDF files by version in this file.
_CONFIG = "model.config"
_DEFAULT_VERSION = "1.7"


@dataclass(frozen=True, eq=False)
class SdfSource:
    """A ``<model>`` element, with its file and what an ``<include>`` says of it.

    ``pose`` is that of the model's frame ``placement`` (empty for the model's own) in frame ``relative_to`` (empty for
    the frame of what holds the model).
    """

    element: Element
    """Parsed element."""
    path: Path
    """File that holds the element."""
    version: tuple[int, ...]
    """Version of SDFormat that the file states."""
    name: str
    """Name, as an ``<include>`` may change it."""
    pose: Pose
    relative_to: str
    placement: str
    static: bool
    """True if the model does not move."""
    above: tuple[Path, ...]
    """The files that include ``path``, the outermost first."""


@dataclass(frozen=True, eq=False)
class SdfWorld:
    """The models and ``<frame>`` elements of one world, or of a file right below its root."""

    fields: SdfFields
    """Reader of values."""
    models: list[SdfSource] = field(default_factory=list)
    """Models, included ones too."""
    frames: list[Element] = field(default_factory=list)
    """Frames that models may be placed in."""


class SdfFiles:
    """Reader of the files of one model or world, under the limits of the caller.

    Args:
        options: which files may be opened, and how many.
    """

    def __init__(self, options: ReadOptions) -> None:
        self.options = options
        self._opened = 0

    def worlds(self, path: Path, above: tuple[Path, ...] = ()) -> list[SdfWorld]:
        """Return the worlds of a file, included models in their place.

        Args:
            path: the file.
            above: the files that include this one, the outermost first.

        Raises:
            AssetError: the file, or one that it includes, is missing, not allowed, malformed or holds no model.
        """
        findings = Findings(f"SDF file '{path}'", self.options)
        self._opened += 1
        if len(above) > _DEEPEST:
            raise findings.error(f"it is included {len(above)} files deep", "include it once")
        if self._opened > self.options.limits.copies:
            raise findings.error(
                f"it is one of more than {self.options.limits.copies} files that are included",
                "include fewer, or raise ReadLimits.copies",
            )
        root = read_xml(path, self.options)
        if root.tag != "sdf":
            raise findings.error(f"its root element is <{root.tag}>", "give an SDF file, whose root is <sdf>")
        fields = SdfFields(findings)
        worlds = [self._world(each, path, _version(root), fields, above) for each in (root, *root.findall("world"))]
        if not any(world.models for world in worlds):
            raise findings.error("it holds no <model>", "give a file that does")
        return worlds

    def included(self, element: Element, fields: SdfFields, path: Path, above: tuple[Path, ...]) -> SdfSource:
        """Return the model that an ``<include>`` names, placed as the element says, or else as the model itself.

        Args:
            element: the ``<include>``.
            fields: of the file that holds it, for errors.
            path: that file.
            above: the files that include that one.

        Raises:
            AssetError: as :meth:`worlds`.
        """
        uri = fields.text(element, "uri", "an <include>").rstrip("/")
        file = resolve_file(uri if uri.endswith(".sdf") else self._in_folder(uri, path), path, self.options)
        # SDFormat takes the first model of an included file.
        model = next(model for world in self.worlds(file, (*above, path)) for model in world.models)
        name = fields.text(element, "name", "an <include>", model.name)
        where = f"the <include> of '{name}'"
        placed = element.find("pose") is not None
        if element.find("placement_frame") is not None and not placed:
            raise fields.findings.error(f"{where} has a <placement_frame> and no <pose>", "add the pose of that frame")
        pose, relative_to = fields.pose(element, where) if placed else (model.pose, model.relative_to)
        return replace(
            model,
            name=name,
            pose=pose,
            relative_to=relative_to,
            placement=fields.text(element, "placement_frame", where, model.placement),
            static=model.static or fields.flag(element, "static", where),
        )

    def _world(
        self, container: Element, path: Path, version: tuple[int, ...], fields: SdfFields, above: tuple[Path, ...]
    ) -> SdfWorld:
        world = SdfWorld(fields, frames=container.findall("frame"))
        for element in container:
            if element.tag == "model":
                world.models.append(model_source(element, path, version, fields, above))
            elif element.tag == "include":
                world.models.append(self.included(element, fields, path, above))
            elif element.tag == "joint":
                where = f"joint '{element.get('name', '')}'"
                fields.findings.unsupported("ends in two models of a world", where, "put both into one model")
        return world

    def _in_folder(self, uri: str, base: Path) -> str:
        """Return the file of a model's folder: that of the latest version in its ``model.config``, or ``model.sdf``."""
        config = allowed_path(f"{uri}/{_CONFIG}", base, self.options)
        versions = [] if not config.is_file() else read_xml(config, self.options).findall("sdf")
        named = [(_version(each), (each.text or "").strip()) for each in versions]
        return f"{uri}/{max(named)[1]}" if any(text for _, text in named) else f"{uri}/model.sdf"


def model_source(
    element: Element, path: Path, version: tuple[int, ...], fields: SdfFields, above: tuple[Path, ...]
) -> SdfSource:
    """Return a ``<model>`` element as a source, at its own pose.

    Args:
        element: the ``<model>``.
        path: the file that holds it.
        version: of SDFormat, as that file says.
        fields: of that file.
        above: the files that include that file.

    Raises:
        AssetError: it has no name, or its pose is malformed.
    """
    name = fields.name(element, "a model")
    pose, relative_to = fields.pose(element, f"model '{name}'")
    static = fields.flag(element, "static", f"model '{name}'")
    placement = element.get("placement_frame", "")
    return SdfSource(element, path, version, name, pose, relative_to, placement, static, above)


def _version(element: Element) -> tuple[int, ...]:
    numbers = element.get("version", _DEFAULT_VERSION).split(".")
    return tuple(int(number) for number in numbers if number.isdigit())
