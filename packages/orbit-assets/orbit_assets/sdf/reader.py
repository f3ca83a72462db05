"""SDFormat files (.sdf, of Gazebo and others) read into articulation descriptions, a model each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from orbit_assets.findings import Findings
from orbit_assets.naming import names_file
from orbit_assets.options import ReadOptions
from orbit_assets.sdf.frames import WORLD
from orbit_assets.sdf.model import SdfModelReader
from orbit_assets.sdf.sources import SdfFiles, SdfSource, SdfWorld
from orbit_assets.sdf.structure import world_frames
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.scene import Articulation, Pose


@dataclass(frozen=True, eq=False)
class SdfModel:
    """A model of an SDFormat file, where it stands in the file's world, and whether the file says that it is fixed."""

    articulation: Articulation
    pose: Pose
    """Of the model's frame."""
    static: bool
    root_pose: Pose
    """Of the root link, as an entity of a scene needs it."""


@names_file
def read_sdf(path: Path | str, name: str | None = None, *, options: ReadOptions = ReadOptions()) -> Articulation:
    """The articulation that a model of an SDFormat file describes, in link order depth first, fixed joints kept.

    Of several models ``options.articulation`` names the one. Poses are taken in the frames that they name, as
    SDFormat 1.7 has it; axes before version 1.5 are in the model's frame. Ball and universal joints become chains of
    simple ones. A second joint to a link closes a loop: a ball joint or a weld exactly, a revolute one as a ball joint
    at its origin. A link without ``<inertial>`` has SDFormat's default, 1 kg and 1 kg m^2. Where the root link stands
    and whether the model is static is in the notes; :func:`read_sdf_models` gives it as data.

    Raises:
        AssetError: the file, or one that it names, is missing, malformed or describes what ORBIT has no word for.
    """
    models = _models(Path(path), options)
    known = [model.name for _, model in models]
    wanted = options.articulation or (known[0] if len(known) == 1 else None)
    if wanted is None:
        listed = ", ".join(f"'{each}'" for each in known[:8])
        raise AssetError(f"there are several models, {listed}: name one by ReadOptions(articulation=...)")
    if wanted not in known:
        raise UnknownNameError("model", wanted, known, f"'{path}'")
    model = _read(*models[known.index(wanted)], options)
    notes = list(model.articulation.notes)
    if model.static:
        notes.append("the model is static: give the entity fixed_base=True")
    if model.root_pose != Pose():
        at = ", ".join(f"{value:.6g}" for value in model.root_pose.position)
        turned = ", ".join(f"{value:.6g}" for value in model.root_pose.orientation)
        root = model.articulation.root.name
        notes.append(
            f"root link '{root}' stands at ({at}) with quaternion ({turned}) in its world: give the entity that pose"
        )
    return replace(model.articulation, name=name or wanted, notes=tuple(notes))


@names_file
def read_sdf_models(path: Path | str, *, options: ReadOptions = ReadOptions()) -> tuple[SdfModel, ...]:
    """All models of an SDFormat file and of those that it includes, as :func:`read_sdf` reads one.

    Raises:
        AssetError: as :func:`read_sdf`.
    """
    return tuple(_read(world, model, options) for world, model in _models(Path(path), options))


def _models(path: Path, options: ReadOptions) -> list[tuple[SdfWorld, SdfSource]]:
    """The models of a file, world by world, each with its world."""
    return [(world, model) for world in SdfFiles(options).worlds(path) for model in world.models]


def _read(world: SdfWorld, source: SdfSource, options: ReadOptions) -> SdfModel:
    findings = Findings(f"SDF file '{source.path}'", options)
    reader = SdfModelReader(source, findings, options)
    articulation = reader.read()
    pose = source.pose @ reader.placement().inverse() if source.placement else source.pose
    if source.relative_to not in ("", WORLD):
        pose = world_frames(world.models, world.frames, world.fields, options).pose(source.relative_to) @ pose
    notes = (*world.fields.findings.notes, *articulation.notes)
    return SdfModel(
        replace(articulation, notes=notes), pose, source.static, pose @ reader.pose_of(articulation.root.name)
    )
