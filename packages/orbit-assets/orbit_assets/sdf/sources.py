"""Models of SDFormat files before they are read: elements, files, versions, and where an ``<include>`` puts them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree.ElementTree import Element

from orbit_assets.findings import Findings
from orbit_assets.options import ReadOptions
from orbit_assets.outside import allowed_path, resolve_file
from orbit_assets.sdf.fields import SdfFields
from orbit_assets.source_text import read_xml
from orbit_core.scene import Pose

_DEEPEST = 8
"""Files that include one another."""
_CONFIG = "model.config"
_DEFAULT_VERSION = "1.7"


@dataclass(frozen=True, eq=False)
class SdfSource:
    """A ``<model>`` element, with its file and what an ``<include>`` says of it.

    ``pose`` is that of the model's frame ``placement`` (empty for the model's own) in frame ``relative_to`` (empty for
    the frame of what holds the model).
    """

    element: Element
    path: Path
    version: tuple[int, ...]
    name: str
    pose: Pose
    relative_to: str
    placement: str
    static: bool
    above: tuple[Path, ...]
    """The files that include ``path``, the outermost first."""


@dataclass(frozen=True, eq=False)
class SdfWorld:
    """The models and ``<frame>`` elements of one world, or those of a file right below its root."""

    fields: SdfFields
    models: list[SdfSource] = field(default_factory=list)
    frames: list[Element] = field(default_factory=list)


class SdfFiles:
    """Reads the files of one model or world, under the limits of the caller.

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
    """Return a ``<model>`` element as a source, placed as it says itself.

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
