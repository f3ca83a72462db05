"""Reader of MJCF files, with the format's own parser and compiler.

Everything is taken from the compiled model, in which defaults, units, nested frames and inertias are settled.

* A body with several joints becomes a chain of links, one a joint; those in between have no mass. A ball is three.
* A geom collides if its ``contype`` or ``conaffinity`` is set, and is drawn if its group is 0, 1 or 2.
* Masks say which links may collide: ``self_collisions`` and exclusions follow from them.
* Friction acts in the directions that ``condim`` opens.
* Sites become frames. Planes and height fields that do not move are terrain, and terrain is the scene's.
* Constraints on joints and fixed tendons become mimic joints, ``connect`` and ``weld`` loops.
* Materials become finishes, with their textures.
* Actuators become drives, and the keyframe becomes the home pose; a specification takes them over on request.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.mass_properties import repaired
from orbit_assets.mjcf.couplings import OWN_SITES, Couplings, Loops
from orbit_assets.mjcf.joints import Actuators, body_chain, check_root
from orbit_assets.mjcf.model import Compiled, compile_file, pose_of, vector_of
from orbit_assets.mjcf.surfaces import Surfaces
from orbit_assets.mjcf.trees import WORLD, Tree, Trees
from orbit_assets.options import ReadOptions
from orbit_assets.placed import PlacedArticulation
from orbit_assets.source_text import names_file
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Color,
    Cylinder,
    Frame,
    Geometry,
    HeightField,
    Joint,
    Link,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.pose import Vector3

# Geoms of a compiled MJCF model as shapes, and its masks and exclusions as pairs that do not collide ------------------

# A geom of this colour shows its material's.
_UNPAINTED: Color = (0.5, 0.5, 0.5, 1.0)
# MuJoCo's viewer draws geoms of the groups below this one, by default.
_DRAWN_GROUPS = 3


class Geoms:
    """Geoms of one tree of a model; ``terrain`` takes over planes and height fields that do not move.

    Raises:
        AssetError: a height field moves, and the options have what cannot be held refused.
    """

    def __init__(self, compiled: Compiled, tree: Tree, *, terrain: bool = False) -> None:
        self.compiled = compiled
        """Compiled model."""
        self.tree = tree
        """Tree whose geoms they are."""
        self._meshes: dict[tuple[int, MeshCollision], Mesh] = {}
        self._surfaces = Surfaces(compiled)
        model, kinds = compiled.model, compiled.mujoco.mjtGeom
        endless = np.isin(model.geom_type, (int(kinds.mjGEOM_PLANE), int(kinds.mjGEOM_HFIELD)))
        ours = np.isin(model.geom_bodyid, tree.bodies) & endless
        moves = ours & ((model.body_weldid[model.geom_bodyid] != 0) | tree.floating)
        for geom in np.flatnonzero(moves):
            compiled.unsupported(f"{self.called(int(geom))} is a height field that moves", "make it a mesh")
        still = ours & ~moves
        if still.any() and not terrain:
            compiled.notes.append(f"planes and height fields, which are the scene's, are left out: {still.sum()}")
        self._left = moves if terrain else endless

    def of_body(self, body: int) -> Iterator[int]:
        """Yield the body's geoms that are taken over."""
        model = self.compiled.model
        if body == 0 and not self.tree.world_geoms:
            return
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            if not self._left[geom]:
                yield geom

    def shapes(self, body: int) -> tuple[tuple[Shape, ...], tuple[Shape, ...]]:
        """Return the shapes that collide, and the shapes that are drawn."""
        model = self.compiled.model
        collisions: list[Shape] = []
        visuals: list[Shape] = []
        for geom in self.of_body(body):
            shape = self._shape(geom)
            drawn = self._surfaces.drawn(geom, shape)
            if model.geom_contype[geom] or model.geom_conaffinity[geom]:
                # A geometry that has coordinates on a picture is for the eye only.
                collisions.append(drawn if drawn.geometry is shape.geometry else shape)
            if model.geom_group[geom] < _DRAWN_GROUPS and shape.color[3] > 0:
                visuals.append(drawn)
        return tuple(collisions), tuple(visuals)

    def called(self, geom: int) -> str:
        """Return the name of the geom for messages."""
        body = self.compiled.body_names[int(self.compiled.model.geom_bodyid[geom])]
        return f"geom '{self.compiled.geom_names[geom] or geom}' of body '{body}'"

    def _shape(self, geom: int) -> Shape:
        """Return a geom with its pose in the body, material and colour."""
        model = self.compiled.model
        sliding, torsional, rolling = model.geom_friction[geom].tolist()
        dimensions = int(model.geom_condim[geom])
        # condim 1 has no friction, 3 adds sliding, 4 torsional and 6 rolling friction.
        sliding = sliding if dimensions >= 3 else 0.0
        material = PhysicsMaterial(
            static_friction=sliding,
            dynamic_friction=sliding,
            torsional_friction=torsional if dimensions >= 4 else 0.0,
            rolling_friction=rolling if dimensions >= 6 else 0.0,
        )
        pose = pose_of(model.geom_pos[geom], model.geom_quat[geom])
        return Shape(self._geometry(geom), pose, material, self._color(geom), self.compiled.geom_names[geom])

    def _geometry(self, geom: int) -> Geometry:
        model, kinds = self.compiled.model, self.compiled.mujoco.mjtGeom
        x, y, z = size = vector_of(model.geom_size[geom])
        match kinds(model.geom_type[geom]):
            case kinds.mjGEOM_BOX:
                return Box(size)
            case kinds.mjGEOM_SPHERE:
                return Sphere(x)
            case kinds.mjGEOM_CAPSULE:
                return Capsule(x, y)
            case kinds.mjGEOM_CYLINDER:
                return Cylinder(x, y)
            case kinds.mjGEOM_ELLIPSOID:
                return self._ellipsoid((x, y, z), geom)
            case kinds.mjGEOM_MESH:
                return self._mesh(int(model.geom_dataid[geom]), MeshCollision.CONVEX_HULL)
            case kinds.mjGEOM_SDF:
                self.compiled.notes.append(f"{self.called(geom)}, a signed distance field, is the mesh of its surface")
                return self._mesh(int(model.geom_dataid[geom]), MeshCollision.TRIANGLES)
            case kinds.mjGEOM_PLANE:
                return Plane()
            case kinds.mjGEOM_HFIELD:
                return self._height_field(int(model.geom_dataid[geom]))
            case kind:
                raise AssetError(f"{self.compiled.path}: {self.called(geom)} is of {kind.name}: make it a mesh")

    def _ellipsoid(self, radii: Vector3, geom: int) -> Mesh:
        from trimesh.creation import icosphere

        self.compiled.notes.append(f"{self.called(geom)}, an ellipsoid, is a mesh of 320 triangles")
        # 320 triangles: within 1 % of the ellipsoid, and few enough to collide as a hull.
        ball = icosphere(subdivisions=2)
        return Mesh(np.asarray(ball.vertices) * radii, np.asarray(ball.faces))

    def _mesh(self, mesh: int, collision: MeshCollision) -> Mesh:
        """Return one object however many geoms show it, so that engines store the mesh once."""
        if (mesh, collision) not in self._meshes:
            model = self.compiled.model
            first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
            face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
            vertices = model.mesh_vert[first : first + count].copy()
            self._meshes[mesh, collision] = Mesh(vertices, model.mesh_face[face : face + faces].copy(), collision)
        return self._meshes[mesh, collision]

    def _height_field(self, field: int) -> HeightField:
        model = self.compiled.model
        rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
        first = int(model.hfield_adr[field])
        x, y, top, _ = model.hfield_size[field].tolist()
        # Heights of a compiled field are normalised to [0, 1]; the fourth size is the base's thickness.
        heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns) * top
        return HeightField(heights.astype(np.float64), (2 * x, 2 * y))

    def _color(self, geom: int) -> Color:
        model = self.compiled.model
        rgba = model.geom_rgba[geom]
        # MuJoCo takes the material's colour where the geom has its default one.
        if model.geom_matid[geom] >= 0 and np.allclose(rgba, _UNPAINTED):
            rgba = model.mat_rgba[model.geom_matid[geom]]
        red, green, blue, alpha = rgba.tolist()
        return (red, green, blue, alpha)


