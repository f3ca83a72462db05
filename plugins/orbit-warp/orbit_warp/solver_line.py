"""Line search of the solver in one launch: that of MuJoCo-Warp (``_linesearch_iterative_kernel``), step by step.

What rows cost along a line is computed by MuJoCo-Warp's own functions.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportPrivateUsage=false, reportReturnType=false
# ruff: noqa: UP018 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import functools
from typing import Any

import warp as wp
from mujoco_warp._src import solver, types

from orbit_warp.lanes import LANES, total3, total9
from orbit_warp.solver_arrays import Contacts, Rows, Work, vec5

_ELLIPTIC = wp.constant(int(types.ConstraintType.CONTACT_ELLIPTIC))
_LEAST = wp.constant(float(types.MJ_MINVAL))
_NOISE = wp.constant(solver._ALPHA_NOISE_EPS)
_eval_pt = solver._eval_pt
_eval_pt_3alphas = solver._eval_pt_3alphas
_in_bracket = solver._in_bracket


@wp.struct
class Line:
    """Result of a search along a line."""

    alpha: float
    """Step along the line."""
    improvement: float
    """Decrease of the cost, in J."""
    noise: float
    """Least step that is more than rounding."""
    converged: bool
    """True if no step lowers the cost any more."""


@wp.struct
class ConeLine:
    """An elliptic contact along a line."""

    friction: vec5
    """Coefficients of sliding, turning and rolling."""
    row: int
    """Its first row."""
    quad: wp.vec3
    """Coefficients of the normal's cost as a polynomial of the step."""
    quad1: wp.vec3
    """Normal residual and slope times the cone's friction, and the squared tangential residual."""
    quad2: wp.vec3
    """Product of tangential residual and slope, squared slope, and the cone's stiffness."""


@wp.func
def cone_line(rows: Rows, contacts: Contacts, work: Work, world: int, row: int) -> ConeLine:
    line = ConeLine()
    contact = rows.ids[world, row]
    line.friction = contacts.friction[contact]
    line.row = contacts.addresses[contact, 0]
    line.quad = work.quad[world, row]
    line.quad1 = work.quad[world, contacts.addresses[contact, 1]]
    line.quad2 = work.quad[world, contacts.addresses[contact, 2]]
    return line


@wp.func
def prepare_cone(narrowing: float, rows: Rows, contacts: Contacts, work: Work, world: int, row: int):
    """Write a contact's cost along the line, if the row is its first."""
    contact = rows.ids[world, row]
    if contact >= contacts.count[0]:
        return
    if contacts.addresses[contact, 0] != row:
        return
    residual, slope, stiffness = work.residual[world, row], work.slope[world, row], rows.stiffness[world, row]
    scaled = slope * stiffness
    quad = wp.vec3(0.5 * residual * residual * stiffness, scaled * residual, 0.5 * slope * scaled)
    friction = contacts.friction[contact]
    mu = friction[0] * narrowing
    uu, uv, vv = float(0.0), float(0.0), float(0.0)
    for j in range(1, contacts.dimensions[contact]):
        other = contacts.addresses[contact, j]
        if other >= 0:
            slope_j, residual_j, stiffness_j = (
                work.slope[world, other],
                work.residual[world, other],
                rows.stiffness[world, other],
            )
            scaled_j = stiffness_j * residual_j
            quad += wp.vec3(0.5 * residual_j * scaled_j, slope_j * scaled_j, 0.5 * slope_j * stiffness_j * slope_j)
            u, v = residual_j * friction[j - 1], slope_j * friction[j - 1]
            uu += u * u
            uv += u * v
            vv += v * v
    mu2 = mu * mu
    work.quad[world, row] = quad
    work.quad[world, contacts.addresses[contact, 1]] = wp.vec3(residual * mu, slope * mu, uu)
    work.quad[world, contacts.addresses[contact, 2]] = wp.vec3(uv, vv, stiffness / (mu2 * (1.0 + mu2)))


