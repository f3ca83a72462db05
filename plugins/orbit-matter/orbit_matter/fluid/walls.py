"""Lattices of particles at rest that fill walls, summed where they are within the kernel of a particle.

A wall presses on a liquid, and takes of its flow, as liquid that stands in its place would. A box has the lattice that
divides it into whole cells, so that its edges and corners count as what they are. Behind a face that the particle is
in front of the lattice goes on beyond the box's other side: a thin wall holds as a thick one does, and a particle on
its other side sees the cells behind its own face. Other shapes have the lattice of the half-space behind their nearest
point.

Samples are written down nowhere: a lattice is found again from the place of the particle in the shape's frame.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

THIN = wp.constant(0.4)
"""Spacings between layers at least: walls that are thinner are filled beyond their other side."""
ENDLESS = wp.constant(1000)
"""Cells along an axis that has no end."""
WIDE = wp.constant(17)
"""Cells across a half-space: more than a kernel reaches, and odd, so that one is behind the particle."""

Filled = wp.types.vector(length=14, dtype=float)
"""Sums over a lattice: of its volume times the kernel's slope, as vectors, once as it is and once times the pull to
each cell; of the kernel; of the first two along the normals of two planes, behind each; and times the flow's shock."""

_FILLED = """
#ifdef __CUDA_ARCH__
    typedef float Lanes;
    const int step = 1;
    const Lanes first = 0.0f;
    const auto root = [](Lanes a) { asm("sqrt.approx.f32 %0, %0;" : "+f"(a)); return a; };
    const auto ratio = [](Lanes a, Lanes b) { return __fdividef(a, b); };
    const auto positive = [](Lanes a) { return fmaxf(a, 0.0f); };
    const auto smaller = [](Lanes a) { return fminf(a, 1.0f); };
    const auto sum = [](Lanes a) { return a; };
#else
    typedef float Lanes __attribute__((ext_vector_type(8)));
    const int step = 8;
    const Lanes first = {0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f};
    const auto root = [](Lanes a) { return __builtin_elementwise_sqrt(a); };
    const auto ratio = [](Lanes a, Lanes b) { return a / b; };
    const auto positive = [](Lanes a) { return __builtin_elementwise_max(a, Lanes(0.0f)); };
    const auto smaller = [](Lanes a) { return __builtin_elementwise_min(a, Lanes(1.0f)); };
    const auto sum = [](Lanes a) { return ((a[0] + a[1]) + (a[2] + a[3])) + ((a[4] + a[5]) + (a[6] + a[7])); };
#endif
    const float reach = 1.0f / half, most = reach * reach;
    // Cells of an axis that the kernel reaches.
    int begin[3], end[3];
    for (int k = 0; k < 3; ++k) {
        const float size = fabsf(cell[k]);
        const float middle = -at[k] / cell[k];
        begin[k] = static_cast<int>(ceilf(middle - reach / size));
        if (begin[k] < 0) begin[k] = 0;
        end[k] = static_cast<int>(floorf(middle + reach / size)) + 1;
        if (end[k] > last[k]) end[k] = last[k];
        if (begin[k] >= end[k]) return wp::vec_t<14, wp::float32>();
    }
    Lanes s[14];
    for (int k = 0; k < 14; ++k) s[k] = 0.0f;
    const bool is_corner = one[3] < 1e5f, is_blow = flow[0] != 0.0f || flow[1] != 0.0f || flow[2] != 0.0f;
    for (int c = begin[2]; c < end[2]; ++c) {
        const float z = -(at[2] + c * cell[2]);
        for (int b = begin[1]; b < end[1]; ++b) {
            const float y = -(at[1] + b * cell[1]);
            const float beside = y * y + z * z;
            const int beyond = (c >= inside[2]) + (b >= inside[1]);
            if (beside >= most || beyond > 1) continue;
            // Behind one face only: what is beyond the box on two sides is neither's.
            const int stop = beyond && end[0] > inside[0] ? inside[0] : end[0];
            for (int a = begin[0]; a < stop; a += step) {
                const Lanes index = first + static_cast<float>(a);
                const Lanes x = -(at[0] + index * cell[0]);
                const Lanes square = x * x + beside;
                const Lanes t = positive(1.0f - root(square) * half);
                const Lanes rest = positive(1.0f - square * (half * half));
                Lanes here = smaller(positive(static_cast<float>(stop) - index));
                Lanes behind_one = 0.0f, behind_two = 0.0f;
                if (is_corner) {
                    behind_one = smaller(positive(x * one[0] + (y * one[1] + z * one[2] - one[3])) * 1e9f);
                    behind_two = smaller(positive(x * two[0] + (y * two[1] + z * two[2] - two[3])) * 1e9f);
                    here = here * (1.0f - skip_one * behind_one) * (1.0f - skip_two * behind_two);
                }
                const Lanes part = here * t * t * t;
                const Lanes pulled = part * (x * pull[0] + (y * pull[1] + z * pull[2]));
                s[0] += x * part;
                s[1] += y * part;
                s[2] += z * part;
                s[3] += x * pulled;
                s[4] += y * pulled;
                s[5] += z * pulled;
                s[6] += here * (rest * rest) * (rest * rest);
                if (is_corner) {
                    const Lanes along_one = behind_one * (x * one[0] + (y * one[1] + z * one[2]));
                    const Lanes along_two = behind_two * (x * two[0] + (y * two[1] + z * two[2]));
                    s[7] += along_one * part;
                    s[8] += along_one * pulled;
                    s[9] += along_two * part;
                    s[10] += along_two * pulled;
                }
                if (is_blow) {
                    const Lanes along = positive(x * flow[0] + (y * flow[1] + z * flow[2]));
                    const Lanes closing = ratio(along * length, square + soft);
                    const Lanes shocked = part * closing * closing;
                    s[11] += x * shocked;
                    s[12] += y * shocked;
                    s[13] += z * shocked;
                }
            }
        }
    }
    wp::vec_t<14, wp::float32> found;
    for (int k = 0; k < 14; ++k) found[k] = 0.0f;
    for (int k = 0; k < 7; ++k) found[k] = sum(s[k]);
    if (is_corner) for (int k = 7; k < 11; ++k) found[k] = sum(s[k]);
    if (is_blow) for (int k = 11; k < 14; ++k) found[k] = sum(s[k]);
    return found;
"""