def self_collisions(compiled: Compiled, geoms: Geoms, tree: Tree) -> tuple[bool, tuple[tuple[str, str], ...]]:
    """Return whether any two links may collide, and the pairs that never do although others may."""
    model = compiled.model
    types = np.zeros(model.nbody, np.int64)
    affinities = np.zeros(model.nbody, np.int64)
    for body in tree.bodies:
        for geom in geoms.of_body(body):
            types[body] |= int(model.geom_contype[geom])
            affinities[body] |= int(model.geom_conaffinity[geom])
    bodies = np.asarray(tree.bodies)
    solid = np.sort(bodies[(types[bodies] | affinities[bodies]) != 0])
    parent, weld = np.asarray(model.body_parentid), np.asarray(model.body_weldid)
    hangs_on = weld[parent[weld]]
    excluded = _excluded(model)
    may = False
    apart: list[tuple[str, str]] = []
    unfiltered: list[tuple[str, str]] = []
    # A row of all later bodies at a time: the number of pairs grows with the square, and only NumPy is fast enough.
    for position, first in enumerate(solid[:-1]):
        later = solid[position + 1 :]
        meet = (types[first] & affinities[later]) | (types[later] & affinities[first])
        one, others = weld[first], weld[later]
        joined = (
            (one == others) | ((one != 0) & (one == hangs_on[later])) | ((others != 0) & (others == hangs_on[first]))
        )
        free = (meet != 0) & ~joined & ~np.isin(later, list(excluded.get(int(first), ())))
        neighbours = parent[later] == first
        # The engine filters no pair with a body that is fixed to the world, where a joint moves the other.
        unfiltered += [(compiled.body_names[first], compiled.body_names[body]) for body in later[free & neighbours]]
        free, later = free[~neighbours], later[~neighbours]
        may = may or bool(free.any())
        apart += [(compiled.body_names[first], compiled.body_names[body]) for body in later[~free]]
    if unfiltered:
        pairs = ", ".join(f"{one} with {other}" for one, other in unfiltered)
        compiled.notes.append(f"bodies fixed to the world do not collide with those that they carry by joints: {pairs}")
    return (True, tuple(apart)) if may else (False, ())