def _elliptic_points():
    """Cost, slope and curvature of a row along the line where contacts have elliptic cones."""

    @wp.func
    def at_zero(narrowing: float, rows: Rows, contacts: Contacts, work: Work, world: int, row: int) -> wp.vec3:
        kind = rows.kinds[world, row]
        line = ConeLine()
        if kind == _ELLIPTIC:
            line = cone_line(rows, contacts, work, world, row)
        return solver._compute_efc_eval_pt_alpha_zero_elliptic(
            row, rows.equalities[world], rows.frictions[world], narrowing, kind, rows.stiffness[world],
            rows.friction_bounds[world], work.residual[world, row], work.slope[world, row],
            line.quad, line.friction, line.row, line.quad1, line.quad2,
        )  # fmt: skip

    @wp.func
    def at_one(
        narrowing: float, rows: Rows, contacts: Contacts, work: Work, world: int, row: int, alpha: float
    ) -> wp.vec3:
        kind = rows.kinds[world, row]
        line = ConeLine()
        if kind == _ELLIPTIC:
            line = cone_line(rows, contacts, work, world, row)
        return solver._compute_efc_eval_pt_elliptic(
            row, alpha, rows.equalities[world], rows.frictions[world], narrowing, kind, rows.stiffness[world],
            rows.friction_bounds[world], work.residual[world, row], work.slope[world, row],
            line.quad, line.friction, line.row, line.quad1, line.quad2,
        )  # fmt: skip

    @wp.func
    def at_three(
        narrowing: float, rows: Rows, contacts: Contacts, work: Work, world: int, row: int,
        low: float, high: float, middle: float,
    ) -> tuple[wp.vec3, wp.vec3, wp.vec3]:  # fmt: skip
        kind = rows.kinds[world, row]
        line = ConeLine()
        if kind == _ELLIPTIC:
            line = cone_line(rows, contacts, work, world, row)
        a, b, c = solver._compute_efc_eval_pt_3alphas_elliptic(
            row, low, high, middle, rows.equalities[world], rows.frictions[world], narrowing, kind,
            rows.stiffness[world], rows.friction_bounds[world], work.residual[world, row], work.slope[world, row],
            line.quad, line.friction, line.row, line.quad1, line.quad2,
        )  # fmt: skip
        return a, b, c

    return at_zero, at_one, at_three


def _pyramidal_points():
    """Cost, slope and curvature of a row along the line where contacts have pyramids."""

    @wp.func
    def at_zero(narrowing: float, rows: Rows, contacts: Contacts, work: Work, world: int, row: int) -> wp.vec3:
        return solver._compute_efc_eval_pt_alpha_zero_pyramidal(
            row, rows.equalities[world], rows.frictions[world], rows.stiffness[world, row],
            rows.friction_bounds[world], work.residual[world, row], work.slope[world, row],
        )  # fmt: skip

    @wp.func
    def at_one(
        narrowing: float, rows: Rows, contacts: Contacts, work: Work, world: int, row: int, alpha: float
    ) -> wp.vec3:
        return solver._compute_efc_eval_pt_pyramidal(
            row, alpha, rows.equalities[world], rows.frictions[world], rows.stiffness[world, row],
            rows.friction_bounds[world], work.residual[world, row], work.slope[world, row],
        )  # fmt: skip

    @wp.func
    def at_three(
        narrowing: float, rows: Rows, contacts: Contacts, work: Work, world: int, row: int,
        low: float, high: float, middle: float,
    ) -> tuple[wp.vec3, wp.vec3, wp.vec3]:  # fmt: skip
        a, b, c = solver._compute_efc_eval_pt_3alphas_pyramidal(
            row, low, high, middle, rows.equalities[world], rows.frictions[world], rows.stiffness[world, row],
            rows.friction_bounds[world], work.residual[world, row], work.slope[world, row],
        )  # fmt: skip
        return a, b, c

    return at_zero, at_one, at_three


