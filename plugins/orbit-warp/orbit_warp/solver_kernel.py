"""Newton's method of MuJoCo-Warp for a world in a block of one warp: all rounds in one launch.

Each lane keeps what belongs to its degree of freedom in registers, and goes through every 32nd constraint row. States
and forces of rows, and what they cost along a line, are computed by MuJoCo-Warp's own functions; sums over rows run
in another order.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportPrivateUsage=false, reportReturnType=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import functools
from typing import Any

import warp as wp
from mujoco_warp._src import solver, types

from orbit_warp.lanes import LANES, four, meet, of_lane, of_lane16, total, total3
from orbit_warp.solver_arrays import Contacts, Found, Inertia, Limits, Rows, Work
from orbit_warp.solver_line import line_search, prepare_cone

_CONE = wp.constant(int(types.ConstraintState.CONE))
_QUADRATIC = wp.constant(int(types.ConstraintState.QUADRATIC))
_ELLIPTIC = wp.constant(int(types.ConstraintType.CONTACT_ELLIPTIC))
_LEAST = wp.constant(float(types.MJ_MINVAL))
_eval_constraint = solver._eval_constraint
# Worlds that a multiprocessor solves at a time; more would leave each lane less than 128 registers.
_BLOCKS = 16


@wp.func
def publish(work: Work, world: int, lane: int, value: float):
    """Let all lanes read a vector of which each has one entry."""
    meet()
    if lane < work.vector.shape[1]:
        work.vector[world, lane] = value
    meet()


@wp.func
def row_product(jacobian: wp.array2d[float], vector: wp.array2d[float], world: int, row: int) -> float:
    result = float(0.0)
    for quarter in range(vector.shape[1] // 4):
        result += wp.dot(four(jacobian, row, quarter), four(vector, world, quarter))
    return result


@wp.func
def inertia_product(inertia: Inertia, vector: wp.array2d[float], world: int, dof: int) -> float:
    result = float(0.0)
    for k in range(inertia.starts[dof], inertia.starts[dof + 1]):
        result += inertia.values[world, inertia.row_entries[k]] * vector[world, inertia.row_columns[k]]
    return result


@wp.func
def force_product(rows: Rows, found: Found, world: int, dof: int, count: int) -> float:
    result = float(0.0)
    for row in range(count):
        result += rows.jacobian[world, row, dof] * found.force[world, row]
    return result


@wp.func
def update_row(
    narrowing: float, rows: Rows, contacts: Contacts, work: Work, found: Found, world: int, row: int
) -> bool:
    """Write a row's force and state. Return True if the state is another than before."""
    equalities, frictions = rows.equalities[world], rows.frictions[world]
    is_equality = row < equalities
    is_friction = (not is_equality) and row < equalities + frictions
    is_cone = rows.kinds[world, row] == _ELLIPTIC
    bound = float(0.0)
    if is_friction:
        bound = rows.friction_bounds[world, row]
    first = int(-1)
    first_residual, first_stiffness = float(0.0), float(0.0)
    mu, scaled, tangent = float(0.0), float(0.0), float(0.0)
    if is_cone:
        contact = rows.ids[world, row]
        if contact >= contacts.count[0]:
            return False
        first = contacts.addresses[contact, 0]
        if first < 0:
            return False
        friction = contacts.friction[contact]
        mu = friction[0] * narrowing
        first_residual = work.residual[world, first]
        first_stiffness = rows.stiffness[world, first]
        for j in range(1, contacts.dimensions[contact]):
            other = contacts.addresses[contact, j]
            if other < 0:
                return False
            u = work.residual[world, other] * friction[j - 1]
            tangent += u * u
            if row == other:
                scaled = u * friction[j - 1]
    result = _eval_constraint(
        is_equality, is_friction, is_cone, work.residual[world, row], rows.stiffness[world, row], bound,
        row, first, first_residual, first_stiffness, mu, scaled, tangent,
    )  # fmt: skip
    state = int(result[1])
    changed = found.state[world, row] != state
    found.force[world, row] = result[0]
    found.state[world, row] = state
    return changed


