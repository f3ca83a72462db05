"""Kinds of ground. Each is a height as a function of position, which difficulty makes steeper, higher or sparser.

A cell is a square around its own origin. Its height is zero all along its rim, so that any cell may be next to any
other, and a robot starts in its middle. The kinds are those of Rudin et al., Learning to Walk in Minutes Using
Massively Parallel Deep Reinforcement Learning (2021), and of Isaac Gym's terrains before it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError

Array = npt.NDArray[np.floating[Any]]
Surface = Callable[[Array, Array], Array]
"""Height in metres at x and y in metres from the middle of a cell; arrays of one shape."""
# Metres: a place on an edge belongs to the side that is nearer to the middle.
_EDGE = 1e-9
# Most stones in a row across a cell.
_MOST_STONES = 1000


@dataclass(frozen=True)
class Span:
    """A quantity that goes from ``easy`` to ``hard`` in a straight line as difficulty goes from 0 to 1."""

    easy: float
    hard: float

    def at(self, difficulty: float) -> float:
        """Return the value at a difficulty."""
        return self.easy + difficulty * (self.hard - self.easy)


def is_number(value: object) -> bool:
    """Return True if the value is a finite number."""
    return isinstance(value, int | float) and bool(np.isfinite(value))


@dataclass(frozen=True, kw_only=True)
class TerrainKind(ABC):
    """One kind of ground."""

    platform: float = 2.0
    """Metres: side of the level square in the middle, where robots start."""

    def __post_init__(self) -> None:
        """Check what every kind must hold.

        Raises:
            ConfigurationError: a number is not finite, or a length is below zero; or a field is of another type.
        """
        for field in fields(self):
            value, usual = getattr(self, field.name), field.default
            what = f"terrain {type(self).__name__}: {field.name} is {value!r}"
            if isinstance(usual, Span) and not isinstance(value, Span):
                raise ConfigurationError(f"{what}: give Span(easy, hard)")
            if type(usual) is int and type(value) is not int:
                raise ConfigurationError(f"{what}: give a whole number")
            ends = (value.easy, value.hard) if isinstance(value, Span) else (value,)
            if not all(is_number(end) and end >= 0.0 for end in ends):
                raise ConfigurationError(f"{what}: give finite numbers, zero or above")

    @abstractmethod
    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        """Return the surface of a cell of side ``size`` (m) at a difficulty of 0 to 1; random values are drawn here,
        once.
        """


def _ring(x: Array, y: Array) -> Array:
    """Return the distance from the middle in the larger of both directions, whose level lines are squares."""
    return np.maximum(np.abs(x), np.abs(y))


def _square(place: Array, count: int, slack: float = 1e-6) -> npt.NDArray[np.int_]:
    """Return the square (of ``count`` in a row, side 1) of each place; an edge, within slack, belongs to the next."""
    return np.clip(np.floor(place + slack).astype(int), 0, count - 1)


def _inside(ring: Array, half: float) -> npt.NDArray[np.bool_]:
    return ring <= half + _EDGE


@dataclass(frozen=True, kw_only=True)
class Flat(TerrainKind):
    """Level ground."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        return lambda x, y: np.zeros_like(x)


