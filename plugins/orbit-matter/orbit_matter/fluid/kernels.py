"""Liquids by weakly compressible smoothed particle hydrodynamics, as launches over environments and particles.

Densities follow the flow's divergence and are smoothed against noise (Antuono, Colagrossi, Marrone, "Numerical
diffusive terms in weakly-compressible SPH schemes", 2012; without the hydrostatic part, Fourtakas et al., "Local
uniform stencil boundary conditions for arbitrary shaped boundaries", 2019), and where particles are; pressures follow
densities. Walls are filled with a lattice of the liquid (``walls.py``), and may be as thin as they like.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.block import BLOCK, BOUNDS, any_in_warp, sum_of_block
from orbit_matter.contact import MARGIN, NEAREST, Felt, carried, carried_by, feel, feel_together, surface
from orbit_matter.fluid import fluids
from orbit_matter.fluid.maps import Maps, half_space, mapped
from orbit_matter.fluid.pairs import diverged_from, keep, pressed_by
from orbit_matter.fluid.walls import (
    SOFT,
    Filled,
    Layers,
    filled_by,
    lattice_behind,
    lattice_of_box,
    layered_by,
    layers_behind,
    layers_of_box,
)
from orbit_matter.kernels import Links, turn_between
from orbit_matter.surfaces import BOX, PLANE, Shapes

PROBE = wp.constant(0.1)
"""Spacings below a surface where its depth tells edges from faces, and where walls are looked for that hide others or
overlap with them."""
SHARP = wp.constant(2.05)
"""Factor of the loss of a wall's weight at an edge, of what is no box: 0.6 of it where faces are square."""
FACING = wp.constant(0.999)
"""Least part of a box's normal along one of its axes before a face and not an edge."""
ACROSS = wp.constant(0.7)
"""Most that the normals of two walls have in common which make a corner."""
CLOSEST = wp.constant(0.25)
"""Spacings that a particle is kept from a wall, should the wall be faster than pressure."""
ESCAPE = wp.constant(0.5)
"""m/s at most with which a particle that is nearer comes out."""
SHOCK = wp.constant(2.0)
"""Quadratic artificial viscosity, the usual value (Monaghan, "Smoothed particle hydrodynamics", 1992): a blow loses its
energy, which drops would bounce by else, and what flows smoothly feels next to none of it."""
RUBBING = wp.constant(14.0)
"""Times the viscosity that particles resist where they come nearer or part (Monaghan and Gingold, "Shock simulation by
the particle method SPH", 1983). It acts along the line between two, so that turning is kept; by differences of
velocities (Morris, Fox, Zhu, 1997) a lump of honey lost two thirds of its spin in 50 ms. 10 would do in an endless
liquid (Monaghan, "Smoothed particle hydrodynamics", 2005); with 14, layers of 6 flow 0 to 20 % too fast."""

BLOW = wp.constant(3.0)
"""Times as fast as it comes that a particle meets the cells of a wall: with 2 a lump of glycerol that fell by 20 cm
broke into drops, which kept 1 to 2 % of its energy for half a second; with 3 it spreads and stops."""
SHALLOW = wp.constant(0.25)
"""Spacings of depth whose pressure a particle has at least that rests on others: half of one at a surface."""
STRUCK = wp.constant(0.4)
"""Spacings by which two particles come nearer in a substep at most that count for the shock: it would throw them back
by more than they came with."""
STEADY = wp.constant(0.5)
"""Most of the square of a phase by which a particle's density follows its own motion in a substep. Particles of jets
and sheets, which have neighbours on one side only, have up to ``1.0 (sound h / spacing)^2``, and swung up by half in
each substep where that was above 1.3; at a level surface it is 0.33 of it, and within a liquid INNER."""
INNER = wp.constant(0.17)
"""Sum of the squares of the kernel's gradients over whole surroundings, times the squares of a particle's volume and of
the spacing."""
GENTLE = wp.constant(0.01)
"""m/s towards a wall below which there is no blow: it would press by less than a millimetre of water."""

KEPT = wp.constant(fluids.KEPT)
BOUNDS_OF_WALLS = (BLOCK, 4)
"""Bounds of the kernel that finds walls side by side: with 4 blocks on a multiprocessor it spills registers."""

Others = wp.types.vector(length=2, dtype=int)
Planes = wp.types.matrix(shape=(2, 4), dtype=float)