@wp.func
def cone_block(
    narrowing: float, rows: Rows, contacts: Contacts, work: Work, world: int, row: int, i: int, j: int
) -> wp.mat44:
    """Four by four entries of the Hessian of a contact between the cone's surface and its polar's."""
    contact = rows.ids[world, row]
    condim = contacts.dimensions[contact]
    if contacts.addresses[contact, 0] != row or condim == 1:
        return wp.mat44()
    if contacts.distances[contact] - contacts.margins[contact] >= 0.0:
        return wp.mat44()
    friction = contacts.friction[contact]
    mu = friction[0] * narrowing
    mu2 = mu * mu
    across = mu2 * (1.0 + mu2)
    dm = rows.stiffness[world, row] / wp.where(across != 0.0, across, _LEAST)
    jacobian = rows.jacobian[world]
    tt = float(0.0)
    for d in range(1, condim):
        other = contacts.addresses[contact, d]
        if other >= 0:
            u = work.residual[world, other] * friction[d - 1]
            tt += u * u
    inverse = 1.0 / wp.max(wp.sqrt(tt), _LEAST)
    ratio = mu * (work.residual[world, row] * mu) * inverse
    normal_i, normal_j = mu * four(jacobian, row, i), mu * four(jacobian, row, j)
    along_i, along_j = wp.vec4(), wp.vec4()
    result = wp.mat44()
    for d in range(1, condim):
        other = contacts.addresses[contact, d]
        if other >= 0:
            scale = friction[d - 1]
            u = work.residual[world, other] * scale
            z_i, z_j = scale * four(jacobian, other, i), scale * four(jacobian, other, j)
            along_i += u * z_i
            along_j += u * z_j
            result += wp.outer((mu2 - ratio) * z_i, z_j)
    along_i *= inverse
    along_j *= inverse
    result += wp.outer(normal_i - mu * along_i, normal_j) + wp.outer(ratio * along_i - mu * normal_i, along_j)
    return dm * result


@wp.func
def hessian_block(
    narrowing: float, rows: Rows, contacts: Contacts, work: Work, found: Found, world: int, count: int,
    first: int, step: int, block: int,
) -> wp.mat44:  # fmt: skip
    """Four by four entries of the Hessian of every ``step``-th row."""
    i, j = block_place(block)
    jacobian = rows.jacobian[world]
    result = wp.mat44()
    for row in range(first, count, step):
        state = found.state[world, row]
        if state == _QUADRATIC:
            result += wp.outer(rows.stiffness[world, row] * four(jacobian, row, i), four(jacobian, row, j))
        if state == _CONE:
            result += cone_block(narrowing, rows, contacts, work, world, row, i, j)
    return result


@wp.func
def block_place(block: int) -> tuple[int, int]:
    """Row and column of a block in the upper triangle of blocks."""
    j = int(0)
    while (j + 1) * (j + 2) // 2 <= block:
        j += 1
    return block - j * (j + 1) // 2, j


