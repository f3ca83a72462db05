"""Bullet's OpenGL: one client of a process, whose EGL context is current only while Bullet draws.

Bullet makes its context current once, when its plugin loads, and never again. Its later calls go to the context that
is current in the calling thread by then: to that of another library, whose pictures they spoil, or to none, which
crashes in the driver. So the context is made current around everything that draws, and the one before is put back.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import functools
import importlib.util
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

from orbit_bullet.library import Client, silence

_PROBE = """
import sys
sys.path[:] = sys.argv[2:]
import pybullet
pybullet.connect(pybullet.DIRECT)
assert pybullet.loadPlugin(sys.argv[1], "_eglRendererPlugin") >= 0
pybullet.getCameraImage(8, 8, renderer=pybullet.ER_BULLET_HARDWARE_OPENGL)
"""
_PROBE_SECONDS = 60.0
# EGL's numbers of the surfaces that a context draws to and reads from.
_DRAW, _READ = 0x3059, 0x305A


class OpenGl:
    """A client that draws with OpenGL."""

    def __init__(self, client: Client, egl: ctypes.CDLL) -> None:
        """Take over the context that is current, which Bullet has just made."""
        self.client = client
        """Bullet's client that owns the context."""
        self._egl = egl
        self._own = _current(egl)

    @contextlib.contextmanager
    def current(self) -> Iterator[None]:
        """Have Bullet's context current in this thread, and put back the one before."""
        before = _current(self._egl)
        self._egl.eglMakeCurrent(*self._own)
        try:
            yield
        finally:
            display = self._own[0]
            self._egl.eglMakeCurrent(*(before if before[0] else (display, None, None, None)))


_lock = threading.Lock()
# The client of this process once it is made. It stays until the process ends: to close it would end EGL's display,
# which other libraries of the process share.
_made: list[OpenGl] = []
# The same while no renderer has it.
_free: list[OpenGl] = []


def acquire() -> OpenGl | None:
    """Return the OpenGL client of this process, without any shapes.

    Returns:
        None if another renderer has it, or OpenGL does not work here.
    """
    with _lock:
        if not _made and loads():
            _made.append(_make())
            _free.extend(_made)
        return _free.pop() if _free else None


def _make() -> OpenGl:
    egl, client = _egl(), Client()
    before = _current(egl)
    with silence():
        client.loadPlugin(_plugin(), "_eglRendererPlugin")
        opengl = OpenGl(client, egl)
        client.createMultiBody(0, -1, client.createVisualShape(client.GEOM_BOX, halfExtents=(1, 1, 1)))
        for shadow in (0, 1):  # the first picture of either kind prints
            client.getCameraImage(8, 8, shadow=shadow, renderer=client.ER_BULLET_HARDWARE_OPENGL)
        client.resetSimulation()
        atexit.register(_close, opengl)
    egl.eglMakeCurrent(*(before if before[0] else (_current(egl)[0], None, None, None)))
    return opengl


def _close(opengl: OpenGl) -> None:
    with silence(), opengl.current():
        opengl.client.close()


def release(opengl: OpenGl) -> None:
    """Give the client back, for the next renderer of this process."""
    with opengl.current():
        opengl.client.resetSimulation()
    _free.append(opengl)


@functools.cache
def loads() -> bool:
    """Return True if Bullet draws with OpenGL here, which a separate process tries.

    Where EGL finds no device, the plugin ends the process that loads it, without a word.
    """
    if not _plugin():
        return False
    try:
        _egl()
        words = [sys.executable, "-c", _PROBE, _plugin(), *sys.path]
        return subprocess.run(words, capture_output=True, timeout=_PROBE_SECONDS, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def _plugin() -> str:
    """Name of the plugin's file; empty if this build of Bullet has none."""
    found = importlib.util.find_spec("eglRenderer")
    return (found.origin or "") if found else ""


@functools.cache
def _egl() -> ctypes.CDLL:
    library = ctypes.CDLL("libEGL.so.1")
    for name in ("eglGetCurrentDisplay", "eglGetCurrentContext", "eglGetCurrentSurface"):
        getattr(library, name).restype = ctypes.c_void_p
    library.eglMakeCurrent.argtypes = (ctypes.c_void_p,) * 4
    return library


# Display, surface to draw to, surface to read from, and context.
_Current = tuple[Any, Any, Any, Any]


def _current(egl: ctypes.CDLL) -> _Current:
    surfaces = egl.eglGetCurrentSurface(_DRAW), egl.eglGetCurrentSurface(_READ)
    return egl.eglGetCurrentDisplay(), *surfaces, egl.eglGetCurrentContext()
