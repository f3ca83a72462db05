"""Cloth, rope and solids as parts of a MuJoCo model: cloth a flex of triangles, a rope a chain of capsules on ball
joints, a solid a flex that follows a grid of nodes (:mod:`orbit_mjmodel.solids`).

Cloth follows its membrane stiffness E t, Poisson's ratio nu and bending stiffness D. MuJoCo 3's two-dimensional
flex of Young's modulus Y, ratio p and thickness h has, as stretched strips and cantilevers show, the membrane's
``E t = Y h (1 + 2 p) / (4 (1 + p))`` and ``nu = 2 p``, and a bending stiffness of ``Y h^3 / (12 (1 + p))`` over
:data:`_BENDING`; MuJoCo 4 has the same bending, and ``E t = Y h`` and ``nu = p``. These are solved for Y, p and h.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation, ConfigurationError, SceneLayout, UnsupportedCapabilityError
from orbit_core.plugin_kit.bodies import hanging_weight
from orbit_core.plugin_kit.closed_surfaces import is_convex
from orbit_core.scene import Attachment, Cloth, Rope, Scene, SoftBody
from orbit_mjmodel.addresses import MATTER_BODY, body_name
from orbit_mjmodel.chains import chain_positions
from orbit_mjmodel.materials import OVERRIDING
from orbit_mjmodel.solids import SolidGrid, embed, shortest_edge, skin

# What MuJoCo's bending of flexes is too soft by: strips that droop by a quarter and by four fifths of their length then
# do so as elasticas within 7 % at 10 pieces, and 1 % at 20.
_BENDING = 1.75
# Impedance of contacts and of what is held: a particle is so light that a softer contact gives way by centimetres.
_STIFF = (0.99, 0.9999, 0.001, 0.5, 2.0)
# The same of solids: with that of cloth a block crept by 0.6 mm/s in a grasp, and seven times as fast on a slope.
_STIFFER = (0.9995, *_STIFF[1:])
# How many times as stiff contacts of cloth are as MuJoCo would have them, which are as soft as a particle is light: a
# finger's corner came through triangles of 7 mg, which are 2 mm thick, as it pinched, and the cloth hung on it, 1.9 mm
# deep, when the fingers had opened. Six times as stiff, cloth that slides on a slope is 3 % too fast.
_FIRMER = 4.0
# Time constant of contacts in seconds, where two steps are not longer.
_FASTEST = 0.004
# Layer of elements, counted from the surface, that never collide.
_NEVER = 1000
_SELF_CONTACT = int(mujoco.mjtFlexSelf.mjFLEXSELF_AUTO)
_EXACT_MEMBRANE = int(mujoco.__version__.partition(".")[0]) >= 4
# Of MuJoCo's ``elastic2d``.
_STRETCH_AND_BEND, _STRETCH = 3, 2
# Radii of rope along it, within which it does not touch itself: pieces of a bent rope overlap there.
_CLEARANCE = 3.0

# Of a rope: MuJoCo's matrices of a chain grow with the square of its pieces, to 70 MB each for these.
_MOST_PIECES = 1000
# Of ``D h^2 / (rho l^4)`` with edges l: MuJoCo ends its solution at a residual of 1e-8 of the largest forces, so that
# cloth as stiff as this falls as it should on meshes of 9 to 33 rows, and at two to seven times that more slowly.
_STIFFEST_BEND = 100.0

# Of ``E h^2 / (rho l^2)`` of a cell of edge l: up to 6e5 a block and a beam fell, came to rest and kept their shape
# within 1e-6; MuJoCo's solver ends at a residual of 1e-8 of the largest forces.
_STIFFEST_CELL = 5e5

# How many times as long as cloth's the time constant of contacts of rope and solids is: on the limit of two steps a
# rope's pieces rattle on what they lie on, and creep by 4 mm/s where friction should hold them; a block trembled on
# another at 2 cm/s.
_SOFTER = 2.0
# Inertia of a rope's pieces about their own axes, over that of their mass at their radius. A rope that rolled would
# turn by more than a radian in a step, and so could not be bent: its pieces' spin, which does not move anything else,
# is stopped in each step, and friction then gains so little on it that they roll by 0.1 mm/s at 5 ms.
_SPIN = 300.0
# Inertia of a rope's joints over its tension, a piece's length and the square of a step. The pull of pieces across the
# rope is explicit, which a step allows to four times that of a piece's own mass: ropes that were lighter against what
# hung on them sank through bars in growing waves. With half of this 1 kg on a rope of 5 g/m still did.
_TAUT = 4.0
# Of a rope's joints, over a piece's mass times its length squared and a step: what the shortest waves lose in a step,
# without which a whipping chain gains energy. The slowest wave of 50 pieces loses a millionth of that.
_INNER_DAMPING = 0.1


@dataclass(frozen=True, eq=False)
class MatterAddresses:
    """Addresses of one deformable in MuJoCo's arrays; each is a range, in the order of its particles or pieces."""

    spec: Cloth | Rope | SoftBody
    """Description in the scene."""
    index: int
    """Among the scene's deformables."""
    particles: slice
    """Among the particles of all deformables."""
    bodies: slice
    """Bodies of each particle of a cloth, each piece of a rope, or each node of a solid that moves."""
    positions: slice
    """Into ``qpos``: displacements of particles or nodes; a rope's first place and orientation, then ball joints."""
    velocities: slice
    """Into ``qvel``."""
    anchors: slice
    """Of each particle: the equality constraints that hold them."""
    firmness: npt.NDArray[np.float64]
    """(bodies,) by which contacts, and what holds particles, are stiffer than MuJoCo makes them of a body's mass."""
    grid: SolidGrid | None = None
    """Grid of cells that a solid follows; None for cloth and rope."""

    def flex(self, model: mujoco.MjModel) -> int:
        """Number of its flex; a rope has none."""
        return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, matter_name(self.index)))

    def own_geoms(self, model: mujoco.MjModel) -> npt.NDArray[np.int64]:
        """A rope's capsules; a cloth has none."""
        owners = model.geom_bodyid
        return np.flatnonzero((owners >= self.bodies.start) & (owners < self.bodies.stop))