@wp.func
def assemble(
    narrowing: float, inertia: Inertia, rows: Rows, contacts: Contacts, work: Work, found: Found,
    world: int, lane: int, count: int,
):  # fmt: skip
    """Write the upper triangle of inertia and the rows' Hessian."""
    quarters = work.vector.shape[1] // 4
    blocks = quarters * (quarters + 1) // 2
    # Where blocks are few several lanes share each one's rows.
    groups = wp.max(LANES // blocks, 1)
    for start in range(0, blocks, LANES):
        group = int(0)
        block = start + lane
        if groups > 1:
            group = lane // blocks
            block = lane - group * blocks
        has = group < groups and block < blocks
        part = wp.mat44()
        if has:
            part = hessian_block(narrowing, rows, contacts, work, found, world, count, group, groups, block)
        whole = 1.0 * part
        for turn in range(1, groups):
            whole += of_lane16(part, wp.min(lane + turn * blocks, LANES - 1))
        if has and group == 0:
            i, j = block_place(block)
            for a in range(4):
                for b in range(4):
                    work.hessian[world, 4 * i + a, 4 * j + b] = whole[a, b]
    meet()
    for entry in range(lane, inertia.rows.shape[0], LANES):
        work.hessian[world, inertia.columns[entry], inertia.rows[entry]] += inertia.values[world, entry]
    meet()


@wp.func
def solve_factored(work: Work, world: int, lane: int, nv: int, side: float) -> float:
    """Factor the Hessian in its place, and return a lane's entry of the solution."""
    y = side
    own_inverse = float(0.0)
    for k in range(nv):
        s = float(0.0)
        if k <= lane and lane < nv:
            s = work.hessian[world, k, lane]
            for j in range(k):
                s -= work.hessian[world, j, lane] * work.hessian[world, j, k]
        inverse = 1.0 / wp.sqrt(of_lane(s, k))
        y_k = of_lane(y, k) * inverse
        if k < lane and lane < nv:
            u = s * inverse
            y -= u * y_k
            work.hessian[world, k, lane] = u
            work.hessian[world, lane, k] = u  # for the way back, where lanes read a row rather than a column
        if lane == k:
            y = y_k
            own_inverse = inverse
        meet()
    for back in range(nv):
        k = nv - 1 - back
        x = of_lane(y * own_inverse, k)
        if lane < k:
            y -= work.hessian[world, k, lane] * x
        if lane == k:
            y = x
    return y


@functools.cache
def solver_kernel(elliptic: bool, line_iterations: int) -> Any:
    """Return the kernel, to be launched with a block of ``LANES`` threads for each world.

    Args:
        elliptic: whether contacts have elliptic friction cones.
        line_iterations: the most steps of a line search.
    """
    search_line = line_search(elliptic, line_iterations)
    # Without elliptic cones the cost is quadratic as long as no row changes its state: MuJoCo-Warp then keeps the
    # search direction, whose gradient has only been scaled, and so does this.
    keeps_direction = not elliptic

    # As the line search of MuJoCo-Warp: only division and square root are approximate, to 2 units in the last place.
    @wp.kernel(
        module="unique",
        enable_backward=False,
        grid_stride=False,
        module_options={"fast_math": True},
        launch_bounds=(LANES, _BLOCKS),
    )
    def solve_worlds(
        nv: int, warm: bool, limits: Limits, inertia: Inertia, rows: Rows, contacts: Contacts,
        warm_start: wp.array2d[float], free_acceleration: wp.array2d[float], free_force: wp.array2d[float],
        work: Work, found: Found,
    ):  # fmt: skip
        world, lane = wp.tid()
        own = lane < nv
        count = wp.min(rows.most, rows.counts[world])
        equalities = rows.equalities[world]
        tolerance = limits.tolerance[world % limits.tolerance.shape[0]]
        line_tolerance = limits.line_tolerance[world % limits.line_tolerance.shape[0]]
        narrowing = limits.narrowing[world % limits.narrowing.shape[0]]
        jacobian = rows.jacobian[world]

        # The first guess, and what it means for each row.
        free, acceleration, diagonal = float(0.0), float(0.0), float(0.0)
        if own:
            free = free_force[world, lane]
            acceleration = free_acceleration[world, lane]
            if warm and count > 0:
                acceleration = warm_start[world, lane]
            diagonal = inertia.values[world, inertia.diagonal_starts[lane] + inertia.diagonal_counts[lane] - 1]
        scale = 1.0 / wp.max(_LEAST, total(diagonal))
        publish(work, world, lane, acceleration)
        momentum = float(0.0)
        if own:
            momentum = inertia_product(inertia, work.vector, world, lane)
        for row in range(lane, count, LANES):
            work.residual[world, row] = row_product(jacobian, work.vector, world, row) - rows.reference[world, row]
        meet()
        for row in range(lane, count, LANES):
            update_row(narrowing, rows, contacts, work, found, world, row)
        meet()

        # Gradient and search direction; what follows updates them at the end of each round.
        force, gradient, search, along = float(0.0), float(0.0), float(0.0), float(0.0)
        gradient_square, search_square, decrement = float(0.0), float(0.0), float(0.0)
        gradient_scale, changed = float(1.0), bool(True)
        alpha, improvement = float(0.0), float(0.0)
        rounds = int(0)
        while True:
            if changed:
                if own:
                    force = force_product(rows, found, world, lane, count)
                    gradient = momentum - free - force
                gradient_square = total(gradient * gradient)
                assemble(narrowing, inertia, rows, contacts, work, found, world, lane, count)
                solution = solve_factored(work, world, lane, nv, gradient)
                both = total3(wp.vec3(solution * solution, gradient * solution, 0.0))
                search, search_square, decrement, gradient_scale = -solution, both[0], both[1], 1.0
            else:
                scaled = gradient_scale - alpha
                ratio = float(0.0)
                if gradient_scale != 0.0:
                    ratio = scaled / gradient_scale
                gradient_square *= ratio * ratio
                decrement *= ratio * ratio
                gradient_scale = scaled

            if rounds > 0:
                done = (
                    alpha == 0.0
                    or (scale * improvement > 0.0 and scale * improvement < tolerance)
                    or scale * wp.sqrt(gradient_square) < tolerance
                    or scale * 0.5 * decrement < tolerance
                )
                if not done and rounds == limits.iterations and lane == 0:
                    found.overflow[world] = found.overflow[world] | wp.static(int(types.OverflowType.ITERATIONS))
                if done or rounds == limits.iterations:
                    break
            rounds += 1

            # The line search.
            if changed:
                publish(work, world, lane, search)
                if own:
                    along = inertia_product(inertia, work.vector, world, lane)
                for row in range(lane, count, LANES):
                    work.slope[world, row] = row_product(jacobian, work.vector, world, row)
                meet()
            if wp.static(elliptic):
                for row in range(lane, count, LANES):
                    if rows.kinds[world, row] == _ELLIPTIC:
                        prepare_cone(narrowing, rows, contacts, work, world, row)
                meet()
            part = wp.vec3(0.0, search * (momentum - free), 0.5 * search * along)
            for row in range(lane, equalities, LANES):
                slope = work.slope[world, row]
                scaled_slope = slope * rows.stiffness[world, row]
                part += wp.vec3(0.0, scaled_slope * work.residual[world, row], 0.5 * slope * scaled_slope)
            gtol = wp.max(tolerance * line_tolerance * wp.sqrt(search_square) / scale, 1e-6)
            line = search_line(narrowing, rows, contacts, work, world, lane, count, total3(part), gtol)
            alpha = line.alpha
            improvement = line.improvement
            if not line.converged and lane == 0:
                found.overflow[world] = found.overflow[world] | wp.static(int(types.OverflowType.LS_ITERATIONS))

            # The step.
            acceleration += alpha * search
            momentum += alpha * along
            for row in range(lane, count, LANES):
                work.residual[world, row] += alpha * work.slope[world, row]
            meet()
            changes = float(0.0)
            for row in range(lane, count, LANES):
                if update_row(narrowing, rows, contacts, work, found, world, row):
                    changes += 1.0
            meet()
            if wp.static(keeps_direction):
                changed = total(changes) > 0.0 or wp.abs(alpha) < line.noise

        if own:
            found.acceleration[world, lane] = acceleration
            found.momentum[world, lane] = momentum
            if wp.static(keeps_direction):
                force = momentum - free - gradient_scale * gradient
            found.constraint_force[world, lane] = force
        if lane == 0:
            found.rounds[world] = rounds

    return solve_worlds
