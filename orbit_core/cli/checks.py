"""What can be known to be wrong before any work is done."""

from __future__ import annotations

import os
from pathlib import Path

from orbit_core.files import storage_faults, sweep
from orbit_core.interfaces.errors import ConfigurationError


def check_output(path: Path | None, suffix: str, overwrite: bool) -> None:
    """Refuse a file that could not be written, or is there already, before the work whose result it is to hold.

    What a program that was killed has left in its folder is deleted.
    """
    if path is None:
        return
    if path.suffix != suffix:
        raise ConfigurationError(f"the name of output file {path} must end in {suffix}")
    if not path.parent.is_dir():
        raise ConfigurationError(f"cannot write {path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise ConfigurationError(f"cannot write {path}: folder {path.parent} is read-only for this user")
    if path.is_dir():
        raise ConfigurationError(f"cannot write {path}: it is a folder")
    if path.exists() and not path.is_file():
        raise ConfigurationError(f"cannot write {path}: it is no regular file")
    if path.exists() and not overwrite:
        raise ConfigurationError(f"{path} is there already: give another name, or --overwrite")
    sweep(path.parent)


def make_folder(path: Path) -> None:
    """Make the folder that an output file is to lie in.

    Raises:
        StorageError: it cannot be made.
    """
    with storage_faults(path):
        path.parent.mkdir(parents=True, exist_ok=True)


def check_port(name: str, port: int) -> None:
    """Refuse what is no port."""
    if not 0 <= port <= 65535:
        raise ConfigurationError(f"{name} must be from 0 to 65535, not {port}")


def check_positive(name: str, value: int) -> None:
    """Refuse a number below one."""
    if value < 1:
        raise ConfigurationError(f"{name} must be at least 1, not {value}")


def check_steps(max_steps: int | None) -> None:
    """Refuse a limit of steps below one."""
    if max_steps is not None:
        check_positive("max_steps", max_steps)


def check_size(name: str, size: tuple[int, ...]) -> None:
    """Refuse what is no width and height; a file's list may have any length."""
    if len(size) != 2:
        raise ConfigurationError(f"{name} must be a width and a height, not {list(size)}")