@wp.struct
class Fluid:
    """State of (N, P) particles of liquid, and what does not differ between environments."""

    x: wp.array2d[wp.vec3]
    """(N, P) m."""
    v: wp.array2d[wp.vec3]
    """(N, P) m/s."""
    s: wp.array2d[float]
    """Density over density at rest."""
    place: wp.array2d[wp.vec4]
    """(N, P + 1) positions and volumes in m^3; the last row is far away and fills up lists of neighbours."""
    motion: wp.array2d[wp.vec4]
    """(N, P + 1) velocities and pressures in Pa."""
    pushed: wp.array2d[wp.vec4]
    """(N, P + 1) velocities at the end of the substep, and densities over those at rest."""
    packed: wp.array2d[float]
    """Density over density at rest by where particles are, too small at the surface."""
    rate: wp.array2d[float]
    """1/s, of ``s``."""
    rest_density: wp.array[float]
    """(P,) kg/m^3"""
    viscosity: wp.array[float]
    """(P,) Pa s"""
    owner: wp.array[int]
    """(P,) index of the deformable."""
    parameters: wp.array3d[float]
    """(N, D, 4) whose first is the scale of mass."""
    plane: wp.array3d[wp.vec4]
    """(N, P, W) normal and distance of each wall."""
    shape: wp.array3d[int]
    """(N, P, W) that each wall is of."""
    facing: wp.array3d[int]
    """(N, P, W) 1 where a particle is in front of a face of a wall, and not of an edge of a box."""
    walls: wp.array2d[int]
    """(N, P) how many of them there are."""
    shielded: wp.array3d[wp.vec4]
    """(N, P, W) planes at the last search, with a distance of 1e6 for none."""
    given: wp.array3d[wp.vec3]
    """(N, P, W) sums of the kernel's gradient over the cells of a wall, in 1/m."""
    pull: wp.array3d[wp.vec3]
    """(N, P, W) m/s^2 from a wall whose cells are deeper or higher, or that comes near fast."""
    drift: wp.array2d[float]
    """(N, P) m that particles have moved at most against the shapes near them since their walls were found."""
    stayed: float
    """m of it up to which they keep their walls."""
    held: wp.array2d[float]
    """(N, P) part of gravity that gave the gradient of the pressure behind walls when they were found."""
    eased: float
    """Largest difference of today's part of gravity from that."""
    left: wp.array2d[wp.transform]
    """(N, S) where shapes were in the last substep, when drifts were found."""
    way: wp.array2d[wp.vec3]
    """(N, S) m that shapes' origins have gone since then."""
    turn: wp.array2d[wp.quat]
    """(N, S) by which they have turned since then."""
    due: wp.array2d[int]
    """(N, P) particles whose walls are to be found again, in any order."""
    dues: wp.array[int]
    """(N,) how many of them there are."""
    filled: wp.array2d[float]
    """(N, P) what walls add to ``packed``."""
    neighbours: wp.array3d[int]
    """(N, P, K)"""
    count: wp.array2d[int]
    """(N, P) how many of them there are, a multiple of LANES."""
    searched: wp.array2d[wp.vec3]
    """(N, P) where particles were at the last search; on a CPU each at its own, less ``carried`` at that time."""
    stale: wp.array[int]
    """(N,) 1 where a search is due."""
    carried: wp.array[wp.vec3]
    """(N,) m that all particles have moved in the mean since the last search for all of them."""
    passed: float
    """m that all particles may move together and keep their neighbours: a wall may come between them."""
    guarded: wp.array2d[int]
    """(N, P) how many walls particles had at the last search."""
    columns: wp.array3d[float]
    """(N, 3, P or a few more) positions at the last search by axis, far away beyond the last particle."""
    moved: wp.array2d[int]
    """(N, P) particles that a CPU searches anew, in ascending order."""
    nearby: wp.array3d[int]
    """(N, 1, P) list of one particle, before a CPU knows whose lists differ from it."""
    head: wp.array2d[int]
    """(N, B) first particle of each bucket of cells; -1 for none."""
    following: wp.array2d[int]
    """(N, P) next particle in the bucket; -1 for none."""
    spacing: float
    """m between particles at rest."""
    volume: float
    """m^3 of a particle at rest."""
    length: float
    """Smoothing length in metres; the kernel ends at twice of it."""
    ratio: float
    """Smoothing length in spacings."""
    slope: float
    """Slope of the kernel: its gradient is ``-slope t^3 x`` with ``t = 1 - r / (2 length)`` (Wendland's C2)."""
    sound: float
    """m/s"""
    rough: float
    """m^2/s that a particle's kinematic viscosity is at least, between particles only."""
    smooth: float
    """m^2/s of the diffusion of densities."""
    peak: float
    """Height of the kernel that ``packed`` sums, times a particle's volume: ``peak (1 - r^2 / (2 length)^2)^4``. Of
    particles in disorder it says the density three times as well as the other kernel."""
    renewal: float
    """1/s with which densities follow ``packed``, and 1 where that is smaller."""
    cell: float
    """Metres within which neighbours are searched."""
    maps: Maps
    """Maps of hollow meshes and of united pieces."""