def matter_name(deformable: int) -> str:
    """The body whose subtree is a deformable, and its flex."""
    return f"{MATTER_BODY}{deformable}"


def simulated(layout: SceneLayout) -> list[Cloth | Rope | SoftBody]:
    """The scene's deformables, which are of these kinds: their needs were held against what the backend declares."""
    return [spec for spec in layout.scene.deformables if isinstance(spec, Cloth | Rope | SoftBody)]


def solid_grids(layout: SceneLayout) -> tuple[SolidGrid | None, ...]:
    """Return the grids of the scene's solids, and None for each other deformable.

    Raises:
        ConfigurationError: a grid has too many nodes.
    """
    return tuple(embed(thing) if isinstance(thing, SoftBody) else None for thing in simulated(layout))


def add_matter(spec: mujoco.MjSpec, layout: SceneLayout, grids: Sequence[SolidGrid | None]) -> list[Approximation]:
    """Add the scene's deformables, each particle with an inactive constraint that may hold it to any body.

    Args:
        spec: to add them to.
        layout: of the scene.
        grids: of its solids.

    Returns:
        What MuJoCo does not take as it is.

    Raises:
        UnsupportedCapabilityError: two cloths, which MuJoCo's contacts of flexes throw up or let through each other.
        ConfigurationError: cloth too stiff for the time step, or a rope of too many pieces.
    """
    _check_one_cloth(layout)
    report: list[Approximation] = []
    for index, thing in enumerate(simulated(layout)):
        _check_solvable(thing, layout.scene.physics_dt)
        solref = (max(_FASTEST, 2.0 * layout.scene.physics_dt), 1.0)
        grid = grids[index]
        if isinstance(thing, Cloth):
            _add_cloth(spec, index, thing, solref)
        elif isinstance(thing, SoftBody):
            assert grid is not None
            _add_solid(spec, index, thing, grid, (_SOFTER * solref[0], solref[1]))
            report += _report_solid(thing, grid)
        else:
            report += _add_rope(spec, index, thing, (_SOFTER * solref[0], solref[1]), layout.scene)
            for _, link in _attached_links(thing, layout):
                _exclude_held(spec, index, thing, link)
        report += _report_held(thing)
        _add_anchors(spec, index, thing, grid, layout)
    return report


