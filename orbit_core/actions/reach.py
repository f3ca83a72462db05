"""By how much a pose that was asked for is beyond what the joints can reach."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor

from orbit_core.actions.base import MotionGenerator
from orbit_core.actions.full_ik import FullIk
from orbit_core.actions.pose_command import PoseCommand
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error, pose_inverse, pose_multiply

_RESTING = 0.05
"""rad/s or m/s"""


class PoseFollower(MotionGenerator):
    """A generator whose commands ask for poses of a frame."""

    frame: str
    _pose: PoseCommand

    def asked(self) -> Tensor:
        """(N, 7) the pose of the frame that was last asked for, in each environment's frame."""
        return self._pose.asked()

    def out_of_reach(self) -> Tensor:
        """(N, 2) m and rad by which the nearest pose that the joints can take misses :meth:`asked`.

        Zero where it can be reached, to 1e-4 m and 1e-3 rad, within the joints' limits and from where the other joints
        are. It is looked for by :class:`orbit_core.actions.full_ik.FullIk` whenever this is called, and costs a step
        nothing; obstacles are not asked about.
        """
        with torch.inference_mode():
            local = pose_multiply(pose_inverse(self.robot.root_pose), self.asked())
            found = self._search.solve(local, self.robot.joint_positions)
            missing = torch.stack((found.position_error, found.rotation_error), 1)
            return torch.where(found.converged.unsqueeze(1), 0.0, missing)

    def resting_off(self) -> Tensor:
        """(N,) bool: whether the frame rests by a centimetre or 0.1 rad and more away from :meth:`asked`."""
        with torch.inference_mode():
            off = pose_error(self.robot.frame_pose(self.frame), self.asked())
            far = (off[:, :3].norm(dim=1) > 0.01) | (off[:, 3:].norm(dim=1) > 0.1)
            return far & (self.velocities.abs().amax(1) < _RESTING)

    def reach_problem(self, env: int = 0) -> str:
        """What :meth:`out_of_reach` says of one environment in a sentence; empty where the pose can be reached."""
        metres, radians = self.out_of_reach()[env].tolist()
        if not metres and not radians:
            return ""
        return (
            f"'{self.name}': the pose asked of '{self.frame}' of robot '{self.robot.name}' is out of reach by "
            f"{metres:.3f} m and {radians:.2f} rad"
        )

    @cached_property
    def _search(self) -> FullIk:
        tree = KinematicTree(self.robot.spec.articulation, self.device)
        return FullIk(tree, self.frame, self.joints, self.robot.position_limits, self.robot.home_positions)