@wp.func
def velocity_of(row: wp.vec4) -> wp.vec3:
    """Return the first three numbers of a row."""
    return wp.vec3(row[0], row[1], row[2])


@wp.kernel(enable_backward=False)
def find_inside(f: Fluid, links: Links, shapes: Shapes, found: wp.array2d[int]):
    """Write the shape that each particle is inside of; -1 for none."""
    env, i = wp.tid()
    kind = env % shapes.kind.shape[0]
    found[env, i] = -1
    for s in range(shapes.kind.shape[1]):
        # Where a kind of environment has fewer shapes than another, a negative reach fills the row.
        if shapes.reach[kind, s] >= 0.0:  # noqa: SIM102 - Warp evaluates both sides of an `and`
            # A ball, as meshes are searched within a multiple of its radius.
            if surface(links, shapes, env, kind, s, f.x[env, i], f.spacing)[3] > f.spacing:
                found[env, i] = s


@wp.kernel(enable_backward=False)
def meet(
    f: Fluid, links: Links, shapes: Shapes, felt: Felt, gravity: wp.array[wp.vec3], h: float, most: float,
):  # fmt: skip
    """Find the pressure and the walls of each particle; search where one moved by ``most`` since the last search."""
    env, i = wp.tid()
    note_state(f, env, i, most)
    f.drift[env, i] = 0.0
    f.due[env, i] = i
    renew_walls(f, links, shapes, felt, gravity, h, env, i, i + 1, 1)


@wp.func
def end_carry(f: Fluid, env: int, carried: wp.vec3):
    """Note how far all particles have moved, and search anew where a wall may have come between some."""
    f.carried[env] = carried
    # Not a number is never less, so that what has diverged is searched for as well.
    if not wp.length_sq(carried) < f.passed * f.passed:
        f.stale[env] = 1


@wp.kernel(enable_backward=False, launch_bounds=BOUNDS)
def carry(f: Fluid):
    """Find how far all particles have moved in the mean since the last search."""
    env, lane = wp.tid()
    whole = wp.vec3()
    for i in range(lane, f.x.shape[1], wp.block_dim()):
        whole += f.x[env, i] - f.searched[env, i]
    x, y, z = sum_of_block(whole[0]), sum_of_block(whole[1]), sum_of_block(whole[2])
    if lane == 0:
        end_carry(f, env, wp.vec3(x, y, z) / float(f.x.shape[1]))


@wp.kernel(enable_backward=False)
def approach(f: Fluid, links: Links, felt: Felt, gravity: wp.array[wp.vec3], h: float, most: float, lanes: int):
    """Find the pressure of each particle as :func:`meet` does, and list the particles whose walls are due.

    Particles that stay where they were keep their walls. A warp of a GPU waits for its slowest thread, and walls cost
    most. Few particles are due at a time; :func:`renew` finds their walls side by side. Each environment has ``lanes``
    threads: on a CPU one, as a launch thread costs some 35 ns there.
    """
    env, lane = wp.tid()
    for i in range(lane, f.x.shape[1], lanes):
        note_state(f, env, i, most)
        if is_due(f, felt, gravity, env, i, h):
            f.due[env, wp.atomic_add(f.dues, env, 1)] = i


@wp.kernel(enable_backward=False)
def leave(f: Fluid, links: Links):
    """Find how shapes have moved since the last substep, between two physics steps as well."""
    env, s = wp.tid()
    before, now = f.left[env, s], links.shape[env, s]
    way = wp.transform_get_translation(now) - wp.transform_get_translation(before)
    turn = turn_between(wp.transform_get_rotation(before), wp.transform_get_rotation(now))
    f.way[env, s] = way
    f.turn[env, s] = turn
    f.left[env, s] = now
    # Of a shape that was put elsewhere those particles do not know that are no longer near it.
    turned = 2.0 * links.reach[env, s] * wp.length(wp.vec3(turn[0], turn[1], turn[2]))
    if wp.length(way) + turned > 0.5 * MARGIN:
        for i in range(f.x.shape[1]):
            f.drift[env, i] = f.stayed