@functools.cache
def line_search(elliptic: bool, iterations: int) -> Any:
    """Return the function that searches along a line.

    Args:
        elliptic: whether contacts have elliptic friction cones.
        iterations: the most steps.
    """
    at_zero, at_one, at_three = _elliptic_points() if elliptic else _pyramidal_points()

    @wp.func
    def search_line(
        narrowing: float, rows: Rows, contacts: Contacts, work: Work, world: int, lane: int, count: int,
        smooth: wp.vec3, gtol: float,
    ) -> Line:  # fmt: skip
        begin = rows.equalities[world] + lane
        part0 = wp.vec3()
        for row in range(begin, count, LANES):
            part0 += at_zero(narrowing, rows, contacts, work, world, row)
        sums = total3(part0)
        p0 = wp.vec3(smooth[0], smooth[1], 2.0 * smooth[2]) + sums
        p0_delta = wp.vec3(0.0, p0[1], p0[2])
        gross = wp.sqrt(2.0 * wp.max(sums[0], 0.0) * wp.max(sums[2], 0.0)) + wp.abs(smooth[1])
        accepted = wp.max(gtol, _NOISE * gross)
        result = Line()
        result.noise = _NOISE * wp.max(1.0, gross / wp.where(p0[2] != 0.0, p0[2], _LEAST))
        alpha, improvement = float(0.0), float(0.0)
        converged = wp.abs(p0[1]) < _NOISE * gross
        first_alpha = -p0[1] / wp.where(p0[2] != 0.0, p0[2], _LEAST)
        first = wp.vec3()
        if not converged:
            part1 = wp.vec3()
            for row in range(begin, count, LANES):
                part1 += at_one(narrowing, rows, contacts, work, world, row, first_alpha)
            first = _eval_pt(smooth, first_alpha) + total3(part1)
            if wp.abs(first[1]) < accepted and first[0] < 0.0:
                converged = True
                alpha = first_alpha
                improvement = -first[0]
        if not converged:
            less = first[1] < p0[1]
            lo, hi = wp.where(less, first, p0_delta), wp.where(less, p0_delta, first)
            lo_alpha, hi_alpha = wp.where(less, first_alpha, 0.0), wp.where(less, 0.0, first_alpha)
            for _ in range(wp.static(iterations)):
                lo_next_alpha = lo_alpha - lo[1] / wp.where(lo[2] != 0.0, lo[2], _LEAST)
                hi_next_alpha = hi_alpha - hi[1] / wp.where(hi[2] != 0.0, hi[2], _LEAST)
                mid_alpha = 0.5 * (lo_alpha + hi_alpha)
                part_lo, part_hi, part_mid = wp.vec3(), wp.vec3(), wp.vec3()
                for row in range(begin, count, LANES):
                    row_lo, row_hi, row_mid = at_three(
                        narrowing, rows, contacts, work, world, row, lo_next_alpha, hi_next_alpha, mid_alpha
                    )
                    part_lo += row_lo
                    part_hi += row_hi
                    part_mid += row_mid
                together = total9(wp.matrix_from_rows(part_lo, part_hi, part_mid))
                of_lo, of_hi, of_mid = _eval_pt_3alphas(smooth, lo_next_alpha, hi_next_alpha, mid_alpha)
                lo_next, hi_next, mid = of_lo + together[0], of_hi + together[1], of_mid + together[2]
                # The converged candidate of the lowest cost, whatever the sign of its slope.
                lo_fits = wp.abs(lo_next[1]) < accepted and lo_next[0] < 0.0
                hi_fits = wp.abs(hi_next[1]) < accepted and hi_next[0] < 0.0
                mid_fits = wp.abs(mid[1]) < accepted and mid[0] < 0.0
                fits = lo_fits or hi_fits or mid_fits
                swap_lo, swap_hi = bool(False), bool(False)
                if fits:
                    best, best_alpha = wp.vec3(types.MJ_MAXVAL, 0.0, 0.0), float(0.0)
                    if lo_fits and lo_next[0] < best[0]:
                        best, best_alpha = lo_next, lo_next_alpha
                    if hi_fits and hi_next[0] < best[0]:
                        best, best_alpha = hi_next, hi_next_alpha
                    if mid_fits and mid[0] < best[0]:
                        best, best_alpha = mid, mid_alpha
                    lo, lo_alpha = best, best_alpha
                    hi, hi_alpha = best, best_alpha
                else:
                    swap = _in_bracket(lo, lo_next)
                    lo, lo_alpha = wp.where(swap, lo_next, lo), wp.where(swap, lo_next_alpha, lo_alpha)
                    swap_lo = swap
                    swap = _in_bracket(lo, mid)
                    lo, lo_alpha = wp.where(swap, mid, lo), wp.where(swap, mid_alpha, lo_alpha)
                    swap_lo = swap_lo or swap
                    swap = _in_bracket(lo, hi_next)
                    lo, lo_alpha = wp.where(swap, hi_next, lo), wp.where(swap, hi_next_alpha, lo_alpha)
                    swap_lo = swap_lo or swap
                    swap = _in_bracket(hi, hi_next) or (hi[1] < 0.0 and hi_next[1] > 0.0)
                    hi, hi_alpha = wp.where(swap, hi_next, hi), wp.where(swap, hi_next_alpha, hi_alpha)
                    swap_hi = swap
                    swap = _in_bracket(hi, mid)
                    hi, hi_alpha = wp.where(swap, mid, hi), wp.where(swap, mid_alpha, hi_alpha)
                    swap_hi = swap_hi or swap
                    swap = _in_bracket(hi, lo_next)
                    hi, hi_alpha = wp.where(swap, lo_next, hi), wp.where(swap, lo_next_alpha, hi_alpha)
                    swap_hi = swap_hi or swap
                ended = (
                    fits
                    or (not swap_lo and not swap_hi)
                    or (lo[0] < 0.0 and lo[1] < 0.0 and lo[1] > -gtol)
                    or (hi[0] < 0.0 and hi[1] > 0.0 and hi[1] < gtol)
                )
                if lo[0] < 0.0 or hi[0] < 0.0:
                    better = lo[0] < hi[0]
                    alpha = wp.where(better, lo_alpha, hi_alpha)
                    improvement = -wp.where(better, lo[0], hi[0])
                if ended:
                    converged = True
                    break
        result.alpha = alpha
        result.improvement = improvement
        result.converged = converged
        return result

    return search_line
