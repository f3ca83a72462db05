"""How far a posture is from singular ones, and how to get away from them."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.linear import solve_spd

_REGULAR = 1e-6


def manipulability(jacobian: Tensor) -> Tensor:
    """(N,) ``sqrt(det(J J^T))`` of Jacobians (N, 6, k).

    Yoshikawa, Manipulability of Robotic Mechanisms, International Journal of Robotics Research 4(2), 1985.
    """
    return torch.linalg.det(jacobian @ jacobian.mT).clamp_min(0.0).sqrt()


def manipulability_gradient(jacobian: Tensor) -> Tensor:
    """(N, k) gradient of the manipulability's logarithm by the joints, for a chain of joints in order.

    ``d log w / dq_i = tr(J^+ dJ/dq_i)``, and with columns ``(v_j, w_j)`` of the geometric Jacobian a turn about axis i
    carries the axes and points behind it along: ``dv_j = w_min(i,j) x v_max(i,j)``, and ``dw_j = w_i x w_j`` for i < j.
    """
    identity = torch.eye(6, device=jacobian.device, dtype=jacobian.dtype)
    inverse = jacobian.mT @ solve_spd(
        jacobian @ jacobian.mT + _REGULAR * identity, identity.expand(len(jacobian), 6, 6)
    )
    linear, angular = jacobian[:, :3].mT, jacobian[:, 3:].mT
    crossed = torch.linalg.cross(angular.unsqueeze(2), linear.unsqueeze(1))  # (N, i, j, 3): w_i x v_j
    count = linear.shape[1]
    before = torch.triu(torch.ones(count, count, device=jacobian.device)).view(1, count, count, 1)
    turning = torch.linalg.cross(angular.unsqueeze(2), angular.unsqueeze(1)) * before
    moving = crossed * before + crossed.transpose(1, 2) * (1.0 - before)
    change = torch.cat((moving, turning), -1)
    return (change * inverse.unsqueeze(1)).sum((2, 3))
