"""Lattices of particles at rest that fill walls, summed where they are within the kernel of a particle.

A wall presses on a liquid, and takes of its flow, as liquid that stands in its place would. A box has the lattice that
divides it into whole cells, so that its edges and corners count as what they are. Behind a face that the particle is
in front of the lattice goes on beyond the box's other side: a thin wall holds as a thick one does, and a particle on
its other side sees the cells behind its own face. Other shapes have the lattice of the half-space behind their nearest
point.

Samples are written down nowhere: a lattice is found again from the place of the particle in the shape's frame. Behind a
face its layers move along with the particle, which takes a fraction of the sums; in front of an edge it stays in place.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

THIN = wp.constant(0.4)
"""Spacings between layers at least: walls that are thinner are filled beyond their other side."""
ENDLESS = wp.constant(1000)
"""Cells along an axis that has no end."""
FAR_CELLS = wp.constant(1.0e3)
"""Spacings along a face that no kernel reaches."""
SOFT = wp.constant(0.01)
"""Squares of the smoothing length that keep the shock of a particle, or of a cell, at the same place finite."""
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


_LAYERS = """
#ifdef __CUDA_ARCH__
    typedef float Lanes;
    const int step = 1;
    const Lanes first = 0.0f;
    const auto root = [](Lanes a) { asm("sqrt.approx.f32 %0, %0;" : "+f"(a)); return a; };
    const auto ratio = [](Lanes a, Lanes b) { return __fdividef(a, b); };
    const auto positive = [](Lanes a) { return fmaxf(a, 0.0f); };
    const auto sum = [](Lanes a) { return a; };
    struct Cells {
        float of[5];
        __device__ float operator[](int j) const { return of[j]; }
    };
    const auto sums_to = [](float end) {
        Cells found;
        for (int j = 0; j < 5; ++j) {
            const float v = end - static_cast<float>(j - 2), a = fminf(fabsf(v), 1.5f);
            const float part = a < 0.5f ? a * (1.25f - a * a) : a * (1.875f + a * (0.5f * a - 1.75f)) - 0.0625f;
            found.of[j] = copysignf(part, v);
        }
        return found;
    };
#else
    // Few walls have more than four layers within the kernel.
    typedef float Lanes __attribute__((ext_vector_type(4)));
    const int step = 4;
    const Lanes first = {0.0f, 1.0f, 2.0f, 3.0f};
    const auto root = [](Lanes a) { return __builtin_elementwise_sqrt(a); };
    const auto ratio = [](Lanes a, Lanes b) { return a / b; };
    const auto positive = [](Lanes a) { return __builtin_elementwise_max(a, Lanes(0.0f)); };
    const auto sum = [](Lanes a) { return (a[0] + a[1]) + (a[2] + a[3]); };
    typedef float Cells __attribute__((ext_vector_type(8)));
    const auto sums_to = [](float end) {
        const Cells v = end - Cells{-2.0f, -1.0f, 0.0f, 1.0f, 2.0f, 2.0f, 2.0f, 2.0f};
        const Cells a = __builtin_elementwise_min(__builtin_elementwise_abs(v), Cells(1.5f));
        const Cells near = a * (1.25f - a * a), far = a * (1.875f + a * (0.5f * a - 1.75f)) - 0.0625f;
        const Cells part = a < 0.5f ? near : far;
        return v < 0.0f ? -part : part;
    };