@wp.kernel(enable_backward=False)
def carry_on(f: Fluid, h: float):
    """Add what all particles moved in the mean in the last substep to :func:`carry`'s, where each has its own search.

    Any motion would do in its place that all particles of an environment are told to have in common.
    """
    env = wp.tid()
    whole = wp.vec3()
    for i in range(f.v.shape[1]):
        whole += f.v[env, i]
    end_carry(f, env, f.carried[env] + whole * (h / float(f.v.shape[1])))


@wp.kernel(enable_backward=False, launch_bounds=BOUNDS_OF_WALLS)
def renew(f: Fluid, links: Links, shapes: Shapes, felt: Felt, gravity: wp.array[wp.vec3], h: float):
    """Find the walls of the particles that are due."""
    env, lane = wp.tid()
    renew_walls(f, links, shapes, felt, gravity, h, env, lane, f.dues[env], wp.block_dim())


@wp.func
def note_state(f: Fluid, env: int, i: int, most: float):
    """Write the rows of a particle that its neighbours read, and whether a search is due."""
    x, s = f.x[env, i], f.s[env, i]
    if not wp.length_sq(x - f.searched[env, i] - f.carried[env]) < most * most:
        f.stale[env] = 1
    pressed = (s - 1.0) * f.rest_density[i] * f.parameters[env, f.owner[i], 0] * f.sound * f.sound
    if pressed < 0.0:
        # A liquid pulls where it is whole, and not at its surface, where it would curl up.
        pressed *= wp.clamp((f.packed[env, i] - 0.8) * 10.0, 0.0, 1.0)
    v = f.v[env, i]
    f.place[env, i] = wp.vec4(x[0], x[1], x[2], f.volume / s)
    f.motion[env, i] = wp.vec4(v[0], v[1], v[2], pressed)


@wp.func
def held_by(f: Fluid, gravity: wp.array[wp.vec3], env: int, i: int) -> float:
    """Return the part of gravity that gives the gradient of the pressure behind a particle's walls."""
    # A wall goes on with the gradient of a pressure: what slides down on it by itself has none.
    weight = f.rest_density[i] * f.parameters[env, f.owner[i], 0] * wp.length(gravity[env])
    return wp.clamp(f.motion[env, i][3] / wp.max(weight * SHALLOW * f.spacing, 1.0e-6), 0.0, 1.0)


@wp.func
def is_due(f: Fluid, felt: Felt, gravity: wp.array[wp.vec3], env: int, i: int, h: float) -> bool:
    """Return True if a particle's walls are to be found again."""
    farthest, m, x, way = float(0.0), int(0), f.x[env, i], f.v[env, i] * h
    while m < NEAREST:
        shape = felt.near[env, i, m]
        m += 1
        if shape < 0:
            m = NEAREST
        else:
            arm = x - wp.transform_get_translation(f.left[env, shape])
            farthest = wp.max(farthest, wp.length_sq(way - carried_by(f.way[env, shape], f.turn[env, shape], arm)))
    drift = f.drift[env, i] + wp.sqrt(farthest) + f.stayed / float(KEPT)
    due = not drift < f.stayed
    if f.walls[env, i] > 0 and wp.abs(held_by(f, gravity, env, i) - f.held[env, i]) > f.eased:
        due = True
    if due:
        drift = 0.0
    f.drift[env, i] = drift
    return due


@wp.func
def renew_walls(
    f: Fluid, links: Links, shapes: Shapes, felt: Felt, gravity: wp.array[wp.vec3], h: float, env: int, begin: int,
    end: int, step: int,
):  # fmt: skip
    """Find the walls, and what they give, of every ``step``-th particle that is due from ``begin`` on.

    The loop is in here, as a CPU copies 8 KiB of arguments for each call.
    """
    kind = env % shapes.kind.shape[0]
    for n in range(begin, end, step):
        i = f.due[env, n]
        x, row = f.x[env, i], f.motion[env, i]
        count = find_walls(f, links, shapes, felt, env, i, kind, x)
        held, filled = held_by(f, gravity, env, i), float(0.0)
        for k in range(count):
            filled += fill(f, links, shapes, env, i, k, count, x, velocity_of(row), gravity[env] * held, h)
        f.held[env, i] = held
        f.filled[env, i] = filled
        f.walls[env, i] = count


