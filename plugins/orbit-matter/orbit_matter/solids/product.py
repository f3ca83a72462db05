"""Product of a matrix that all environments share and a vector of each, as a GPU's block of threads computes it.

It is a kernel here and no call of cuBLAS: a step is recorded by several owners of graphs, on streams of their own, and
cuBLAS would need a workspace for each of these streams that outlives each of these graphs. Numbers keep their 24 bits.
"""

# pyright: reportInvalidTypeForm=false, reportReturnType=false, reportCallIssue=false
# Functions are compiled by Warp; to Python they are annotations that no type checker can follow.

from __future__ import annotations

import warp as wp

ENVS, ROWS = wp.constant(64), wp.constant(64)
"""Environments and rows of the matrix that a block computes the product of."""

# Each thread computes 4 x 4 numbers; 16 columns of both factors are in shared memory, and the next 16 on their way.
_MULTIPLY = """
    const int envs = rows.shape[0], matrices[2] = {free, attached};
#ifdef __CUDA_ARCH__
    const int deep = 16, lane = threadIdx.x;
    __shared__ __align__(16) float left[2][16][68];
    __shared__ __align__(16) float right[2][16][64];
    const int left_env = env + lane / 4, left_j = lane % 4 * 4;
    const int right_j = lane / 16, right_row = row + lane % 16 * 4;
    const int own_env = lane / 16 * 4, own_row = lane % 16 * 4;
    for (int kind = 0; kind < 2; ++kind) {
        const int other = env + lane;
        const int wanted = lane < 64 && other < envs && *wp::address(preset, other, b) == kind;
        if (!__syncthreads_or(wanted)) continue;
        float4 next_left, next_right;
        const auto fetch = [&](int j) {
            next_left = next_right = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
            // Residuals have zeros after the last column.
            if (left_env < envs)
                next_left = *reinterpret_cast<const float4*>(wp::address(rows, left_env, first + j + left_j));
            if (right_row < padded && j + right_j < count)
                next_right = *reinterpret_cast<const float4*>(
                    wp::address(inverse, matrices[kind] + right_row / 32 * count + j + right_j, right_row % 32));
        };
        const auto keep = [&](int half) {
            left[half][left_j][lane / 4] = next_left.x;
            left[half][left_j + 1][lane / 4] = next_left.y;
            left[half][left_j + 2][lane / 4] = next_left.z;
            left[half][left_j + 3][lane / 4] = next_left.w;
            *reinterpret_cast<float4*>(&right[half][right_j][right_row - row]) = next_right;
        };
        float found[4][4] = {};
        int half = 0;
        fetch(0);
        keep(0);
        __syncthreads();
        for (int j = 0; j < count; j += deep) {
            const bool more = j + deep < count;
            if (more) fetch(j + deep);
            #pragma unroll
            for (int k = 0; k < deep; ++k) {
                const float4 x = *reinterpret_cast<const float4*>(&left[half][k][own_env]);
                const float4 y = *reinterpret_cast<const float4*>(&right[half][k][own_row]);
                const float xs[4] = {x.x, x.y, x.z, x.w}, ys[4] = {y.x, y.y, y.z, y.w};
                #pragma unroll
                for (int m = 0; m < 4; ++m)
                    #pragma unroll
                    for (int n = 0; n < 4; ++n) found[m][n] += xs[m] * ys[n];
            }
            half = 1 - half;
            if (more) keep(half);
            __syncthreads();
        }
        #pragma unroll
        for (int m = 0; m < 4; ++m) {
            const int to = env + own_env + m;
            if (to < envs && row + own_row < padded && *wp::address(preset, to, b) == kind)
                *reinterpret_cast<float4*>(wp::address(out, to, first + row + own_row)) =
                    make_float4(found[m][0], found[m][1], found[m][2], found[m][3]);
        }
    }
#else
    for (int to = env; to < env + 64 && to < envs; ++to)
        for (int r = row; r < row + 64 && r < padded; ++r) {
            const int at = matrices[*wp::address(preset, to, b)] + r / 32 * count;
            float found = 0.0f;
            for (int j = 0; j < count; ++j)
                found += *wp::address(rows, to, first + j) * *wp::address(inverse, at + j, r % 32);
            *wp::address(out, to, first + r) = found;
        }
#endif
"""


@wp.func_native(_MULTIPLY)
def multiply(
    rows: wp.array2d[float],
    inverse: wp.array2d[float],
    preset: wp.array2d[int],
    out: wp.array2d[float],
    env: int,
    b: int,
    first: int,
    row: int,
    padded: int,
    count: int,
    free: int,
    attached: int,
):
    """Multiply ROWS rows of the preconditioner of a solid and the residuals of ENVS environments.

    Args:
        rows: (N, D) residuals.
        inverse: blocks of 32 rows of all preconditioners, column by column.
        preset: (N, B) 1 where the second preconditioner is meant.
        out: (N, D) products.
        env: first of the environments.
        b: solid.
        first: of the solid's columns in ``rows`` and ``out``.
        row: first of the rows, counted within the solid.
        padded: rows of the solid, filled up to multiples of 32 with zeros.
        count: columns of the solid's preconditioner.
        free: row of ``inverse`` where the first preconditioner begins.
        attached: row where the second one begins.
    """
