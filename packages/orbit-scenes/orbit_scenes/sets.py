"""Readers of object sets that users have on disk: YCB, Google Scanned Objects, Objaverse, PartNet-Mobility, RoboCasa.

Nothing is downloaded. :func:`set_layout` finds the set by the files of a folder; :func:`load_set_object` reads the
object of a folder or file into an :class:`~orbit_core.scene.ObjectSpec`, with its semantic label.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.files import load_articulation
from orbit_assets.options import ReadOptions, Repair, Unsupported
from orbit_assets.urdf import read_urdf
from orbit_assets.usd.writer import MeshBody, mesh_articulation
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import link_poses, validate
from orbit_core.scene import Articulation, Frame, Link, MeshCollision, ObjectSpec, Pose
from orbit_scenes.things import thing_table


class SetLayout(Enum):
    """Sets of objects, by the layout of an object's folder."""

    YCB = "ycb"
    """``003_cracker_box/google_16k/textured.obj``, or ``poisson`` or ``tsdf`` in the place of ``google_16k``."""
    SCANNED_OBJECTS = "gso"
    """Google Scanned Objects: ``Mug/meshes/model.obj`` beside ``Mug/model.sdf`` or ``Mug/metadata.pbtxt``."""
    OBJAVERSE = "objaverse"
    """``glbs/000-023/UID.glb``; annotations, where kept, in ``metadata/*.json`` above."""
    PARTNET_MOBILITY = "partnet"
    """``7119/mobility.urdf`` beside ``meta.json`` and ``semantics.txt``."""
    ROBOCASA = "robocasa"
    """``apple/apple_0/model.xml`` beside ``visual`` and ``collision``."""


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """Properties that a set does not state.

    ``height`` is needed for Objaverse, whose models have no unit.
    """

    mass: float | None = None
    """kg; None takes the set's own, a table's, or ``density``."""
    density: float = 400.0
    """kg/m^3, of the hull of what has no mass: hollow household things."""
    friction: float = 0.6
    """Coefficient of static and dynamic friction, in sets whose objects are single meshes."""
    height: float | None = None
    """Metres that the object is high; scales it."""
    collision: MeshCollision = MeshCollision.CONVEX_HULL
    """Shape that a mesh collides as, in sets whose objects are single meshes."""
    fixed_base: bool | None = None
    """None fixes PartNet-Mobility's furniture and leaves all else free."""


def set_layout(path: str | Path) -> tuple[SetLayout, Path]:
    """Return the set that a folder or file of an object is of, and the file to read.

    Raises:
        AssetError: it does not exist, or has the layout of no set; names those that are known.
    """
    path = Path(path)
    if not path.exists():
        raise AssetError(f"'{path}' does not exist: give the folder or file of an object of a set")
    # A file means its folder, but for Objaverse, which keeps many models in one.
    if path.is_file():
        if path.suffix.lower() == ".glb":
            return SetLayout.OBJAVERSE, path
        path = path.parent
    for layout, patterns in _FILES.items():
        for pattern in patterns:
            if found := sorted(path.glob(pattern)):
                return layout, found[0]
    known = "; ".join(f"{layout.value}: {patterns[0]}" for layout, patterns in _FILES.items())
    raise AssetError(f"'{path}' has the layout of no known set: give an object's folder that holds one of {known}")


_FILES: dict[SetLayout, tuple[str, ...]] = {
    SetLayout.PARTNET_MOBILITY: ("mobility.urdf",),
    SetLayout.ROBOCASA: ("model.xml",),
    SetLayout.SCANNED_OBJECTS: ("meshes/model.obj",),
    SetLayout.YCB: ("google_16k/textured.obj", "google_*k/textured.obj", "poisson/textured.obj", "tsdf/textured.obj"),
    SetLayout.OBJAVERSE: ("*.glb",),
}


def load_set_object(
    path: str | Path, name: str | None = None, options: ImportOptions = ImportOptions(), pose: Pose | None = None
) -> ObjectSpec:
    """Read an object of a set.

    Args:
        path: folder of the object, or its file.
        name: of the object in its scene; None takes the set's.
        options: what the set does not state.
        pose: at reset, in the environment's frame.

    Raises:
        AssetError: the path has the layout of no known set, a file of it cannot be read, or a size is missing.
    """
    layout, file = set_layout(path)
    own, label, articulation, fixed = _READERS[layout](file, options)
    # Labels of links, where a set has them, are finer than that of the whole.
    labelled = tuple(replace(link, semantic_label=link.semantic_label or label) for link in articulation.links)
    return ObjectSpec(
        name=name or own,
        articulation=replace(articulation, name=own, links=labelled),
        pose=pose or Pose(),
        fixed_base=fixed if options.fixed_base is None else options.fixed_base,
        semantic_label=label,
    )


_Read = tuple[str, str, Articulation, bool]


def _ycb(file: Path, options: ImportOptions) -> _Read:
    folder = file.parent.parent
    number, _, name = folder.name.partition("_")
    if not number[:3].isdigit() or not name:
        raise AssetError(f"'{folder}' is no object of YCB: its folder is named as 003_cracker_box is")
    entry = thing_table().get(name)
    # The paper weighed its objects: their masses are in the table of things.
    mass = options.mass if options.mass is not None else (entry.mass if entry and entry.source == "ycb" else None)
    return folder.name, name, _mesh(file, replace(options, mass=mass), "z"), False


