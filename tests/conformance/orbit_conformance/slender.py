"""Truths of ropes and cloths: closed forms, and equations of one variable solved to double precision."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from orbit_conformance.reference import FloatArray, trajectory

# The first zero of J0 (Abramowitz and Stegun, table 9.5).
BESSEL_ZERO = 2.404825557695773


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the root of a function that has opposite signs at both ends, by bisection."""
    rising = function(high) > 0.0
    # Each halving gains a bit: 100 are more than a double holds.
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if (function(middle) > 0.0) == rising else (middle, high)
    return 0.5 * (low + high)


def catenary(length: float, span: float) -> float:
    """The parameter a (m) of ``z = a cosh(x / a)`` of a rope between two points of equal height, ``span`` apart.

    Routh, A Treatise on Analytical Statics, vol. I, section 443: ``2 a sinh(span / (2 a)) = length``.
    """
    return root(lambda a: length - 2 * a * math.sinh(min(span / (2 * a), 700.0)), 1e-3 * span, 1e3 * span)


def chain_period(length: float, gravity: float) -> float:
    """Seconds that small swings of a hanging chain take in its first mode: ``4 pi sqrt(L / g) / 2.405`` (Lamb)."""
    return 4 * math.pi * math.sqrt(length / gravity) / BESSEL_ZERO


def loaded_chain_period(length: float, chain: float, load: float, gravity: float) -> float:
    """Seconds of the first mode of a hanging chain of mass ``chain`` (kg) with a mass ``load`` at its end.

    Sujith and Hodges, Exact solution for the free vibration of a hanging cord with a tip mass, 1995: with z the height
    above the load and c = L load / chain, the deflection is ``A J0(u) + B Y0(u)``, ``u = 2 w sqrt((z + c) / g)``; the
    load follows ``g y' = -w^2 y`` at z = 0, and the upper end is held. Here the same equation is integrated from below.
    """
    rate = math.sqrt(gravity / length)

    def held(frequency: float) -> float:
        def slope(state: FloatArray) -> FloatArray:  # of the deflection, the tension times its slope, and z
            deflection, pull, z = state
            return np.array(
                [pull / (gravity * (load + chain * z / length)), -(frequency**2) * chain / length * deflection, 1.0]
            )

        start = np.array([1.0, -(frequency**2) * load, 0.0])
        return float(trajectory(slope, start, (length,), length / 200)[0, 0])

    return 2 * math.pi / root(held, 0.5 * rate, 1.5 * rate)


def elastica_droop(length: float, weight: float, stiffness: float) -> float:
    """Metres that the tip of a strip falls that is held level at one end: ``B theta'' = -w (L - s) cos(theta)``.

    Bickley, The heavy elastica, 1934, by shooting at the curvature that vanishes at the free end.

    Args:
        length: L in metres.
        weight: w in N/m per metre of width.
        stiffness: B in N m, Peirce's flexural rigidity; ``w L^3 / B`` up to 50, beyond which there are other solutions.
    """

    def end(curvature: float) -> FloatArray:  # angle, curvature, drop, arc length
        def slope(state: FloatArray) -> FloatArray:
            angle, bent, _, s = state
            return np.array([bent, -weight * (length - s) * math.cos(angle) / stiffness, math.sin(angle), 1.0])

        # Shooting: a guess of the curvature at the clamp, integrated to the free end.
        return trajectory(slope, np.array([0.0, curvature, 0.0, 0.0]), (length,), length / 200)[0]

    # A beam's curvature at the clamp; of a limp strip the integral of the equation times theta' gives a lesser bound.
    most = min(0.5 * weight * length**2 / stiffness, math.sqrt(2 * weight * length / stiffness))
    curvature = root(lambda guess: float(end(guess)[1]), 0.0, most)
    return float(end(curvature)[2])


class Edge:
    """A strip of length L on a level table that hangs down over a quarter-round edge, with friction all along.

    The capstan equation with the strip's own weight and inertia (Euler; Meriam and Kraige, Statics, section 6/8), with
    m the mass per length: along the arc ``dT/dtheta = mu (T - m v^2) + mu m g R cos(theta) - m g R sin(theta) + m a R``
    where it moves, on the table ``T = m (mu g + a) L1``, and below ``T = m (g - a) L2``.

    Args:
        length: L in metres.
        radius: R in metres, to the strip's middle.
        friction: mu.
        gravity: g in m/s^2.
    """

    def __init__(self, length: float, radius: float, friction: float, gravity: float) -> None:
        self._straight, self._radius = length - 0.5 * math.pi * radius, radius
        self._friction, self._gravity = friction, gravity
        angles = np.linspace(0.0, 0.5 * math.pi, 2001)
        gains = np.exp(friction * (0.5 * math.pi - angles))
        # How much more tension the far end of the arc bears than the near one.
        self._gain = float(gains[0])
        pulls = gains * (friction * np.cos(angles) - np.sin(angles))
        self._weight = float(np.trapezoid(pulls, angles)) * gravity * radius
        self._inertia = float(np.trapezoid(gains, angles)) * radius

    @property
    def limit(self) -> float:
        """The length (m) below the arc at which the strip begins to slide."""
        return root(lambda below: self.acceleration(below, 0.0), 0.0, self._straight)

    def acceleration(self, below: float, speed: float) -> float:
        """m/s^2 of a strip that slides, of which ``below`` metres hang below the arc."""
        table, g, mu = self._straight - below, self._gravity, self._friction
        pressed = (self._gain - 1.0) * speed**2  # the integral of mu v^2 over the arc, that lifts it off
        resisting = self._gain * mu * g * table + self._weight - pressed
        return (g * below - resisting) / (self._gain * table + self._inertia + below)

    def slid(self, below: float, times: list[float], speed: float = 0.0) -> FloatArray:
        """Metres (T,) that a strip slides by ``times``, with ``below`` metres below the arc and a speed at first."""

        def slope(state: FloatArray) -> FloatArray:
            return np.array([state[1], self.acceleration(below + state[0], state[1])])

        return trajectory(slope, np.array([0.0, speed]), times)[:, 0]
