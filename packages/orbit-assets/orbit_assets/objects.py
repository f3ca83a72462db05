"""Objects of a scene: solids, a table, a cabinet with a drawer and a door, towers of blocks, an ice hockey net.

:func:`box_between` and :func:`solid_part` build furniture from boxes that are given by two corners.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np

from orbit_assets.mass_properties import MassProperties, mass_properties, shapes_mass_properties
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.scene_data import check_data
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Color,
    Cylinder,
    Frame,
    Geometry,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    MagneticSeal,
    Mesh,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    RobotSpec,
    Shape,
    Sphere,
)
from orbit_core.scene.pose import Vector3

if TYPE_CHECKING:
    from torch import Tensor


def box_between(name: str, low: Vector3, high: Vector3, color: Color, surface: PhysicsMaterial) -> Shape:
    """Build a box between two corners, in metres."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    middle = ((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2)
    return Shape(Box(((x1 - x0) / 2, (y1 - y0) / 2, (z1 - z0) / 2)), Pose(middle), surface, color, name)


def solid_part(
    name: str, shapes: tuple[Shape, ...], density: float, label: str, origin: Vector3 = (0.0, 0.0, 0.0)
) -> Link:
    """Build a solid link of shapes of one density.

    Args:
        name: of the link.
        shapes: in the frame of the whole piece of furniture.
        density: kg/m^3.
        label: semantic label.
        origin: of the link's own frame, in the frame of the whole piece.
    """
    inward = Pose(origin).inverse()
    own = tuple(Shape(shape.geometry, inward @ shape.pose, shape.material, shape.color, shape.name) for shape in shapes)
    body = shapes_mass_properties(own, density)
    return Link(name, body.mass, body.center_of_mass, body.inertia, own, own, label)


DENSITY = 500.0
"""kg/m^3, of an object whose mass is not given: that of soft wood."""
GRAY: Color = (0.7, 0.7, 0.7, 1.0)
WOOD: Color = (0.72, 0.55, 0.38, 1.0)
BENCH_HEIGHT = 0.7
"""Metres from the floor to the top of the work bench, which is at z = 0."""


class SolidOptions(TypedDict, total=False):
    """Options of every solid other than its shape."""

    mass: float
    """kg; overrides ``density``."""
    density: float
    """kg/m^3; :data:`DENSITY` where it is left out."""
    color: Color
    """RGBA in [0, 1]."""
    material: PhysicsMaterial
    """Friction, restitution and compliance."""
    pose: Pose
    """Pose of the object at reset, in the environment's frame."""
    fixed_base: bool
    """True for a thing that does not move."""
    label: str
    """Semantic label; the object's name where it is left out."""


def box(name: str, size: Vector3, **options: Unpack[SolidOptions]) -> ObjectSpec:
    """Build a solid box of full ``size`` in metres, its frame at the middle."""
    return _solid(name, Box(_halves(name, size)), options)


def sphere(name: str, radius: float, **options: Unpack[SolidOptions]) -> ObjectSpec:
    """Build a solid ball, its frame at the middle."""
    return _solid(name, Sphere(radius), options)


def cylinder(name: str, radius: float, length: float, **options: Unpack[SolidOptions]) -> ObjectSpec:
    """Build a solid cylinder along z of full ``length``, its frame at the middle."""
    return _solid(name, Cylinder(radius, _half(name, length)), options)


def capsule(name: str, radius: float, length: float, **options: Unpack[SolidOptions]) -> ObjectSpec:
    """Build a solid capsule along z, its frame at the middle; ``length`` excludes the round caps."""
    return _solid(name, Capsule(radius, _half(name, length)), options)


def keyed_block(
    name: str,
    edge: float = 0.06,
    *,
    mass: float = 0.08,
    color: Color = GRAY,
    key_color: Color = (0.75, 0.15, 0.1, 1.0),
    pose: Pose | None = None,
) -> ObjectSpec:
    """Build a cube with a ridge along one edge of its top, so that all its orientations look different.

    The frame is the middle of the cube, z through the face with the ridge. The ridge is 0.3 of ``edge`` wide and 0.2
    high, is at the edge of the face towards +x, and ends 0.4 of ``edge`` before its corner towards -y. Both are of one
    density.

    Raises:
        AssetError: a length or a mass that is not above zero.
    """
    half, wide, high = _half(name, edge), 0.15 * edge, 0.1 * edge
    ridge = Box((wide, 0.3 * edge, high))
    middle = Pose((half - wide, half - 0.3 * edge, half + high))
    shapes = (
        Shape(Box((half, half, half)), color=color, name="cube"),
        Shape(ridge, middle, color=key_color, name="key"),
    )
    # The ridge adds 0.3 x 0.6 x 0.2 of the cube's volume.
    body = shapes_mass_properties(shapes, _positive(name, mass, "mass") / (edge**3 * (1.0 + 0.3 * 0.6 * 0.2)))
    return _object(name, shapes, body, pose, False, "")


