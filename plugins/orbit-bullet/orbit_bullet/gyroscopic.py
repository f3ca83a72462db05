"""The rotation of free bodies, by their angular momentum.

Bullet takes the gyroscopic torque ``- w x L`` of a body at the beginning of a step, so that a fast one gains energy
without end. Here a torque before the step makes Bullet turn the body with the velocity of the step's middle, where
``w = I(exp(w h / 2) R)^-1 L`` with the orientation R, the step of h seconds and the angular momentum L (implicit
midpoint). After the step the velocity becomes the one that L, with what the step added to it, has in the new
orientation: ``w = I(R)^-1 L``. A free body then keeps its angular momentum to rounding at any speed, and its
energy does not drift as long as a step turns it by less than about 45 degrees, which is the most that Bullet does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit.rotations import cross, rotate

FloatArray = npt.NDArray[np.float64]
# Relative difference of moments below which a body has no gyroscopic torque.
_ROUND = 1e-9
# rad that a body turns in a step, below which it is left to Bullet: what trembles on its contacts would be given half
# of a gyroscopic torque that no contact saw. At 5 ms and 1.9 rad/s a free body then gains 0.2 % of energy in 2 s.
_SLOW = 1e-2

# Most rounds of the fixed-point iteration for the middle of a step, and the relative change that ends it.
_ROUNDS, _SETTLED = 40, 1e-9
# rad that a body turns in half a step, from which on whole steps of the iteration may lead away.
_FAR = 0.3


@dataclass
class _Turning:
    """A body in the midst of a step, in world axes."""

    inertia: FloatArray
    momentum: FloatArray
    middle: FloatArray
    """The angular velocity that Bullet gives it if nothing else acts, in the step's middle."""


class Gyroscopes:
    """Bodies of one link that are free to turn."""

    def __init__(self, client: Any, bodies: list[int], dt: float) -> None:
        self._client = client
        self._bodies = bodies
        self._dt = dt
        self._turning: dict[int, _Turning] = {}
        self.refresh()

    def refresh(self) -> None:
        """Read the moments about principal axes again, after they were changed."""
        moments = {body: np.array(self._client.getDynamicsInfo(body, -1)[2]) for body in self._bodies}
        self._moments = {body: own for body, own in moments.items() if np.ptp(own) > _ROUND * own.max()}

    def begin(self) -> None:
        """Before a step."""
        client, dt = self._client, self._dt
        self._turning.clear()
        for body, moments in self._moments.items():
            x, y, z = client.getBaseVelocity(body)[1]
            if x * x + y * y + z * z < (_SLOW / dt) ** 2:
                continue
            spin, axes = np.array((x, y, z)), self._axes(body)
            inertia = (axes * moments) @ axes.T
            momentum = inertia @ spin
            middle = axes @ self._middle(axes.T @ momentum, moments)
            # The second term cancels the torque that Bullet takes off by itself.
            torque = inertia @ (middle - spin) / dt + cross(spin, momentum)
            self._turning[body] = _Turning(inertia, momentum, middle)
            client.applyExternalTorque(body, -1, torque.tolist(), client.WORLD_FRAME)

    def end(self) -> None:
        """After it."""
        client = self._client
        for body, before in self._turning.items():
            reached = np.array(client.getBaseVelocity(body)[1])
            momentum = before.momentum + before.inertia @ (reached - before.middle)
            axes = self._axes(body)
            spin = (axes / self._moments[body]) @ (axes.T @ momentum)
            client.resetBaseVelocity(body, angularVelocity=spin.tolist())

    def _middle(self, momentum: FloatArray, moments: FloatArray) -> FloatArray:
        """The angular velocity half a step on, in the principal axes at the beginning, as the momentum is."""
        spin = momentum / moments
        for _ in range(_ROUNDS):
            angle = 0.5 * self._dt * float(np.linalg.norm(spin))
            turn = np.concatenate(([np.cos(0.5 * angle)], -np.sin(0.5 * angle) * 0.5 * self._dt / angle * spin))
            change = rotate(turn, momentum) / moments - spin
            # Half steps converge where the iteration would swing about its solution.
            spin = spin + (change if angle < _FAR else 0.5 * change)
            if np.abs(change).sum() < _SETTLED * np.abs(spin).sum():
                break
        return spin

    def _axes(self, body: int) -> FloatArray:
        """Principal axes as columns, in world axes."""
        orientation = self._client.getBasePositionAndOrientation(body)[1]
        return np.array(self._client.getMatrixFromQuaternion(orientation)).reshape(3, 3)
