"""A node that plays trajectories of joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget
from orbit_core.interfaces import ConfigurationError, Node, Port, Robot
from orbit_motion.planning.trajectory import JointTrajectory


class TrajectoryFollower(Node):
    """Gives the targets of joints along a trajectory of each environment's own, and holds its end.

    An environment without a trajectory holds the positions measured when it was reset. At each turn the time goes on by
    the node's period.

    Args:
        name: of the node.
        robot: whose joints move.
        joints: their indices.
        rate: Hz; must divide the agent's.
    """

    def __init__(self, name: str, robot: Robot, joints: Sequence[int], rate: float) -> None:
        if not rate > 0.0:
            raise ConfigurationError(f"node '{name}': its rate is {rate:g} Hz, give one above zero")
        self.name, self.rate = name, rate
        self._robot, self._joints = robot, list(joints)
        count = len(self._joints)
        self.outputs = (Port(JointTarget.POSITION, (count,)), Port(JointTarget.VELOCITY, (count,)))
        self._envs = torch.arange(robot.joint_positions.shape[0], device=robot.joint_positions.device)
        self._positions = robot.joint_positions[:, None, self._joints].clone()
        self._velocities = torch.zeros_like(self._positions)
        self._last, self._step = torch.zeros(2, len(self._envs), device=self._positions.device).unbind()
        self._elapsed = torch.zeros_like(self._step)

    def load(self, trajectories: Mapping[int, JointTrajectory]) -> None:
        """Begin trajectories in some environments, by index, at the next turn.

        Raises:
            ConfigurationError: a trajectory is of another number of joints.
        """
        for env, trajectory in trajectories.items():
            if trajectory.positions.shape[1] != len(self._joints):
                raise ConfigurationError(
                    f"node '{self.name}' moves {len(self._joints)} joints, but the trajectory of environment {env} is "
                    f"of {trajectory.positions.shape[1]}"
                )
        longest = max([self._positions.shape[1], *(len(t.positions) for t in trajectories.values())])
        self._positions, self._velocities = (longer(part, longest) for part in (self._positions, self._velocities))
        for env, trajectory in trajectories.items():
            length = len(trajectory.positions)
            for own, given in ((self._positions, trajectory.positions), (self._velocities, trajectory.velocities)):
                own[env, :length] = torch.as_tensor(given, dtype=own.dtype, device=own.device)
            self._last[env], self._step[env], self._elapsed[env] = length - 1, 1.0 / trajectory.dt, 0.0

    @property
    def finished(self) -> Tensor:
        """(N,) bool, where the trajectory's end is reached, or there is none."""
        return self._elapsed * self._step >= self._last

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        assert self.rate is not None  # the constructor's
        place = torch.minimum(self._elapsed * self._step, self._last)
        before = place.floor().long()
        after = torch.minimum(before + 1, self._last.long())
        share = (place - before).unsqueeze(1)
        positions, velocities = (
            torch.lerp(part[self._envs, before], part[self._envs, after], share)
            for part in (self._positions, self._velocities)
        )
        velocities = velocities.masked_fill(self.finished.unsqueeze(1), 0.0)
        self._elapsed.add_(1.0 / self.rate)
        return {JointTarget.POSITION: positions, JointTarget.VELOCITY: velocities}

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self._last[rows] = 0.0
        self._elapsed[rows] = 0.0
        self._positions[rows, 0] = self._robot.joint_positions[:, self._joints][rows]
        self._velocities[rows, 0] = 0.0

    def memory(self) -> Mapping[str, Tensor]:
        return {"elapsed": self._elapsed, "last": self._last, "step": self._step}


def longer(part: Tensor, length: int) -> Tensor:
    """(N, length, D) the part (N, L, D), with zeros at the end."""
    grown = part.new_zeros(part.shape[0], length, part.shape[2])
    grown[:, : part.shape[1]] = part
    return grown
