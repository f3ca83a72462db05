"""Kernels are compiled for a GPU that is not here, each once."""

from __future__ import annotations

from pathlib import Path

import pytest
import warp as wp

from orbit_warp.ahead import Launches, compile_modules
from orbit_warpkit.start import start


@wp.kernel(module="unique")
def _double(values: wp.array(dtype=float)):  # pyright: ignore[reportInvalidTypeForm, reportUnknownParameterType]
    i = wp.tid()
    values[i] = 2.0 * values[i]


def test_kernels_are_compiled_for_a_gpu_that_is_not_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start()  # which sets the folder of Warp's cache
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    launches, lines = Launches(), list[str]()
    launches.found[_double.module, 256] = None
    for expected in ("1 of 1 modules compiled", "0 of 1 modules compiled"):
        compile_modules(launches, 90, 2, lines.append)
        assert f"sm_90: {expected}" in lines[-1]
    (binary,) = tmp_path.glob("*/*.sm90*.cubin")
    assert binary.stat().st_size > 500
