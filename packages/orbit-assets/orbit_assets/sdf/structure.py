"""Links, joints and frames of an SDFormat model and of the models in it, by their path, before they are read."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element

from orbit_assets.findings import Findings
from orbit_assets.options import ReadOptions
from orbit_assets.sdf.fields import SdfFields
from orbit_assets.sdf.frames import MODEL, WORLD, SdfFrames
from orbit_assets.sdf.shapes import SdfShapes
from orbit_assets.sdf.sources import SdfFiles, SdfSource, model_source
from orbit_core.scene import Pose

_READ = {"pose", "static", "link", "joint", "frame", "model", "self_collide", "allow_auto_disable", "include"}
"""Elements of a model that are read; all others are left out with a note."""


@dataclass(frozen=True, eq=False)
class SdfScope:
    """A model within which names are looked up.

    ``prefix`` leads to what the model holds, as ``hand::``; it is empty in the outermost model. ``model`` is the name
    of the model's own frame.
    """

    prefix: str
    model: str
    version: tuple[int, ...]
    shapes: SdfShapes

    def named(self, name: str) -> str:
        """Return the path of a name that is used within the model."""
        return self.model if name == MODEL else f"{self.prefix}{name}"


class SdfStructure:
    """What models hold, included ones too, each element with the scope of its model.

    Args:
        findings: for errors and notes.
        options: which files may be opened.
        root: the frame of reference, as for :class:`SdfFrames`.
    """

    def __init__(self, findings: Findings, options: ReadOptions, root: str) -> None:
        self.findings = findings
        self.options = options
        self.fields = SdfFields(findings)
        self.frames = SdfFrames(findings, root)
        self.links: dict[str, tuple[Element, SdfScope]] = {}
        self.joints: dict[str, tuple[Element, SdfScope]] = {}
        self.named_frames: list[str] = []
        self.self_collisions = False
        self._files = SdfFiles(options)

    def add_outermost(self, source: SdfSource) -> None:
        """Collect a model in its own frame, without a prefix."""
        self._collect(source, "", MODEL)

    def add_nested(self, source: SdfSource, prefix: str, around: str, named: str) -> None:
        """Collect a model within another or within a world.

        Args:
            source: the model.
            prefix: of what holds it.
            around: the frame of what holds it.
            named: path of the frame that its pose is given in.
        """
        path = f"{prefix}{source.name}"
        self._check_new(path, f"model '{path}'")
        inner = f"{path}::"
        own = f"{inner}{MODEL}"
        self.frames.add(path, source.pose, named or around, f"{inner}{source.placement}" if source.placement else "")
        self.frames.add(own, Pose(), path)
        self.frames.attach(path, own)
        self._collect(source, inner, own)

    def _collect(self, source: SdfSource, prefix: str, own: str) -> None:
        model = source.element
        for child in model:
            if child.tag not in _READ:
                self.findings.leave_out(f"<{child.tag}>", f"model '{model.get('name')}'")
        self.self_collisions |= self.fields.flag(model, "self_collide", "the model")
        scope = SdfScope(prefix, own, source.version, SdfShapes(source.path, self.fields, self.options))
        held: list[str] = []
        for tag, hold in (("link", self._add_link), ("joint", self._add_joint), ("frame", self._add_frame)):
            for element in model.findall(tag):
                name = scope.named(self.fields.name(element, f"a {tag}"))
                self._check_new(name, f"{tag} '{name}'")
                hold(name, element, scope)
                held += [name] if tag == "link" else []
        for element in model:
            if element.tag == "model":
                nested = model_source(element, source.path, source.version, self.fields, source.above)
            elif element.tag == "include":
                nested = self._files.included(element, self.fields, source.path, source.above)
            else:
                continue
            if nested.static:
                self.findings.leave_out("<static> of a nested model", f"model '{prefix}{nested.name}'")
            named = scope.named(nested.relative_to) if nested.relative_to else ""
            if element.tag == "include" and element.get("merge", "false") in ("true", "1"):
                held.append(self._merge(nested, scope, named))
            else:
                self.add_nested(nested, prefix, own, named)
                held.append(f"{prefix}{nested.name}")
        canonical = model.get("canonical_link")
        if canonical:
            self.frames.attach(own, scope.named(canonical))
        elif held:
            self.frames.attach(own, held[0])

    def _merge(self, source: SdfSource, scope: SdfScope, named: str) -> str:
        """Collect a model as if its elements were those of the scope; return the name of the frame that it had."""
        own = f"{scope.prefix}_merged__{source.name}__model__"
        self._check_new(own, f"the merged model '{source.name}'")
        self.frames.add(
            own, source.pose, named or scope.model, scope.named(source.placement) if source.placement else ""
        )
        self._collect(source, scope.prefix, own)
        return own

    def _add_link(self, name: str, element: Element, scope: SdfScope) -> None:
        self.links[name] = (element, scope)
        self._place(name, element, f"link '{name}'", scope, scope.model)

    def _add_joint(self, name: str, element: Element, scope: SdfScope) -> None:
        where = f"joint '{name}'"
        self.joints[name] = (element, scope)
        child = scope.named(self.fields.text(element, "child", where))
        self._place(name, element, where, scope, child)
        self.frames.attach(name, child)

    def _add_frame(self, name: str, element: Element, scope: SdfScope) -> None:
        self.named_frames.append(name)
        host = scope.named(element.get("attached_to") or MODEL)
        self._place(name, element, f"frame '{name}'", scope, host)
        self.frames.attach(name, host)

    def _place(self, name: str, element: Element, where: str, scope: SdfScope, default: str) -> None:
        pose, frame = self.fields.pose(element, where)
        self.frames.add(name, pose, scope.named(frame) if frame else default)

    def _check_new(self, name: str, where: str) -> None:
        if name in self.frames:
            raise self.findings.error(f"{where} has the name of another link, joint, frame or model", "rename one")


def world_frames(models: list[SdfSource], frames: list[Element], fields: SdfFields, options: ReadOptions) -> SdfFrames:
    """Return all frames of a world: its own, and those of its models by their path.

    Raises:
        AssetError: a model cannot be read, or two things in a model have one name.
    """
    structure = SdfStructure(fields.findings, options, WORLD)
    for element in frames:
        name = fields.name(element, "a frame")
        pose, relative_to = fields.pose(element, f"frame '{name}'")
        structure.frames.add(name, pose, relative_to or element.get("attached_to") or WORLD)
    for source in models:
        structure.add_nested(source, "", WORLD, source.relative_to)
    return structure.frames
