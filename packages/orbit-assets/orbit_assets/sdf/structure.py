"""Links, joints, frames and shapes of an SDFormat model and of the models in it, found by their path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

from orbit_assets.meshes import MeshFiles
from orbit_assets.options import ReadOptions
from orbit_assets.outside import resolve_file
from orbit_assets.sdf.sources import SdfFields, SdfFiles, SdfSource, model_source
from orbit_assets.source_text import Findings, naming
from orbit_assets.urdf.reader import SIZELESS, TEXTURES, facing, is_sizeless, touchable
from orbit_core.scene import Box, Capsule, Color, Cylinder, Geometry, PhysicsMaterial, Plane, Pose, Shape, Sphere
from orbit_core.scene.pose import Vector3

MODEL = "__model__"
"""SDFormat's name for a model's own frame."""
WORLD = "world"
"""SDFormat's name for the frame of the world."""


@dataclass(frozen=True)
class _Given:
    """A frame as the file gives it: the pose, in frame ``relative_to``, of the frame's own part ``placement``."""

    pose: Pose
    relative_to: str
    placement: str


class SdfFrames:
    """Poses and hosts of links, joints, frames and nested models, each relative to another by name, in any order.

    Args:
        findings: for errors.
        root: the frame in which all poses are computed, :data:`MODEL` or :data:`WORLD`.
    """

    def __init__(self, findings: Findings, root: str) -> None:
        self._findings = findings
        self._root = root
        self._given: dict[str, _Given] = {}
        self._hosts: dict[str, str] = {}
        self._known: dict[str, Pose] = {root: Pose()}

    def __contains__(self, name: str) -> bool:
        return name == self._root or name in self._given

    def add(self, name: str, pose: Pose, relative_to: str, placement: str = "") -> None:
        """Record the pose of a frame.

        Args:
            name: of the frame.
            pose: in the frame ``relative_to``.
            relative_to: the name of a frame that may be added later.
            placement: the frame within the one added that stands at ``pose``, where it is not its origin.
        """
        self._given[name] = _Given(pose, relative_to, placement)

    def attach(self, name: str, host: str) -> None:
        """Record that a frame moves with another one, or with a link."""
        self._hosts[name] = host

    def pose(self, name: str, within: str | None = None) -> Pose:
        """Return the pose of a frame in the root, or in the frame ``within`` that it is given in, through others.

        Raises:
            AssetError: the frame, or one that it is given in, is unknown, or they form a circle.
        """
        root = within or self._root
        known = self._known if within is None else {within: Pose()}
        chain: list[str] = []
        met: set[str] = set()
        while name not in known:
            if name not in self._given:
                raise self._findings.error(f"a pose is given in frame '{name}', which does not exist", "define it")
            if name in met:
                raise self._findings.error(
                    f"the pose of '{name}' is given in itself, by way of others", "break the circle"
                )
            met.add(name)
            chain.append(name)
            name = self._given[name].relative_to
        pose = known[name]
        for each in reversed(chain):
            given = self._given[each]
            pose = pose @ given.pose
            if given.placement:
                # A placement frame puts that part of the frame at the pose: the frame itself is the inverse away.
                pose = pose @ self.pose(given.placement, each).inverse()
            # Only poses in the root are cached: those within another frame are needed once.
            if root == self._root:
                self._known[each] = pose
        return pose

    def link_of(self, name: str) -> str:
        """Return the link that a frame moves with; a link and an unknown name are returned as they are.

        Raises:
            AssetError: frames are attached to each other in a circle.
        """
        met: set[str] = set()
        while name in self._hosts:
            if name in met:
                raise self._findings.error(
                    f"frame '{name}' is attached to itself, by way of others", "break the circle"
                )
            met.add(name)
            name = self._hosts[name]
        return name


_HULLS = "collision meshes of the SDF collide as their convex hulls"
_KNOWN = {
    "visual": {"pose", "geometry", "material", "cast_shadows", "visibility_flags"},
    "collision": {"pose", "geometry", "surface", "density"},
    "material": {"ambient", "diffuse", "specular", "emissive", "lighting", "double_sided"},
}


