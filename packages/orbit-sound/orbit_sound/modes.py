"""Vibration modes of free bodies in closed form: bars, rods, plates, discs and spheres."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.special import spherical_jn

from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from orbit_sound.materials import SoundMaterial

_AIR_DENSITY = 1.204  # kg/m^3 at 20 degrees
SPEED_OF_SOUND = 343.0
"""Speed of sound in air at 20 degrees, m/s."""
_HIGHEST = 20_000.0  # Hz: no one hears more, and most microphones record less
_MOST = 24  # modes of a body: more are dense in frequency and add cost, not character


@dataclass(frozen=True)
class Modes:
    """Vibration modes of a body, as a microphone at 1 m hears them.

    Raises:
        ConfigurationError: lengths differ, or a number is out of its range.
    """

    frequencies: tuple[float, ...]
    """Hz."""
    decays: tuple[float, ...]
    """Rates in 1/s at which amplitudes decay."""
    gains: tuple[float, ...]
    """Pa m / (N s): amplitude of the pressure at 1 m of the damped sine that an impulse of 1 N s starts."""
    mass: float
    """kg that takes part in each mode."""

    def __post_init__(self) -> None:
        counts = {len(self.frequencies), len(self.decays), len(self.gains)}
        values = (*self.frequencies, *self.decays, *self.gains, self.mass)
        if len(counts) != 1 or not all(math.isfinite(value) and value >= 0.0 for value in values) or self.mass == 0.0:
            raise ConfigurationError(
                "modes need as many frequencies as decays and gains, all finite and at least zero, and a mass above "
                f"zero, not {len(self.frequencies)}, {len(self.decays)} and {len(self.gains)} with {self.mass} kg"
            )


def bar_modes(length: float, thickness: float, width: float, material: SoundMaterial) -> Modes:
    """Return the bending modes of a free bar across ``thickness``, by Euler and Bernoulli; lengths in m."""
    stiffness = material.young * width * thickness**3 / 12.0
    return _beam(length, stiffness, width * thickness, width * length, material)


def rod_modes(length: float, radius: float, material: SoundMaterial) -> Modes:
    """Return the bending modes of a free round rod, by Euler and Bernoulli; lengths in m."""
    stiffness = material.young * math.pi * radius**4 / 4.0
    return _beam(length, stiffness, math.pi * radius**2, 2.0 * radius * length, material)


def plate_modes(length: float, width: float, thickness: float, material: SoundMaterial) -> Modes:
    """Return the bending modes of a free rectangular plate, by Warburton's formula (5 % for low modes of a square).

    Warburton, The vibration of rectangular plates, Proceedings of the Institution of Mechanical Engineers 168, 1954.

    Args:
        length: m.
        width: m.
        thickness: m.
        material: of the plate.
    """
    ratio, poisson = length / width, material.poisson
    scale = math.pi**2 / length**2 * math.sqrt(_flexural(thickness, material) / (material.density * thickness))
    angular = []
    for along, across in itertools.product(range(8), repeat=2):
        # No nodal line, or a single one, is a motion of the rigid body.
        if along + across < 2:
            continue
        (gx, hx, jx), (gy, hy, jy) = _warburton(along), _warburton(across)
        square = gx**4 + (gy * ratio) ** 4 + 2.0 * ratio**2 * (poisson * hx * hy + (1.0 - poisson) * jx * jy)
        angular.append(scale * math.sqrt(square))
    return _finish(angular, length * width, material.density * length * width * thickness, material)


# Leissa, Vibration of Plates, NASA SP-160, 1969, table 2.6: omega r^2 sqrt(rho h / D) of a free disc, Poisson's ratio
# 0.33.
_DISC = (5.253, 9.084, 12.23, 20.52, 21.6, 33.1, 35.25, 38.55, 46.2, 52.91)


def disc_modes(radius: float, thickness: float, material: SoundMaterial) -> Modes:
    """Return the bending modes of a free round plate; lengths in m."""
    scale = math.sqrt(_flexural(thickness, material) / (material.density * thickness)) / radius**2
    area = math.pi * radius**2
    return _finish([scale * value for value in _DISC], area, material.density * area * thickness, material)


def sphere_modes(radius: float, material: SoundMaterial) -> Modes:
    """Return the spheroidal modes of a free solid sphere, by Lamb's frequency equation; the radius in m.

    Torsional modes move no air and are left out.
    """
    shear = material.young / (2.0 * (1.0 + material.poisson))
    scale = math.sqrt(shear / material.density) / radius
    roots = [root for order in (0, 2, 3, 4, 5) for root in sphere_roots(order, material.poisson)]
    mass = material.density * 4.0 / 3.0 * math.pi * radius**3
    return _finish([scale * root for root in roots], 2.0 * math.pi * radius**2, mass, material)


def sphere_roots(order: int, poisson: float, most: int = 2) -> list[float]:
    """Return the lowest roots ``omega radius / shear speed`` of a solid sphere's spheroidal modes.

    Args:
        order: n of the spherical harmonic.
        poisson: Poisson's ratio.
        most: number of roots.
    """
    # Ratio of the speeds of shear and pressure waves.
    slow = math.sqrt((1.0 - 2.0 * poisson) / (2.0 * (1.0 - poisson)))

    def stresses(root: npt.NDArray[np.floating] | float) -> npt.NDArray[np.floating]:
        """Return the determinant of the surface's radial and tangential stress (Eringen and Suhubi, 1975)."""
        press, shear, n = slow * root, root, order
        j = spherical_jn
        radial = (n * n - n - 0.5 * shear**2) * j(n, press) + 2.0 * press * j(n + 1, press)
        if n == 0:  # breathing: no shear at all
            return radial
        tangential = (n - 1) * j(n, press) - press * j(n + 1, press)
        radial_shear = n * (n + 1) * ((n - 1) * j(n, shear) - shear * j(n + 1, shear))
        tangential_shear = (n * n - 1 - 0.5 * shear**2) * j(n, shear) + shear * j(n + 1, shear)
        return radial * tangential_shear - radial_shear * tangential

    grid = np.arange(0.5, 25.0, 0.02)
    signs = np.sign(stresses(grid))
    crossings = np.flatnonzero(signs[1:] != signs[:-1])[:most]
    return [_root(stresses, float(grid[index]), float(grid[index + 1])) for index in crossings]


