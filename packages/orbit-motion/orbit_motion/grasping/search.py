"""The grasps of one thing, each with the timed motion to it, found in a copy of the world."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from orbit_core.dynamics.transforms import pose_multiply, quat_rotate_inverse, transform_points
from orbit_core.interfaces import PlanningError
from orbit_core.interfaces.layout import joint_limits
from orbit_motion.grasping.antipodal import GraspConfig, grasp_candidates
from orbit_motion.grasping.hand_boxes import HandBoxes
from orbit_motion.grasping.planner import GraspPlan, GraspPlanner
from orbit_motion.grasping.surface import surface_of
from orbit_motion.obstacles import TERRAIN
from orbit_motion.planning import JointTrajectory, PlannerConfig, StillWorld, time_optimal

# Share of the joints' velocity limits that is used.
_SPEED = 0.5
# 1/s: accelerations over velocity limits.
_SPEED_UP = 2.0
# m around the line between the fingers, within which they must meet the thing.
_BETWEEN = 0.005


@dataclass(frozen=True, eq=False)
class GraspMotion:
    """What the arm does for one grasp."""

    pose: Tensor
    """(7,) of the hand in the environment when the gripper closes."""
    score: float | None
    """From 0 to 1; None for a pose that a person gave."""
    reach: JointTrajectory
    approach: JointTrajectory
    lift: JointTrajectory


class GraspSearch:
    """Candidates for a thing of a copied world and motions to them.

    Args:
        world: the copy.
        joints: indices of the arm's joints.
        thing: name of the object.
        dt: s between samples of the motions.

    Raises:
        ArgumentError: the thing cannot be grasped: it is too wide, or has no shape.
        ConfigurationError: the robot has no parallel gripper; or a library is missing.
    """

    def __init__(self, world: StillWorld, joints: list[int], thing: str, dt: float) -> None:
        self._robot, self._joints, self._thing, self._dt = world.robot, joints, thing, dt
        self._pose = world.objects[thing].root_pose[0]
        self._hand = HandBoxes.of(world.robot.spec)
        self.opening = self._hand.opening
        """m between the fingers."""
        self._surface = surface_of(world.objects[thing].spec.articulation.links[0])
        up = quat_rotate_inverse(self._pose[None, 3:], self._pose.new_tensor([[0.0, 0.0, 1.0]]))[0]
        self.candidates = grasp_candidates(self._surface, self._hand, GraspConfig(most=32), up.cpu())
        self.poses = pose_multiply(self._pose.expand(len(self.candidates), 7), self.candidates.poses.to(self._pose))
        """(K, 7) of the candidates in the environment, the best first."""
        self.place = self._pose[:3]
        """(3,) m, where the thing was."""
        others = tuple(name for name in world.objects if name != thing)
        config = PlannerConfig(obstacles=(TERRAIN, *others), time_limit=5.0)
        self._planner = GraspPlanner(world, world.robot, joints, config=config)

    def motions(self) -> Iterator[GraspMotion]:
        """Yield a motion for each candidate that has one, the best first.

        Raises:
            PlanningError: no candidate has one, and why.
        """
        for plan in self._planner.plans(self.candidates, self._pose):
            assert plan.candidate is not None  # they are of candidates
            score = float(self.candidates.scores[plan.candidate])
            yield self._timed(plan, self.poses[plan.candidate], score)

    def motion_to(self, pose: Tensor) -> GraspMotion:
        """Return the motion for a pose (7,) of the hand that a person gave.

        Raises:
            PlanningError: there is none, and why.
        """
        points = transform_points(self._pose[None], self._surface.points.to(pose)[None])[0]
        local = quat_rotate_inverse(pose[None, 3:], points - pose[:3])
        if bool(self._hand.touches(local)):
            raise PlanningError(f"the open hand would be inside '{self._thing}'")
        near = (local[:, 0].abs() < _BETWEEN) & (local[:, 2].abs() < _BETWEEN)
        if not bool((near & (local[:, 1].abs() < 0.5 * self._hand.opening)).any()):
            raise PlanningError(f"nothing of '{self._thing}' is between the fingers: they would close on air")
        return self._timed(self._planner.plan(pose), pose, None)

    def _timed(self, plan: GraspPlan, pose: Tensor, score: float | None) -> GraspMotion:
        limits = joint_limits(self._robot.spec, "velocity_limit")[self._joints]
        limits = np.where(np.isfinite(limits), limits, 1.0)
        parts = (
            time_optimal(part.cpu().numpy(), _SPEED * limits, _SPEED_UP * limits, self._dt)
            for part in (plan.reach, plan.approach, plan.lift)
        )
        return GraspMotion(pose.clone(), score, *parts)
