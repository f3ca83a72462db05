"""From candidates to motion: to before the thing, straight to it, and straight up with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_inverse, pose_multiply, quat_rotate
from orbit_core.interfaces import PlanningError, Robot, World
from orbit_core.motion.full_ik import FullIk, FullIkConfig
from orbit_core.motion.grasping.antipodal import GraspCandidates
from orbit_core.motion.planning import JointPlanner, PlannerConfig

_STRAIGHT = 8
"""Postures along a straight part."""


@dataclass(frozen=True, eq=False)
class GraspPlan:
    """What the arm does for one candidate; between two rows joints go straight."""

    candidate: int
    """Its number among the candidates."""
    reach: Tensor
    """(P, k) joint positions to before the thing, around obstacles."""
    approach: Tensor
    """(Q, k) from there along the hand's z axis to the thing; then the gripper closes."""
    lift: Tensor
    """(R, k) straight up with it."""


class GraspPlanner:
    """Plans grasps for a robot's first end effector in one environment at a time.

    Args:
        world: of the robot.
        robot: that grasps.
        joints: indices of the arm's joints.
        before: m along the approach at which the arm stops before it goes straight.
        lift: m straight up with the thing.
        config: of the path to before the thing; the thing itself should not be among its obstacles.
    """

    def __init__(
        self,
        world: World,
        robot: Robot,
        joints: list[int],
        before: float = 0.1,
        lift: float = 0.15,
        config: PlannerConfig | None = None,
    ) -> None:
        self._robot, self._joints, self._before, self._lift = robot, joints, before, lift
        self._planner = JointPlanner(world, robot, joints, config or PlannerConfig())
        frame = robot.spec.end_effector.frame
        tree = KinematicTree(robot.spec.articulation, world.device)
        many = FullIkConfig(seeds=12, iterations=60)
        near = FullIkConfig(seeds=1, iterations=40)
        self._anywhere, self._nearby = (
            FullIk(tree, frame, joints, robot.position_limits, robot.home_positions, kind) for kind in (many, near)
        )

    def plans(self, candidates: GraspCandidates, thing: Tensor, env: int = 0) -> Iterator[GraspPlan]:
        """A plan for each candidate that has one, the best first.

        Args:
            candidates: in the thing's frame.
            thing: (7,) pose of that frame in the environment's.
            env: index of the environment.

        Raises:
            PlanningError: no candidate has a plan; tells how many fail for which reason. It is raised at the end, after
                no plan was given.
        """
        poses = pose_multiply(thing.expand(len(candidates), 7), candidates.poses.to(thing))
        straight, reached = self._straight_parts(poses, env)
        failed = {"cannot be reached": int((~reached).sum()), "touch something": 0, "have no path": 0}
        given = False
        for number in reached.nonzero()[:, 0].tolist():
            approach, lift = straight[number, :_STRAIGHT], straight[number, _STRAIGHT - 1 :]
            if float(self._planner.clearances(approach[:1], env).min()) < self._planner.config.margin:
                failed["touch something"] += 1
                continue
            try:
                reach = self._planner.plan(approach[0], env)
            except PlanningError:
                failed["have no path"] += 1
                continue
            given = True
            yield GraspPlan(number, reach, approach, lift)
        if not given:
            why = ", ".join(f"{count} {reason}" for reason, count in failed.items() if count)
            raise PlanningError(f"none of {len(candidates)} grasps has a plan: {why}")

    def _straight_parts(self, poses: Tensor, env: int) -> tuple[Tensor, Tensor]:
        """(K, T, k) joint positions through approach and lift, and (K,) whether all of them are reached."""
        start = self._robot.joint_positions[env].expand(len(poses), -1)
        ways = torch.linspace(-self._before, 0.0, _STRAIGHT, device=poses.device)
        rises = torch.linspace(0.0, self._lift, _STRAIGHT, device=poses.device)[1:]
        root = pose_inverse(self._robot.root_pose[env].expand(len(poses), 7))
        parts, good = [], torch.ones(len(poses), dtype=torch.bool, device=poses.device)
        full = start.clone()
        for number, (way, rise) in enumerate([(float(w), 0.0) for w in ways] + [(0.0, float(r)) for r in rises]):
            shift = quat_rotate(poses[:, 3:], poses.new_tensor([0.0, 0.0, way]).expand(len(poses), 3))
            target = torch.cat((poses[:, :3] + shift + poses.new_tensor([0.0, 0.0, rise]), poses[:, 3:]), dim=1)
            solver = self._nearby if number else self._anywhere
            found = solver.solve(pose_multiply(root, target), full)
            moved = (found.positions - full[:, self._joints]).abs().amax(1)
            good = good & found.converged & (moved < 0.5 if number else True)  # no jump to another branch
            full = full.clone()
            full[:, self._joints] = found.positions
            parts.append(found.positions)
        return torch.stack(parts, dim=1), good