def _check_one_cloth(layout: SceneLayout) -> None:
    """Refuse cloths that may touch: of two that fell on a box one was flung up 0.3 m, or came out under the other."""
    names = [repr(thing.name) for thing in simulated(layout) if isinstance(thing, Cloth)]
    if len(names) > 1:
        raise UnsupportedCapabilityError(
            f"cloths {' and '.join(names)} would be flung up, or change places, where they touch as MuJoCo's own: "
            "simulate them with a matter solver (matter='orbit-matter')"
        )


def _check_solvable(thing: Cloth | Rope | SoftBody, dt: float) -> None:
    """Refuse cloth that would not fall, solids beyond what was tried, and ropes whose matrices fill memory."""
    if isinstance(thing, SoftBody):
        edge = shortest_edge(thing)
        most = math.sqrt(_STIFFEST_CELL * thing.density / thing.youngs_modulus) * edge
        if dt > most:
            raise ConfigurationError(
                f"soft body '{thing.name}' is too stiff for MuJoCo's own solids at a physics_dt of {dt:g} s, "
                f"{thing.youngs_modulus:.3g} Pa and cells of {edge:.2g} m: use at most {most:.2g} s, larger cells "
                "(resolution), or a rigid object"
            )
        return
    if isinstance(thing, Rope):
        if (pieces := len(thing.rest_positions) - 1) > _MOST_PIECES:
            raise ConfigurationError(
                f"rope '{thing.name}' has {pieces} pieces, and MuJoCo's own chains {_MOST_PIECES} at most: take fewer "
                "points, or a matter solver"
            )
        return
    corners = thing.rest_positions[np.asarray(thing.mesh.faces)]
    edge = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).min(axis=1).mean())
    most = math.sqrt(_STIFFEST_BEND * thing.area_density * edge**4 / max(thing.bending_stiffness, 1e-30))
    if dt > most:
        raise ConfigurationError(
            f"'{thing.name}' is too stiff to bend for MuJoCo's own cloth at a physics_dt of {dt:g} s: use at most "
            f"{most:.2g} s, a lower bending_stiffness, a coarser mesh or a matter solver"
        )


# Cloth ---------------------------------------------------------------------------------------------------------------


def _add_cloth(spec: mujoco.MjSpec, index: int, cloth: Cloth, solref: tuple[float, float]) -> None:
    base = spec.worldbody.add_body(name=matter_name(index))
    masses = particle_masses(cloth)
    for number, (place, mass) in enumerate(zip(cloth.pose.transform(cloth.rest_positions), masses, strict=True)):
        _add_particle(base, f"{matter_name(index)}_{number}", place, float(mass))
    young, ratio, thickness = flex_material(cloth)
    flex = spec.add_flex(name=matter_name(index), dim=2)
    flex.vertbody = [f"{matter_name(index)}_{number}" for number in range(len(masses))]
    flex.vert = np.zeros(3 * len(masses)).tolist()
    flex.elem = np.asarray(cloth.mesh.faces).ravel().tolist()
    flex.young, flex.poisson, flex.thickness = young, ratio, thickness
    flex.elastic2d = _STRETCH_AND_BEND if cloth.bending_stiffness > 0.0 else _STRETCH
    flex.radius = 0.5 * cloth.thickness
    flex.friction = (cloth.friction, 0.0, 0.0)
    flex.solref, flex.solimp, flex.solmix = solref, _STIFF, OVERRIDING
    flex.selfcollide = _SELF_CONTACT if cloth.self_collisions else int(mujoco.mjtFlexSelf.mjFLEXSELF_NONE)