def mesh_object(name: str, mesh: Mesh | str | Path, scale: float = 1.0, **options: Unpack[SolidOptions]) -> ObjectSpec:
    """Build a solid with the surface of a mesh or mesh file, in the mesh's own frame.

    ``scale`` takes a file's unit to metres; a :class:`Mesh` is in metres already and is not scaled.

    Raises:
        AssetError: the file cannot be read, or the mesh encloses no volume.
    """
    if not isinstance(mesh, Mesh):
        # Late: trimesh takes half a second to import, and most objects need none.
        from orbit_assets.meshes import load_mesh

        return _solid(name, load_mesh(Path(mesh), (scale, scale, scale)), options)
    return _solid(name, mesh, options)


def table(
    name: str = "table",
    size: Vector3 = (0.8, 1.2, 0.7),
    *,
    color: Color = WOOD,
    material: PhysicsMaterial | None = None,
    pose: Pose | None = None,
    label: str = "table",
) -> ObjectSpec:
    """Build a static table whose frame is in the middle of the TOP surface: objects at z = 0 of it stand on the table.

    ``size`` is depth (x), width (y) and height in metres; the legs reach down to ``z = -height``. With ``pose`` at
    height ``size[2]`` the table stands on the ground z = 0.
    """
    half = _halves(name, size)
    thickness, leg = min(0.04, half[2]), 0.06
    surface = material or PhysicsMaterial()
    parts = [Shape(Box((half[0], half[1], thickness / 2)), Pose((0.0, 0.0, -thickness / 2)), surface, color, "top")]
    length = size[2] - thickness
    for index, (x, y) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        center = (x * (size[0] - leg) / 2, y * (size[1] - leg) / 2, -thickness - length / 2)
        parts.append(Shape(Box((leg / 2, leg / 2, length / 2)), Pose(center), surface, color, f"leg_{index}"))
    shapes = tuple(parts)
    return _object(name, shapes, shapes_mass_properties(shapes, DENSITY), pose, True, label)


def cabinet(name: str = "cabinet", *, pose: Pose | None = None) -> ObjectSpec:
    """Build a cabinet on the floor, 0.5 m wide and deep and 0.62 m high, with a drawer above and a door below.

    Its frame is on the floor in the middle of its footprint, and its front faces -x: the default ``pose`` stands it
    before a robot at the origin that looks along +x, with the drawer's handle at x = 0.635, z = 0.49.

    * ``drawer_joint`` (prismatic, 0 to 0.4 m) opens the drawer towards -x.
    * ``door_joint`` (revolute, 0 to 1.57 rad) opens the door, hinged at +y, towards -x.
    * Frames ``drawer_handle`` and ``door_handle`` lie in the middle of the handle's bar, with z into the cabinet
      (the approach of a gripper that grasps it) and y across the bar (the opening direction of its fingers).

    Raises:
        AssetError: the cache has no copy of it and the extra ``usd`` is not installed.
    """
    return ObjectSpec(
        name=name,
        articulation=_own_asset("cabinet.usda"),
        pose=pose or Pose((0.93, 0.0, 0.0)),
        fixed_base=True,
        semantic_label="cabinet",
    )


def dishwasher(name: str = "dishwasher", *, seal: float = 25.0, pose: Pose | None = None) -> ObjectSpec:
    """Build a small dishwasher on a table, 0.44 m wide, 0.4 m deep and 0.36 m high, with a door in front of a rack.

    Its frame is on the table in the middle of its footprint, and its front faces -x: the default ``pose`` stands it
    before a robot at the origin that looks along +x.

    * ``door_joint`` (revolute, 0 to 1.5 rad) opens the door, hinged at its bottom, towards -x. A magnetic seal named
      ``seal`` holds it shut with ``seal`` newtons at its upper edge, 0.22 m above the hinge
      (:class:`~orbit_core.scene.MagneticSeal`); once it is ajar its weight opens it.
    * ``rack_joint`` (prismatic, 0 to 0.22 m) brings the rack out towards -x, over the open door; the shut one holds it
      back.
    * Frames ``door_bar`` and ``rack_bar`` lie in the middles of two round bars along y, axes as the dishwasher's where
      it is shut. A hand that points down reaches behind either from above.

    Raises:
        AssetError: the cache has no copy of it and the extra ``usd`` is not installed.
    """
    # The force falls to 1/e within 3 mm, as of a fridge's magnetic strip.
    latch = MagneticSeal(name="seal", joint="door_joint", force=seal, decay=0.003, arm=0.22)
    return ObjectSpec(
        name=name,
        articulation=_own_asset("dishwasher.usda"),
        pose=pose or Pose((0.82, 0.0, 0.0)),
        fixed_base=True,
        semantic_label="dishwasher",
        active=(latch,),
    )


