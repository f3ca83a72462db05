"""Denoiser of path-traced pictures on a machine without an NVIDIA GPU: Intel's Open Image Denoise, by pyoidn."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError

Denoiser = Callable[[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]], npt.NDArray[np.float32]]
"""Function of colours in [0, 1], albedo and normals, each (H, W, 3), to denoised colours."""


def host_denoiser(name: str) -> Denoiser:
    """Return the denoiser of that name that runs on the host.

    Raises:
        ConfigurationError: it runs on an NVIDIA GPU only, or pyoidn is not installed.
    """
    if name != "oidn":
        raise ConfigurationError(
            f"denoiser '{name}' needs an NVIDIA GPU, and this machine draws without one: use 'oidn' or 'none'"
        )
    try:
        library = importlib.import_module("pyoidn")
    except ImportError as error:
        raise ConfigurationError(
            "denoiser 'oidn' needs an NVIDIA GPU or the package pyoidn, and this machine has neither: "
            "pip install 'orbit-sapien[denoiser]', or use 'none'"
        ) from error

    def denoise(
        color: npt.NDArray[Any], albedo: npt.NDArray[Any], normals: npt.NDArray[Any]
    ) -> npt.NDArray[np.float32]:
        guides = {"albedo": _contiguous(np.clip(albedo, 0.0, 1.0)), "normal": _contiguous(normals)}
        return library.denoise(_contiguous(color), **guides)

    return denoise


def _contiguous(picture: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    return np.ascontiguousarray(picture, dtype=np.float32)
