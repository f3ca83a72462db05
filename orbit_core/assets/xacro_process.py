"""The process in which :mod:`orbit_core.assets.xacro_files` expands a file: reads an order, writes URDF or an error."""

from __future__ import annotations

import importlib
import json
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from orbit_core.assets.options import ReadOptions
from orbit_core.assets.outside import package_folders

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_REFUSED = ("subprocess.", "os.", "socket.", "shutil.", "ctypes.", "pty.")
"""What no xacro file needs, by how the interpreter's audit events begin."""
_ALLOWED = ("os.listdir", "os.scandir", "os.walk")
"""Listing folders is what includes by pattern do; what is found is opened, or not, as any file."""


def main() -> None:
    """Expand the file that the order on standard input names, to standard output."""
    order = json.load(sys.stdin)
    limit = order["megabytes"] * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    # xacro imports yaml when it first needs it, when no file of Python's can be opened.
    xacro, substitution_args, _ = (
        importlib.import_module(name) for name in ("xacro", "xacro.substitution_args", "yaml")
    )

    folders = [*(order["folders"] or ["/"]), *order["packages"].values(), os.path.dirname(os.__file__)]
    vars(substitution_args)["_eval_find"] = _finder(order, folders)
    sys.addaudithook(_guard(folders))
    try:
        document = xacro.process_file(order["path"])
    except Exception as error:  # xacro's expressions raise anything
        print(f"{type(error).__name__}: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(1) from None
    sys.stdout.write(document.toxml())


def _finder(order: dict[str, Any], folders: list[str]) -> Callable[[str], str]:
    """What ``$(find package)`` gives: a folder as for ``package://``, without ROS; it joins those that may be read."""
    options = ReadOptions(packages={name: Path(folder) for name, folder in order["packages"].items()})

    def find(package: str) -> str:
        folder = next(package_folders(package, Path(order["path"]), options), None)
        if folder is None:
            raise FileNotFoundError(f"package '{package}' is unknown, give its folder by ReadOptions(packages=...)")
        folders.append(str(folder))
        return str(folder)

    return find


def _guard(folders: list[str]) -> Callable[[str, tuple[Any, ...]], None]:
    def check(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, mode, flags = arguments
            if isinstance(path, int):
                return
            place = os.path.realpath(os.fsdecode(path))
            writes = any(letter in (mode or "") for letter in "wax+") or bool(flags & _WRITING)
            if writes or not any(_below(place, folder) for folder in folders):
                raise RuntimeError(f"it opens '{place}', which the model may not: ReadOptions(allow_outside=...)")
        elif event.startswith(_REFUSED) and event not in _ALLOWED:
            raise RuntimeError(f"it calls {event}, which no model may")

    return check


def _below(place: str, folder: str) -> bool:
    return place.startswith(os.path.join(os.path.realpath(folder), ""))


if __name__ == "__main__":
    main()
