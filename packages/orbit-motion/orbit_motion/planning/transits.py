"""Planned ways of a hand between the parts of a task: up from where it is, around what stands there, to a pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.actions.base import MotionGenerator
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error, pose_inverse, pose_multiply
from orbit_core.interfaces import PlanningError, Robot, World
from orbit_motion.full_ik import FullIk
from orbit_motion.obstacles import TERRAIN
from orbit_motion.planning.follower import longer
from orbit_motion.planning.joint_planner import JointPlanner, PlannerConfig

# rad or m by which the joint that travels most leads; also the distance within which a place on the way is passed.
_JOINT_LEAD, _PASSED = 0.5, 0.15
# rad or m within which the end of the way counts as reached.
_THERE = 0.03
# m by which a hand rises out of what it has done, before its way is planned.
_RISE = 0.1
# m within which a thing's origin is in the hand, and is no obstacle; a way shorter than that needs no plan.
_HELD = 0.08
# m kept free around everything. Balls are larger than links: with more, many grasps count as touching.
_MARGIN = 0.005
# Steps after which a rise, and a way, are over all the same.
_PATIENCE = (50, 250)


@dataclass(frozen=True)
class TransitCounts:
    """Numbers of ways by how they were found."""

    planned: int
    """Paths around obstacles."""
    straight: int
    """Straight lines through joint positions: the planner found no path, as where the hand touches something."""
    unreachable: int
    """No joint positions reach the pose; the hand goes there in a straight line as far as it can."""


class HandTransits:
    """Ways of one robot's hand, one in each environment at a time.

    The hand rises, full inverse kinematics finds the joint positions of the pose, and a path there keeps off everything
    in the scene but what the hand holds.

    Args:
        world: world of the robot.
        robot: robot whose hand moves.
        generators: motion generators of all its commands.
        time_limit: seconds that one plan may take.

    Raises:
        ConfigurationError: OMPL is not installed.
    """

    def __init__(
        self, world: World, robot: Robot, generators: Sequence[MotionGenerator], time_limit: float = 5.0
    ) -> None:
        effector = robot.spec.end_effector
        self._world, self._robot, self._generators = world, robot, generators
        self._frame, self._time_limit = effector.frame, time_limit
        self._joints = robot.find_joints(*effector.arm_joints)
        self._tree = KinematicTree(robot.spec.articulation, robot.home_positions.device)
        limits = robot.position_limits.clone()
        for generator in generators:
            limits[generator.joints] = generator.position_range
        self._solver = FullIk(self._tree, self._frame, self._joints, limits, robot.home_positions)
        self._planners: dict[frozenset[str], JointPlanner] = {}
        self._planner(frozenset())  # raises where OMPL is missing, before anything runs
        count, device = world.num_envs, world.device
        self._rows = torch.arange(count, device=device)
        self._target = torch.zeros(count, 7, device=device)
        self._height = torch.zeros(count, device=device)
        self._waited = torch.zeros(count, dtype=torch.int64, device=device)
        self._places = torch.zeros(count, 1, len(self._joints), device=device)
        self._next, self._last = torch.zeros_like(self._waited), torch.zeros_like(self._waited)
        self._rises, self._travels = torch.zeros(2, count, dtype=torch.bool, device=device).unbind()
        self._counts = [0, 0, 0]

    @property
    def counts(self) -> TransitCounts:
        """Ways so far."""
        return TransitCounts(*self._counts)

    @property
    def active(self) -> Tensor:
        """(N,) bool: the hand is on its way."""
        return self._rises | self._travels

    def begin(self, target: Tensor, rows: Tensor, rise: Tensor) -> None:
        """Begin ways to poses.

        Args:
            target: (N, 7) in the environments' frames.
            rows: (N,) bool, the environments that begin; one whose hand is there already stays where it is.
            rise: (N,) bool, the hand goes up first.
        """
        hand = self._hand()
        far = pose_error(hand, target)[:, :3].norm(dim=1) > _HELD
        self._target = torch.where(rows[:, None], target, self._target)
        self._rises = torch.where(rows, far & rise, self._rises)
        self._travels = torch.where(rows, False, self._travels)
        self._height = torch.where(rows, hand[:, 2] + _RISE, self._height)
        self._waited = torch.where(rows, 0, self._waited)
        self._plan(rows & far & ~rise)

    def act(self, gripper_open: Tensor) -> Tensor:
        """Return the action (N, A) that leads on, with the gripper as it is given (N,) bool."""
        hand = self._hand()
        self._waited += 1
        risen = self._rises & ((hand[:, 2] > self._height - 0.01) | (self._waited > _PATIENCE[0]))
        self._rises = self._rises & ~risen
        self._plan(risen)
        here = self._robot.joint_positions
        left = self._left()
        passed = (left < _PASSED) & (self._next < self._last)
        self._next = self._next + passed
        left = self._left()
        there = (self._next == self._last) & (left < _THERE)
        self._travels = self._travels & ~there & (self._waited <= _PATIENCE[1])
        way = torch.zeros_like(here)
        way[:, self._joints] = self._places[self._rows, self._next] - here[:, self._joints]
        positions = here + way * (_JOINT_LEAD / left.clamp_min(1e-9)).clamp(max=1.0)[:, None]
        posed = self._tree.frame_pose(self._tree.forward(self._robot.root_pose, positions), self._frame)
        above = hand.clone()
        above[:, 2] = torch.minimum(self._height, hand[:, 2] + 0.06)
        led = torch.cat([each.encode_posture(positions, posed, gripper_open) for each in self._generators], 1)
        up = torch.cat([each.encode(above, gripper_open) for each in self._generators], 1)
        return torch.where(self._rises[:, None], up, led)

    def _left(self) -> Tensor:
        """(N,) rad or m that the joint which travels most lacks to the next place."""
        here = self._robot.joint_positions[:, self._joints]
        return (self._places[self._rows, self._next] - here).abs().amax(1)

    def _plan(self, rows: Tensor) -> None:
        env_ids = rows.nonzero().squeeze(-1)
        if not len(env_ids):
            return
        local = pose_multiply(pose_inverse(self._robot.root_pose[env_ids]), self._target[env_ids])
        found = self._solver.solve(local, self._robot.joint_positions[env_ids])
        # A loop, for paths differ in length; it runs once for each way, not once for each step.
        for index, env in enumerate(env_ids.tolist()):
            if not bool(found.converged[index]):
                self._counts[2] += 1
                continue
            path = self._path(found.positions[index], env)
            self._places = longer(self._places, max(self._places.shape[1], len(path)))
            self._places[env, : len(path)] = path
            self._next[env], self._last[env], self._travels[env], self._waited[env] = 0, len(path) - 1, True, 0

    def _path(self, goal: Tensor, env: int) -> Tensor:
        """Return joint positions (P, k) that lead to ``goal`` (k,), without those at the start."""
        hand = self._hand()[env, :3]
        held = frozenset(
            name
            for name, thing in self._world.objects.items()
            if not thing.spec.fixed_base and float((thing.root_pose[env, :3] - hand).norm()) < _HELD
        )
        try:
            path = self._planner(held).plan(goal, env)[1:]
        except PlanningError:
            self._counts[1] += 1
            return goal[None]
        self._counts[0] += 1
        return path

    def _planner(self, held: frozenset[str]) -> JointPlanner:
        """Return the planner around everything but what is held; made once for each such set."""
        if held not in self._planners:
            names = (TERRAIN, *(name for name in self._world.objects if name not in held))
            config = PlannerConfig(obstacles=names, margin=_MARGIN, time_limit=self._time_limit)
            self._planners[held] = JointPlanner(self._world, self._robot, self._joints, config)
        return self._planners[held]

    def _hand(self) -> Tensor:
        return self._robot.frame_pose(self._frame)
