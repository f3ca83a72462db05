"""Cartesian impedance control: springs draw the hand to its goal, with the inertia that the arm has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.interfaces import Robot
from orbit_motion.compliant import Compliant, CompliantConfig, HandState, check_rate, without_free

# Iterations: enough for motions whose frequencies differ by a factor of 15.
_ROOT_ITERATIONS = 8


@dataclass(frozen=True, kw_only=True)
class CartesianImpedanceConfig(CompliantConfig):
    """A command is a pose of the hand, or its change, towards which springs draw the hand.

    ``wrench = K (x* - x) - D x'`` in six world axes, K in N/m and N m/rad. The arm's inertia stays as it is: the hand
    yields to a steady force by force over stiffness (Hogan, Impedance Control: An Approach to Manipulation, Journal of
    Dynamic Systems, Measurement, and Control 107, 1985). ``D = 2 zeta (Lambda # K)``, the geometric mean of the inertia
    that the hand shows and the stiffness, gives all its motions the damping ratio zeta, however the axes are coupled
    (the double diagonalisation of Albu-Schaeffer et al., Cartesian Impedance Control of Redundant Robots, ICRA 2003).
    """

    name: ClassVar[str] = "impedance"

    stiffness: float = 400.0
    rotational_stiffness: float = 30.0

    def build(self, name: str, robot: Robot) -> CartesianImpedance:
        return CartesianImpedance(name, robot, self)


class CartesianImpedance(Compliant):
    """Six commands, or more for gains, :class:`CartesianImpedanceConfig`."""

    def __init__(self, name: str, robot: Robot, config: CartesianImpedanceConfig) -> None:
        super().__init__(name, robot, config)
        self._inverse_root = InverseRoot(6, self.device)

    def check_stable(self) -> None:
        step = self.physics_dt
        # Double precision: eigenvalues of products of small inertias are lost in single.
        roots = torch.tensor(self.gains.stiffest, dtype=torch.float64, device=self.device).sqrt()
        mobility = roots.unsqueeze(-1) * self.workspace_mobility() * roots
        fastest = float(torch.linalg.eigvalsh(mobility).max()) ** 0.5
        told = f"a stiffness of {max(self.gains.stiffest):g} with a damping ratio of {self.gains.most_damped:g}"
        check_rate(self.name, (step * fastest) ** 2 + 4.0 * step * self.gains.most_damped * fastest, told)
        self.check_posture()

    def hand_accelerations(self, hand: HandState, free: Tensor, aims: Mapping[str, Tensor]) -> Tensor:
        stiffness, ratio = self.gains.of(aims)
        weights = (2.0 * ratio * stiffness).sqrt()
        roots = stiffness.sqrt()
        inverse_rate = self._inverse_root(roots.unsqueeze(-1) * hand.inverse_inertia * roots.unsqueeze(-2))
        damping = weights * torch.bmm(inverse_rate, (weights * hand.velocity).unsqueeze(-1)).squeeze(-1)
        wrench = stiffness * self.error(hand, aims) - damping
        return hand.joint_accelerations(wrench - hand.wrench(without_free(hand, free))) + free


class InverseRoot:
    """``A^-1/2`` of symmetric positive definite matrices (N, n, n), by products only, which run as batched kernels.

    Newton and Schulz' iteration, coupled (Higham, Functions of Matrices, 2008, equation 6.35). Where A has eigenvalues
    below a 200th of its trace, the root comes out too small there.
    """

    def __init__(self, size: int, device: torch.device) -> None:
        self._identity = torch.eye(size, device=device)
        places = torch.arange(size, device=device)
        lower = torch.maximum(places[:, None], places) * size + torch.minimum(places[:, None], places)
        self._lower = lower.flatten()

    def __call__(self, matrix: Tensor) -> Tensor:
        # Scaled by the trace, eigenvalues are in (0, 1], where the iteration converges.
        size = matrix.diagonal(dim1=1, dim2=2).sum(-1)[:, None, None].clamp_min(1e-12)
        root, inverse = self._mirrored(matrix / size), self._identity.expand_as(matrix)
        for _ in range(_ROOT_ITERATIONS):
            step = 1.5 * self._identity - 0.5 * self._product(inverse, root)
            root, inverse = self._product(root, step), self._product(step, inverse)
        return inverse * size.rsqrt()

    def _product(self, a: Tensor, b: Tensor) -> Tensor:
        """Multiply matrices that commute and have a symmetric product: in a kernel only half of it is computed."""
        return self._mirrored(torch.bmm(a, b))

    def _mirrored(self, matrix: Tensor) -> Tensor:
        return matrix.flatten(1).index_select(1, self._lower).view(matrix.shape)