class SdfShapes:
    """Reader of ``<collision>`` and ``<visual>`` elements of one file.

    Args:
        path: the file, from which meshes are named.
        fields: for values, errors and notes.
        options: which files may be opened.
    """

    def __init__(self, path: Path, fields: SdfFields, options: ReadOptions) -> None:
        self.path = path
        self.fields = fields
        self.options = options
        self.meshes = MeshFiles(options, path)
        """Reader of mesh files, which keeps each."""

    def collision(self, element: Element, pose: Pose, where: str) -> Iterator[Shape]:
        """Yield the shapes that collide, at ``pose`` in the link.

        Raises:
            AssetError: a value, a file or the geometry is not as it should be.
        """
        self._note_unread(element, where)
        material, name = self._material(element, where), element.get("name", "")
        for kind, child in self._geometry(element, where):
            if kind == "mesh":
                self.fields.findings.note(_HULLS)
                solids = [(self.meshes.mesh(*self._mesh_file(child, where)), Pose())]
            else:
                solids = self._primitive(kind, child, where)
            for solid, turned in solids:
                shape = touchable(solid, self.fields.findings, where)
                if shape is not None:
                    yield Shape(shape, pose @ turned, material, name=name)

    def visual(self, element: Element, pose: Pose, where: str) -> Iterator[Shape]:
        """Yield the shapes that are drawn, at ``pose`` in the link, one for each colour of a mesh.

        Raises:
            AssetError: as :meth:`collision`.
        """
        self._note_unread(element, where)
        color, name = self._color(element, where), element.get("name", "")
        for kind, child in self._geometry(element, where):
            if kind != "mesh":
                for solid, turned in self._primitive(kind, child, where):
                    if is_sizeless(solid):
                        self.fields.findings.leave_out(SIZELESS, where)
                        continue
                    shape = Shape(solid, pose @ turned, name=name)
                    yield shape if color is None else replace(shape, color=color)
                continue
            file, scale = self._mesh_file(child, where)
            # A mesh of scale zero hides a part in published models.
            if 0.0 in scale:
                self.fields.findings.leave_out(SIZELESS, where)
                continue
            for part in self.meshes.parts(file, scale):
                if part.textured and part.texture is None and color is None:
                    self.fields.findings.note(TEXTURES)
                shape = Shape(part.mesh, pose, name=name)
                yield part.shown(shape) if color is None else replace(shape, color=color)

    def _geometry(self, element: Element, where: str) -> Iterator[tuple[str, Element]]:
        geometry = element.find("geometry")
        if geometry is None or not len(geometry):
            raise self.fields.findings.error(f"{where} has a <{element.tag}> without <geometry>", "add it")
        return ((child.tag, child) for child in geometry if child.tag != "empty")

    def _primitive(self, kind: str, child: Element, where: str) -> Iterator[tuple[Geometry, Pose]]:
        fields = self.fields
        match kind:
            case "box":
                x, y, z = fields.vector(child, "size", where)
                yield Box((x / 2, y / 2, z / 2)), Pose()
            case "sphere":
                yield Sphere(fields.number(child, "radius", where)), Pose()
            case "cylinder" | "capsule":
                radius, length = (fields.number(child, key, where) for key in ("radius", "length"))
                yield (Cylinder if kind == "cylinder" else Capsule)(radius, length / 2), Pose()
            case "plane":
                yield Plane(), facing(fields.vector(child, "normal", where, "0 0 1"))
            case _:
                remedy = "use box, sphere, cylinder, capsule, plane or mesh"
                fields.findings.unsupported(f"a <geometry> of kind <{kind}>", where, remedy)

    def _mesh_file(self, mesh: Element, where: str) -> tuple[Path, Vector3]:
        if mesh.find("submesh") is not None:
            self.fields.findings.unsupported("a <submesh>", where, "export the part as a file of its own")
        uri = self.fields.text(mesh, "uri", where)
        with naming(f"in {self.fields.findings.place}, {where}"):
            return resolve_file(uri, self.path, self.options), self.fields.vector(mesh, "scale", where, "1 1 1")

    def _material(self, element: Element, where: str) -> PhysicsMaterial:
        """Return friction and restitution; ORBIT's defaults apply where SDFormat has none, and its mu is the same."""
        surface = element.find("surface")
        material = PhysicsMaterial()
        if surface is None:
            return material
        ode, bounce = surface.find("friction/ode"), surface.find("bounce")
        if ode is not None:
            mu = self.fields.number(ode, "mu", where, 1.0)
            if self.fields.number(ode, "mu2", where, mu) != mu:
                self.fields.findings.note("friction that differs by direction has its first value in all")
            material = replace(material, static_friction=mu, dynamic_friction=mu)
        if bounce is not None:
            material = replace(material, restitution=self.fields.number(bounce, "restitution_coefficient", where, 0.0))
        for child in surface:
            if child.tag not in ("friction", "bounce"):
                self.fields.findings.leave_out(f"<{child.tag}> of surfaces", where)
        return material

    def _color(self, element: Element, where: str) -> Color | None:
        material = element.find("material")
        if material is None:
            return None
        self._note_unread(material, where)
        # Gazebo shows the diffuse colour; files of other tools have only an ambient one.
        for tag in ("diffuse", "ambient"):
            text = self.fields.text(material, tag, where, "")
            if text:
                count = 3 if len(text.split()) == 3 else 4
                r, g, b, *a = self.fields.numbers(material, tag, where, count)
                return (r, g, b, a[0] if a else 1.0)
        return None

    def _note_unread(self, element: Element, where: str) -> None:
        for child in element:
            if child.tag not in _KNOWN[element.tag]:
                self.fields.findings.leave_out(f"<{child.tag}> of a {element.tag}", where)


