"""Functions made into one kernel give what torch gives."""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_core.capture.kernels import fusing
from orbit_core.dynamics.linear import solve_spd
from orbit_core.dynamics.transforms import pose_error, quat_from_matrix, quat_to_matrix
from orbit_motion.fusion import Fused
from orbit_motion.fusion import fused as fused_module
from orbit_motion.fusion.fused import Program

Given = Callable[..., tuple[Tensor, ...]]


def compared(function: Given, **inputs: Tensor) -> Fused:
    """Both ways, on all rows and on ten, which do not fill the registers."""
    for count in (37, 10):
        fused = Fused(function)
        rows = {name: tensor[:count] for name, tensor in inputs.items()}
        with fusing(True):
            made = fused(**rows)
        assert not fused.refusal
        for one, other in zip(made, function(**rows), strict=True):
            assert one.shape == other.shape
            torch.testing.assert_close(one, other, rtol=2e-4, atol=2e-4)
    return fused


def random(*shape: int) -> Tensor:
    return torch.randn(37, *shape, generator=torch.Generator().manual_seed(sum(shape)))


def of_parts(own: Tensor, env: Tensor, part: Tensor) -> tuple[Tensor, ...]:
    both = own * env + part.square()
    return both, (own.unsqueeze(-1) @ env.unsqueeze(-2)).sum(-1) - part


def test_parts_of_environments() -> None:
    inputs = {"own": random(5, 3), "env": random(1, 3), "part": random(5, 3)[:1]}
    fused = Fused(of_parts, in_parts=True)
    with fusing(True):
        made = fused(**inputs)
    assert fused.operations, fused.refusal
    for one, other in zip(made, of_parts(**inputs), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5)


_ON_HOST = """
#include <cmath>
#define __global__
#define __device__
struct Place {{ int x; }};
static Place blockIdx, threadIdx, blockDim = {{4}};
#define fused of_thread
{source}
#undef fused
extern "C" void fused({pointers}float* out, int count) {{
  for (blockIdx.x = 0; 4 * blockIdx.x < count; blockIdx.x++)
    for (threadIdx.x = 0; threadIdx.x < 4; threadIdx.x++) of_thread({names}out, count);
}}
"""
"""What a GPU is given, thread after thread."""


@pytest.fixture
def sources(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What a GPU is given is what runs, on the host; and what was given."""
    given: list[str] = []
    launch = fused_module.launcher

    def launcher(source: str, inputs: int, device: torch.device) -> Any:
        given.append(source)
        names = [f"in_{number}, " for number in range(inputs)]
        pointers = "".join(f"const float* {name}" for name in names)
        return launch(_ON_HOST.format(source=source, names="".join(names), pointers=pointers), inputs, device)

    monkeypatch.setattr(Program, "on_cpu", False)
    monkeypatch.setattr(fused_module, "launcher", launcher)
    return given


def test_what_a_gpu_is_given_does_the_same_thread_by_thread(sources: list[str]) -> None:
    test_parts_of_environments()
    test_elementwise_and_reductions()
    test_matrices()
    assert all("__global__" in source for source in sources)
    assert sources[-1] == sources[-2]  # of two sizes: the next run finds what was compiled


def test_nvidias_compiler_takes_it(sources: list[str]) -> None:
    nvrtc = compiler_of_nvidia()
    if nvrtc is None:
        pytest.skip("no NVRTC here")
    test_elementwise_and_reductions()
    program, options = (
        ctypes.c_void_p(),
        (ctypes.c_char_p * 3)(b"--gpu-architecture=sm_90", *map(str.encode, fused_module.GPU_FLAGS)),
    )
    nvrtc.nvrtcCreateProgram(ctypes.byref(program), sources[0].encode(), b"fused.cu", 0, None, None)
    result, size = nvrtc.nvrtcCompileProgram(program, len(options), options), ctypes.c_size_t()
    nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    log = ctypes.create_string_buffer(size.value)
    nvrtc.nvrtcGetProgramLog(program, log)
    assert result == 0, log.value.decode()


def compiler_of_nvidia() -> ctypes.CDLL | None:
    """NVRTC, of the system or of a package: it compiles without a GPU."""
    packages = Path(torch.__file__).parents[1].glob("nvidia/*/lib/libnvrtc.so.*")
    for name in [ctypes.util.find_library("nvrtc"), *map(str, packages)]:
        if name is not None:
            return ctypes.CDLL(name)
    return None


_MEMORY = random(3)


def test_elementwise_and_reductions() -> None:
    constant = torch.tensor([[0.0, 1.0, -1.0], [2.5, 0.0, -3.0]])

    def function(a: Tensor, b: Tensor, chosen: Tensor) -> tuple[Tensor, ...]:
        c = a * constant + b.unsqueeze(1) / (1.5 + b.unsqueeze(1).square())
        d = torch.where(chosen, c.sin(), torch.atan2(c, 2.0 - a))
        e = torch.clamp(d, -0.4, 0.5).pow(3) + torch.copysign(a, c) - (a > 0.2) * a.abs().sqrt()
        f = torch.minimum(c, d).amax(1) + torch.linalg.vector_norm(c, dim=(1, 2)).unsqueeze(1)
        return e, f, torch.maximum(a, c).sum(1, keepdim=True), torch.linalg.cross(a, c).cos().amin((1, 2))

    compared(function, a=random(2, 3), b=random(3), chosen=random(2, 3) > 0.0)


def test_matrices() -> None:
    def function(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        spd = a @ a.mT + 3.0 * torch.eye(4)
        return solve_spd(spd, b), torch.diag_embed(spd.diagonal(dim1=1, dim2=2)) @ a - torch.baddbmm(a, a, spd).mT

    compared(function, a=random(4, 4), b=random(4, 2))


def test_rotations() -> None:
    def function(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        first, second = (torch.cat((p[:, :3], p[:, 3:] / p[:, 3:].norm(dim=1, keepdim=True)), 1) for p in (a, b))
        return pose_error(first, second), quat_from_matrix(quat_to_matrix(first[:, 3:]))

    compared(function, a=random(7), b=random(7).flip(0))


def test_what_is_zero_or_occurs_twice_costs_nothing() -> None:
    mask = torch.tensor([0.0, 1.0, 0.0])
    fused = compared(lambda a: ((a * mask).sum(1, keepdim=True) + (mask * a).sum(1, keepdim=True),), a=random(3))
    assert fused.operations == 1


@pytest.mark.parametrize("above", [torch.ones(9, 9).tril(), torch.ones(9, 9).triu()], ids=["up", "down"])
def test_sums_along_a_branch_cost_an_addition_each(above: Tensor) -> None:
    assert compared(lambda a: (a @ above.mT,), a=random(9)).operations == 8


@pytest.mark.parametrize(
    ("function", "told"),
    [
        (lambda a: (a.cumsum(1),), "'cumsum'"),
        (lambda a: (a + _MEMORY,), "for one environment"),
        (lambda a: (a[a > 0.0],), "cannot be followed"),
    ],
    ids=["unknown operation", "memory taken for a constant", "shapes that depend on values"],
)
def test_what_cannot_be_followed_runs_as_it_is(function: Given, told: str) -> None:
    fused, a = Fused(function), random(3)
    with fusing(True):
        made = fused(a=a)
    assert told in fused.refusal
    torch.testing.assert_close(made, function(a=a))
