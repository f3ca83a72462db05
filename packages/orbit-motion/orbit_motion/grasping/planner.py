"""Motion to a grasp: in front of the thing, straight to it, and straight up with it.

:class:`GraspSearch` computes the timed motion of each candidate in a copy of the world.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import (
    pose_inverse,
    pose_multiply,
    quat_rotate,
    quat_rotate_inverse,
    transform_points,
)
from orbit_core.interfaces import PlanningError
from orbit_core.interfaces.layout import joint_limits
from orbit_motion.full_ik import FullIk, FullIkConfig
from orbit_motion.grasping.antipodal import GraspCandidates, GraspConfig, HandBoxes, grasp_candidates, surface_of
from orbit_motion.obstacles import TERRAIN
from orbit_motion.planning import JointPlanner, JointTrajectory, PlannerConfig, StillWorld, time_optimal
from orbit_motion.still import PlacedRobot, PlacedWorld

# Postures along a straight part of the motion.
_STRAIGHT = 8
# Candidates per batch of inverse kinematics: few, so that the first plan does not wait for all.
_AT_ONCE = 8
# rad or m between postures of a straight part beyond which the arm has changed its branch of solutions.
_JUMP = 0.5


@dataclass(frozen=True, eq=False)
class GraspPlan:
    """Motion for one candidate; between two rows joints move in straight lines."""

    candidate: int | None
    """Index among the candidates; None for a given pose."""
    reach: Tensor
    """Joint positions (P, k) to the pre-grasp pose, around obstacles."""
    approach: Tensor
    """Joint positions (Q, k) along the hand's z axis to the thing; then the gripper closes."""
    lift: Tensor
    """Joint positions (R, k) straight up with it."""