@wp.func
def wall_at(f: Fluid, links: Links, shapes: Shapes, env: int, kind: int, shape: int, x: wp.vec3) -> wp.vec4:
    """Return the normal of a shape near x, and how deep x is in it."""
    # A ball, as meshes are searched within ten times its radius and a margin: the kernel reaches twice the length.
    radius = 0.3 * f.length
    found = surface(links, shapes, env, kind, shape, x, radius)
    return wp.vec4(found[0], found[1], found[2], found[3] - radius)


@wp.func
def find_walls(f: Fluid, links: Links, shapes: Shapes, felt: Felt, env: int, i: int, kind: int, x: wp.vec3) -> int:
    """Write the walls of a particle that no nearer one hides, and return how many there are."""
    looked, m = int(0), int(0)
    while m < NEAREST:
        shape = felt.near[env, i, m]
        m += 1
        if shape < 0:
            m = NEAREST
        else:
            found = wall_at(f, links, shapes, env, kind, shape, x)
            if -found[3] < 2.0 * f.length:
                f.plane[env, i, looked] = wp.vec4(found[0], found[1], found[2], -found[3])
                f.shape[env, i, looked] = shape
                looked += 1
    hidden = int(0)
    if looked > 1:
        for k in range(looked):
            for other in range(looked):
                if other != k and is_hidden(f, links, shapes, env, i, kind, x, k, other):
                    hidden = hidden | (1 << k)
    count = int(0)
    for k in range(looked):
        if (hidden >> k) & 1 == 0:
            wall = int(f.shape[env, i, k])
            plane = wp.vec4(f.plane[env, i, k])
            facing = int(1)
            if shapes.kind[kind, wall] == BOX:
                local = wp.vec3(plane[0], plane[1], plane[2]) @ links.axes[env, wall]
                if wp.max(wp.abs(local[0]), wp.max(wp.abs(local[1]), wp.abs(local[2]))) < FACING:
                    facing = 0
            f.plane[env, i, count] = plane
            f.shape[env, i, count] = wall
            f.facing[env, i, count] = facing
            f.given[env, i, count] = wp.vec3()
            f.pull[env, i, count] = wp.vec3()
            count += 1
    return count


@wp.func
def is_hidden(
    f: Fluid, links: Links, shapes: Shapes, env: int, i: int, kind: int, x: wp.vec3, k: int, other: int
) -> bool:
    """Return True if a particle's k-th wall is behind the face of a nearer one, and of what goes on behind that."""
    mine, nearer = f.plane[env, i, k], f.plane[env, i, other]
    hidden = bool(False)
    if nearer[3] < mine[3] or (nearer[3] == mine[3] and other < k):
        facing = wp.vec3(nearer[0], nearer[1], nearer[2])
        away = wp.vec3(mine[0], mine[1], mine[2]) * -(mine[3] + PROBE * f.spacing)
        height = nearer[3] + wp.dot(facing, away)
        if height < 0.0:
            below = x + away - facing * (height + PROBE * f.spacing)
            hidden = wall_at(f, links, shapes, env, kind, f.shape[env, i, other], below)[3] > 0.0
    return hidden


@wp.func
def wall_of(f: Fluid, env: int, i: int, k: int) -> wp.vec3:
    """Return the normal of a particle's k-th wall."""
    plane = f.plane[env, i, k]
    return wp.vec3(plane[0], plane[1], plane[2])


