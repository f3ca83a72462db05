"""How the command line says which files a model may open, and what is done with what ORBIT lacks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction, arg

from orbit_assets.options import ReadOptions, Repair, Unsupported
from orbit_core.interfaces.errors import AssetError, ConfigurationError

# Remedies as readers say them to programs, and the flag that does the same on the command line.
_FLAGS = (
    (r"ReadOptions\(unsupported=[^)]*\)", "--unsupported drop"),
    (r"ReadOptions\(repair=[^)]*\)", "--repair balance"),
    (r"allow its folder by ReadOptions\(allow_outside=\(folder,\)\)", "let it by --allow-outside"),
    (r"ReadOptions\(allow_outside=[^)]*\)", "--allow-outside"),
    (r"ReadOptions\(packages=\{'([^']*)': folder\}\)", r"--package \1=FOLDER"),
    (r"ReadOptions\(packages=[^)]*\)", "--package NAME=FOLDER"),
    (r"ReadOptions\(articulation=[^)]*\)", "--articulation NAME"),
    (r"ReadOptions\(environment=[^)]*\)", "--environment NAME"),
)


def in_flags(text: str) -> str:
    """Return a reader's message with flags in the place of Python's words."""
    for words, flag in _FLAGS:
        text = re.sub(words, flag, text)
    return text


@contextmanager
def remedies_in_flags() -> Iterator[None]:
    """Let a reader's refusals name flags of the command line.

    Raises:
        AssetError: one was raised within.
    """
    try:
        yield
    except AssetError as error:
        raise AssetError(in_flags(str(error))) from error


@dataclass(frozen=True, kw_only=True)
class ReadSettings:
    """How an asset file is read."""

    articulation: str | None = None
    """Which one, where the file holds several."""
    package: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=FOLDER")] = ()
    """Where package://NAME is; repeatable."""
    allow_outside: bool = False
    """Let the file name files outside its folder and packages."""
    environment: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME")] = ()
    """An environment variable that $(env NAME) of a xacro file may read; repeatable."""
    unsupported: Literal["refuse", "drop"] = "refuse"
    """What becomes of what ORBIT cannot describe."""
    repair: Literal["none", "balance"] = "none"
    """What becomes of inertias that no body can have."""

    def options(self) -> ReadOptions:
        """The same for readers.

        Raises:
            ConfigurationError: a package is not given as NAME=FOLDER.
        """
        packages: dict[str, Path] = {}
        for words in self.package:
            name, _, folder = words.partition("=")
            if not (name and folder):
                raise ConfigurationError(f"--package takes NAME=FOLDER, not '{words}'")
            packages[name] = Path(folder)
        return ReadOptions(
            packages=packages,
            allow_outside=self.allow_outside,
            environment=self.environment,
            articulation=self.articulation,
            unsupported=Unsupported(self.unsupported),
            repair=Repair(self.repair),
        )