@dataclass(frozen=True, kw_only=True)
class Rough(TerrainKind):
    """Heights drawn at knots of a square grid, level in the platform and plane in the triangles between the knots."""

    amplitude: Span = Span(0.01, 0.08)
    """Metres: heights are uniform between minus and plus this."""
    spacing: float = 0.2
    """Metres between knots, about; it is rounded so that knots lie on the rim."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        cells = max(round(size / self.spacing), 1) if self.spacing else 1
        step = size / cells
        knots = random.uniform(-1.0, 1.0, (cells + 1, cells + 1)) * self.amplitude.at(difficulty)
        place = np.linspace(-size / 2, size / 2, cells + 1)
        knots[_inside(_ring(*np.meshgrid(place, place)), self.platform / 2)] = 0.0
        knots[[0, -1]], knots[:, [0, -1]] = 0.0, 0.0

        def height(x: Array, y: Array) -> Array:
            column, row = (_square((v + size / 2) / step, cells, _EDGE) for v in (x, y))
            u, v = (x + size / 2) / step - column, (y + size / 2) / step - row
            start, across = knots[row, column], knots[row + 1, column + 1]
            # Each square is split along its rising diagonal, as height fields are.
            lower = start + u * (knots[row, column + 1] - start) + v * (across - knots[row, column + 1])
            upper = start + v * (knots[row + 1, column] - start) + u * (across - knots[row + 1, column])
            return np.where(u >= v, lower, upper)

        return height


@dataclass(frozen=True, kw_only=True)
class Slope(TerrainKind):
    """A pyramid with four slopes; upside down, a funnel."""

    grade: Span = Span(0.0, 0.4)
    """Rise over run: the tangent of the slope's angle."""
    down: bool = False
    """True for a funnel at whose bottom robots start, False for a pyramid on whose top they start."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        grade = self.grade.at(difficulty) * (-1.0 if self.down else 1.0)
        return lambda x, y: grade * (size / 2 - np.maximum(_ring(x, y), self.platform / 2))


@dataclass(frozen=True, kw_only=True)
class Stairs(TerrainKind):
    """A pyramid of steps; upside down, an amphitheatre."""

    rise: Span = Span(0.05, 0.23)
    """Metres: height of a step."""
    run: float = 0.3
    """Metres: depth of a step. A multiple of the grid's resolution, so that all steps are alike."""
    down: bool = False
    """True if robots start at the bottom and climb out."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        if not self.run:
            raise ConfigurationError("terrain Stairs: run is 0: give the steps a depth")
        # Down is the same surface upside down.
        rise = self.rise.at(difficulty) * (-1.0 if self.down else 1.0)
        most = np.floor((size - self.platform) / 2 / self.run + _EDGE)
        if most < 1.0:
            raise ConfigurationError(
                f"terrain Stairs: a step of {self.run:g} m does not fit between the rim of a {size:g} m cell and its "
                f"platform of {self.platform:g} m: give a shorter run"
            )
        return lambda x, y: rise * np.clip(np.floor((size / 2 - _ring(x, y)) / self.run + 1e-6), 0.0, most)


@dataclass(frozen=True, kw_only=True)
class SteppingStones(TerrainKind):
    """Square stones in a hole, level with the platform and the rim but for a little chance."""

    side: Span = Span(1.0, 0.3)
    """Metres: side of a stone."""
    apart: Span = Span(0.05, 0.2)
    """Metres between neighbouring stones."""
    unevenness: Span = Span(0.0, 0.05)
    """Metres: tops are uniform between minus and plus this."""
    depth: float = 1.0
    """Metres."""
    rim: float = 0.4
    """Metres: width of the level ground around the hole."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        apart = self.apart.at(difficulty)
        pitch = self.side.at(difficulty) + apart
        if pitch < size / _MOST_STONES:
            raise ConfigurationError(
                f"terrain SteppingStones: side and apart are {pitch:g} m together: in a cell of {size:g} m give "
                f"{size / _MOST_STONES:g} m or more"
            )
        count = int(np.ceil(size / pitch)) + 1
        tops = random.uniform(-1.0, 1.0, (count, count)) * self.unevenness.at(difficulty)

        def height(x: Array, y: Array) -> Array:
            across, along = (v + size / 2 for v in (x, y))
            column, row = (_square(v / pitch, count) for v in (across, along))
            # A slack of a micrometre keeps rounding from opening a gap one point wide at a stone's edge.
            wide = pitch - apart + 1e-6
            gap = (across - column * pitch > wide) | (along - row * pitch > wide)
            ring = _ring(x, y)
            level = _inside(ring, self.platform / 2) | ~(ring < size / 2 - self.rim - _EDGE)
            return np.where(level, 0.0, np.where(gap, -self.depth, tops[row, column]))

        return height


@dataclass(frozen=True, kw_only=True)
class Boxes(TerrainKind):
    """Square blocks side by side, each with an independent height."""

    amplitude: Span = Span(0.025, 0.15)
    """Metres: heights are uniform between minus and plus this."""
    side: float = 0.5
    """Metres: side of a block, about; it is rounded so that blocks fill the cell. The outermost ring is level."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        cells = max(round(size / self.side), 1) if self.side else 1
        heights = random.uniform(-1.0, 1.0, (cells, cells)) * self.amplitude.at(difficulty)
        heights[[0, -1]], heights[:, [0, -1]] = 0.0, 0.0

        def height(x: Array, y: Array) -> Array:
            column, row = (_square((v / size + 0.5) * cells, cells) for v in (x, y))
            return np.where(_inside(_ring(x, y), self.platform / 2), 0.0, heights[row, column])

        return height


@dataclass(frozen=True, kw_only=True)
class Gap(TerrainKind):
    """A trench around the platform, to be crossed."""

    width: Span = Span(0.1, 1.0)
    """Metres."""
    depth: float = 1.0
    """Metres."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        inner, width = self.platform / 2, self.width.at(difficulty)

        def height(x: Array, y: Array) -> Array:
            ring = _ring(x, y)
            trench = ~_inside(ring, inner) & (ring < inner + width - _EDGE) & (ring < size / 2 - _EDGE)
            return np.where(trench, -self.depth, 0.0)

        return height


@dataclass(frozen=True, kw_only=True)
class Pit(TerrainKind):
    """The platform is at the bottom of a pit with upright walls, which robots climb out of."""

    depth: Span = Span(0.05, 0.35)
    """Metres."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        depth = self.depth.at(difficulty)
        return lambda x, y: np.where(_inside(_ring(x, y), self.platform / 2), -depth, 0.0)


@dataclass(frozen=True, kw_only=True)
class Waves(TerrainKind):
    """``amplitude sin(k x) sin(k y)``: hills and hollows like those of a tray for eggs."""

    amplitude: Span = Span(0.02, 0.2)
    """Metres."""
    count: int = 3
    """Whole waves along each side of the cell, so that the rim is level."""

    def surface(self, size: float, difficulty: float, random: np.random.Generator) -> Surface:
        amplitude, k = self.amplitude.at(difficulty), 2.0 * np.pi * self.count / size
        return lambda x, y: amplitude * np.sin(k * (x + size / 2)) * np.sin(k * (y + size / 2))
