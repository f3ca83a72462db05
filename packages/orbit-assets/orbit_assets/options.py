"""Options for reading asset files: files that may be opened, limits of size, and handling of what ORBIT lacks."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from orbit_core.configuration import TypeChecker
from orbit_core.interfaces.errors import ArgumentError


class Unsupported(Enum):
    """Handling of something in a file that the description cannot hold."""

    REFUSE = "refuse"
    """The file is rejected, and the error names the element."""
    DROP = "drop"
    """It is left out, and the articulation's notes say so."""


class Repair(Enum):
    """Handling of an inertia that no body can have."""

    NONE = "none"
    """The file is rejected."""
    BALANCE = "balance"
    """The principal moments are raised to the nearest that a body can have, and the articulation's notes say so."""


@dataclass(frozen=True)
class ReadLimits:
    """Limits on the resources that one model may use, its meshes and pictures included; checked before allocation."""

    file_bytes: int = 512 * 2**20
    """Most bytes of any one file."""
    expanded_bytes: int = 2**30
    """Most bytes of all that an archive holds, once unpacked."""
    elements: int = 2_000_000
    """XML elements of a file, or prims of a stage."""
    copies: int = 10_000
    """Elements that MJCF makes of a count: by ``<replicate>``, ``<composite>``, ``<flexcomp>``, ``<attach>``
    and ``nkey``, whose time to compile grows with their square; and files that an SDFormat world includes."""
    nesting: int = 2_000
    """XML elements, or folders of included files, within each other."""
    vertices: int = 10_000_000
    """Most vertices of one mesh; also the most triangles and corners of faces."""
    pixels: int = 64 * 2**20
    """Most pixels of one picture."""


@dataclass(frozen=True)
class ReadOptions:
    """Options of every reader of asset files.

    ``packages`` gives the folders of packages that ``package://`` names, in addition to the model's own.
    ``allow_outside`` allows a model to name files outside its folder and its packages: those below the folders listed,
    or
    any (``True``). ``environment`` names the environment variables that a xacro file may read by ``$(env NAME)``.
    ``articulation`` names one of several in a file.
    """

    packages: Mapping[str, Path] = field(default_factory=dict)
    allow_outside: bool | tuple[Path, ...] = False
    environment: tuple[str, ...] = ()
    limits: ReadLimits = field(default_factory=ReadLimits)
    """Largest sizes and counts that a file may have."""
    articulation: str | None = None
    unsupported: Unsupported = Unsupported.REFUSE
    """Treatment of elements that the description cannot hold: an error, or a note."""
    repair: Repair = Repair.NONE
    """Repairs of meshes and inertias that are allowed; none by default."""

    def __post_init__(self) -> None:
        """Check all fields: readers would blame the file, or would not notice.

        Raises:
            ArgumentError: a field is of another type.
        """
        if not isinstance(self.allow_outside, bool | tuple):
            raise ArgumentError(f"ReadOptions.allow_outside is {self.allow_outside!r}: give True or a tuple of folders")
        TypeChecker().check(self, "ReadOptions")
        folders = self.allow_outside if isinstance(self.allow_outside, tuple) else ()
        for folder in (*folders, *self.packages.values()):
            if not isinstance(folder, str | os.PathLike):
                raise ArgumentError(f"ReadOptions names the folder {folder!r}: give a path")
