"""Operational-space control: the hand moves as six unit masses on springs, decoupled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from orbit_core.interfaces import Robot
from orbit_motion.compliant import Compliant, CompliantConfig, HandState, check_rate, without_free


@dataclass(frozen=True, kw_only=True)
class OperationalSpaceConfig(CompliantConfig):
    """A command is a pose of the hand, or its change, towards which the hand moves as a unit mass on springs.

    ``x'' = k (x* - x) - 2 zeta sqrt(k) x'`` in each of six directions, k in 1/s^2, the arm's inertia decoupled
    (:mod:`orbit_motion.compliant`).
    """

    name: ClassVar[str] = "osc"

    def build(self, name: str, robot: Robot) -> OperationalSpace:
        return OperationalSpace(name, robot, self)


class OperationalSpace(Compliant):
    """Six commands, or more for gains, :class:`OperationalSpaceConfig`."""

    def check_stable(self) -> None:
        step, ratio = self.physics_dt, self.gains.most_damped
        for stiffness in {*self.gains.stiffest}:
            what = f"a stiffness of {stiffness:g} with a damping ratio of {ratio:g}"
            check_rate(self.name, step**2 * stiffness + 4.0 * step * ratio * stiffness**0.5, what)
        self.check_posture()

    def hand_accelerations(self, hand: HandState, free: Tensor, aims: Mapping[str, Tensor]) -> Tensor:
        wanted = self.spring_accelerations(hand, aims) - without_free(hand, free)
        return hand.joint_accelerations(hand.wrench(wanted)) + free

    def spring_accelerations(self, hand: HandState, aims: Mapping[str, Tensor]) -> Tensor:
        """Return the accelerations (N, 6) of the unit masses on their springs."""
        stiffness, ratio = self.gains.of(aims)
        return stiffness * self.error(hand, aims) - 2.0 * ratio * stiffness.sqrt() * hand.velocity