def _scanned(file: Path, options: ImportOptions) -> _Read:
    folder = file.parent.parent
    label = folder.name.lower()
    metadata = folder / "metadata.pbtxt"
    if metadata.is_file():
        # A text of protocol buffers: the categories of the annotation, of which the first is the nearest.
        found = re.search(r'category:\s*"([^"]+)"', metadata.read_text(encoding="utf-8", errors="replace"))
        label = found[1].lower() if found else label
    return folder.name, label.replace(" ", "_"), _mesh(file, options, "z"), False


def _objaverse(file: Path, options: ImportOptions) -> _Read:
    if options.height is None:
        raise AssetError(
            f"'{file}' is a model of Objaverse, which has no unit: say how high it is, ImportOptions(height=...)"
        )
    return file.stem, _annotation(file) or file.stem, _mesh(file, options, "y"), False


def _annotation(file: Path) -> str:
    """Return the first category, else the name, that the annotations above a model give it; empty without."""
    for folder in file.parents[:3]:
        for path in sorted((folder / "metadata").glob("*.json")):
            entry = _json(path).get(file.stem)
            if isinstance(entry, dict):
                categories = entry.get("categories") or [{}]
                word = categories[0].get("name") if isinstance(categories[0], dict) else None
                return str(word or entry.get("name", "")).lower().replace(" ", "_")
    return ""


def _partnet(file: Path, options: ImportOptions) -> _Read:
    folder = file.parent
    # Read without a check first: the files give no masses.
    read = read_urdf(file, options=ReadOptions(unsupported=Unsupported.DROP))
    label = str(_json(folder / "meta.json").get("model_cat", "object")).lower()
    kinds = _semantics(folder / "semantics.txt")
    weighed = (_weighed(link, options.density) for link in read.links)
    links = tuple(replace(link, semantic_label=kinds.get(link.name, label)) for link in weighed)
    articulation = merge_fixed_links(validate(replace(read, links=links)))
    # Models are centred about their origin: the frame says where their underside is.
    floor = Frame("floor", articulation.root.name, Pose((0.0, 0.0, _lowest(articulation))))
    return f"partnet_{folder.name}", label, replace(articulation, frames=(*articulation.frames, floor)), True


def _semantics(path: Path) -> dict[str, str]:
    """Return the label of each link, by lines such as ``link_0 hinge rotation_door``."""
    if not path.is_file():
        return {}
    rows = (line.split() for line in path.read_text(encoding="utf-8", errors="replace").splitlines())
    return {row[0]: row[2] for row in rows if len(row) >= 3}


def _robocasa(file: Path, options: ImportOptions) -> _Read:
    folder = file.parent
    read = ReadOptions(unsupported=Unsupported.DROP, repair=Repair.BALANCE)
    articulation = load_articulation(file, options=read)
    label = re.sub(r"_\d+$", "", folder.name)
    if options.mass is not None:
        links = tuple(_with_mass(link, options.mass) for link in articulation.links)
        articulation = replace(articulation, links=links)
    return folder.name, label, articulation, bool(articulation.joints)


_READERS: dict[SetLayout, Callable[[Path, ImportOptions], _Read]] = {
    SetLayout.YCB: _ycb,
    SetLayout.SCANNED_OBJECTS: _scanned,
    SetLayout.OBJAVERSE: _objaverse,
    SetLayout.PARTNET_MOBILITY: _partnet,
    SetLayout.ROBOCASA: _robocasa,
}


def _mesh(file: Path, options: ImportOptions, up: str) -> Articulation:
    """Read a mesh as one rigid body, scaled to the height that the options give."""
    body = MeshBody(
        friction=options.friction,
        density=options.density if options.mass is None else None,
        mass=options.mass,
        collision=options.collision,
        up="y" if up == "y" else "z",
    )
    # Textures of a set are next to its meshes, or in a folder next to theirs.
    read = ReadOptions(allow_outside=(file.parent.parent,))
    made = mesh_articulation(file, body, options=read)
    if options.height is None:
        return made
    points = np.concatenate([np.asarray(shape.geometry.vertices) for shape in made.root.collisions])  # pyright: ignore[reportAttributeAccessIssue]
    return mesh_articulation(file, replace(body, scale=options.height / float(np.ptp(points[:, 2]))), options=read)


def _weighed(link: Link, density: float) -> Link:
    """Return a link with the mass of its hulls at a density, where the file gives none of note."""
    from orbit_assets.mass_properties import shapes_mass_properties

    if link.mass > 1e-6 or not link.collisions:
        return link
    solid = shapes_mass_properties(link.collisions, density)
    return replace(link, mass=solid.mass, center_of_mass=solid.center_of_mass, inertia=solid.inertia)


def _with_mass(link: Link, mass: float) -> Link:
    return link if link.mass <= 0.0 else replace(link, mass=mass, inertia=link.inertia * (mass / link.mass))


def _lowest(articulation: Articulation) -> float:
    """Return the height of the lowest point of the collision shapes in the root's frame, joints at zero."""
    from orbit_core.plugin_kit.meshes import triangles

    poses = link_poses(articulation, {})
    heights = [
        (poses[link.name] @ shape.pose).transform(triangles(shape.geometry).vertices)[:, 2].min()
        for link in articulation.links
        for shape in link.collisions
    ]
    return float(min(heights, default=0.0))


def _json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise AssetError(f"'{path}' is not JSON: {error}") from None
    return values if isinstance(values, dict) else {}
