"""Messages between the reader of a xacro file and the process that expands it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from orbit_assets.options import ReadLimits, ReadOptions


@dataclass(frozen=True)
class Order:
    """One file to expand, and what it may use."""

    path: str
    packages: Mapping[str, str]
    outside: tuple[str, ...]
    """Folders that the caller allows; "/" for any."""
    environment: Mapping[str, str]
    """Variables that ``$(env NAME)`` may read."""
    limits: ReadLimits
    characters: int
    """Most characters of the URDF."""
    memory: int
    """Bytes of address space of the process."""
    seconds: int
    """Processor time of the process."""

    def encoded(self) -> str:
        """Return the order as JSON."""
        return json.dumps(asdict(self))

    @staticmethod
    def decoded(text: str) -> Order:
        """Return the order that JSON from :meth:`encoded` holds."""
        fields = json.loads(text)
        return Order(**fields | {"outside": tuple(fields["outside"]), "limits": ReadLimits(**fields["limits"])})

    def options(self) -> ReadOptions:
        """Return the options by which files that the model names are found and opened."""
        return ReadOptions(
            packages={name: Path(folder) for name, folder in self.packages.items()},
            allow_outside=True if "/" in self.outside else tuple(map(Path, self.outside)),
            limits=self.limits,
        )


@dataclass(frozen=True)
class Expansion:
    """Result of an order.

    ``unnamed`` lists the variables for which ``$(optenv NAME default)`` gave its default.
    """

    document: str
    unnamed: tuple[str, ...]

    def encoded(self) -> str:
        """Return the result as JSON."""
        return json.dumps(asdict(self), ensure_ascii=False)

    @staticmethod
    def decoded(text: str) -> Expansion:
        """Return the result that JSON from :meth:`encoded` holds."""
        fields = json.loads(text)
        return Expansion(fields["document"], tuple(fields["unnamed"]))