def _own_asset(file_name: str) -> Articulation:
    """Read an articulation of ORBIT's own USD files, from the cache unless the file or its readers changed."""
    from orbit_assets.cache import Model, cached_articulation
    from orbit_assets.files import asset_file
    from orbit_assets.usd import read_usd

    path = asset_file(file_name)
    # The digest is in the name: the cache's fingerprint covers code and packages, but no files of ours.
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    packages = ("usd-core", "newton-usd-schemas")
    return cached_articulation(Model(f"{path.stem}-{digest}", lambda: read_usd(path), packages, "BSD-3-Clause"))


def _solid(name: str, geometry: Geometry, options: SolidOptions) -> ObjectSpec:
    check_data(geometry, f"'{name}'")
    mass = options.get("mass")
    density = options.get("density", DENSITY) if mass is None else None
    _positive(name, density if mass is None else mass, "density" if mass is None else "mass")
    shape = Shape(
        geometry, material=options.get("material", PhysicsMaterial()), color=options.get("color", GRAY), name=name
    )
    return _object(
        name,
        (shape,),
        mass_properties(geometry, mass=mass, density=density),
        options.get("pose"),
        options.get("fixed_base", False),
        options.get("label", ""),
    )


def _halves(name: str, size: Vector3) -> Vector3:
    if not isinstance(size, Sequence | np.ndarray) or len(size) != 3:
        raise AssetError(f"the size of '{name}' is {size!r}: give three lengths in metres")
    return (_half(name, size[0]), _half(name, size[1]), _half(name, size[2]))


def solid_link(name: str, shapes: Sequence[Shape], density: float) -> Link:
    """Build a link that is drawn and collides as shapes of one density (kg/m^3). Overlaps count twice."""
    body = shapes_mass_properties(shapes, density)
    return Link(name, body.mass, body.center_of_mass, body.inertia, tuple(shapes), tuple(shapes))


def _half(name: str, length: float) -> float:
    return _positive(name, length, "length") / 2