def _add_particle(base: mujoco.MjsBody, name: str, place: npt.NDArray[np.float64], mass: float) -> None:
    """Add a body that moves along the axes of the world and never turns."""
    body = base.add_body(name=name, pos=place)
    body.explicitinertial = True
    body.mass, body.inertia, body.ipos = mass, np.full(3, 1e-4 * mass), np.zeros(3)
    for axis in np.eye(3):
        body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)


def flex_material(cloth: Cloth) -> tuple[float, float, float]:
    """Return Young's modulus in Pa, Poisson's ratio and thickness in m of a flex with a cloth's stiffnesses."""
    stretch, nu = cloth.membrane_stiffness, cloth.poissons_ratio
    bending = cloth.bending_stiffness or 1e-6  # any: a membrane without bending has a thickness too
    if _EXACT_MEMBRANE:
        thickness = math.sqrt(12.0 * _BENDING * bending * (1.0 + nu) / stretch)
        return stretch / thickness, nu, thickness
    thickness = math.sqrt(3.0 * _BENDING * bending * (1.0 + nu) / stretch)
    return 4.0 * stretch * (1.0 + 0.5 * nu) / ((1.0 + nu) * thickness), 0.5 * nu, thickness


def particle_masses(cloth: Cloth) -> npt.NDArray[np.float64]:
    """(P,) kg: a third of each triangle's."""
    points, faces = cloth.rest_positions, np.asarray(cloth.mesh.faces)
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    shares = np.zeros(len(points))
    np.add.at(shares, faces, (cloth.area_density * np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0)[:, None])
    return shares


# Solids --------------------------------------------------------------------------------------------------------------


def _add_solid(spec: mujoco.MjSpec, index: int, solid: SoftBody, grid: SolidGrid, solref: tuple[float, float]) -> None:
    base, name = spec.worldbody.add_body(name=matter_name(index)), matter_name(index)
    places = solid.pose.transform(grid.nodes)
    # Nodes of empty cells come last, so that those that move follow each other.
    for number in np.flatnonzero(grid.moving):
        _add_particle(base, f"{name}_{number}", places[number], float(grid.masses[number]))
    for number in np.flatnonzero(~grid.moving):
        base.add_body(name=f"{name}_{number}", pos=places[number])
    points, tetrahedra = skin(solid)
    # MuJoCo's compiler wants every cell whose nodes move to hold an element.
    fillers = len(points) + grid.fillers
    points, tetrahedra = np.concatenate((points, grid.nodes)), np.concatenate((tetrahedra, fillers))
    flex = spec.add_flex(name=name, dim=3)
    flex.order, flex.cellcount = 1, grid.counts.tolist()
    flex.nodebody = [f"{name}_{number}" for number in range(len(places))]
    flex.vertbody, flex.vert = [name] * len(points), solid.pose.transform(points).ravel().tolist()
    flex.elem = tetrahedra.ravel().tolist()
    flex.young, flex.poisson, flex.damping = solid.youngs_modulus, solid.poissons_ratio, solid.damping
    flex.radius, flex.activelayers = 0.0, 1
    flex.friction = (solid.friction, 0.0, 0.0)
    flex.solref, flex.solimp, flex.solmix = solref, _STIFFER, OVERRIDING
    flex.selfcollide = int(mujoco.mjtFlexSelf.mjFLEXSELF_NONE)


def _report_solid(solid: SoftBody, grid: SolidGrid) -> list[Approximation]:
    subject, report = f"'{solid.name}'", list[Approximation]()
    if not is_convex(solid.rest_positions, np.asarray(solid.mesh.faces)):
        why = "MuJoCo's contacts of a solid with itself take 100 to 400 ms a step, and let its sides overlap by 8 mm"
        report.append(Approximation(subject, "contact with itself", "none", why))
    if solid.attachments:
        why = "MuJoCo's constraints hold bodies, and a vertex is a mean of several nodes"
        report.append(Approximation(subject, "held vertices", "the nodes nearest to them held", why))
    if thin := [axis for axis, count in zip("xyz", grid.counts.tolist(), strict=True) if count == 1]:
        asked, got = "the inertia of its mass", f"three times as much of what is spread along {' and '.join(thin)}"
        report.append(Approximation(subject, asked, got, "the nodes of a single cell are all on the surface"))
    return report


