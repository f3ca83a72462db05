"""Reader of MJCF files, with the format's own parser and compiler.

Everything is taken from the compiled model, in which defaults, units, nested frames and inertias are settled.

* A body with several joints becomes a chain of links, one a joint; those in between have no mass. A ball is three.
* A geom collides if its ``contype`` or ``conaffinity`` is set, and is drawn if its group is 0, 1 or 2.
* Masks say which links may collide: ``self_collisions`` and exclusions follow from them.
* Friction acts in the directions that ``condim`` opens.
* Sites become frames. Planes and height fields that do not move are terrain, and terrain is the scene's.
* Constraints on joints and fixed tendons become mimic joints, ``connect`` and ``weld`` loops.
* Actuators become drives, and the keyframe becomes the home pose; a specification takes them over on request.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.inertia_repair import repaired
from orbit_assets.mjcf.couplings import Couplings
from orbit_assets.mjcf.geometry import Geoms, self_collisions
from orbit_assets.mjcf.joints import Actuators, body_chain, check_root
from orbit_assets.mjcf.loops import OWN_SITES, Loops
from orbit_assets.mjcf.model import Compiled, compile_file, pose_of, vector_of
from orbit_assets.mjcf.trees import WORLD, Tree, Trees
from orbit_assets.naming import names_file
from orbit_assets.options import ReadOptions
from orbit_assets.placed import PlacedArticulation
from orbit_core.scene import Articulation, Frame, Joint, Link, Pose

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
        "textures": model.ntex,
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