def _excluded(model: Any) -> dict[int, set[int]]:
    """Return for each body the bodies that an ``<exclude>`` names with it."""
    found: dict[int, set[int]] = {}
    for mark in model.exclude_signature.tolist():
        # The two bodies' numbers, 16 bits each.
        for one, other in ((mark >> 16, mark & 0xFFFF), (mark & 0xFFFF, mark >> 16)):
            found.setdefault(one, set()).add(other)
    return found


# MuJoCo's defaults for a contact or a limit.
_SOLREF, _SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
_GRAVITY = (0.0, 0.0, -9.81)


def meet_leftovers(compiled: Compiled, tree: Tree) -> None:
    """Note settings that belong to the scene or the engine, and reject or note what changes how the bodies move.

    Raises:
        AssetError: the options have what the description cannot hold refused.
    """
    _meet_bodies(compiled, tree)
    _note_contact(compiled, tree)
    _note_surroundings(compiled)
    model = compiled.model
    counts = {
        "tendons": model.ntendon,
        "contact pairs": model.npair,
        "sensors": model.nsensor,
        "cameras": model.ncam,
        "skins": model.nskin,
        "textures of other than colour": Surfaces(compiled).unread,
        "joints whose springs and limits are soft (solref, solimp or margin)": _soft_joints(model),
        # Every part of the file that is not read is counted, so that nothing is lost in silence.
    }
    compiled.notes += [f"{what} are left out: {count}" for what, count in counts.items() if count]