def finish_solids(model: mujoco.MjModel, matter: Iterable[MatterAddresses]) -> None:
    """Give the cells of solids their own stiffness, and have nothing collide but their skin."""
    for one in matter:
        if one.grid is None:
            continue
        flex, grid = one.flex(model), one.grid
        start = int(model.flex_stiffnessadr[flex])
        model.flex_stiffness[start : start + grid.stiffness.size] = -grid.stiffness.ravel()  # MuJoCo keeps a minus
        stop = int(model.flex_elemadr[flex] + model.flex_elemnum[flex])
        model.flex_elemlayer[stop - len(grid.fillers) : stop] = _NEVER
        stop = int(model.flex_vertadr[flex] + model.flex_vertnum[flex])
        # Planes meet vertices: those of fillers are put where the first vertex is.
        own = slice(stop - len(grid.nodes), stop)
        for field in (model.flex_vert, model.flex_vert0):
            field[own] = field[int(model.flex_vertadr[flex])]


# Rope ----------------------------------------------------------------------------------------------------------------


def piece_lengths(rope: Rope) -> npt.NDArray[np.float64]:
    """(P - 1,) metres."""
    return np.linalg.norm(np.diff(rope.rest_positions, axis=0), axis=1)


def _add_rope(
    spec: mujoco.MjSpec, index: int, rope: Rope, solref: tuple[float, float], scene: Scene
) -> list[Approximation]:
    """A straight chain along x; the initial state bends it."""
    lengths = piece_lengths(rope)
    dt, pull = scene.physics_dt, hanging_weight(rope, scene)
    body = spec.worldbody
    for number, length in enumerate(lengths):
        root = number == 0
        offset = rope.pose.position if root else (lengths[number - 1], 0.0, 0.0)
        body = body.add_body(name=matter_name(index) + (f"_{number}" if number else ""), pos=offset)
        if root:
            body.add_freejoint()
        else:
            stiffness = rope.bending_stiffness / (0.5 * (lengths[number - 1] + length))
            # The first part takes as much as the end of a step would of the spring: rope at rest is then quiet.
            damping = dt * stiffness + _INNER_DAMPING * rope.linear_density * length**3 / dt
            body.add_joint(
                type=mujoco.mjtJoint.mjJNT_BALL,
                stiffness=[stiffness, 0.0, 0.0],
                damping=[damping, 0.0, 0.0],
                armature=_TAUT * pull * length * dt**2,
            )
        mass, radius = rope.linear_density * length, rope.radius
        across = mass * (length**2 / 12.0 + radius**2 / 4.0)
        body.explicitinertial = True
        body.mass, body.ipos, body.inertia = mass, (0.5 * length, 0.0, 0.0), (0.5 * mass * radius**2, across, across)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=(0.0, 0.0, 0.0, length, 0.0, 0.0),
            size=(radius, 0.0, 0.0),
            friction=(rope.friction, 0.0, 0.0),
            condim=3,
            solref=solref,
            solimp=_STIFF,
            solmix=OVERRIDING,
            rgba=(0.0, 0.0, 0.0, 0.0),  # which rays take for not there
        )
    _exclude_neighbours(spec, index, rope, lengths)
    why = "a chain of stiff pieces on ball joints, whose springs turn about every axis alike"
    axial = Approximation(f"'{rope.name}'", f"axial stiffness {rope.axial_stiffness:g} N", "no stretch", why)
    twist = Approximation(f"'{rope.name}'", "no resistance to twist", "that of bending", why)
    spins = "it would turn by more than a radian in a step, and its joints could not follow"
    report = [axial, Approximation(f"'{rope.name}'", "that it may roll", "no spin about its own axis", spins)]
    if rope.bending_stiffness > 0.0:
        report.append(twist)
    if pull > 0.0:
        got, why = f"that of joints under {pull:.3g} N as well", "lighter joints would not bear it at this physics_dt"
        report.append(Approximation(f"'{rope.name}'", "the inertia of its mass alone", got, why))
    return report