@wp.func_native(_FILLED)
def filled_by(
    at: wp.vec3,
    cell: wp.vec3,
    inside: wp.vec3i,
    last: wp.vec3i,
    half: float,
    length: float,
    soft: float,
    pull: wp.vec3,
    flow: wp.vec3,
    one: wp.vec4,
    two: wp.vec4,
    skip_one: float,
    skip_two: float,
) -> Filled:
    """Sum over the cells of a lattice that are within the kernel around the origin.

    Args:
        at: of the first cell, in metres from the particle.
        cell: from one cell to the next along each axis, in metres; negative where they go the other way.
        inside: cells of each axis that are in the shape.
        last: cells of each axis, with those behind a face.
        half: over the smoothing length, in 1/m.
        length: of smoothing in metres.
        soft: m^2 that keep the shock of a cell at the particle finite.
        pull: gravity, in m/s^2.
        flow: of the shape against the particle, in m/s.
        one: plane of another wall, its normal and its distance in metres.
        two: plane of a second one.
        skip_one: 1 where cells behind the first plane are the other wall's, else 0.
        skip_two: the same for the second plane.
    """


@wp.struct
class Lattice:
    """Cells of a wall as :func:`filled_by` takes them."""

    at: wp.vec3
    """Middle of the first cell from the particle, in metres along the wall's axes."""
    cell: wp.vec3
    """Edges of a cell along the axes in metres, negative where cells are counted the other way."""
    inside: wp.vec3i
    """Cells of the shape itself along each axis."""
    last: wp.vec3i
    """Cells along each axis with those beyond the shape's other side."""
    volume: float
    """m^3 of a cell."""


@wp.func
def lattice_of_box(p: wp.vec3, half: wp.vec3, spacing: float) -> Lattice:
    """Return the cells of a box of half extents around a point in its frame, seen from there."""
    made = Lattice()
    # From inside, as the liquid has come in: through the nearest face.
    q = wp.vec3(wp.abs(p[0]) - half[0], wp.abs(p[1]) - half[1], wp.abs(p[2]) - half[2])
    nearest = wp.max(q[0], wp.max(q[1], q[2]))
    made.volume = 1.0
    for k in range(3):
        count = wp.max(int(wp.round(2.0 * half[k] / spacing)), 1)
        size, end, here, way = 2.0 * half[k] / float(count), count, p[k], float(1.0)
        if q[k] > 0.0 or (q[k] == nearest and nearest <= 0.0):
            size = wp.max(size, THIN * spacing)
            end = ENDLESS
            if p[k] > 0.0:
                way = -1.0
            here = wp.max(wp.abs(p[k]), half[k]) * -way
        made.cell[k] = way * size
        made.at[k] = way * (0.5 * size - half[k]) - here
        made.inside[k] = count
        made.last[k] = end
        made.volume *= size
    return made


@wp.func
def lattice_behind(d: float, spacing: float) -> Lattice:
    """Return the cells of the half-space that begins a distance below a point, along the third axis."""
    made = Lattice()
    across = -0.5 * float(WIDE - 1) * spacing
    made.at = wp.vec3(across, across, -wp.max(d, 0.0) - 0.5 * spacing)
    made.cell = wp.vec3(spacing, spacing, -spacing)
    made.inside = wp.vec3i(WIDE, WIDE, ENDLESS)
    made.last = made.inside
    made.volume = spacing * spacing * spacing
    return made


@wp.func
def axes_of(n: wp.vec3) -> wp.mat33:
    """Return axes, one a column, of which the third is a normal."""
    across = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(n[0]) > 0.7:
        across = wp.vec3(0.0, 1.0, 0.0)
    first = wp.normalize(wp.cross(across, n))
    return wp.matrix_from_cols(first, wp.cross(n, first), n)
