"""Options of the command line for reading a model: files that it may open, and handling of unsupported elements."""

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

# Remedies in readers' messages, which name Python's options, and the flag of the command line that does the same.
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
    """Replace Python's options in a reader's message by flags."""
    for words, flag in _FLAGS:
        text = re.sub(words, flag, text)
    return text


@contextmanager
def remedies_in_flags() -> Iterator[None]:
    """Rewrite the remedies in a reader's errors as flags of the command line.

    Raises:
        AssetError: one was raised within.
    """
    try:
        yield
    except AssetError as error:
        raise AssetError(in_flags(str(error))) from error


@dataclass(frozen=True, kw_only=True)
class ReadSettings:
    """Options for reading an asset file."""

    articulation: str | None = None
    """Name of the articulation, where the file holds several."""
    package: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=FOLDER")] = ()
    """Folder of package://NAME; repeatable."""
    allow_outside: bool = False
    """Allow the file to name files outside its folder and packages."""
    environment: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME")] = ()
    """An environment variable that $(env NAME) of a xacro file may read; repeatable."""
    unsupported: Literal["refuse", "drop"] = "refuse"
    """Handling of elements that ORBIT cannot describe."""
    repair: Literal["none", "balance"] = "none"
    """Handling of inertias that no body can have."""

    def options(self) -> ReadOptions:
        """Return the options for a reader.

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