def _root(function: Callable[[float], npt.NDArray[np.floating]], low: float, high: float) -> float:
    """Return the root between two values of other signs."""
    root = brentq(function, low, high)
    assert isinstance(root, float)
    return root


def shape_modes(shape: Shape, material: SoundMaterial) -> Modes:
    """Return the modes of the closed form nearest to a shape: a mesh counts as its bounding box.

    A box three times longer than wide is a bar, one three times wider than thick a plate, any other a short bar.

    Raises:
        ConfigurationError: the shape has no end, as planes and height fields.
    """
    match shape.geometry:
        case Sphere(radius=radius):
            return sphere_modes(radius, material)
        case Cylinder(radius=radius, half_length=half) if half < radius:
            return disc_modes(radius, 2.0 * half, material)
        case Cylinder(radius=radius, half_length=half):
            return rod_modes(2.0 * half, radius, material)
        case Capsule(radius=radius, half_length=half):
            return rod_modes(2.0 * (half + radius), radius, material)
        case Box(half_extents=half):
            return _box_modes(2.0 * np.asarray(half), material)
        case Mesh(vertices=vertices):
            return _box_modes(np.ptp(vertices, axis=0), material)
        case other:
            raise ConfigurationError(
                f"a {type(other).__name__} has no vibration modes of its own: give the source its 'modes'"
            )


def _box_modes(extents: npt.NDArray[np.floating], material: SoundMaterial) -> Modes:
    thickness, width, length = (float(extent) for extent in np.sort(extents))
    if length < 3.0 * width and width >= 3.0 * thickness:
        return plate_modes(length, width, thickness, material)
    return bar_modes(length, thickness, width, material)


def _beam(length: float, stiffness: float, section: float, area: float, material: SoundMaterial) -> Modes:
    scale = math.sqrt(stiffness / (material.density * section)) / length**2
    # Roots of cos x cosh x = 1; from the fourth on (n + 1/2) pi to seven digits.
    roots = [4.730041, 7.853205, 10.995608, *((n + 0.5) * math.pi for n in range(4, 17))]
    return _finish([scale * root**2 for root in roots], area, material.density * section * length, material)


def _flexural(thickness: float, material: SoundMaterial) -> float:
    """Return the bending stiffness of a plate, N m."""
    return material.young * thickness**3 / (12.0 * (1.0 - material.poisson**2))


def _warburton(lines: int) -> tuple[float, float, float]:
    """Return Warburton's G, H and J of a free-free direction with that number of nodal lines."""
    if lines < 2:
        return 0.0, 0.0, lines * 12.0 / math.pi**2
    if lines == 2:
        return 1.506, 1.248, 5.017
    half = lines - 0.5
    return half, half**2 * (1.0 - 2.0 / (half * math.pi)), half**2 * (1.0 + 6.0 / (half * math.pi))


def _finish(angular: list[float], area: float, mass: float, material: SoundMaterial) -> Modes:
    """Return the audible modes with their decays and gains.

    Mode shapes are scaled to a mean square of one, so that each moves the whole mass, and a hit anywhere starts it with
    that mean. The face of area ``area`` radiates as a point source that is weak where waves are longer than it.
    """
    audible = sorted(value for value in angular if value < 2.0 * math.pi * _HIGHEST)[:_MOST]
    radius = math.sqrt(area / math.pi)
    decays, gains = [], []
    for value in audible:
        squared = (value / SPEED_OF_SOUND * radius) ** 2
        radiation = _AIR_DENSITY * area / (4.0 * math.pi) * squared / (1.0 + squared)
        decays.append(material.decay(value))
        gains.append(radiation * value / mass * _pulse(value * material.contact_time))
    return Modes(tuple(value / (2.0 * math.pi) for value in audible), tuple(decays), tuple(gains), mass)


def _pulse(angle: float) -> float:
    """Return the spectrum of a half-sine pulse that lasts ``angle`` radians, relative to its impulse."""
    if abs(angle - math.pi) < 1e-6:
        return math.pi / 4.0
    return abs(math.cos(0.5 * angle) / (1.0 - (angle / math.pi) ** 2))
