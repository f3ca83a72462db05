"""Truths that have no closed form, integrated in double precision at a fine step, and special functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Derivative = Callable[[FloatArray], FloatArray]


def trajectory(derivative: Derivative, start: FloatArray, times: Sequence[float], step: float = 1e-3) -> FloatArray:
    """States (T, n) at ``times`` (T,), ascending from zero, of ``dx/dt = derivative(x)`` with ``x(0) = start``.

    Classical Runge-Kutta of fourth order (Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I,
    section II.1) with steps of at most ``step`` seconds.
    """
    state, passed, states = np.asarray(start, dtype=np.float64), 0.0, []
    for time in times:
        count = max(1, math.ceil((time - passed) / step - 1e-9)) if time > passed else 0
        for _ in range(count):
            state = _runge_kutta(derivative, state, (time - passed) / count)
        passed = time
        states.append(state)
    return np.stack(states)


def _runge_kutta(derivative: Derivative, state: FloatArray, step: float) -> FloatArray:
    a = derivative(state)
    b = derivative(state + 0.5 * step * a)
    c = derivative(state + 0.5 * step * b)
    d = derivative(state + step * c)
    return state + step / 6 * (a + 2 * b + 2 * c + d)


def complete_elliptic_integral(modulus: float) -> float:
    """K(k) by the arithmetic-geometric mean (Abramowitz and Stegun, 17.6.3)."""
    a, b = 1.0, math.sqrt(1 - modulus**2)
    while a - b > 1e-15 * a:
        a, b = (a + b) / 2, math.sqrt(a * b)
    return math.pi / (a + b)


def pendulum_period(amplitude: float, small: float) -> float:
    """The period of swings to an angle of ``amplitude`` (rad), where small swings take ``small`` seconds.

    Landau and Lifshitz, Mechanics, 3rd ed., section 11, problem 1.
    """
    return small * 2 / math.pi * complete_elliptic_integral(math.sin(amplitude / 2))


def linear_response(stiffness: float, damping: float, inertia: float, times: Sequence[float]) -> FloatArray:
    """Positions (T,) of ``inertia a = stiffness (1 - q) - damping v`` from rest at zero.

    Ogata, Modern Control Engineering, 5th ed., section 5.3, by the two poles, complex or not.
    """
    time = np.asarray(times, dtype=np.float64)
    decay, frequency = damping / (2 * inertia), math.sqrt(stiffness / inertia)
    root = np.sqrt(complex(decay**2 - frequency**2))
    # Equal poles: the general form is 0 / 0.
    if abs(root) < 1e-9 * frequency:
        return 1 - np.exp(-decay * time) * (1 + decay * time)
    # The slow pole by the product of both: the difference would lose all digits for stiff drives.
    fast, slow = -decay - root, -(frequency**2) / (decay + root)
    return 1 - ((fast * np.exp(slow * time) - slow * np.exp(fast * time)) / (fast - slow)).real


def euler_equations(moments: Sequence[float]) -> Derivative:
    """The derivative of a free rigid body's state, by its principal ``moments``: quaternion (w, x, y, z), then spin.

    Goldstein, Classical Mechanics, 3rd ed., sections 5.5 and 5.6.
    """
    inertia = np.asarray(moments, dtype=np.float64)

    def derivative(state: FloatArray) -> FloatArray:
        (w, x, y, z), spin = state[:4], state[4:]
        p, q, r = spin
        turning = 0.5 * np.array([
            -x * p - y * q - z * r, w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p
        ])  # fmt: skip
        a, b, c = inertia
        return np.concatenate((turning, np.array([(b - c) * q * r, (c - a) * r * p, (a - b) * p * q]) / inertia))

    return derivative


@dataclass(frozen=True)
class PlanarChain:
    """The equal links of :func:`orbit_conformance.bodies.pendulum`, on hinges about y, the first fixed.

    State: joint angles, then joint velocities. With angles ``phi`` against the horizontal, ``T`` and ``V`` are those of
    a multiple pendulum (Goldstein, Classical Mechanics, 3rd ed., section 1.6 and exercise 1.22).
    """

    links: int
    """Number of links."""
    length: float
    """m of a link."""
    mass: float = 1.0
    """kg of a link."""
    inertia: float = 0.01
    """Moment of inertia of a link about its centre, at half its length."""
    armature: float = 0.0
    """Armature of each joint."""
    gravity: float = 9.81
    """m/s^2, downwards."""

    @property
    def _levers(self) -> FloatArray:
        """Matrix (k, i): how far link k's centre moves with link i's direction."""
        return self.length * (np.tri(self.links, k=-1) + 0.5 * np.eye(self.links))

    def derivative(self, state: FloatArray) -> FloatArray:
        """The time derivative of the state."""
        matrix, push = self._equations(state)
        rates = np.linalg.solve(matrix, push).astype(np.float64)
        return np.concatenate((state[self.links :], rates))

    def efforts(self, state: FloatArray, accelerations: FloatArray) -> FloatArray:
        """Efforts (links,) on the joints that give them the accelerations (links,)."""
        matrix, push = self._equations(state)
        return matrix @ accelerations - push

    def _equations(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the joint-space inertia, and the efforts of gravity and of centrifugal terms."""
        total = np.tri(self.links)  # joint angles to angles against the horizontal
        angles, speeds = total @ state[: self.links], total @ state[self.links :]
        levers = self._levers
        coupling = self.mass * levers.T @ levers
        apart = angles[:, None] - angles
        matrix = coupling * np.cos(apart) + self.inertia * np.eye(self.links)
        push = self.mass * self.gravity * levers.sum(0) * np.cos(angles) - (coupling * np.sin(apart)) @ speeds**2
        return total.T @ matrix @ total + self.armature * np.eye(self.links), total.T @ push

    def energy(self, state: FloatArray) -> float:
        """Kinetic and potential energy in J."""
        total = np.tri(self.links)
        angles, speeds = total @ state[: self.links], total @ state[self.links :]
        levers = self._levers
        matrix = self.mass * levers.T @ levers * np.cos(angles[:, None] - angles) + self.inertia * np.eye(self.links)
        joints = self.armature * float((state[self.links :] ** 2).sum())
        height = -(levers @ np.sin(angles)).sum()
        return 0.5 * float(speeds @ matrix @ speeds) + 0.5 * joints + self.mass * self.gravity * float(height)


