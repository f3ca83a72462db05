"""An OpenGL context without a screen."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any, Protocol

from orbit_core.interfaces import ConfigurationError

_HEADLESS = ("egl", "osmesa")


class GlContext(Protocol):
    """Interface that MuJoCo's classes for OpenGL contexts share."""

    def make_current(self) -> None: ...

    def free(self) -> None: ...


def create_context(width: int, height: int) -> GlContext:
    """The context that the environment variable MUJOCO_GL names; without it EGL, or OSMesa where EGL does not work.

    Raises:
        ConfigurationError: none works here; says what to install.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wanted and wanted not in _HEADLESS:
        from mujoco.gl_context import GLContext  # made for that very variable

        return GLContext(width, height)
    failures: list[str] = []
    for platform in (wanted,) if wanted else _HEADLESS:
        loaded = set(sys.modules)
        try:
            context = _context_class(platform)(width, height)
        except Exception as error:  # PyOpenGL raises AttributeError, ImportError, TypeError or its own errors
            failures.append(f"{platform} ({error})")
            _forget(platform, loaded)
        else:
            os.environ["MUJOCO_GL"] = platform  # MuJoCo's C library looks there for where to find OpenGL
            return context
    raise ConfigurationError(
        f"MuJoCo cannot draw here, for no OpenGL works: {'; '.join(failures)}. Install the Debian packages libegl1 and "
        "libegl-mesa0, or libosmesa6"
    )


def _context_class(platform: str) -> Any:
    return importlib.import_module(f"mujoco.{platform}").GLContext


def _forget(platform: str, loaded: set[str]) -> None:
    # PyOpenGL binds itself to one platform when it loads; the next platform needs it afresh.
    if os.environ.get("PYOPENGL_PLATFORM") == platform and "OpenGL" not in loaded:
        del os.environ["PYOPENGL_PLATFORM"]
    for name in set(sys.modules) - loaded:
        if name.partition(".")[0] == "OpenGL" or name.startswith(f"mujoco.{platform}"):
            del sys.modules[name]
