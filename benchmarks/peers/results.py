"""Results of measurements in turns, kept as JSON."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import msgspec
from session import Facts

from orbit_core.files import read_bytes, written_whole


@dataclass(frozen=True, kw_only=True)
class Side:
    """One project's part of a measurement, one way of stepping."""

    project: str
    """``orbit``, or name of the peer."""
    way: str
    """Way of stepping: "compiled", "processes" and the like."""
    facts: Facts
    """Properties of its environments."""
    versions: dict[str, str]
    """Versions by distribution."""
    start_seconds: list[float]
    """From the first import to the end of the first step, for each start of the process that was timed."""
    command_seconds: list[float]
    """From the command to the end of the first step, for each start of the process that was timed."""
    settle_seconds: float
    """Seconds of the steps after the first that do something once: compiling and recording."""
    memory_mib: float
    """Largest memory of the process and its children that was seen after a block of steps."""
    rates: list[float]
    """Steps of single environments per second, a block each."""
    raw_rates: list[float] = field(default_factory=list)
    """The same of the bare engine; empty where it was not measured."""
    pictures: list[float] = field(default_factory=list)
    """Pictures per second, a block each; empty where none were drawn."""
    no_pictures: str = ""
    """Why no pictures were drawn."""


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """A peer and ORBIT in turns, for one case and number of environments."""

    peer: str
    """Name of the peer."""
    case: str
    """Name of the case."""
    num_envs: int
    """Number of environments."""
    device: str
    """Device of the environments."""
    hardware: str = ""
    """Processor or GPU."""
    block_seconds: float = 0.0
    """Length of a block."""
    load: float = 0.0
    """Load average of the machine over the minute before."""
    sides: list[Side] = field(default_factory=list)
    """The peer's ways of stepping, then ORBIT's; empty where nothing was measured."""
    absent: str = ""
    """Why nothing was measured."""

    @property
    def key(self) -> tuple[str, str, int]:
        """Identity of the measurement: a new one takes the place of an old one."""
        return self.peer, self.case, self.num_envs

    def fastest(self, project: str) -> Side | None:
        """Return the way of stepping of a project whose median rate is highest."""
        sides = [side for side in self.sides if side.project == project]
        return max(sides, key=lambda side: statistics.median(side.rates), default=None)


@dataclass(frozen=True)
class Spread:
    """Median and quartiles of repeated measurements."""

    median: float
    low: float
    high: float

    @staticmethod
    def of(values: Sequence[float]) -> Spread:
        """Return the spread of at least one value."""
        ordered = sorted(values)
        return Spread(statistics.median(ordered), ordered[len(ordered) // 4], ordered[-1 - len(ordered) // 4])

    @staticmethod
    def of_ratio(above: Sequence[float], below: Sequence[float]) -> Spread:
        """Return the spread of ratios, block by block: neighbours in time share the machine's state."""
        return Spread.of([one / other for one, other in zip(above, below, strict=True)])


def read(path: Path) -> list[Measurement]:
    """Read measurements; none where there is no file yet."""
    return msgspec.json.decode(read_bytes(path), type=list[Measurement]) if path.exists() else []


def read_learned(path: Path) -> list[dict[str, Any]]:
    """Return the lines of ``learn.py`` and ``speed.py`` in a file; none if there is no such file."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def write(path: Path, measurements: list[Measurement]) -> None:
    """Write measurements; the file is whole or as it was."""
    with written_whole(path) as written:
        values = [asdict(measurement) for measurement in measurements]
        written.write_text(json.dumps(msgspec.to_builtins(values), indent=1) + "\n", encoding="utf-8")


def merged(old: list[Measurement], new: list[Measurement]) -> list[Measurement]:
    """Return both, where new measurements take the place of old ones of the same key, unless they are absent.

    A run without the peer's device or models says why it measured nothing, and loses no figure of an earlier run.
    """
    found = {measurement.key: measurement for measurement in old}
    for measurement in new:
        if measurement.sides or not (known := found.get(measurement.key)) or not known.sides:
            found[measurement.key] = measurement
    return sorted(found.values(), key=lambda measurement: measurement.key)