# Elements of a model that are read; all others are left out with a note.
_READ = {"pose", "static", "link", "joint", "frame", "model", "self_collide", "allow_auto_disable", "include"}


@dataclass(frozen=True, eq=False)
class SdfScope:
    """A model as a namespace of links, joints and frames.

    ``prefix`` leads to what the model holds, as ``hand::``; it is empty in the outermost model. ``model`` is the name
    of the model's own frame.
    """

    prefix: str
    model: str
    version: tuple[int, ...]
    """Version of SDFormat that the model's file states."""
    shapes: SdfShapes
    """Reader of shapes in that file."""

    def named(self, name: str) -> str:
        """Return the path of a name that is used within the model."""
        return self.model if name == MODEL else f"{self.prefix}{name}"


class SdfStructure:
    """Elements of a model and of the models in it, included ones too, each with the scope of its model.

    Args:
        findings: for errors and notes.
        options: which files may be opened.
        root: the frame of reference, as for :class:`SdfFrames`.
    """

    def __init__(self, findings: Findings, options: ReadOptions, root: str) -> None:
        self.findings = findings
        self.options = options
        self.fields = SdfFields(findings)
        """Reader of values."""
        self.frames = SdfFrames(findings, root)
        """Poses of links and frames."""
        self.links: dict[str, tuple[Element, SdfScope]] = {}
        """Elements and scopes of links by scoped name."""
        self.joints: dict[str, tuple[Element, SdfScope]] = {}
        """Elements and scopes of joints by scoped name."""
        self.named_frames: list[str] = []
        """Scoped names of ``<frame>`` elements."""
        self.self_collisions = False
        """True if any model or link in it may collide with itself."""
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
        # Frames last: they may be attached to links and joints.
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
        # A model's frame moves with its canonical link, by default the first link or nested model.
        canonical = model.get("canonical_link")
        if canonical:
            self.frames.attach(own, scope.named(canonical))
        elif held:
            self.frames.attach(own, held[0])

    def _merge(self, source: SdfSource, scope: SdfScope, named: str) -> str:
        """Collect a model as if its elements were those of the scope; return the name of the frame that it had."""
        # ``merge`` puts the elements into the scope; the name of the model's own frame must still be unique.
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
