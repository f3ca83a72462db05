"""SDFormat files (.sdf, of Gazebo and others) read into articulation descriptions, a model each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

from orbit_core.assets.findings import Findings
from orbit_core.assets.naming import names_file
from orbit_core.assets.options import ReadOptions
from orbit_core.assets.outside import resolve_file
from orbit_core.assets.sdf.fields import SdfFields
from orbit_core.assets.sdf.model import SdfModelReader
from orbit_core.assets.source_text import read_xml
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.scene import Articulation, Pose

_DEEPEST = 8
"""Files that include one another."""


@dataclass(frozen=True, eq=False)
class SdfModel:
    """A model of an SDFormat file, where its frame stands in the world, and whether the file says that it is fixed."""

    articulation: Articulation
    pose: Pose
    static: bool


@names_file
def read_sdf(path: Path | str, name: str | None = None, *, options: ReadOptions = ReadOptions()) -> Articulation:
    """The articulation that a model of an SDFormat file describes, in link order depth first, fixed joints kept.

    Of several models ``options.articulation`` names the one. Poses are taken in the frames that they name, as
    SDFormat 1.7 has it; axes before version 1.5 are in the model's frame. Ball and universal joints become chains of
    simple ones. A second joint to a link closes a loop: a ball joint or a weld exactly, a revolute one as a ball joint
    at its origin. A link without ``<inertial>`` has SDFormat's default, 1 kg and 1 kg m^2. Where the model stands and
    whether it is static is in the notes; :func:`read_sdf_models` gives it as data.

    Raises:
        AssetError: the file, or one that it names, is missing, malformed or describes what ORBIT has no word for.
    """
    models = _sources(Path(path), options)
    known = [model.name for model in models]
    wanted = options.articulation or (known[0] if len(known) == 1 else None)
    if wanted is None:
        listed = ", ".join(f"'{each}'" for each in known[:8])
        raise AssetError(f"there are several models, {listed}: name one by ReadOptions(articulation=...)")
    if wanted not in known:
        raise UnknownNameError("model", wanted, known, f"'{path}'")
    model = _read(models[known.index(wanted)], options)
    notes = list(model.articulation.notes)
    if model.static:
        notes.append("the model is static: give the entity fixed_base=True")
    if model.pose != Pose():
        notes.append(f"the model stands at {model.pose.position} in its world: give the entity that pose")
    return replace(model.articulation, name=name or wanted, notes=tuple(notes))


@names_file
def read_sdf_models(path: Path | str, *, options: ReadOptions = ReadOptions()) -> tuple[SdfModel, ...]:
    """All models of an SDFormat file and of those that it includes, as :func:`read_sdf` reads one.

    Raises:
        AssetError: as :func:`read_sdf`.
    """
    return tuple(_read(source, options) for source in _sources(Path(path), options))


@dataclass(frozen=True)
class _Source:
    """A ``<model>`` element, with its file and what an ``<include>`` says of it."""

    element: Element
    path: Path
    name: str
    pose: Pose
    version: tuple[int, ...]
    static: bool


def _read(source: _Source, options: ReadOptions) -> SdfModel:
    findings = Findings(f"SDF file '{source.path}'", options)
    reader = SdfModelReader(source.element, source.path, source.version, findings, options)
    return SdfModel(reader.read(source.name), source.pose, source.static)


def _sources(
    path: Path, options: ReadOptions, above: tuple[Path, ...] = (), read: list[Path] | None = None
) -> list[_Source]:
    """Return the models of a file, world by world, included ones in their place.

    Args:
        path: the file.
        options: which files may be included, and how many.
        above: the files that include this one, the outermost first.
        read: all files read so far, which grows.
    """
    findings = Findings(f"SDF file '{path}'", options)
    read = [] if read is None else read
    read.append(path)
    if len(above) > _DEEPEST:
        raise findings.error(f"it is included {len(above)} files deep", "include it once")
    if len(read) > options.limits.copies:
        raise findings.error(
            f"it is one of more than {options.limits.copies} files that are included",
            "include fewer, or raise ReadLimits.copies",
        )
    root = read_xml(path, options)
    if root.tag != "sdf":
        raise findings.error(f"its root element is <{root.tag}>", "give an SDF file, whose root is <sdf>")
    fields = SdfFields(findings)
    found: list[_Source] = []
    for container in (root, *root.findall("world")):
        for element in container:
            if element.tag == "model":
                name = fields.name(element, "a model")
                pose, frame = fields.pose(element, f"model '{name}'")
                if frame not in ("", "world"):
                    raise findings.error(f"model '{name}' stands in frame '{frame}'", "give its pose in the world")
                static = fields.flag(element, "static", f"model '{name}'")
                found.append(_Source(element, path, name, pose, _version(root), static))
            elif element.tag == "include":
                found += _included(element, fields, options, (*above, path), read)
    if not found:
        raise findings.error("it holds no <model>", "give a file that does")
    return found


def _included(
    element: Element, fields: SdfFields, options: ReadOptions, above: tuple[Path, ...], read: list[Path]
) -> list[_Source]:
    uri = fields.text(element, "uri", "an <include>").rstrip("/")
    file = resolve_file(uri if uri.endswith(".sdf") else f"{uri}/model.sdf", above[-1], options)
    pose, _ = fields.pose(element, "an <include>")
    given = element.find("pose") is not None
    models = _sources(file, options, above, read)
    name = fields.text(element, "name", "an <include>", models[0].name)
    static = fields.flag(element, "static", "an <include>")
    return [
        replace(model, name=name, pose=pose if given else model.pose, static=static or model.static)
        for model in models[:1]
    ]


def _version(root: Element) -> tuple[int, ...]:
    numbers = root.get("version", "1.7").split(".")
    return tuple(int(number) for number in numbers if number.isdigit())
