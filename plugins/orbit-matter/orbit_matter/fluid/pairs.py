"""Sums over the neighbours of a particle, of which a CPU takes :data:`LANES` at a time.

Warp's own loops take one neighbour after another, and an array's element costs them some ten instructions. These loops
are written in C++ over vectors of eight numbers, which clang compiles for the registers that a machine has; the order
of sums is the same on all machines. On a GPU a vector is one number, and a row of four numbers is one load; a block of
threads takes an environment and keeps its rows in the memory that the block shares, where any order of neighbours reads
fast.

Lists of neighbours are filled up to whole vectors with a row of zeros that is out of reach.
"""

# pyright: reportInvalidTypeForm=false, reportReturnType=false, reportCallIssue=false
# Functions are compiled by Warp; to Python they are annotations that no type checker can follow.

from __future__ import annotations

import warp as wp

LANES = wp.constant(8)
"""Neighbours that a CPU sums side by side."""
FAR = 1e9
"""Metres; where the neighbour is that fills up a list."""
SHARED = 1500
"""Most rows of an environment that a block of a GPU's threads keeps; two arrays of them are 48,000 of 49,152 bytes."""

# A CPU turns eight rows of four numbers, two in each register, into four vectors of eight numbers by shuffles:
# gathers of single numbers take half as much again for the whole loop.
_VECTORS = """
#ifdef __CUDA_ARCH__
    typedef float Lanes;
    struct alignas(16) Rows { Lanes x, y, z, w; };
    typedef Rows Row;
    const int step = 1;
    const auto load = [](const Row* rows, const int* list) { return rows[*list]; };
    // Within two units in the last place, by one instruction each; exact ones take some ten, of 60 for a neighbour.
    const auto root = [](Lanes a) { asm("sqrt.approx.f32 %0, %0;" : "+f"(a)); return a; };
    const auto ratio = [](Lanes a, Lanes b) { return __fdividef(a, b); };
    const auto plus = [](Lanes a, Lanes b, Lanes c) { return fmaf(a, b, c); };
    const auto positive = [](Lanes a) { return fmaxf(a, 0.0f); };
    const auto smaller = [](Lanes a, float b) { return fminf(a, b); };
    const auto sum = [](Lanes a) { return a; };
    // Lists are side by side, so that threads read neighbouring numbers.
    const int stride = neighbours.strides[2] / 4;
    const Row* const kept = reinterpret_cast<const Row*>(rows);
    const Row* const places = kept ? kept : reinterpret_cast<const Row*>(wp::address(place, env, 0));
    const Row* const motions = kept ? kept + 1500 : reinterpret_cast<const Row*>(wp::address(motion, env, 0));
#else
    typedef float Row __attribute__((ext_vector_type(4)));
    typedef float Lanes __attribute__((ext_vector_type(8)));
    struct Rows { Lanes x, y, z, w; };
    const int step = 8;
    const auto load = [](const Row* rows, const int* list) {
        const auto two = [&](int k) {
            return __builtin_shufflevector(rows[list[k]], rows[list[k + 4]], 0, 1, 2, 3, 4, 5, 6, 7);
        };
        const Lanes a = two(0), b = two(1), c = two(2), d = two(3);
        const Lanes ab = __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13);
        const Lanes cd = __builtin_shufflevector(c, d, 0, 8, 1, 9, 4, 12, 5, 13);
        const Lanes ba = __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15);
        const Lanes dc = __builtin_shufflevector(c, d, 2, 10, 3, 11, 6, 14, 7, 15);
        return Rows{
            __builtin_shufflevector(ab, cd, 0, 1, 8, 9, 4, 5, 12, 13),
            __builtin_shufflevector(ab, cd, 2, 3, 10, 11, 6, 7, 14, 15),
            __builtin_shufflevector(ba, dc, 0, 1, 8, 9, 4, 5, 12, 13),
            __builtin_shufflevector(ba, dc, 2, 3, 10, 11, 6, 7, 14, 15),
        };
    };
    const auto root = [](Lanes a) { return __builtin_elementwise_sqrt(a); };
    const auto ratio = [](Lanes a, Lanes b) { return a / b; };
    // Warp's compiler fuses no products and sums of vectors by itself.
    const auto plus = [](Lanes a, Lanes b, Lanes c) { return __builtin_elementwise_fma(a, b, c); };
    const auto positive = [](Lanes a) { return __builtin_elementwise_max(a, Lanes(0.0f)); };
    const auto smaller = [](Lanes a, Lanes b) { return a < b ? a : b; };
    const auto sum = [](Lanes a) { return ((a[0] + a[1]) + (a[2] + a[3])) + ((a[4] + a[5]) + (a[6] + a[7])); };
    const int stride = 1;
    const Row* places = reinterpret_cast<const Row*>(wp::address(place, env, 0));
    const Row* motions = reinterpret_cast<const Row*>(wp::address(motion, env, 0));
#endif
    const int* list = wp::address(neighbours, env, i, 0);
    const Row own = places[i], self = motions[i];
"""
_LOOP = """
#ifdef __CUDA_ARCH__
    #pragma unroll 4
#endif
    for (int k = 0; k < count; k += step) {
        const Rows a = load(places, list + k * stride), b = load(motions, list + k * stride);
        const Lanes x = own.x - a.x, y = own.y - a.y, z = own.z - a.z;
        // Two particles at one place are a little apart, for the quotient.
        const Lanes square = plus(x, x, plus(y, y, plus(z, z, 1e-16f)));
        const Lanes t = positive(plus(root(square), -half, 1.0f));
        const Lanes u = b.x - self.x, v = b.y - self.y, w = b.z - self.z;
        const Lanes along = plus(u, x, plus(v, y, w * z));
        const Lanes cube = t * t * t, part = cube * a.w;
"""
_PRESSED = """
    Lanes pressing_x = 0.0f, pressing_y = 0.0f, pressing_z = 0.0f;
    Lanes packed = 0.0f;
    // @loop
        const Lanes closing = ratio(along, square), struck = smaller(positive(closing), fastest);
        const Lanes pressure = part * plus(shock * struck, struck, plus(closing, rubbing, self.w + b.w));
        pressing_x = plus(x, pressure, pressing_x);
        pressing_y = plus(y, pressure, pressing_y);
        pressing_z = plus(z, pressure, pressing_z);
        const Lanes rest = positive(plus(square, -half * half, 1.0f)), again = rest * rest;
        packed = plus(again, again, packed);
    }
    return wp::vec_t<4, wp::float32>(sum(pressing_x), sum(pressing_y), sum(pressing_z), sum(packed));
"""
_DIVERGED = """
    Lanes rate = 0.0f, open_x = 0.0f, open_y = 0.0f, open_z = 0.0f;
    // @loop
        rate = plus(part, plus(along, self.w, smooth * (b.w - self.w)), rate);
        open_x = plus(x, part, open_x);
        open_y = plus(y, part, open_y);
        open_z = plus(z, part, open_z);
    }
    const float opened[3] = {sum(open_x), sum(open_y), sum(open_z)};
    const float leaning = lean[0] * opened[0] + lean[1] * opened[1] + lean[2] * opened[2];
    return wp::vec_t<4, wp::float32>(opened[0], opened[1], opened[2], sum(rate) + smooth * leaning);
"""
_KEEP = """
#ifdef __CUDA_ARCH__
    struct alignas(16) Row { float x, y, z, w; };
    __shared__ Row rows[2 * 1500];
    if (count > 1500) return 0;
    const Row* places = reinterpret_cast<const Row*>(wp::address(place, env, 0));
    const Row* motions = reinterpret_cast<const Row*>(wp::address(motion, env, 0));
    __syncthreads();
    for (int i = threadIdx.x; i < count; i += blockDim.x) {
        rows[i] = places[i];
        rows[1500 + i] = motions[i];
    }
    __syncthreads();
    return reinterpret_cast<wp::uint64>(rows);
#else
    return 0;
#endif
"""


