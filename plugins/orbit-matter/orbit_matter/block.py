"""Steps that the threads of a GPU's block take together: waiting, sums and ranks.

Warp's own kernels know no block; these functions are CUDA C++. On a CPU a block is one thread, for which a sum is its
own number. All threads of a block must call each of them, in the same order; those ``of_warp`` and ``in_warp``, all
32 of a warp.
"""

# pyright: reportInvalidTypeForm=false, reportReturnType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# Functions are compiled by Warp; to Python they are annotations that no type checker can follow.

from __future__ import annotations

import warp as wp

BLOCK = 256
"""Threads of a block on a GPU; it is Warp's own number, for which kernels are loaded."""
BOUNDS = (BLOCK, 4)
"""Bounds of kernels whose blocks take environments: four blocks on a multiprocessor, of 64 registers a thread, are two
rounds of an H100 for 1,024 environments; three would be three rounds."""

_SUM = """
#ifdef __CUDA_ARCH__
    __shared__ float parts[32];
    float whole = mine;
    // A butterfly: every thread adds the same pairs, so that all get the same bits.
    for (int step = 16; step > 0; step /= 2) whole += __shfl_xor_sync(0xffffffffu, whole, step);
    // Others may still read the parts of the sum before this one.
    __syncthreads();
    if (threadIdx.x % 32 == 0) parts[threadIdx.x / 32] = whole;
    __syncthreads();
    whole = 0.0f;
    for (int warp = 0; warp < blockDim.x / 32; ++warp) whole += parts[warp];
    return whole;
#else
    return mine;
#endif
"""
_RANK = """
#ifdef __CUDA_ARCH__
    __shared__ int counts[32];
    const unsigned votes = __ballot_sync(0xffffffffu, mine != 0);
    const int own = threadIdx.x / 32, place = threadIdx.x % 32;
    __syncthreads();
    if (place == 0) counts[own] = __popc(votes);
    __syncthreads();
    int before = __popc(votes & ((1u << place) - 1u)), all = 0;
    for (int warp = 0; warp < blockDim.x / 32; ++warp) {
        if (warp < own) before += counts[warp];
        all += counts[warp];
    }
    return wp::vec_t<2, wp::int32>(before, all);
#else
    return wp::vec_t<2, wp::int32>(0, mine);
#endif
"""
_ANY = """
#ifdef __CUDA_ARCH__
    return __any_sync(0xffffffffu, mine != 0) ? 1 : 0;
#else
    return mine;
#endif
"""
_FIRST = """
#ifdef __CUDA_ARCH__
    const unsigned votes = __ballot_sync(0xffffffffu, mine >= 0);
    if (votes == 0) return wp::vec_t<2, wp::int32>(-1, 0);
    const int leader = __ffs(votes) - 1;
    return wp::vec_t<2, wp::int32>(__shfl_sync(0xffffffffu, mine, leader), threadIdx.x % 32 == leader ? 1 : 0);
#else
    return wp::vec_t<2, wp::int32>(mine, 1);
#endif
"""
_SUM_OF_WARP = """
#ifdef __CUDA_ARCH__
    wp::vec_t<6, float> whole = mine;
    for (int step = 16; step > 0; step /= 2)
        for (int n = 0; n < 6; ++n) whole[n] += __shfl_xor_sync(0xffffffffu, whole[n], step);
    return whole;
#else
    return mine;
#endif
"""


@wp.func_native("""
#ifdef __CUDA_ARCH__
    __syncthreads();
#endif
""")
def wait():
    """Wait until all threads of the block are here; each then sees what the others have written."""


@wp.func_native(_SUM)
def sum_of_block(mine: float) -> float:
    """Return the sum of the numbers of a block's threads, with the same bits in all of them and in every run."""


@wp.func_native(_RANK)
def rank_in_block(mine: int) -> wp.vec2i:
    """Return how many threads before this one have a 1 and not a 0, and how many of all have."""


@wp.func_native(_ANY)
def any_in_warp(mine: int) -> int:
    """Return 1 if any thread of the warp has a number other than 0, else 0."""


@wp.func_native(_FIRST)
def first_in_warp(mine: int) -> wp.vec2i:
    """Return the number of the warp's first thread that has none below 0, or -1, and 1 in this thread only."""


@wp.func_native(_SUM_OF_WARP)
def sum_of_warp(mine: wp.spatial_vector) -> wp.spatial_vector:
    """Return the sum of the vectors of a warp's threads, with the same bits in all of them."""