def slow_spins(model: mujoco.MjModel, matter: Iterable[MatterAddresses]) -> None:
    """Give a rope's pieces the inertia about their own axes that :data:`_SPIN` asks for, more than solids can have."""
    for one in matter:
        if isinstance(one.spec, Rope):
            model.body_inertia[one.bodies, 0] = axial_inertia(one.spec, model.body_mass[one.bodies])


def axial_inertia(rope: Rope, masses: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """(...) kg m^2 of a rope's pieces of these masses, each about its own axis."""
    return _SPIN * rope.radius**2 * masses


def _exclude_neighbours(spec: mujoco.MjSpec, index: int, rope: Rope, lengths: npt.NDArray[np.float64]) -> None:
    names = [matter_name(index) + (f"_{number}" if number else "") for number in range(len(lengths))]
    starts = np.concatenate(((0.0,), np.cumsum(lengths)))
    for first, second in combinations(range(len(lengths)), 2):
        between = starts[second] - starts[first + 1]
        if not rope.self_collisions or second == first + 1 or between < _CLEARANCE * rope.radius:
            spec.add_exclude(bodyname1=names[first], bodyname2=names[second])


def _exclude_held(spec: mujoco.MjSpec, index: int, rope: Rope, link: str) -> None:
    for piece in range(len(rope.rest_positions) - 1):
        spec.add_exclude(bodyname1=_piece(index, piece), bodyname2=link)


# What holds particles ------------------------------------------------------------------------------------------------


def _add_anchors(
    spec: mujoco.MjSpec, index: int, thing: Cloth | Rope | SoftBody, grid: SolidGrid | None, layout: SceneLayout
) -> None:
    """Springs and dampers that halve what is amiss in a step, and so do not swing."""
    dt = layout.scene.physics_dt
    to = dict.fromkeys(range(len(thing.rest_positions)), "world")
    held = {particle for attachment in thing.attachments for particle in attachment.particles}
    for attachment, link in _attached_links(thing, layout):
        to.update(dict.fromkeys(attachment.particles, link))
    carriers = _carriers(index, thing, grid)
    for particle, other in to.items():
        spec.add_equality(
            name=f"{matter_name(index)}_anchor{particle}",
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=carriers[particle],
            name2=other,
            data=_own_place(thing, particle),
            active=particle in held,
            solref=(-0.5 / dt**2, -1.0 / dt),
            solimp=_STIFF,
        )


def _attached_links(thing: Cloth | Rope | SoftBody, layout: SceneLayout) -> Iterator[tuple[Attachment, str]]:
    """The attachments to links, with the link's body."""
    for attachment in thing.attachments:
        if attachment.entity is not None and attachment.link is not None:
            entity = layout.entity(attachment.entity)
            number = entity.links.start + entity.spec.articulation.link_names.index(attachment.link)
            yield attachment, body_name(number)


def _report_held(thing: Cloth | Rope | SoftBody) -> list[Approximation]:
    why = "what lies in the link would be pushed out of what holds it"
    links = dict.fromkeys(attachment.link for attachment in thing.attachments if attachment.link is not None)
    return [
        Approximation(f"'{thing.name}'", f"contact with link '{link}', which holds it", "none", why) for link in links
    ]


def _own_place(thing: Cloth | Rope | SoftBody, particle: int) -> npt.NDArray[np.float64]:
    """Return a particle's position in the body that carries it, as constraint data; that in the other is set later."""
    data = np.zeros(mujoco.mjNEQDATA)
    if isinstance(thing, Rope) and particle == len(thing.rest_positions) - 1:
        data[0] = piece_lengths(thing)[-1]
    return data


def _carriers(index: int, thing: Cloth | Rope | SoftBody, grid: SolidGrid | None) -> list[str]:
    """The body that each particle belongs to: of a rope's last one, the last piece; of a solid's, the nearest node."""
    name, count = matter_name(index), len(thing.rest_positions)
    if isinstance(thing, Rope):
        return [_piece(index, min(particle, count - 2)) for particle in range(count)]
    if grid is None:
        return [f"{name}_{particle}" for particle in range(count)]
    return [f"{name}_{node}" for node in np.flatnonzero(grid.moving)[grid.nearest()]]


def _piece(index: int, number: int) -> str:
    return matter_name(index) + (f"_{number}" if number else "")


def spare_holders(model: mujoco.MjModel, layout: SceneLayout, matter: Iterable[MatterAddresses]) -> None:
    """Have cloth or solids and the links that hold them pass each other by, for flexes know no excluded pairs.

    Each such flex collides by a separate bit, which all geoms and flexes but those links' answer to.
    """
    bit = 1
    for one in matter:
        if isinstance(one.spec, Rope):
            continue
        flex = one.flex(model)
        links = [model.body(link).id for _, link in _attached_links(one.spec, layout)]
        if links:
            bit *= 2
            model.flex_contype[flex] = bit
            model.flex_conaffinity[flex] &= ~1
            model.flex_conaffinity |= bit
            model.geom_conaffinity[~np.isin(model.geom_bodyid, links)] |= bit
            solid = (model.body_geomnum > 0) & ~np.isin(np.arange(model.nbody), links)
            model.body_conaffinity[solid] |= bit


def firm_contacts(
    of_bodies: npt.NDArray[np.float64], of_freedoms: npt.NDArray[np.float64], matter: Iterable[MatterAddresses]
) -> None:
    """Have contacts of cloth and solids give way less; impedance, of which MuJoCo takes 0.9999 at most, does not do it.

    Args:
        of_bodies: (..., bodies, 2) ``body_invweight0`` as MuJoCo computes it, changed in place: it determines only how
            far contacts give way.
        of_freedoms: (..., nv) ``dof_invweight0``, likewise.
        matter: all deformables.
    """
    for one in matter:
        if not isinstance(one.spec, Rope):
            of_bodies[..., one.bodies, :] /= one.firmness[:, None]
            of_freedoms[..., one.velocities] /= np.repeat(one.firmness, 3)


def matter_addresses(
    model: mujoco.MjModel, layout: SceneLayout, grids: Sequence[SolidGrid | None]
) -> tuple[MatterAddresses, ...]:
    """The addresses of each of the scene's deformables in a compiled model."""
    found: list[MatterAddresses] = []
    start = 0
    for index, (thing, grid) in enumerate(zip(simulated(layout), grids, strict=True)):
        count = len(thing.rest_positions)
        rope = isinstance(thing, Rope)
        moving = count - 1 if rope else count if grid is None else int(grid.moving.sum())
        lead = matter_name(index) if rope else f"{matter_name(index)}_{0 if grid is None else grid.moving.argmax()}"
        first = model.body(lead).id
        joint = model.body_jntadr[first]
        q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        anchor = model.equality(f"{matter_name(index)}_anchor0").id
        # A rope's first piece is on a free joint, the others on ball joints.
        numbers = (7 + 4 * (moving - 1), 6 + 3 * (moving - 1)) if rope else (3 * moving, 3 * moving)
        found.append(
            MatterAddresses(
                thing,
                index,
                slice(start, start + count),
                slice(first, first + moving),
                slice(q, q + numbers[0]),
                slice(v, v + numbers[1]),
                slice(anchor, anchor + count),
                np.full(moving, _FIRMER) if grid is None else grid.firmness(model.opt.timestep),
                grid,
            )
        )
        start += count
    return tuple(found)


def set_matter_home(model: mujoco.MjModel, matter: tuple[MatterAddresses, ...]) -> None:
    """Bend ropes in the model's keyframe as the scene has them at first."""
    for one in matter:
        if isinstance(one.spec, Rope):
            points = one.spec.pose.transform(one.spec.rest_positions)
            model.key_qpos[0][one.positions] = chain_positions(points[None])[0]