def _meet_bodies(compiled: Compiled, tree: Tree) -> None:
    model, bodies = compiled.model, list(tree.bodies)
    if model.nflex:
        compiled.unsupported(f"there are {model.nflex} flexes, which are deformable", "remove them")
    floating = [body for body in bodies if model.body_gravcomp[body]]
    if floating:
        compiled.unsupported(f"gravity is compensated on bodies {compiled.listed(floating)}", "remove gravcomp")
    if plugged := [body for body in bodies if model.body_plugin[body] >= 0]:
        compiled.unsupported(f"a plugin of MuJoCo acts on bodies {compiled.listed(plugged)}", "remove the plugin")


def _note_contact(compiled: Compiled, tree: Tree) -> None:
    model = compiled.model
    ours = np.isin(model.geom_bodyid, tree.bodies)
    # Contact settings of geoms that never collide have no effect and are not reported.
    solid = ours & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    of = {
        "solref or solimp": _unlike(model.geom_solref, _SOLREF) | _unlike(model.geom_solimp, _SOLIMP),
        "a margin or gap": (model.geom_margin != 0) | (model.geom_gap != 0),
        "a priority or solmix": (model.geom_priority != 0) | (model.geom_solmix != 1),
    }
    for what, rows in of.items():
        if count := int(np.sum(rows & solid)):
            compiled.notes.append(f"{what} of geoms is left out: {count}")


def _note_surroundings(compiled: Compiled) -> None:
    """Note options of the world, which the scene sets."""
    option = compiled.model.opt
    said = {
        "gravity": not np.allclose(option.gravity, _GRAVITY, atol=0.01),
        "the medium's density, viscosity or wind": bool(option.density or option.viscosity or np.any(option.wind)),
        "overridden contact": bool(option.enableflags & int(compiled.mujoco.mjtEnableBit.mjENBL_OVERRIDE)),
        "what the file disables": bool(option.disableflags),
    }
    if left := [what for what, is_said in said.items() if is_said]:
        compiled.notes.append(f"options that are the scene's to say are left out: {', '.join(left)}")


def _soft_joints(model: Any) -> int:
    soft = _unlike(model.jnt_solref, _SOLREF) | _unlike(model.jnt_solimp, _SOLIMP) | (model.jnt_margin != 0)
    return int(np.sum(soft & (model.jnt_limited != 0)))


def _unlike(rows: Any, default: tuple[float, ...]) -> np.ndarray:
    return ~np.all(np.isclose(rows, default), axis=1)


@names_file
def read_mjcf(path: Path | str, *, options: ReadOptions = ReadOptions()) -> Articulation:
    """Read the one articulation in an MJCF file, or the one that the options name.

    Its root is the one body that floats freely or stands fixed in the world; where several bodies hang from the world,
    or one by a joint, the root is a link ``world`` without mass, for a fixed base. ``options.articulation`` names a
    body right below the world, or ``"world"`` for all that does not float.

    Raises:
        AssetError: the file does not compile, holds several articulations of which none is named, or something that the
            description cannot hold and the options do not have left out, or MuJoCo, whose format it is, is not
            installed.
    """
    compiled = compile_file(Path(path), options)
    tree = Trees(compiled).one()
    return _read_tree(compiled, tree, compiled.name, terrain=False)