_NEARBY = """
    int* const list = wp::address(neighbours, env, row, 0);
    const int most = neighbours.shape[2];
    int found = 0, doubtful = 0;
#ifdef __CUDA_ARCH__
    const int stride = neighbours.strides[2] / 4;
    doubtful = walls > 0;
    const wp::vec_t<3, wp::float32> own = wp::load(wp::address(searched, env, i));
    for (int j = 0; j < searched.shape[1]; ++j) {
        const wp::vec_t<3, wp::float32> way = wp::load(wp::address(searched, env, j)) - own;
        if (wp::dot(way, way) < square && j != i && found < most) {
            list[found * stride] = j;
            ++found;
        }
    }
#else
    typedef float Lanes __attribute__((ext_vector_type(8)));
    typedef int Marks __attribute__((ext_vector_type(8)));
    typedef float Loaded __attribute__((ext_vector_type(8), aligned(4)));
    const float* x = wp::address(columns, env, 0, 0);
    const float* y = wp::address(columns, env, 1, 0);
    const float* z = wp::address(columns, env, 2, 0);
    for (int first = 0; first < columns.shape[2]; first += 8) {
        const Lanes a = *reinterpret_cast<const Loaded*>(x + first) - x[i];
        const Lanes b = *reinterpret_cast<const Loaded*>(y + first) - y[i];
        const Lanes c = *reinterpret_cast<const Loaded*>(z + first) - z[i];
        const Lanes apart = __builtin_elementwise_fma(a, a, __builtin_elementwise_fma(b, b, c * c));
        const Marks near = apart < square;
#ifdef __AVX__
        int bits = __builtin_ia32_movmskps256(reinterpret_cast<Lanes>(near));
#else
        int bits = __builtin_reduce_or(near & Marks{1, 2, 4, 8, 16, 32, 64, 128});
#endif
        if (bits == 0) continue;
        for (int k = 0; k < walls; ++k) {
            const wp::vec_t<4, wp::float32>& plane = *wp::address(planes, env, i, k);
            const Lanes height = plane[0] * a + plane[1] * b + plane[2] * c + plane[3];
            // A micrometre for errors of rounding: the answer must be the same for both particles of a pair.
            doubtful |= __builtin_reduce_or(near & (height < 1.0e-6f));
        }
        for (; bits != 0 && found < most; bits &= bits - 1) {
            const int j = first + __builtin_ctz(bits);
            list[found] = j;
            found += j != i;
        }
    }
#endif
    return wp::vec_t<2, wp::int32>(found, doubtful != 0);
"""