#endif
    wp::vec_t<14, wp::float32> found;
    for (int k = 0; k < 14; ++k) found[k] = 0.0f;
    const float reach = 1.0f / half;
    const int count = static_cast<int>(ceilf((reach - depth) / thick));
    if (count <= 0) return found;
    // Weights of the cells at 0, 1 and 2 spacings either way that are between two ends, and of their places. A sum up
    // to an end is the cubic (Catmull-Rom) through the sums over whole cells: in proportion to cells that are cut, it
    // would be 5 % too small between two rows of cells, and twice too large beyond the first one.
    struct Row { float whole_0, whole_1, whole_2, odd_1, odd_2; };
    const auto between = [&](float low, float high) {
        const Cells to = sums_to(high), from = sums_to(low);
        const float w0 = to[2] - from[2], left_1 = to[1] - from[1], right_1 = to[3] - from[3];
        const float left_2 = to[0] - from[0], right_2 = to[4] - from[4];
        return Row{w0, left_1 + right_1, left_2 + right_2, right_1 - left_1, 2.0f * (right_2 - left_2)};
    };
    // Where a plane's normal points up an axis, what is behind it is below its place there.
    const auto less = [](float a, float b) { return a < b ? a : b; };
    float lower[2] = {low[0], low[1]}, upper[2] = {high[0], high[1]};
    for (int axis = 0; axis < 2; ++axis) {
        for (int m = 0; m < 2; ++m) {
            const float side = m == 0 ? one[axis] : two[axis], away = m == 0 ? one[2] : two[2];
            if ((m == 0 ? skip_one : skip_two) == 0.0f) continue;
            if (side > 0.0f) lower[axis] = -less(-lower[axis], away);
            if (side < 0.0f) upper[axis] = less(upper[axis], away);
        }
    }
    if (upper[0] <= lower[0] || upper[1] <= lower[1]) return found;
    const Row a = between(lower[0], upper[0]), b = between(lower[1], upper[1]);
    const bool is_corner = one[0] != 0.0f || one[1] != 0.0f;
    Row behind[2];
    for (int m = 0; m < 2; ++m) {
        const float side = m == 0 ? one[0] + one[1] : two[0] + two[1], away = m == 0 ? one[2] : two[2];
        const int axis = (m == 0 ? one[0] : two[0]) != 0.0f ? 0 : 1;
        const float end = side > 0.0f ? less(upper[axis], -away) : -less(-lower[axis], -away);
        behind[m] = Row{0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
        if (side > 0.0f && end > lower[axis]) behind[m] = between(lower[axis], end);
        if (side < 0.0f && end < upper[axis]) behind[m] = between(end, upper[axis]);
    }
    float s0 = 0.0f, s1 = 0.0f, s2 = 0.0f, s3 = 0.0f, s4 = 0.0f, s5 = 0.0f, s6 = 0.0f;
    float given_one = 0.0f, given_two = 0.0f, pulled_one = 0.0f, pulled_two = 0.0f, shock = 0.0f;
    for (int m = 0; m < count; m += step) {
        const Lanes index = first + static_cast<float>(m);
        const Lanes z = depth + index * thick, height = z * z;
        // Cells are at the distances 0, 1, sqrt(2), 2 and sqrt(5) from the normal: all others are out of reach.
        const float squares[5] = {0.0f, 1.0f, 2.0f, 4.0f, 5.0f};
        Lanes part[5], packed[5];
        for (int k = 0; k < 5; ++k) {
            const Lanes square = height + squares[k];
            const Lanes t = positive(1.0f - root(square) * half);
            const Lanes rest = positive(1.0f - square * (half * half));
            part[k] = t * t * t;
            packed[k] = (rest * rest) * (rest * rest);
        }
        // Sums over the second axis at 0, 1 and 2 spacings along the first one: plain, and of moments.
        const Lanes r0 = b.whole_0 * part[0] + b.whole_1 * part[1] + b.whole_2 * part[3];
        const Lanes r1 = b.whole_0 * part[1] + b.whole_1 * part[2] + b.whole_2 * part[4];
        const Lanes r2 = b.whole_0 * part[3] + b.whole_1 * part[4];
        const Lanes o0 = b.odd_1 * part[1] + b.odd_2 * part[3];
        const Lanes o1 = b.odd_1 * part[2] + b.odd_2 * part[4];
        const Lanes o2 = b.odd_1 * part[4];
        const Lanes plain = a.whole_0 * r0 + a.whole_1 * r1 + a.whole_2 * r2;
        const Lanes along_a = a.odd_1 * r1 + a.odd_2 * r2;
        const Lanes along_b = a.whole_0 * o0 + a.whole_1 * o1 + a.whole_2 * o2;
        const Lanes across = a.odd_1 * o1 + a.odd_2 * o2;
        // Squares of places are summed to 2 % too little by cells right behind the particle; with 4 % more, sides of a
        // tank bear 0.8 % of the liquid's weight, and 1.04 % with 2 %.
        const float one_square = 1.04f, two_squares = 4.16f;
        const Lanes square_a = one_square * a.whole_1 * r1 + two_squares * a.whole_2 * r2;
        const float b1 = one_square * b.whole_1, b2 = two_squares * b.whole_2;
        const Lanes square_b = a.whole_0 * (b1 * part[1] + b2 * part[3]) +
            a.whole_1 * (b1 * part[2] + b2 * part[4]) + a.whole_2 * b1 * part[4];
        s0 -= sum(along_a);
        s1 -= sum(along_b);
        s2 += sum(z * plain);
        s3 += sum(square_a * pull[0] + across * pull[1] - z * along_a * pull[2]);
        s4 += sum(across * pull[0] + square_b * pull[1] - z * along_b * pull[2]);
        s5 += sum(z * (z * plain * pull[2] - along_a * pull[0] - along_b * pull[1]));
        s6 += sum(
            a.whole_0 * (b.whole_0 * packed[0] + b.whole_1 * packed[1] + b.whole_2 * packed[3]) +
            a.whole_1 * (b.whole_0 * packed[1] + b.whole_1 * packed[2] + b.whole_2 * packed[4]) +
            a.whole_2 * (b.whole_0 * packed[3] + b.whole_1 * packed[4])
        );
        if (is_corner) {
            // The same sums over the first axis.
            const Lanes q1 = a.whole_0 * part[1] + a.whole_1 * part[2] + a.whole_2 * part[4];
            const Lanes q2 = a.whole_0 * part[3] + a.whole_1 * part[4];
            const Lanes p1 = a.odd_1 * part[2] + a.odd_2 * part[4];
            const Lanes p2 = a.odd_1 * part[4];
            for (int m = 0; m < 2; ++m) {
                const Row& c = behind[m];
                const bool is_first = (m == 0 ? one[0] : two[0]) != 0.0f;
                const float side = -(m == 0 ? one[0] + one[1] : two[0] + two[1]);
                const float own = is_first ? pull[0] : pull[1], other = is_first ? pull[1] : pull[0];
                const Lanes u1 = is_first ? r1 : q1, u2 = is_first ? r2 : q2;
                const Lanes v1 = is_first ? o1 : p1, v2 = is_first ? o2 : p2;
                const Lanes given = c.odd_1 * u1 + c.odd_2 * u2;
                const Lanes even = one_square * c.whole_1 * u1 + two_squares * c.whole_2 * u2;
                const Lanes turned = c.odd_1 * v1 + c.odd_2 * v2;
                (m == 0 ? given_one : given_two) += side * sum(given);
                (m == 0 ? pulled_one : pulled_two) += side * sum(z * pull[2] * given - own * even - other * turned);
            }
        }
        if (blow != 0.0f) {
            Lanes shocked[5];
            for (int k = 0; k < 5; ++k) {
                const Lanes closing = ratio(z * (blow * length), height + squares[k] + soft);
                shocked[k] = part[k] * closing * closing;
            }
            shock += sum(z * (
                a.whole_0 * (b.whole_0 * shocked[0] + b.whole_1 * shocked[1] + b.whole_2 * shocked[3]) +
                a.whole_1 * (b.whole_0 * shocked[1] + b.whole_1 * shocked[2] + b.whole_2 * shocked[4]) +
                a.whole_2 * (b.whole_0 * shocked[3] + b.whole_1 * shocked[4])
            ));
        }
    }
    // Places are in spacings so far; sums that are weighted with the pull have two of them.
    const float area = spacing * spacing;
    found[0] = s0 * spacing;
    found[1] = s1 * spacing;
    found[2] = s2 * spacing;
    found[3] = s3 * area;
    found[4] = s4 * area;
    found[5] = s5 * area;
    found[6] = s6;
    found[7] = given_one * spacing;
    found[8] = pulled_one * area;
    found[9] = given_two * spacing;
    found[10] = pulled_two * area;
    found[13] = shock * spacing;
    return found;
"""


@wp.func_native(_LAYERS)
def layered_by(
    depth: float,
    thick: float,
    low: wp.vec2,
    high: wp.vec2,
    spacing: float,
    half: float,
    length: float,
    soft: float,
    pull: wp.vec3,
    blow: float,
    one: wp.vec3,
    two: wp.vec3,
    skip_one: float,
    skip_two: float,
) -> Filled:
    """Sum over the cells behind a face as :func:`filled_by` does, but for layers of cells that move with the particle.

    Lengths are in spacings, and the sums in metres. A cell of each layer is right behind the particle, and sums end
    between cells where the shape does, so that a layer has cells at five distances only. The axes are two along the
    face and its normal.

    Args:
        depth: of the middle of the first layer below the particle.
        thick: of a layer.
        low: lower ends of the shape along the face from the particle.
        high: upper ends.
        spacing: metres of it.
        half: over the smoothing length.
        length: of smoothing.
        soft: square that keeps the shock of a cell at the particle finite.
        pull: gravity, in m/s^2.
        blow: of the shape against the particle along the normal, in m/s.
        one: plane of another wall: its normal along the face, one of whose numbers is 1 or -1, and its distance; zeros
            for none.
        two: plane of a second one.
        skip_one: 1 where cells behind the first plane are the other wall's, else 0.
        skip_two: the same for the second plane.
    """


@wp.struct
class Layers:
    """Cells behind a face as :func:`layered_by` takes them, in spacings."""

    axes: wp.mat33
    """Axes in the shape's frame, one a column, the third of which is the face's normal."""
    depth: float
    """Distance of the middle of the first layer below the particle."""
    thick: float
    """Thickness of a layer."""
    low: wp.vec2
    """Lower ends of the shape along the face from the particle."""
    high: wp.vec2
    """Upper ends."""


@wp.func
def layers_of_box(p: wp.vec3, half: wp.vec3, spacing: float) -> Layers:
    """Return the layers of a box of half extents behind the face that a point in its frame is the farthest out of."""
    made = Layers()
    q = wp.vec3(wp.abs(p[0]) - half[0], wp.abs(p[1]) - half[1], wp.abs(p[2]) - half[2])
    k = int(0)
    if q[1] > q[0]:
        k = 1
    if q[2] > q[k]:
        k = 2
    made.thick = 2.0 * half[k] / spacing
    made.thick = wp.max(made.thick / wp.max(wp.round(made.thick), 1.0), THIN)
    made.depth = wp.max(q[k], 0.0) / spacing + 0.5 * made.thick
    axes = wp.mat33()
    axes[k, 2] = wp.where(p[k] > 0.0, 1.0, -1.0)
    for axis in range(2):
        m = (k + 1 + axis) % 3
        axes[m, axis] = 1.0
        made.low[axis] = (-half[m] - p[m]) / spacing
        made.high[axis] = (half[m] - p[m]) / spacing
    made.axes = axes
    return made


@wp.func
def layers_behind(d: float, n: wp.vec3, spacing: float) -> Layers:
    """Return the layers of the half-space that begins a distance below a point."""
    made = Layers()
    made.axes = axes_of(n)
    made.depth = wp.max(d, 0.0) / spacing + 0.5
    made.thick = 1.0
    made.low = wp.vec2(-FAR_CELLS, -FAR_CELLS)
    made.high = wp.vec2(FAR_CELLS, FAR_CELLS)
    return made


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