@wp.func
def fill(
    f: Fluid, links: Links, shapes: Shapes, env: int, i: int, k: int, count: int, x: wp.vec3, v: wp.vec3,
    gravity: wp.vec3, h: float,
) -> float:  # fmt: skip
    """Write what the k-th of a particle's ``count`` walls gives, and return what it adds to where particles are."""
    kind, shape, n, d = env % shapes.kind.shape[0], f.shape[env, i, k], wall_of(f, env, i, k), f.plane[env, i, k][3]
    axes, weight, reach = wp.mat33(links.axes[env, shape]), float(1.0), 2.0 * f.length
    form = shapes.kind[kind, shape]
    local = (x - wp.transform_get_translation(links.shape[env, shape])) @ axes
    number = f.maps.of[kind, shape]
    if number >= 0:
        return fill_mapped(f, links, env, i, k, number, x, local, v, gravity, h)
    layers = Layers()
    if form == BOX:
        layers = layers_of_box(local, shapes.size[kind, shape], f.spacing)
    else:
        axes = wp.identity(n=3, dtype=float)
        layers = layers_behind(d, n, f.spacing)
        if form != PLANE:
            # Just below the nearest point of an edge the surface is nearer than below that of a face.
            depth = wall_at(f, links, shapes, env, kind, shape, x - n * (d + PROBE * f.spacing))[3]
            weight = wp.clamp(1.0 - SHARP * (1.0 - depth / (PROBE * f.spacing)), 0.1, 1.0)
    if layers.depth >= 2.0 * f.ratio:
        return 0.0
    turned = axes @ layers.axes
    # Only what comes nearer is a blow: cells that a particle slides past would hold it and lift it.
    toward = wp.max(-wp.dot(n, v - carried(links, env, shape, x) / h), 0.0)
    if toward < GENTLE:
        toward = 0.0
    # Layers are behind a face; other walls that make a corner with this one must be square to it.
    layered = f.facing[env, i, k] == 1
    # Two other walls that make a corner with this one.
    others, skips, found = Others(-1, -1), wp.vec2(0.0, 0.0), int(0)
    planes = Planes()
    for other in range(count):
        away = f.plane[env, i, other][3]
        if other != k and found < 2 and d * d + away * away < reach * reach:
            facing = wall_of(f, env, i, other)
            if wp.abs(wp.dot(n, facing)) < ACROSS and f.facing[env, i, other] == 1:
                plane = f.plane[env, i, other]
                seen = facing @ turned
                for axis in range(3):
                    planes[found, axis] = seen[axis]
                planes[found, 3] = plane[3]
                others[found] = other
                if wp.max(wp.abs(seen[0]), wp.abs(seen[1])) < FACING:
                    layered = False
                if other < k or f.maps.of[kind, f.shape[env, i, other]] >= 0:
                    # Where shapes overlap behind both, cells are of one of them, and of one that has a map.
                    probe = PROBE * f.spacing
                    corner = x - n * (d + probe) - facing * (plane[3] + probe)
                    inside = wall_at(f, links, shapes, env, kind, shape, corner)[3] > 0.0
                    if inside and wall_at(f, links, shapes, env, kind, f.shape[env, i, other], corner)[3] > 0.0:
                        skips[found] = 1.0
                found += 1
    got, volume = Filled(), f.spacing * f.spacing * f.spacing * layers.thick
    if layered:
        # Normals of planes are rounded to axes.
        got = layered_by(
            layers.depth, layers.thick, layers.low, layers.high, f.spacing, 0.5 / f.ratio, f.ratio,
            SOFT * f.ratio * f.ratio, gravity @ turned, BLOW * toward,
            wp.vec3(wp.round(planes[0, 0]), wp.round(planes[0, 1]), planes[0, 3] / f.spacing),
            wp.vec3(wp.round(planes[1, 0]), wp.round(planes[1, 1]), planes[1, 3] / f.spacing), skips[0], skips[1],
        )  # fmt: skip
    else:
        cells, back = lattice_behind(d, f.spacing), wp.identity(n=3, dtype=float)
        if form == BOX:
            # Axes of a box in its own order.
            cells = lattice_of_box(local, shapes.size[kind, shape], f.spacing)
            back = layers.axes
            turned = axes
        one = back @ wp.vec3(planes[0, 0], planes[0, 1], planes[0, 2])
        two = back @ wp.vec3(planes[1, 0], planes[1, 1], planes[1, 2])
        got = filled_by(
            cells.at, cells.cell, cells.inside, cells.last, 0.5 / f.length, f.length, SOFT * f.length * f.length,
            gravity @ turned, n @ turned * (BLOW * toward), wp.vec4(one[0], one[1], one[2], planes[0, 3]),
            wp.vec4(two[0], two[1], two[2], planes[1, 3]), skips[0], skips[1],
        )  # fmt: skip
        volume = cells.volume
    slope = f.slope * volume * weight
    given = turned @ wp.vec3(got[0], got[1], got[2]) * slope
    pull = turned @ wp.vec3(got[3], got[4], got[5]) * -slope
    shock = turned @ wp.vec3(got[11], got[12], got[13]) * (slope * SHOCK)
    # No more than what stops it within the substep.
    strength = wp.length(shock) * h
    if strength > toward:
        shock *= toward / strength
    # Walls press along their normals: what is behind another wall, too, presses on that one as its normal says.
    for m in range(found):
        other = others[m]
        facing = wall_of(f, env, i, other)
        first = facing * (got[7 + 2 * m] * slope)
        second = facing * (got[8 + 2 * m] * -slope)
        given -= first
        pull -= second
        f.given[env, i, other] = f.given[env, i, other] + first
        f.pull[env, i, other] = f.pull[env, i, other] + second
    f.given[env, i, k] = f.given[env, i, k] + given
    f.pull[env, i, k] = f.pull[env, i, k] + pull + shock
    return got[6] * f.peak * volume / f.volume * weight


