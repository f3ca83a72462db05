"""Search for the neighbours of a liquid's particles, as launches over environments and particles.

Lists hold for as long as no particle has moved by half of their margin; on a CPU, those of the others hold even then.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.block import BLOCK, BOUNDS
from orbit_matter.fluid.fluids import NOWHERE
from orbit_matter.fluid.kernels import Fluid
from orbit_matter.fluid.pairs import LANES, list_nearby, set_list, spread_list
from orbit_matter.self_contact import bucket_of, cell_of

COMPARED = 4096
"""Particles up to which each is compared with all others rather than with those in the cells around it."""
SEARCHERS = wp.constant(4 * BLOCK)
"""Threads that compare the particles of an environment: few environments search at a time, and one block each would
leave most of a GPU empty."""
CLEARERS = wp.constant(64)
"""Threads that empty the cells of an environment."""
MANY = wp.constant(0.25)
"""Part of the particles above which all are searched for; 0.1 to 0.75 cost the same while a cup pours."""
UNSEARCHED = wp.constant(0.5 * NOWHERE)
"""Metres beyond which a particle was not searched yet."""


@wp.kernel(enable_backward=False)
def clear(f: Fluid):
    """Empty the cells, by a few threads for each environment: most of the time there is nothing to do."""
    env, first = wp.tid()
    if f.stale[env] == 1:
        for b in range(first, f.head.shape[1], CLEARERS):
            f.head[env, b] = -1


@wp.kernel(enable_backward=False)
def note(f: Fluid, renewed: int, lanes: int):
    """Note where particles are that are searched, and their walls where they are ``renewed``.

    Each environment has ``lanes`` threads.
    """
    env, lane = wp.tid()
    if f.stale[env] == 1:
        for i in range(lane, f.x.shape[1], lanes):
            note_one(f, renewed, wp.vec3(), env, i)


@wp.func
def note_one(f: Fluid, renewed: int, carried: wp.vec3, env: int, i: int):
    """Note where a particle is that is searched, less what all are ``carried`` since the last search for all."""
    if renewed == 1:
        f.searched[env, i] = f.x[env, i] - carried
        for k in range(f.shape.shape[2]):
            f.shielded[env, i, k] = f.plane[env, i, k]
            if k >= f.walls[env, i]:
                f.shielded[env, i, k] = wp.vec4(0.0, 0.0, 0.0, 1.0e6)
    # Walls come first, and few particles have more than two.
    count = int(0)
    for k in range(f.shape.shape[2]):
        if f.shielded[env, i, k][3] < 1.0e6:
            count += 1
    f.guarded[env, i] = count
    for axis in range(3):
        f.columns[env, axis, i] = f.searched[env, i][axis]


@wp.kernel(enable_backward=False)
def insert(f: Fluid):
    """Put each particle into its cell."""
    env, i = wp.tid()
    if f.stale[env] == 0:
        return
    c = cell_of(f.searched[env, i], f.cell)
    b = bucket_of(c[0], c[1], c[2], f.head.shape[1])
    f.following[env, i] = wp.atomic_exch(f.head, env, b, i)


@wp.func
def height_over(plane: wp.vec4, way: wp.vec3) -> float:
    """Return how far in front of a particle's wall a point is that is so far from the particle."""
    return plane[0] * way[0] + plane[1] * way[1] + plane[2] * way[2] + plane[3]


@wp.func
def is_parted(f: Fluid, env: int, i: int, j: int, way: wp.vec3) -> bool:
    """Return True if a wall parts two particles, ``way`` from the first to the second."""
    found = bool(False)
    for k in range(f.guarded[env, i]):
        own = f.shielded[env, i, k]
        if height_over(own, way) < 0.0:
            # Around an edge particles see each other, and over a seam; a wall between them faces one each way.
            for m in range(f.guarded[env, j]):
                other = f.shielded[env, j, m]
                alike = own[0] * other[0] + own[1] * other[1] + own[2] * other[2]
                if alike < -0.7 and height_over(other, -way) < 0.0:
                    found = True
    return found


@wp.func
def end_list(f: Fluid, env: int, i: int, count: int):
    """Fill a list of so many neighbours up to whole LANES, and write its length."""
    while count % LANES > 0:
        f.neighbours[env, i, count] = f.x.shape[1]
        count += 1
    f.count[env, i] = count