_SET = """
    int* const list = wp::address(neighbours, env, i, 0);
    const int* const listed = wp::address(nearby, env, 0, 0);
    int length = found < neighbours.shape[2] ? found : neighbours.shape[2];
    for (int k = 0; k < length; ++k) list[k] = listed[k];
    for (; length % 8 != 0; ++length) list[length] = neighbours.shape[1];
    *wp::address(counts, env, i) = length;
"""
# What fills up lists is greater than all particles, so that filled lists are in ascending order as well.
_SPREAD = """
    const int most = neighbours.shape[2], filler = neighbours.shape[1];
    const auto change = [&](int j, bool met) {
        int* const list = wp::address(neighbours, env, j, 0);
        int& count = *wp::address(counts, env, j);
        if (count == most && list[most - 1] != filler) return false;
        int at = 0;
        while (at < count && list[at] < i) ++at;
        const bool there = at < count && list[at] == i;
        if (met && !there) {
            if (count == 0 || list[count - 1] != filler)
                for (int k = 0; k < 8; ++k, ++count) list[count] = filler;
            for (int k = count - 1; k > at; --k) list[k] = list[k - 1];
            list[at] = i;
        }
        if (!met && there) {
            for (int k = at; k < count - 1; ++k) list[k] = list[k + 1];
            list[count - 1] = filler;
            if (list[count - 8] == filler) count -= 8;
        }
        return true;
    };
    const int* const before = wp::address(neighbours, env, i, 0);
    const int* const after = wp::address(nearby, env, 0, 0);
    const int length = *wp::address(counts, env, i);
    if (found > most || (length == most && before[most - 1] != filler)) return false;
    for (int k = 0, m = 0;;) {
        const int left = k < length ? before[k] : filler, met = m < found ? after[m] : filler;
        if (left == filler && met == filler) return true;
        if (left != met && !change(left < met ? left : met, met < left)) return false;
        k += left <= met;
        m += met <= left;
    }
"""


@wp.func_native(_NEARBY)
def list_nearby(
    searched: wp.array2d[wp.vec3],
    columns: wp.array3d[float],
    neighbours: wp.array3d[int],
    planes: wp.array3d[wp.vec4],
    walls: int,
    env: int,
    row: int,
    i: int,
    square: float,
) -> wp.vec2i:
    """List all particles within a distance of one in ascending order.

    Args:
        searched: (N, P) positions; a GPU reads them.
        columns: (N, 3, P or a few more) the same by axis, far away beyond the last one; a CPU reads eight at a time.
        neighbours: (N, P, K) rows of which one is written.
        planes: (N, P, W) walls of each particle.
        walls: of this particle, how many it has.
        env: of the particle.
        row: of ``neighbours``.
        i: of the particle, its row.
        square: of the distance in m^2.

    Returns:
        How many there are, and 0 if none of them is behind a wall of this one.
    """


