"""Scripted experts: a batched state machine that leads the hand, or several hands, from pose to pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import (
    pose_error,
    pose_inverse,
    pose_multiply,
    quat_from_rotation_vector,
    quat_multiply,
)
from orbit_core.envs.task import Task
from orbit_core.envs.terms import TermFunction
from orbit_core.interfaces import ConfigurationError, Node, Port
from orbit_core.motion.full_ik import FullIk

if TYPE_CHECKING:
    from orbit_core.interfaces import Robot, World
    from orbit_core.motion.base import MotionGenerator

_JOINT_LEAD = 0.5
"""rad or m by which the joint that travels most leads on a free way."""


@dataclass(frozen=True)
class Retry:
    """What to do where a phase, once it is over, has not brought about what the next one needs."""

    phases: int
    """How many phases to go back: 1 does the phase itself again."""
    unless: TermFunction
    """(N,) bool: where it holds, all is well."""
    most: int = 2
    """How often in an episode; after that the expert goes on all the same."""


@dataclass(frozen=True)
class Phase:
    """Lead the hand to ``target`` (N, 7), in each environment's frame, with the gripper open or closed.

    The hand goes there in a straight line. Where the way is ``free``, full inverse kinematics finds joint positions
    within limits, and the joints go there together until the hand is near.

    The phase is over once the hand is within both tolerances and ``dwell`` seconds have passed since it began; or, if
    ``timeout`` is given, after that many seconds. Then ``retry`` may lead back. The last phase goes on for ever.
    """

    target: TermFunction
    gripper_open: bool = True
    position_tolerance: float = 0.01
    rotation_tolerance: float = 0.1
    dwell: float = 0.0
    timeout: float | None = None
    free: bool = False
    retry: Retry | None = None


class Expert(Node):
    """Runs each environment through its phases and turns the hand's next pose into an action of the task's own space.

    The pose asked for runs ahead of the hand by at most ``position_lead`` (m) and ``rotation_lead`` (rad), so that the
    same expert suits absolute and relative action spaces; how fast the hand follows is the drives' affair.

    Where several robots act, ``phases`` holds as many for each, by agent. They wait for each other: a phase is over
    once it is over for all.

    Raises:
        ConfigurationError: an agent has no phases, or another number than the others; or a phase is to be retried that
            never ends, or from before the first.
    """

    def __init__(
        self,
        world: World,
        task: Task,
        phases: Sequence[Phase] | Mapping[str, Sequence[Phase]],
        position_lead: float = 0.1,
        rotation_lead: float = 0.5,
    ) -> None:
        self.name = "policy"
        self.outputs = (Port("action", (sum(generator.command_size for generator in task.generators),)),)
        self._world = world
        self._task = task
        self._dt = task.physics_dt * task.decimation
        by_agent = phases if isinstance(phases, Mapping) else {task.agents[0]: phases}
        counts = {len(own) for own in by_agent.values()}
        if {*by_agent} != {*task.agents} or len(counts) != 1:
            raise ConfigurationError(f"an expert needs equally many phases for each agent: {', '.join(task.agents)}")
        self._last = counts.pop() - 1
        self._retries = [
            (number, phase.retry) for own in by_agent.values() for number, phase in enumerate(own) if phase.retry
        ]
        for number, retry in self._retries:
            if number == self._last or not 1 <= retry.phases <= number + 1:
                raise ConfigurationError(
                    f"phase {number} of 0 to {self._last} cannot go back {retry.phases} phases: the last "
                    "one never ends, and none comes before the first"
                )
        lead = torch.tensor([position_lead, rotation_lead], device=world.device)
        self._arms = [_Arm(agent, by_agent[agent], lead, world, task) for agent in task.agents]
        self.phase = torch.zeros(world.num_envs, dtype=torch.int64, device=world.device)
        self._elapsed = torch.zeros(world.num_envs, device=world.device)
        self._tries = torch.zeros(world.num_envs, len(self._retries), dtype=torch.int64, device=world.device)

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self.phase[rows] = 0
        self._elapsed[rows] = 0.0
        self._tries[rows] = 0

    def memory(self) -> Mapping[str, Tensor]:
        return {"phase": self.phase, "elapsed": self._elapsed, "tries": self._tries}

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        self.reset((self._task.episode_step == 0).nonzero().squeeze(-1))
        elapsed = self._elapsed + self._dt
        commands: list[Tensor] = []
        over = self.phase < self._last
        for arm in self._arms:
            command, finished = arm.compute(self.phase, elapsed, self._elapsed == 0.0)
            commands.append(command)
            over = over & finished
        self.phase += torch.where(over, 1 - self._back(over), 0)
        self._elapsed.copy_(elapsed.masked_fill(over, 0.0))
        return {"action": torch.cat(commands, dim=1).clamp(-1.0, 1.0)}

    def _back(self, over: Tensor) -> Tensor:
        """(N,) by how many phases to go back, where phases are over (N,) that have not done what they should."""
        back = torch.zeros_like(self.phase)
        for (number, retry), tries in zip(self._retries, self._tries.unbind(1), strict=True):
            failed = over & (self.phase == number) & ~retry.unless(self._world, self._task) & (tries < retry.most)
            back = torch.where(failed, retry.phases, back)
            tries += failed
        return back


class _Arm:
    """One robot's part in the phases."""

    def __init__(self, agent: str, phases: Sequence[Phase], lead: Tensor, world: World, task: Task) -> None:
        self._world = world
        self._task = task
        self._phases = tuple(phases)
        self._lead = lead
        self._robot = world.robots[agent]
        self._frame = self._robot.spec.end_effector.frame
        self._generators = [generator for generator in task.generators if generator.robot is self._robot]
        self._rows = torch.arange(world.num_envs, device=world.device)
        tolerances = [(phase.position_tolerance, phase.rotation_tolerance) for phase in phases]
        self._tolerances = torch.tensor(tolerances, device=world.device)
        self._dwell = torch.tensor([phase.dwell for phase in phases], device=world.device)
        timeouts = [torch.inf if phase.timeout is None else phase.timeout for phase in phases]
        self._timeouts = torch.tensor(timeouts, device=world.device)
        self._open = torch.tensor([phase.gripper_open for phase in phases], device=world.device)
        self._free = torch.tensor([phase.free for phase in phases], device=world.device)
        self._route = _Route(self._robot, self._generators) if any(phase.free for phase in phases) else None

    def compute(self, phase: Tensor, elapsed: Tensor, begun: Tensor) -> tuple[Tensor, Tensor]:
        """The command (N, A) in those phases (N,), and whether (N,) they are over after ``elapsed`` seconds (N,).

        ``begun`` (N,) says which of them begin now.
        """
        hand = self._robot.frame_pose(self._frame)
        targets = torch.stack([own.target(self._world, self._task) for own in self._phases])
        target = targets[phase, self._rows]
        error = pose_error(hand, target)
        distances = torch.stack((error[:, :3].norm(dim=1), error[:, 3:].norm(dim=1)), dim=1)
        step = error.view(-1, 2, 3) * (self._lead / distances.clamp_min(1e-9)).clamp(max=1.0)[..., None]
        turned = quat_multiply(quat_from_rotation_vector(step[:, 1]), hand[:, 3:])
        waypoint = torch.cat((hand[:, :3] + step[:, 0], turned), dim=1)
        opened = self._open[phase]
        commands = [generator.encode(waypoint, opened) for generator in self._generators]
        if self._route is not None:
            free = self._free[phase]
            self._route.plan(target, begun & free)
            far = (free & self._route.known & (distances > 0.5 * self._lead).any(1))[:, None]
            positions, pose = self._route.next()
            others = [generator.encode_posture(positions, pose, opened) for generator in self._generators]
            commands = [torch.where(far, other, own) for own, other in zip(commands, others, strict=True)]
        arrived = (distances <= self._tolerances[phase]).all(1) & (elapsed >= self._dwell[phase])
        return torch.cat(commands, dim=1), arrived | (elapsed >= self._timeouts[phase])


