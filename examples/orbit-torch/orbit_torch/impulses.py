"""What resists motion in one step: joints' stops and friction, and contacts, as rows of one problem."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.interfaces import JointParameters
from orbit_torch.contacts import Touch
from orbit_torch.solver import Rows
from orbit_torch.system import Equation

_PUSH_OUT = 0.2
"""Share of an overlap that a step removes."""
_FASTEST = 1.0
"""Greatest speed of that, in m/s or rad/s."""


def approach(gaps: Tensor, dt: float) -> Tensor:
    """The least rate of gaps: closed within the step and no further, or opened gently where they overlap."""
    return torch.where(gaps > 0.0, -gaps / dt, (-_PUSH_OUT * gaps / dt).clamp_max(_FASTEST))


class JointRows:
    """R rows: joints' lower stops, their upper stops, their friction."""

    def __init__(self, parameters: JointParameters, dt: float) -> None:
        self.lower, self.upper = torch.as_tensor(parameters.lower_limit), torch.as_tensor(parameters.upper_limit)
        friction = torch.as_tensor(parameters.friction)
        self._below, self._above, self._rubbed = (
            found.nonzero()[:, 0] for found in (self.lower.isfinite(), self.upper.isfinite(), friction)
        )
        self._dt = dt
        unit = torch.eye(len(friction), dtype=torch.float64)
        self.jacobian = torch.cat((unit[self._below], -unit[self._above], unit[self._rubbed]))
        """(R, J)"""
        stops = unit.new_zeros(len(self._below) + len(self._above))
        rubbing = dt * friction[self._rubbed]
        self.least, self.greatest = torch.cat((stops, -rubbing)), torch.cat((stops + torch.inf, rubbing))
        """(R,) impulses."""

    def targets(self, positions: Tensor) -> Tensor:
        """(N, R) least rates, from the joints' positions (N, J)."""
        stops = torch.cat(((positions - self.lower)[:, self._below], (self.upper - positions)[:, self._above]), 1)
        return torch.cat((approach(stops, self._dt), positions.new_zeros(len(positions), len(self._rubbed))), 1)


def gather(
    joints: JointRows,
    positions: Tensor,
    equation: Equation,
    touch: Touch,
    jacobian: Tensor,
    friction: Tensor,
    dt: float,
) -> Rows:
    """All rows of a step; contacts have a Jacobian (N, C, 3, D) and coefficients (N, C)."""
    count, size = equation.velocity.shape
    own = torch.nn.functional.pad(joints.jacobian, (0, size - joints.jacobian.shape[1])).expand(count, -1, -1)
    onto = approach(touch.gaps, dt)[..., None] * touch.normals
    return Rows(
        torch.cat((own, jacobian.flatten(1, 2)), 1),
        torch.cat((joints.targets(positions), onto.flatten(1)), 1),
        joints.least, joints.greatest, touch.normals, friction,
    )  # fmt: skip
