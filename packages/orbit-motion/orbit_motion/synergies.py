"""Synergies of a hand: the principal components of its postures, as an action term with a command for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.actions import ActionTerm, BinaryGripperConfig, JointTarget, MotionGenerator
from orbit_core.actions.grippers import gripper_positions
from orbit_core.interfaces import ConfigurationError, Robot
from orbit_core.scene import RobotSpec

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Synergies:
    """Postures (m + r)_i of a hand as sums: mean (k,), directions (n, k), and the scores of commands of 1.

    ``low`` and ``high`` (n,) are the scores of the postures that go furthest along each direction.
    """

    mean: _Array
    """(k,) rad or m, mean posture of the joints."""
    directions: _Array
    """(n, k) unit directions, the widest first."""
    low: _Array
    high: _Array


def synergies_of(postures: _Array, count: int) -> Synergies:
    """The principal components of postures (P, k) of a hand, those first that vary most.

    Santello, Flanders and Soechting, Postural Hand Synergies for Tool Use, Journal of Neuroscience 18(23), 1998; for
    robots' hands Ciocarlie and Allen, Hand Posture Subspaces for Dexterous Robotic Grasping, International Journal of
    Robotics Research 28(7), 2009. The sign of each makes the first posture's score positive.

    Raises:
        ConfigurationError: the postures vary in fewer directions than ``count``.
    """
    mean = postures.mean(0)
    values, directions = np.linalg.svd(postures - mean, full_matrices=False)[1:]
    rank = int((values > 1e-6 * max(values.max(initial=0.0), 1e-6)).sum())
    if not 1 <= count <= rank:
        raise ConfigurationError(f"{len(postures)} postures vary in {rank} directions, of which {count} are asked for")
    directions = directions[:count]
    scores = (postures - mean) @ directions.T
    signs = np.where(scores[0] < 0.0, -1.0, 1.0)
    scores = scores * signs
    return Synergies(mean, directions * signs[:, None], scores.min(0), scores.max(0))


@dataclass(frozen=True, kw_only=True)
class GraspSynergiesConfig(ActionTerm):
    """A command is how far the hand goes along each of its synergies.

    ``position = mean + sum_i score_i direction_i``, the scores linear between those of the furthest postures (-1, 1).
    The synergies are the principal components of the hand's open and closed positions and of ``postures``; with those
    two alone there is one, which opens the hand at 1 and closes it at -1.
    """

    name: ClassVar[str] = "grasp_synergies"
    above_zero: ClassVar[tuple[str, ...]] = ("count",)

    frame: str | None = None
    """Frame of the end effector that is the hand; None takes the first one."""
    postures: tuple[tuple[float, ...], ...] = ()
    """Further postures, rad or m: a position of each joint of the term, in the joints' order."""
    count: int = 1
    """How many synergies."""

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        return BinaryGripperConfig(frame=self.frame).gripper_of(spec).joints

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        return tuple(f"synergy {index + 1}" for index in range(self.count))

    def build(self, name: str, robot: Robot) -> GraspSynergies:
        return GraspSynergies(name, robot, self)


class GraspSynergies(MotionGenerator):
    """Motion generator with a command for each synergy, :class:`GraspSynergiesConfig`. Clips targets to limits."""

    def __init__(self, name: str, robot: Robot, config: GraspSynergiesConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, config.count, (JointTarget.POSITION,))
        for posture in config.postures:
            if len(posture) != len(joints):
                raise ConfigurationError(
                    f"action term '{name}': a posture has {len(posture)} positions for {len(joints)} joints"
                )
        gripper = BinaryGripperConfig(frame=config.frame).gripper_of(robot.spec)
        ends = [
            gripper_positions(value, gripper.joints, joints, robot.spec, name)
            for value in (gripper.open_position, gripper.closed_position)
        ]
        try:
            found = synergies_of(np.array([*ends, *config.postures], dtype=np.float64), config.count)
        except ConfigurationError as error:
            raise ConfigurationError(f"action term '{name}': {error}") from None
        self._mean, self._directions, self._low, self._high = (
            torch.as_tensor(part, dtype=torch.float32, device=self.device)
            for part in (found.mean, found.directions, found.low, found.high)
        )
        self._ends = torch.tensor(ends, device=self.device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        share = 0.5 * (inputs["command"] + 1.0)
        scores = self._low + share * (self._high - self._low)
        targets = torch.addmm(self._mean, scores, self._directions)
        return {JointTarget.POSITION: torch.clamp(targets, self.lower_limits, self.upper_limits)}

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        posture = torch.where(gripper_open.unsqueeze(1), self._ends[0], self._ends[1])
        return self.encode_positions(posture)

    def encode_positions(self, positions: Tensor) -> Tensor:
        """(N, count) the command whose posture is nearest to positions (N, k)."""
        scores = (positions - self._mean) @ self._directions.mT
        return (2.0 * (scores - self._low) / (self._high - self._low) - 1.0).clamp(-1.0, 1.0)