@wp.kernel(enable_backward=False)
def find(f: Fluid):
    """Find the neighbours of each particle that no wall parts from it."""
    env, i = wp.tid()
    if f.stale[env] == 0:
        return
    x, count, most = f.searched[env, i], int(0), f.neighbours.shape[2]
    c = cell_of(x, f.cell)
    # Cells that share a bucket would give a particle twice; each cell therefore takes only particles inside it.
    for a in range(-1, 2):
        for b in range(-1, 2):
            for d in range(-1, 2):
                j = f.head[env, bucket_of(c[0] + a, c[1] + b, c[2] + d, f.head.shape[1])]
                while j >= 0:
                    way = f.searched[env, j] - x
                    if wp.length_sq(way) < f.cell * f.cell and j != i and count < most:
                        own = cell_of(f.searched[env, j], f.cell)
                        if own[0] == c[0] + a and own[1] == c[1] + b and own[2] == c[2] + d:
                            parted = is_parted(f, env, i, j, way)
                            if not parted:
                                f.neighbours[env, i, count] = j
                                count += 1
                    j = f.following[env, j]
    end_list(f, env, i, count)


@wp.func
def leave_parted(f: Fluid, lists: wp.array3d[int], env: int, row: int, i: int, length: int) -> int:
    """Take out of the list of a particle those that walls part from it, and return how many are left."""
    count = int(0)
    for k in range(length):
        j = lists[env, row, k]
        parted = bool(False)
        if f.guarded[env, j] > 0:
            parted = is_parted(f, env, i, j, f.searched[env, j] - f.searched[env, i])
        if not parted:
            lists[env, row, count] = j
            count += 1
    return count


@wp.kernel(enable_backward=False, launch_bounds=BOUNDS)
def compare(f: Fluid):
    """Find neighbours as :func:`find` does, but among all particles, SEARCHERS threads for an environment.

    A GPU waits for each step along the particles of a cell; all threads of a block read the same particle at a time.
    """
    env, lane = wp.tid()
    if f.stale[env] == 0:
        return
    for i in range(lane, f.x.shape[1], SEARCHERS):
        walls = f.guarded[env, i]
        listed = list_nearby(f.searched, f.columns, f.neighbours, f.shielded, walls, env, i, i, f.cell * f.cell)
        count = int(listed[0])
        # Walls in a pass of their own: in the one above most threads would wait for the few that have come near.
        if listed[1] == 1:
            count = leave_parted(f, f.neighbours, env, i, i, listed[0])
        end_list(f, env, i, count)


@wp.kernel(enable_backward=False)
def follow(f: Fluid, most: float, renewed: int):
    """Search anew, among all particles, for those alone that moved by ``most`` since their own last search, apart from
    what all have moved together.

    One thread of a CPU takes an environment: few drops that fall fast make it stale in each substep. Lists are those of
    a search for all of them, from where each was at its last search: one that moved is put into the lists of its new
    neighbours. Where many have moved, and where places are not ``renewed``, all are searched for.
    """
    env = wp.tid()
    if f.stale[env] == 0:
        return
    moved, together = int(0), f.carried[env]
    if renewed == 1:
        for i in range(f.x.shape[1]):
            # As in `meet`, what is not a number has moved.
            if not wp.length_sq(f.x[env, i] - f.searched[env, i] - together) < most * most:
                f.moved[env, moved] = i
                moved += 1
    whole = renewed == 0 or float(moved) > MANY * float(f.x.shape[1]) or f.searched[env, 0][0] > UNSEARCHED
    if not wp.length_sq(together) < f.passed * f.passed:
        whole = True
    if not whole:
        for k in range(moved):
            note_one(f, 1, together, env, f.moved[env, k])
        whole = not spread(f, env, moved)
    if whole:
        if renewed == 1:
            f.carried[env] = wp.vec3()
        for i in range(f.x.shape[1]):
            note_one(f, renewed, wp.vec3(), env, i)
        for i in range(f.x.shape[1]):
            found = look_around(f, env, i)
            set_list(f.neighbours, f.count, f.nearby, found, env, i)


@wp.func
def look_around(f: Fluid, env: int, i: int) -> int:
    """List the neighbours of a particle beside all lists, and return how many there are."""
    walls = f.guarded[env, i]
    listed = list_nearby(f.searched, f.columns, f.nearby, f.shielded, walls, env, 0, i, f.cell * f.cell)
    count = int(listed[0])
    if listed[1] == 1:
        count = leave_parted(f, f.nearby, env, 0, i, listed[0])
    return count


@wp.func
def spread(f: Fluid, env: int, moved: int) -> bool:
    """Bring lists up to date with so many particles that moved; return False where a list is full."""
    done, k = bool(True), int(0)
    while done and k < moved:
        i = f.moved[env, k]
        found = look_around(f, env, i)
        done = spread_list(f.neighbours, f.count, f.nearby, found, env, i)
        set_list(f.neighbours, f.count, f.nearby, found, env, i)
        k += 1
    return done