@wp.func
def fill_mapped(
    f: Fluid, links: Links, env: int, i: int, k: int, number: int, x: wp.vec3, local: wp.vec3, v: wp.vec3,
    gravity: wp.vec3, h: float,
) -> float:  # fmt: skip
    """Write what a wall that has a map gives, as :func:`fill` does of others, and return the same."""
    shape, n, d = f.shape[env, i, k], wall_of(f, env, i, k), f.plane[env, i, k][3]
    axes = wp.mat33(links.axes[env, shape])
    got = mapped(f.maps, number, local, n @ axes, d, gravity @ axes)
    given = axes @ wp.vec3(got[0], got[1], got[2])
    toward = wp.max(-wp.dot(n, v - carried(links, env, shape, x) / h), 0.0)
    shock = float(0.0)
    if toward >= GENTLE:
        half = half_space(f.maps.half, f.maps.reach, d)
        part = wp.clamp(wp.dot(given, n) / wp.max(half[0], 1.0e-6), 0.0, 1.0)
        # No more than what stops it within the substep.
        shock = wp.min(half[4] * part * SHOCK * BLOW * BLOW * toward * toward, toward / h)
    f.given[env, i, k] = f.given[env, i, k] + given
    f.pull[env, i, k] = f.pull[env, i, k] + axes @ wp.vec3(got[3], got[4], got[5]) + n * shock
    return got[6]


@wp.kernel(enable_backward=False, launch_bounds=BOUNDS)
def push(f: Fluid, links: Links, shapes: Shapes, felt: Felt, gravity: wp.array[wp.vec3], h: float, share: float):
    """Accelerate particles by pressure, viscosity and gravity, and press on links."""
    env, lane = wp.tid()
    rows = keep(f.place, f.motion, env, f.place.shape[1])
    # All threads of a warp take as many turns, as they sum forces together.
    for first in range(0, f.x.shape[1], wp.block_dim()):
        i = first + lane
        push_one(f, rows, links, shapes, felt, gravity, h, share, env, i)


@wp.func
def push_one(
    f: Fluid, rows: wp.uint64, links: Links, shapes: Shapes, felt: Felt, gravity: wp.array[wp.vec3], h: float,
    share: float, env: int, particle: int,
):  # fmt: skip
    # A thread beyond the last particle has no neighbours, no walls, and nothing to write.
    i = wp.min(particle, f.x.shape[1] - 1)
    count, walls = int(0), int(0)
    if particle == i:
        count = int(f.count[env, i])
        walls = int(f.walls[env, i])
    x, v, g, owner = f.x[env, i], f.v[env, i], gravity[env], f.owner[i]
    own, half = f.motion[env, i][3], 0.5 / f.length
    scale = f.parameters[env, owner, 0]
    density, viscosity = f.rest_density[i] * scale * f.s[env, i], f.viscosity[i]
    shock, fastest = density * SHOCK * f.length * f.length, STRUCK * f.spacing / (h * f.length)
    rubbing = RUBBING * wp.max(f.rough * density, viscosity)
    found = pressed_by(rows, f.place, f.motion, f.neighbours, env, i, count, half, shock, rubbing, fastest)
    a = velocity_of(found) * (f.slope / density)
    # A particle is within its own kernel.
    packed = (found[3] + 1.0) * f.peak + f.filled[env, i]
    mass = f.rest_density[i] * scale * f.volume
    kind, k = env % shapes.kind.shape[0], int(0)
    while any_in_warp(int(k < walls)) == 1:
        link, force, at = int(-1), wp.vec3(), wp.vec3()
        if k < walls:
            wall = f.shape[env, i, k]
            plane = f.plane[env, i, k]
            sides = f.given[env, i, k]
            n = wp.vec3(plane[0], plane[1], plane[2])
            passed = v - carried(links, env, wall, x) / h
            near, toward = wp.max(plane[3], 0.5 * f.spacing), -wp.dot(n, passed)
            slid = passed + n * toward
            rubbed = wp.min(2.0 * viscosity / density * wp.max(wp.dot(sides, n), 0.0) / near, 1.0 / h)
            # Behind the wall the pressure is the particle's own, but for the depth.
            given = sides * (2.0 * own / density) + f.pull[env, i, k] - slid * rubbed
            a += given
            link = shapes.link[kind, wall]
            force = given * (-mass * share)
            at = x - n * plane[3]
        feel_together(felt, links, env, owner, link, force, at)
        k += 1
    if particle == i:
        f.packed[env, i] = packed
        ahead = v + (a + g) * h
        f.pushed[env, i] = wp.vec4(ahead[0], ahead[1], ahead[2], f.s[env, i])