@wp.func_native(_SET)
def set_list(
    neighbours: wp.array3d[int], counts: wp.array2d[int], nearby: wp.array3d[int], found: int, env: int, i: int
):
    """Write the list of a particle, filled up to whole LANES, and its length; what does not fit in is left out.

    Args:
        neighbours: (N, P, K) lists.
        counts: (N, P) their lengths.
        nearby: (N, 1, P) the new list.
        found: length of the new list.
        env: of the particle.
        i: of the particle, its row.
    """


@wp.func_native(_SPREAD)
def spread_list(
    neighbours: wp.array3d[int], counts: wp.array2d[int], nearby: wp.array3d[int], found: int, env: int, i: int
) -> bool:
    """Take a particle out of the lists of those that it has left, and put it into those of what it has met.

    Lists are in ascending order, and stay so.

    Args:
        neighbours: (N, P, K) lists, of which that of the particle itself is the old one.
        counts: (N, P) their lengths.
        nearby: (N, 1, P) the particle's new list.
        found: length of the new list.
        env: of the particle.
        i: of the particle, its row.

    Returns:
        False where a list that this would change is full, and may lack some: all are to be searched again.
    """


@wp.func_native(_KEEP.replace("1500", str(SHARED)))
def keep(place: wp.array2d[wp.vec4], motion: wp.array2d[wp.vec4], env: int, count: int) -> wp.uint64:
    """Copy the rows of an environment to the memory that the threads of a block share; all of them must call this.

    Args:
        place: (N, P + 1) positions and volumes.
        motion: (N, P + 1) velocities, and another number.
        env: of the block.
        count: rows.

    Returns:
        Where they are, for the sums below; 0 on a CPU, and where there are more than SHARED.
    """


@wp.func_native(_VECTORS.replace("1500", str(SHARED)) + _PRESSED.replace("    // @loop\n", _LOOP))
def pressed_by(
    rows: wp.uint64,
    place: wp.array2d[wp.vec4],
    motion: wp.array2d[wp.vec4],
    neighbours: wp.array3d[int],
    env: int,
    i: int,
    count: int,
    half: float,
    shock: float,
    rubbing: float,
    fastest: float,
) -> wp.vec4:
    """Sum the pressure and the friction on a particle, along the lines to its neighbours, and the kernel over these.

    What acts along the line between two particles keeps their angular momentum.

    Args:
        rows: those of the environment, as :func:`keep` returns them.
        place: (N, P + 1) positions and volumes.
        motion: (N, P + 1) velocities and pressures.
        neighbours: (N, P, K) rows of both.
        env: of the particle.
        i: of the particle, its row.
        count: of neighbours, a multiple of LANES.
        half: over the smoothing length, in 1/m.
        shock: quadratic artificial viscosity times the density and the square of the smoothing length, in kg/m.
        rubbing: friction per rate at which two particles come nearer, in Pa s.
        fastest: part of their distance in 1/s, at most, by which two particles come nearer that counts for it.
    """


@wp.func_native(_VECTORS.replace("1500", str(SHARED)) + _DIVERGED.replace("    // @loop\n", _LOOP))
def diverged_from(
    rows: wp.uint64,
    place: wp.array2d[wp.vec4],
    motion: wp.array2d[wp.vec4],
    neighbours: wp.array3d[int],
    env: int,
    i: int,
    count: int,
    half: float,
    smooth: float,
    lean: wp.vec3,
) -> wp.vec4:
    """Sum the kernel's gradient, and the divergence of the flow with the diffusion of densities, over neighbours.

    Args:
        rows: those of the environment, as :func:`keep` returns them.
        place: (N, P + 1) positions and volumes.
        motion: (N, P + 1) velocities, and densities over those at rest.
        neighbours: (N, P, K) rows of both.
        env: of the particle.
        i: of the particle, its row.
        count: of neighbours, a multiple of LANES.
        half: over the smoothing length, in 1/m.
        smooth: twice the diffusion of densities, in m^2/s.
        lean: gradient of the density at rest, in 1/m.
    """