class _Route:
    """Joint positions on the way to a pose, found by full inverse kinematics when a phase begins."""

    def __init__(self, robot: Robot, generators: Sequence[MotionGenerator]) -> None:
        effector, articulation = robot.spec.end_effector, robot.spec.articulation
        self._robot = robot
        self._frame = effector.frame
        self._joints = robot.find_joints(*effector.arm_joints)
        self._tree = KinematicTree(articulation, robot.home_positions.device)
        limits = robot.position_limits.clone()
        for generator in generators:
            limits[generator.joints] = generator.position_range
        self._solver = FullIk(self._tree, self._frame, self._joints, limits, robot.home_positions)
        self._goal = robot.joint_positions.clone()
        self.known = torch.zeros(len(self._goal), dtype=torch.bool, device=self._goal.device)
        """(N,) whether the pose can be reached."""

    def plan(self, target: Tensor, rows: Tensor) -> None:
        """Find the way to poses ``target`` (N, 7), in the environments of ``rows`` (N,) bool."""
        env_ids = rows.nonzero().squeeze(-1)
        if not len(env_ids):
            return
        local = pose_multiply(pose_inverse(self._robot.root_pose[env_ids]), target[env_ids])
        solution = self._solver.solve(local, self._robot.joint_positions[env_ids])
        goal = self._robot.joint_positions[env_ids]
        goal[:, self._joints] = solution.positions
        self._goal[env_ids] = goal
        self.known[env_ids] = solution.converged

    def next(self) -> tuple[Tensor, Tensor]:
        """Joint positions (N, J) a step ahead on the way, and the hand's pose (N, 7) there in the environment."""
        here = self._robot.joint_positions
        way = self._goal - here
        longest = way[:, self._joints].abs().amax(1, keepdim=True).clamp_min(1e-9)
        positions = here + way * (_JOINT_LEAD / longest).clamp(max=1.0)
        links = self._tree.forward(self._robot.root_pose, positions)
        return positions, self._tree.frame_pose(links, self._frame)