@wp.kernel(enable_backward=False, launch_bounds=BOUNDS)
def flow(f: Fluid, links: Links, shapes: Shapes, gravity: wp.array[wp.vec3], h: float):
    """Compute the rates of densities."""
    env, lane = wp.tid()
    rows = keep(f.place, f.pushed, env, f.place.shape[1])
    for i in range(lane, f.x.shape[1], wp.block_dim()):
        flow_one(f, rows, links, shapes, gravity, h, env, i)


@wp.func
def flow_one(
    f: Fluid, rows: wp.uint64, links: Links, shapes: Shapes, gravity: wp.array[wp.vec3], h: float, env: int, i: int
):
    x, v, s = f.x[env, i], velocity_of(f.pushed[env, i]), f.s[env, i]
    lean, count = gravity[env] / (f.sound * f.sound), f.count[env, i]
    half, smooth = 0.5 / f.length, 2.0 * f.smooth
    found = diverged_from(rows, f.place, f.pushed, f.neighbours, env, i, count, half, smooth, lean)
    rate, side = found[3] * f.slope, wp.vec3(found[0], found[1], found[2]) * f.slope
    for k in range(f.walls[env, i]):
        wall = f.shape[env, i, k]
        # Behind the wall the flow is mirrored, as pressure is, so that what one takes from the motion the other
        # gives back.
        rate += 2.0 * s * wp.dot(carried(links, env, wall, x) / h - v, f.given[env, i, k])
        side += 2.0 * f.given[env, i, k]
    phase = f.sound * h
    rate *= wp.min(STEADY / (phase * phase * (wp.length_sq(side) + INNER / (f.spacing * f.spacing))), 1.0)
    # Errors of the divergence add up; where particles are gives the density. At a surface, and where a gap has opened,
    # it is that at rest: nothing presses there, though the divergence may say so.
    f.rate[env, i] = rate + (wp.max(f.packed[env, i], 1.0) - s) * f.renewal


@wp.kernel(enable_backward=False)
def move(f: Fluid, links: Links, shapes: Shapes, felt: Felt, h: float, share: float, lanes: int):
    """Take particles to the end of the substep, past no wall, by ``lanes`` threads for each environment."""
    env, lane = wp.tid()
    for i in range(lane, f.x.shape[1], lanes):
        move_one(f, links, shapes, felt, h, share, env, i)


@wp.func
def move_one(f: Fluid, links: Links, shapes: Shapes, felt: Felt, h: float, share: float, env: int, i: int):
    x, v, owner = f.x[env, i], velocity_of(f.pushed[env, i]), f.owner[i]
    mass = f.rest_density[i] * f.parameters[env, owner, 0] * f.volume
    for k in range(f.walls[env, i]):
        wall = f.shape[env, i, k]
        plane = f.plane[env, i, k]
        n = wp.vec3(plane[0], plane[1], plane[2])
        toward = wp.dot(v - carried(links, env, wall, x) / h, n)
        least = wp.min((CLOSEST * f.spacing - plane[3]) / h, ESCAPE)
        if toward < least:
            given = n * (least - toward)
            v += given
            kind = env % shapes.kind.shape[0]
            force = given * (-mass * share / h)
            feel(felt, links, env, owner, shapes.link[kind, wall], force, x - n * plane[3])
    f.x[env, i] = x + v * h
    f.v[env, i] = v
    # Bounds that no proper flow reaches: pressure stays finite where one particle is caught between fast walls.
    f.s[env, i] = wp.clamp(f.s[env, i] + f.rate[env, i] * h, 0.5, 2.0)