@dataclass(frozen=True)
class RotaryPendulum:
    """Furuta's: a pendulum about the axis of an arm, which turns about the vertical; nothing drives or damps it.

    State: the arm's angle a, the pendulum's b (zero where it hangs down), and their rates. With ``J`` of the arm about
    its axis, lever ``l`` and inertia ``I`` (the same about any axis) of the pendulum, arm ``L``, Lagrange's equations
    (Cazzolato and Prime, Journal of Control Science and Engineering 2011, article 528341, with their J2 = I) are::

        (J + m L^2 + m l^2 sin^2 b + I) a'' + m L l cos b b'' = m L l sin b b'^2 - m l^2 sin 2b a' b'
        m L l cos b a'' + (m l^2 + I) b'' = m l^2 sin 2b a'^2 / 2 - m g l sin b
    """

    arm: float
    """L, m from the vertical axis to the pendulum's."""
    lever: float
    """l, m from the pendulum's axis to its centre."""
    arm_inertia: float
    """The arm's moment of inertia J about its axis, in kg m^2."""
    mass: float = 1.0
    """m, kg of the pendulum."""
    inertia: float = 0.01
    """Moment of inertia of the pendulum about its centre."""
    gravity: float = 9.81
    """g, m/s^2."""

    def derivative(self, state: FloatArray) -> FloatArray:
        """The time derivative of the state."""
        _, b, turning, swinging = state
        sine, cosine = math.sin(b), math.cos(b)
        twist = self.mass * self.lever**2 * 2 * sine * cosine
        couple = self.mass * self.arm * self.lever
        push = np.array([
            couple * sine * swinging**2 - twist * turning * swinging,
            0.5 * twist * turning**2 - self.mass * self.gravity * self.lever * sine,
        ])  # fmt: skip
        change = np.concatenate((state[2:], np.linalg.solve(self._inertia(b), push)))
        return np.asarray(change, np.float64)

    def energy(self, state: FloatArray) -> float:
        """Kinetic energy, and potential energy above the hanging pendulum's, in J."""
        rates = state[2:]
        height = self.lever * (1 - math.cos(state[1]))
        return 0.5 * float(rates @ self._inertia(state[1]) @ rates) + self.mass * self.gravity * height

    def _inertia(self, b: float) -> FloatArray:
        sine, couple = math.sin(b), self.mass * self.arm * self.lever * math.cos(b)
        own = self.mass * self.lever**2
        arm = self.arm_inertia + self.mass * self.arm**2 + own * sine**2 + self.inertia
        return np.array([[arm, couple], [couple, own + self.inertia]], dtype=np.float64)