class GraspPlanner:
    """Planner of grasps for a robot's first end effector in one environment at a time.

    Args:
        world: of the robot; a :class:`~orbit_motion.planning.StillWorld` for plans in another thread.
        robot: that grasps.
        joints: indices of the arm's joints.
        before: m along the approach at which the arm stops before it goes straight.
        lift: m straight up with the thing.
        config: of the path to before the thing; the thing itself should not be among its obstacles.

    Raises:
        ConfigurationError: the robot has no parallel gripper.
    """

    def __init__(
        self,
        world: PlacedWorld,
        robot: PlacedRobot,
        joints: list[int],
        before: float = 0.1,
        lift: float = 0.15,
        config: PlannerConfig | None = None,
    ) -> None:
        self._robot, self._joints, self._before, self._lift = robot, joints, before, lift
        self._hand = HandBoxes.of(robot.spec)
        self._planner = JointPlanner(world, robot, joints, config or PlannerConfig())
        frame = robot.spec.end_effector.frame
        tree = KinematicTree(robot.spec.articulation, world.device)
        # Far targets need many starts; the next one along a line is near the last solution.
        many = FullIkConfig(seeds=12, iterations=60)
        near = FullIkConfig(seeds=1, iterations=40)
        self._anywhere, self._nearby = (
            FullIk(tree, frame, joints, robot.position_limits, robot.home_positions, kind) for kind in (many, near)
        )

    def plan(self, pose: Tensor, env: int = 0) -> GraspPlan:
        """Return the plan for a pose (7,) of the end effector, in the environment, in which the gripper closes.

        Raises:
            PlanningError: the pose cannot be reached, by how much; or something is in the way, what and how far.
        """
        return self._plan(self._straight_parts(pose[None], env), 0, None, env)

    def plans(self, candidates: GraspCandidates, thing: Tensor, env: int = 0) -> Iterator[GraspPlan]:
        """Yield a plan for each candidate that has one, the best first.

        Args:
            candidates: in the thing's frame.
            thing: (7,) pose of that frame in the environment's.
            env: index of the environment.

        Raises:
            PlanningError: no candidate has a plan; counts failures by reason. It is raised at the end, after
                no plan was given.
        """
        poses = pose_multiply(thing.expand(len(candidates), 7), candidates.poses.to(thing))
        failed = {_Unreached: 0, _Touching: 0, PlanningError: 0}
        given = False
        for first in range(0, len(poses), _AT_ONCE):
            ways = self._straight_parts(poses[first : first + _AT_ONCE], env)
            for row in range(len(ways.positions)):
                try:
                    plan = self._plan(ways, row, first + row, env)
                except PlanningError as error:
                    failed[type(error)] += 1
                    continue
                given = True
                yield plan
        if not given:
            reasons = zip(("cannot be reached", "touch something", "have no path"), failed.values(), strict=True)
            why = ", ".join(f"{count} {reason}" for reason, count in reasons if count)
            raise PlanningError(f"none of {len(candidates)} grasps has a plan: {why}")

    def _plan(self, ways: _StraightWays, row: int, candidate: int | None, env: int) -> GraspPlan:
        _check_reached(ways, row)
        self._check_hand(ways.poses[row], env)
        approach, lift = ways.positions[row, :_STRAIGHT], ways.positions[row, _STRAIGHT - 1 :]
        # Cheap tests first: the path planner takes most of the time.
        if float(self._planner.clearances(approach[:1], env).min()) < self._planner.config.margin:
            raise _Touching(f"before the thing, {self._planner.touched(approach[0], env)}")
        return GraspPlan(candidate, self._planner.plan(approach[0], env), approach, lift)

    def _check_hand(self, poses: Tensor, env: int) -> None:
        """Reject a straight way (T, 7) on which the open hand enters an obstacle."""
        points = self._hand.points.to(poses)
        placed = quat_rotate(poses[:, None, 3:], points) + poses[:, None, :3]
        distances, _ = self._planner.obstacles.distances(placed, env)
        if not distances.numel() or float(distances.min()) >= 0.0:
            return
        deepest = int(distances.flatten(0, 1).amin(0).argmin())
        name, depth = self._planner.obstacles.names[deepest], -float(distances.min())
        raise _Touching(f"the open hand would be {depth:.3f} m inside '{name}'")

    def _straight_parts(self, poses: Tensor, env: int) -> _StraightWays:
        """Return joint positions through approach and lift for poses (K, 7) at the thing."""
        start = self._robot.joint_positions[env].expand(len(poses), -1)
        ways = torch.linspace(-self._before, 0.0, _STRAIGHT, device=poses.device)
        rises = torch.linspace(0.0, self._lift, _STRAIGHT, device=poses.device)[1:]
        root = pose_inverse(self._robot.root_pose[env].expand(len(poses), 7))
        targets, parts, errors, jumps = [], [], [], []
        full = start.clone()
        # The approach ends at the pose, from which the lift begins.
        for number, (way, rise) in enumerate([(float(w), 0.0) for w in ways] + [(0.0, float(r)) for r in rises]):
            shift = quat_rotate(poses[:, 3:], poses.new_tensor([0.0, 0.0, way]).expand(len(poses), 3))
            target = torch.cat((poses[:, :3] + shift + poses.new_tensor([0.0, 0.0, rise]), poses[:, 3:]), dim=1)
            solver = self._nearby if number else self._anywhere
            found = solver.solve(pose_multiply(root, target), full)
            moved = (found.positions - full[:, self._joints]).abs().amax(1)
            jumps.append(moved * (number > 0))
            full = full.clone()
            full[:, self._joints] = found.positions
            targets.append(target)
            parts.append(found.positions)
            missing = torch.stack((found.position_error, found.rotation_error), dim=1)
            errors.append(torch.where(found.converged[:, None], 0.0, missing))
        stacked = (torch.stack(part, dim=1) for part in (targets, parts, errors, jumps))
        return _StraightWays(*stacked)


class _Unreached(PlanningError):
    """Raised when the arm does not reach a pose."""


