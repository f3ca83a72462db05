"""Laws between the positions of two joints, as MJCF's constraints on joints and on fixed tendons state them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orbit_core.scene import Mimic

_NEGLIGIBLE = 1e-12
"""Share of the largest coefficient of a law below which a coefficient counts as none."""


@dataclass(frozen=True)
class Law:
    """The position of joint ``follower``: a polynomial in that of ``leader``, or a constant where there is none."""

    follower: int
    leader: int | None
    coefficients: tuple[float, ...]
    """Coefficients of the leader's powers, from the zeroth on."""

    def mimic(self, leader_name: str) -> Mimic:
        """The mimic of the description."""
        offset, multiplier, *higher = (*self.coefficients, 0.0)[: max(2, len(self.coefficients))]
        return Mimic(leader_name, multiplier, offset, tuple(higher))

    def turned(self) -> Law | None:
        """The same law for the other joint's position, if there is one."""
        if self.leader is None or len(self.coefficients) != 2 or not self.coefficients[1]:
            return None
        offset, slope = self.coefficients
        return Law(self.leader, self.follower, (-offset / slope, 1.0 / slope))


def polynomial_law(
    follower: tuple[int, float], leader: tuple[int, float] | None, coefficients: np.ndarray, scales: tuple[float, float]
) -> Law:
    """The law of ``scale * (q - reference)`` of the follower, a polynomial in the same of the leader.

    Args:
        follower: a joint's number, and its reference.
        leader: likewise, or ``None`` for a constant.
        coefficients: (5,) of the polynomial, from the zeroth power on.
        scales: of the follower and of the leader.
    """
    joint, rest = follower
    own, others = scales
    if leader is None:
        return Law(joint, None, (rest + float(coefficients[0]) / own,))
    other, other_rest = leader
    powers = np.polynomial.Polynomial(coefficients / own)(
        np.polynomial.Polynomial((-others * other_rest, others))
    ).coef.tolist()
    powers += [0.0] * (2 - len(powers))
    powers[0] += rest
    while len(powers) > 2 and powers[-1] == 0.0:
        powers.pop()
    return Law(joint, other, tuple(float(power) for power in powers))


def linear_law(coefficients: Mapping[int, float], total: float) -> Law | None:
    """The law of a weighted sum of joint positions of given value; ``None`` unless it is of one joint or two."""
    largest = max((abs(value) for value in coefficients.values()), default=0.0)
    held = {joint: value for joint, value in coefficients.items() if abs(value) > _NEGLIGIBLE * largest}
    if len(held) == 1:
        ((joint, coefficient),) = held.items()
        return Law(joint, None, (total / coefficient,))
    if len(held) == 2:
        leader, follower = sorted(held)
        return Law(follower, leader, (total / held[follower], -held[leader] / held[follower]))
    return None