@names_file
def read_mjcf_all(path: Path | str, *, options: ReadOptions = ReadOptions()) -> tuple[PlacedArticulation, ...]:
    """Read all articulations in an MJCF file: each body right below the world with its tree, and the world's shapes.

    Bodies that hang from the world and that a constraint connects are one articulation, rooted in a link ``world``. The
    shapes of the world, ground included, are an articulation ``world`` of one link. Each is named by its root.

    Raises:
        AssetError: as :func:`read_mjcf`, but for the number of articulations.
    """
    compiled = compile_file(Path(path), options)
    placed: list[PlacedArticulation] = []
    for tree in Trees(compiled).every():
        # Each articulation gets its own notes; those of the file as a whole are in all of them.
        own = replace(compiled, notes=list(compiled.notes))
        articulation = _read_tree(own, tree, own.body_names[_namesake(tree)], terrain=True)
        placed.append(PlacedArticulation(articulation, _placed(compiled, tree), not tree.floating))
    return tuple(placed)


def _namesake(tree: Tree) -> int:
    """Return the body that names the articulation: its root, or the top body that hangs from the world."""
    return tree.bodies[1] if tree.root == 0 and len(tree.bodies) > 1 and not tree.world_geoms else tree.root


def _placed(compiled: Compiled, tree: Tree) -> Pose:
    """Return the root's pose in the world, at home."""
    if not tree.floating:
        return compiled.body_pose(tree.root) if tree.root else Pose()
    values = Actuators(compiled).home_values()
    # A free joint has a position and a quaternion: seven coordinates.
    first = int(compiled.model.jnt_qposadr[compiled.joints_of(tree.root)[0]])
    return pose_of(values[first : first + 3], values[first + 3 : first + 7])


def _read_tree(compiled: Compiled, tree: Tree, name: str, *, terrain: bool) -> Articulation:
    if tree.floating:
        check_root(compiled, tree.root)
    geoms = Geoms(compiled, tree, terrain=terrain)
    actuators = Actuators(compiled)
    couplings = Couplings(compiled, tree)
    limits = actuators.effort_limits()
    numbers = {own: number for number, own in enumerate(compiled.joint_names)}
    links: list[Link] = []
    joints: list[Joint] = []
    for body in tree.bodies:
        between, chain = body_chain(compiled, body, limits) if body != tree.root else ([], [])
        links += [*between, _link(compiled, geoms, body)]
        joints += [couplings.applied(each, numbers.get(each.name, -1)) for each in chain]
    # Last, for the calls above note what they leave out themselves.
    meet_leftovers(compiled, tree)
    moving = {joint.name for joint in joints if joint.movable}
    bodies = set(tree.bodies)
    may_collide, apart = self_collisions(compiled, geoms, tree)
    articulation = Articulation(
        name,
        tuple(links),
        tuple(joints),
        _frames(compiled, bodies),
        may_collide,
        apart,
        loops=Loops(compiled, tree).read(),
        drives=tuple(drive for drive in actuators.drives(bodies) if drive.joint in moving),
        home=tuple((joint, position) for joint, position in actuators.home(bodies) if joint in moving),
        notes=tuple(dict.fromkeys(compiled.notes)),
    )
    return repaired(articulation, compiled.options)


def _link(compiled: Compiled, geoms: Geoms, body: int) -> Link:
    model = compiled.model
    collisions, visuals = geoms.shapes(body)
    # body_inertia is diagonal in the frame body_iquat.
    axes = pose_of((0.0, 0.0, 0.0), model.body_iquat[body]).rotation_matrix()
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    name = compiled.body_names[body] if body else WORLD
    return Link(name, float(model.body_mass[body]), vector_of(model.body_ipos[body]), inertia, collisions, visuals)


def _frames(compiled: Compiled, bodies: set[int]) -> tuple[Frame, ...]:
    """Return the sites as frames, without those that are only a constraint's ends."""
    model = compiled.model
    ends = {f"{name}{end}" for name in compiled.names_of("EQUALITY") if name for end in OWN_SITES}
    return tuple(
        Frame(
            name,
            compiled.body_names[int(model.site_bodyid[site])],
            pose_of(model.site_pos[site], model.site_quat[site]),
        )
        for site, name in enumerate(compiled.site_names)
        if int(model.site_bodyid[site]) in bodies and name not in ends
    )