class _Touching(PlanningError):
    """Raised when something is in the way."""


@dataclass(frozen=True, eq=False)
class _StraightWays:
    """Approach and lift for K poses, in T postures each."""

    poses: Tensor
    """Poses (K, T, 7) of the hand."""
    positions: Tensor
    """Joint positions (K, T, k)."""
    missing: Tensor
    """Distances (K, T, 2) in m and rad by which the hand misses its pose; zero where it reaches it."""
    jumps: Tensor
    """Largest joint motion (K, T) in rad or m from the previous posture."""


def _check_reached(ways: _StraightWays, row: int) -> None:
    missing = ways.missing[row]
    unreached = missing.amax(1).nonzero()[:, 0]
    if len(unreached):
        step = int(unreached[0])
        where = "before the thing" if step == 0 else "at the thing" if step < _STRAIGHT else "when lifting"
        distance, angle = missing[step].tolist()
        raise _Unreached(
            f"{where} the hand misses the pose by {distance:.3f} m and {angle:.2f} rad: it is out of reach"
        )
    if float(ways.jumps[row].max()) >= _JUMP:
        raise _Unreached("the arm would have to turn over on the straight way: take the thing from another side")


# Share of the joints' velocity limits that grasps use.
_SPEED = 0.5
# Acceleration limits as multiples (1/s) of velocity limits.
_SPEED_UP = 2.0
# Metres around the line between the fingers within which they must touch the thing.
_BETWEEN = 0.005


@dataclass(frozen=True, eq=False)
class GraspMotion:
    """Timed motion of the arm for one grasp."""

    pose: Tensor
    """Pose (7,) of the hand in the environment when the gripper closes."""
    score: float | None
    """Score from 0 to 1; None for a pose that a person gave."""
    reach: JointTrajectory
    approach: JointTrajectory
    lift: JointTrajectory


class GraspSearch:
    """Grasp candidates for a thing of a copied world, and motions to them.

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
        """Distance (m) between the fingers."""
        self._surface = surface_of(world.objects[thing].spec.articulation.links[0])
        up = quat_rotate_inverse(self._pose[None, 3:], self._pose.new_tensor([[0.0, 0.0, 1.0]]))[0]
        self.candidates = grasp_candidates(self._surface, self._hand, GraspConfig(most=32), up.cpu())
        self.poses = pose_multiply(self._pose.expand(len(self.candidates), 7), self.candidates.poses.to(self._pose))
        """Poses (K, 7) of the candidates in the environment, the best first."""
        self.place = self._pose[:3]
        """Position (3,) in m of the thing when the copy was made."""
        # The thing itself is no obstacle to the hand that takes it.
        others = tuple(name for name in world.objects if name != thing)
        config = PlannerConfig(obstacles=(TERRAIN, *others), time_limit=5.0)
        self._planner = GraspPlanner(world, world.robot, joints, config=config)

    def motions(self) -> Iterator[GraspMotion]:
        """Yield a motion for each candidate that has one, the best first.

        Raises:
            PlanningError: no candidate has one; says why.
        """
        for plan in self._planner.plans(self.candidates, self._pose):
            assert plan.candidate is not None  # they are of candidates
            score = float(self.candidates.scores[plan.candidate])
            yield self._timed(plan, self.poses[plan.candidate], score)

    def motion_to(self, pose: Tensor) -> GraspMotion:
        """Return the motion for a pose (7,) of the hand that a person gave.

        Raises:
            PlanningError: there is none; says why.
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
        # Joints without a velocity limit move at 1 rad/s or m/s.
        limits = np.where(np.isfinite(limits), limits, 1.0)
        parts = (
            time_optimal(part.cpu().numpy(), _SPEED * limits, _SPEED_UP * limits, self._dt)
            for part in (plan.reach, plan.approach, plan.lift)
        )
        return GraspMotion(pose.clone(), score, *parts)
