"""Operations among the 32 lanes of a warp, for kernels whose blocks are one warp.

On a CPU they are the same among the fibers of a block, for tests (``wp.config.enable_cpu_blocks``).
"""

# pyright: reportReturnType=false, reportUnusedParameter=false

from __future__ import annotations

import warp as wp

LANES = 32
"""Threads of a block."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncwarp();
#else
    WP_TILE_SYNC();
#endif
""")
def meet():
    """Wait for all lanes; what each has written is then seen by all."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __shfl_sync(0xffffffffu, value, source);
#else
    static float shared[32];
    shared[WP_TILE_THREAD_IDX] = value;
    WP_TILE_SYNC();
    const float result = shared[source];
    WP_TILE_SYNC();
    return result;
#endif
""")
def of_lane(value: float, source: int) -> float:
    """Return a lane's value in all lanes."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int i = 0; i < 16; i++)
        value.data[i / 4][i % 4] = __shfl_sync(0xffffffffu, value.data[i / 4][i % 4], source);
    return value;
#else
    static float shared[32][16];
    for (int i = 0; i < 16; i++)
        shared[WP_TILE_THREAD_IDX][i] = value.data[i / 4][i % 4];
    WP_TILE_SYNC();
    for (int i = 0; i < 16; i++)
        value.data[i / 4][i % 4] = shared[source][i];
    WP_TILE_SYNC();
    return value;
#endif
""")
def of_lane16(value: wp.mat44, source: int) -> wp.mat44:
    """Return a lane's sixteen numbers; each lane names its own source."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step /= 2)
        value += __shfl_xor_sync(0xffffffffu, value, step);
    return value;
#else
    static float shared[32];
    for (int step = 16; step > 0; step /= 2) {
        shared[WP_TILE_THREAD_IDX] = value;
        WP_TILE_SYNC();
        value += shared[WP_TILE_THREAD_IDX ^ step];
        WP_TILE_SYNC();
    }
    return value;
#endif
""")
def total(value: float) -> float:
    """Return the sum over lanes, the same number in each."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step /= 2)
        for (int i = 0; i < 3; i++)
            value[i] += __shfl_xor_sync(0xffffffffu, value[i], step);
    return value;
#else
    static float shared[32][3];
    for (int step = 16; step > 0; step /= 2) {
        for (int i = 0; i < 3; i++)
            shared[WP_TILE_THREAD_IDX][i] = value[i];
        WP_TILE_SYNC();
        for (int i = 0; i < 3; i++)
            value[i] += shared[WP_TILE_THREAD_IDX ^ step][i];
        WP_TILE_SYNC();
    }
    return value;
#endif
""")
def total3(value: wp.vec3) -> wp.vec3:
    """Return the sums of three numbers; their exchanges overlap."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int step = 16; step > 0; step /= 2)
        for (int i = 0; i < 9; i++)
            value.data[i / 3][i % 3] += __shfl_xor_sync(0xffffffffu, value.data[i / 3][i % 3], step);
    return value;
#else
    static float shared[32][9];
    for (int step = 16; step > 0; step /= 2) {
        for (int i = 0; i < 9; i++)
            shared[WP_TILE_THREAD_IDX][i] = value.data[i / 3][i % 3];
        WP_TILE_SYNC();
        for (int i = 0; i < 9; i++)
            value.data[i / 3][i % 3] += shared[WP_TILE_THREAD_IDX ^ step][i];
        WP_TILE_SYNC();
    }
    return value;
#endif
""")
def total9(value: wp.mat33) -> wp.mat33:
    """Return the sums of nine numbers; their exchanges overlap."""


@wp.func_native("""
    const float* start = rows.data + (size_t)row * (rows.strides[0] / sizeof(float)) + 4 * quarter;
#if defined(__CUDA_ARCH__)
    const float4 loaded = *reinterpret_cast<const float4*>(start);
    return wp::vec4f(loaded.x, loaded.y, loaded.z, loaded.w);
#else
    return wp::vec4f(start[0], start[1], start[2], start[3]);
#endif
""")
def four(rows: wp.array2d[float], row: int, quarter: int) -> wp.vec4:
    """Return four neighbours of a row in one load: its start and length must be multiples of 16 bytes."""
