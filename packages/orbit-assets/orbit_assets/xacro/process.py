"""Process that expands one xacro file: reads an :class:`Order` and writes an :class:`Expansion`, or why there is none.

    python -P -m orbit_assets.xacro.process < order > result

The file's expressions are not Python (:mod:`orbit_assets.xacro.expressions`). The limits here hold even if a
fault is found in their evaluator: the process may read the files that the model may name and Python's own, and can
write no file, start no other process, use no network and run no code that is made from text.
"""

from __future__ import annotations

import os
import resource
import sys
import sysconfig
from collections.abc import Callable
from typing import Any

from orbit_assets.outside import allowed_folders
from orbit_assets.xacro.markup import Markup
from orbit_assets.xacro.order import Order

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_REFUSED = (
    "subprocess.", "os.", "socket.", "shutil.", "ctypes.", "pty.", "gc.", "code.", "mmap.", "fcntl.", "sys._",
    "resource.", "signal.", "tempfile.", "_thread.", "syslog.", "webbrowser.", "urllib.", "http.", "ftplib.",
)  # fmt: skip
"""Operations that no xacro file needs, by how the interpreter's audit events begin."""
_PATHS = [sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")]
_LIBRARY = [*_PATHS, *map(os.path.realpath, _PATHS)]
"""Folders of Python's own files, from which modules may still load."""
_LISTING = ("os.listdir", "os.scandir")
"""Events of includes by pattern; the files found are opened, or not, as any file."""


def main() -> int:
    """Expand the file that the order on standard input names; return the process's exit code."""
    order = Order.decoded(sys.stdin.read())
    for name in set(os.environ) - {"HOME"}:  # the user's home, above which no packages are looked for
        del os.environ[name]
    markup = Markup(order)
    restrict(order, markup.folders)
    try:
        said = markup.expanded().encoded()
    except Exception as error:  # a file's faults are of any class
        if _for_memory(error):
            _write(f"it takes more than {order.memory // 2**20} MiB of memory")
        else:
            _write(f"{type(error).__name__}: {' '.join(str(error).split())}"[:2000])
        return 1
    _write(said)
    return 0


def _write(text: str) -> None:
    """Write to standard output, halves of surrogate pairs included, which text of a file may hold."""
    sys.stdout.buffer.write(text.encode("utf-8", "backslashreplace"))


def _for_memory(error: BaseException | None) -> bool:
    """Return True if an error is a lack of memory, or was raised for one."""
    return error is not None and (isinstance(error, MemoryError) or _for_memory(error.__context__))


def restrict(order: Order, folders: list[str]) -> None:
    """Take away from this process what expanding needs not; there is no way back.

    Args:
        order: limits of memory and processor time, and the folders that may be read.
        folders: further folders that may be read; the list may grow later.
    """
    for limit, most in (
        (resource.RLIMIT_AS, order.memory),
        (resource.RLIMIT_CPU, order.seconds + 1),  # the caller counts wall time, which is up first
        (resource.RLIMIT_FSIZE, 0),  # what is written to a pipe is no file
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(limit, (most, most))
    given = [os.path.realpath(folder) for folder in (*allowed_folders(order.path, order.options()), *order.outside)]
    sys.addaudithook(_guard(given, folders))


def _guard(given: list[str], later: list[str]) -> Callable[[str, tuple[Any, ...]], None]:
    def check(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, mode, flags = arguments
            if isinstance(path, int):
                return
            writes = any(letter in (mode or "") for letter in "wax+") or bool(flags & _WRITING)
            check_place(path, writes=writes)
        elif event in _LISTING:
            check_place(arguments[0])
        elif event == "exec":
            name = arguments[0].co_filename
            if not name.startswith(("<frozen ", *_LIBRARY)):
                raise RuntimeError(f"it runs code of '{name}', which no model may")
        elif event.startswith(_REFUSED):
            raise RuntimeError(f"it calls {event}, which no model may")

    def check_place(path: Any, *, writes: bool = False) -> None:
        place = os.path.realpath(os.fsdecode(path))
        if writes or not any(_below(place, folder) for folder in (*given, *later, *_LIBRARY)):
            raise RuntimeError(f"it opens '{place}', which the model may not: ReadOptions(allow_outside=...)")

    return check


def _below(place: str, folder: str) -> bool:
    return place == folder or place.startswith(os.path.join(folder, ""))


if __name__ == "__main__":
    sys.exit(main())