def _positive(name: str, value: object, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 < float(value) < math.inf:
        raise AssetError(f"a {what} of '{name}' is {value!r}: give a number above zero")
    return float(value)


def _object(
    name: str, shapes: tuple[Shape, ...], properties: MassProperties, pose: Pose | None, fixed_base: bool, label: str
) -> ObjectSpec:
    link = Link(name, properties.mass, properties.center_of_mass, properties.inertia, shapes, shapes)
    return ObjectSpec(
        name=name,
        articulation=Articulation(name, (link,)),
        pose=pose or Pose(),
        fixed_base=fixed_base,
        semantic_label=label,
    )


def work_bench() -> ObjectSpec:
    """Build a table that carries an arm at the origin and 0.95 m of top in front of it; its top is at z = 0."""
    return table("table", size=(1.25, 1.4, BENCH_HEIGHT), pose=Pose((0.325, 0.0, 0.0)))


BLOCK_SIZE: Vector3 = (0.12, 0.0395, 0.024)
"""Metres: length, width and height of a block; every gripper of the catalogue opens wider than its width."""
BLOCK_PITCH = 0.04
"""Metres between the middles of two blocks of a layer."""


def cell_poses(foot: Tensor, cells: Tensor, layers: int) -> Tensor:
    """Compute poses (n, k, 7) of blocks in cells of towers.

    Args:
        foot: (n, 7) the middle of the towers' undersides. A block on top of the highest layer would lie along its x.
        cells: (n, k) int64, numbered from the lowest layer, three a layer, along the layer's pitch.
        layers: of the whole tower.
    """
    import torch  # here, because kinds of objects are listed without it

    from orbit_core.dynamics.transforms import quat_from_rotation_vector, quat_multiply, quat_rotate

    layer, slot = cells // 3, cells % 3
    # Layers alternate, counted from the top: a block on top of the highest is along x for every number of layers.
    crossing = ((layer - layers) % 2).to(foot.dtype)
    aside = (slot - 1) * BLOCK_PITCH
    local = torch.stack((crossing * aside, (1.0 - crossing) * aside, BLOCK_SIZE[2] * (layer + 0.5)), dim=-1)
    turn = torch.zeros_like(local)
    # Blocks of every second layer are turned by a quarter.
    turn[..., 2] = 0.5 * math.pi * crossing
    standing = foot[:, None].expand(*cells.shape, 7)
    position = standing[..., :3] + quat_rotate(standing[..., 3:], local)
    return torch.cat((position, quat_multiply(standing[..., 3:], quat_from_rotation_vector(turn))), dim=-1)


def tower(foot: Vector3, layers: int) -> list[Pose]:
    """Return the poses of all blocks of a tower, from the lowest layer up; ``foot`` is the middle of its underside."""
    import torch

    cells = torch.arange(3 * layers)[None]
    poses = cell_poses(torch.tensor([[*foot, 1.0, 0.0, 0.0, 0.0]]), cells, layers)[0].tolist()
    return [Pose((x, y, z), (qw, qx, qy, qz)) for x, y, z, qw, qx, qy, qz in poses]


STICK_LENGTH, NET_WIDTH, NET_DEPTH, NET_BOARD = 0.14, 0.2, 0.12, 0.01
"""Metres: from the hand to the blade's middle; between the net's posts; from its line to its back; its boards."""
BLADE_HALF: Vector3 = (0.006, 0.05, 0.02)
"""Metres, half of the blade's sides."""
HOCKEY_RED: Color = (0.75, 0.1, 0.1, 1.0)
HOCKEY_WHITE: Color = (0.9, 0.93, 0.97, 1.0)
BLADE_SURFACE = PhysicsMaterial(0.3, 0.3)


def stick() -> Articulation:
    """Build a stick that hangs from its root along z; its frame ``blade`` is in the middle of its blade."""
    shaft = Shape(
        Cylinder(0.006, 0.5 * STICK_LENGTH), Pose((0.0, 0.0, 0.5 * STICK_LENGTH)), BLADE_SURFACE, WOOD, "shaft"
    )
    blade = Shape(Box(BLADE_HALF), Pose((0.0, 0.0, STICK_LENGTH)), BLADE_SURFACE, HOCKEY_RED, "blade")
    tip = Frame("blade", "stick", Pose((0.0, 0.0, STICK_LENGTH)))
    return Articulation("stick", (solid_link("stick", (shaft, blade), 600.0),), frames=(tip,))


def net(pose: Pose) -> RobotSpec:
    """Return a net of boards on a rail across the ice, along y, with a drive; its frame is in the middle of its line,
    on the ice.
    """
    half, up = 0.5 * NET_WIDTH + NET_BOARD, 0.03
    parts = {
        # Boards end 2 mm above the ice, on which the net would otherwise rub.
        "left": (
            (0.5 * NET_DEPTH, half - 0.5 * NET_BOARD, up),
            (0.5 * NET_DEPTH, 0.5 * NET_BOARD, up - 0.002),
            HOCKEY_RED,
        ),
        "right": (
            (0.5 * NET_DEPTH, 0.5 * NET_BOARD - half, up),
            (0.5 * NET_DEPTH, 0.5 * NET_BOARD, up - 0.002),
            HOCKEY_RED,
        ),
        "back": ((NET_DEPTH + 0.5 * NET_BOARD, 0.0, up), (0.5 * NET_BOARD, half, up - 0.002), HOCKEY_WHITE),
    }
    boards = tuple(Shape(Box(size), Pose(at), BLADE_SURFACE, color, name) for name, (at, size, color) in parts.items())
    # The net moves sideways, so that a task can drive it as a goalkeeper.
    rail = Joint("rail", JointType.PRISMATIC, "mount", "net", axis=(0.0, 1.0, 0.0), lower_limit=-0.3, upper_limit=0.3)
    return RobotSpec(
        name="net",
        articulation=Articulation("net", (Link("mount"), solid_link("net", boards, 1000.0)), (rail,)),
        pose=pose,
        fixed_base=True,
        actuators=(ImplicitPd(joints=("rail",), stiffness=2000.0, damping=60.0),),
        gravity_compensation=True,
    )
