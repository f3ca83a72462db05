"""Source text made into something that runs."""

from __future__ import annotations

import ctypes
import hashlib
import os
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_motion.fusion.interpreter import Unfusable

# Of a block on a GPU: few, so that a few thousand environments fill all multiprocessors.
_THREADS = 32
GPU_FLAGS = ["--prec-div=false", "--prec-sqrt=false"]
"""Quotients and roots to two units in the last place, as in what inductor compiles, and without calls for them."""
_FLAGS = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC", "-w")


Launch = Callable[[Sequence[Tensor], Tensor], None]
"""Of rows of inputs, and memory for the rows that come of them."""


def launcher(source: str, inputs: int, device: torch.device) -> Launch:
    """Runs a program that has so many inputs.

    Raises:
        Unfusable: the compiler refuses it, or there is none.
    """
    return _of_library(_compiled(source), inputs) if device.type == "cpu" else _of_gpu(source)


def _compiled(source: str) -> Path:
    """Return a library of the source, from the cache beside that of torch's compiler if it was made before."""
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch._inductor.runtime.cache_dir_utils import cache_dir

    compiler = get_cpp_compiler()
    name = hashlib.sha256("\n".join((source, compiler, *_FLAGS, _processor())).encode()).hexdigest()[:32]
    folder = Path(cache_dir()) / "orbit_fusion"
    library = folder / f"{name}.so"
    if library.is_file():
        return library
    folder.mkdir(parents=True, exist_ok=True)
    with ScratchFolder("orbit-kernel-", folder) as work:
        text, made = work / "fused.cpp", work / "fused.so"
        text.write_text(source)
        run = subprocess.run([compiler, *_FLAGS, "-o", str(made), str(text)], capture_output=True, text=True)
        if run.returncode:
            raise Unfusable(f"{compiler} refuses it: {next(iter(run.stderr.splitlines()), '')}")
        os.replace(made, library)  # at once, for other processes may be looking
    return library


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ""
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


def _of_library(library: Path, inputs: int) -> Launch:
    function: Any = ctypes.CDLL(str(library)).fused
    function.argtypes, function.restype = [*[ctypes.c_void_p] * (inputs + 1), ctypes.c_int], None
    return lambda rows, outputs: function(*(r.data_ptr() for r in rows), outputs.data_ptr(), outputs.shape[0])


def _of_gpu(source: str) -> Launch:
    try:
        compile_kernel = torch.cuda._compile_kernel  # pyright: ignore[reportPrivateUsage]
        kernel: Any = compile_kernel(source, "fused", nvcc_options=GPU_FLAGS)
    except Exception as error:  # torch's release has none, there is no NVRTC, or it refuses the source
        what = " ".join(str(error).splitlines()[:3])
        raise Unfusable(f"no kernel on the GPU, for {type(error).__name__}: {what}") from error

    def launch(rows: Sequence[Tensor], outputs: Tensor) -> None:
        count = outputs.shape[0]
        kernel(grid=(-(-count // _THREADS), 1, 1), block=(_THREADS, 1, 1), args=[*rows, outputs, count])

    return launch
