"""Scripted experts: a batched state machine that leads the hand, or several hands, from pose to pose.

A mobile base drives to the place that a phase names, and stays there in the phases that follow.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.actions.ik import displaced
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error, pose_inverse, pose_multiply, yaw_angle
from orbit_core.envs import Environment
from orbit_core.envs.task import Task
from orbit_core.envs.terms import TermFunction
from orbit_core.interfaces import ConfigurationError, Node, Port, Robot
from orbit_motion.full_ik import FullIk
from orbit_motion.planning import BasePathFollower, BasePlanner, BasePlannerConfig

if TYPE_CHECKING:
    from orbit_core.actions.base import MotionGenerator
    from orbit_core.interfaces import World

# Metres from a place at which the base heads for the next. A base on two wheels cannot correct the rest sideways.
_NEAR, _NEAR_ON_WHEELS = 0.1, 0.03


class DrivenBase:
    """Driver of one robot's base to one place after another, in each environment independently.

    Args:
        robot: that drives.
        generators: of the robot; one takes the velocity of its base.
        world: that the robot is in.
        task: that acts, for messages.
        planner: how paths are planned around what stands on the floor; None goes straight.

    Raises:
        ConfigurationError: no generator takes velocities of a base over the floor.
    """

    def __init__(
        self,
        robot: Robot,
        generators: Sequence[MotionGenerator],
        world: World,
        task: Task,
        planner: BasePlannerConfig | None,
    ) -> None:
        limits = [each.base_limits for each in generators if each.base_limits is not None]
        if not limits:
            raise ConfigurationError(
                f"the expert of task {type(task).__name__} drives a base by velocities over the floor, which action "
                f"'{task.action}' of robot '{task.robot}' does not take: choose another action space, such as "
                "joint_position, or another robot, such as base_omni_franka_panda"
            )
        sideways = bool(limits[0][1] > 0.0)
        # Without sideways motion a command is forward velocity and yaw rate: the first and the last component.
        self._components = slice(None) if sideways else slice(None, None, 2)
        tolerance = _NEAR if sideways else _NEAR_ON_WHEELS
        # Legged robots walk best forwards.
        face_way = bool(robot.spec.feet)
        self._follower = BasePathFollower(f"{robot.name}_base", robot, limits[0], tolerance, face_way=face_way)
        self._link = robot.link_names.index(robot.spec.base_link)
        self._robot, self._planner = robot, None if planner is None else BasePlanner(world, planner)
        self._target = torch.zeros(world.num_envs, 3, device=world.device)

    def begin(self, target: Tensor, rows: Tensor) -> None:
        """Drive to ``target`` (N, 3), x and y in m and heading in rad, in the environments of ``rows`` (N,) bool.

        Raises:
            PlanningError: something stands in the way.
        """
        env_ids = rows.nonzero().squeeze(-1)
        if not len(env_ids):
            return
        self._target[env_ids] = target[env_ids]
        here = self._robot.link_poses[:, self._link, :2]
        paths: dict[int, Tensor] = {}
        # Planned per environment, and only when a phase begins: paths differ.
        for env in env_ids.tolist():
            goal = target[env, :2]
            paths[env] = goal[None] if self._planner is None else self._planner.plan(here[env], goal, env)[1:]
        self._follower.load(paths, {env: float(target[env, 2]) for env in paths})

    def command(self) -> Tensor:
        """Return the command (N, 3), or (N, 2) on two wheels, that continues the path, or keeps the base at its end."""
        return self._follower.compute({})["command"][:, self._components]

    @property
    def distances(self) -> Tensor:
        """Distances (N, 2) in m and rad from the target; infinite while the base is on its way."""
        pose = self._robot.link_poses[:, self._link]
        away = torch.linalg.vector_norm(self._target[:, :2] - pose[:, :2], dim=1)
        # atan2 of sine and cosine wraps the difference to (-pi, pi].
        turn = self._target[:, 2] - yaw_angle(pose[:, 3:])
        left = torch.stack((away, torch.atan2(turn.sin(), turn.cos()).abs()), 1)
        return torch.where(self._follower.finished[:, None], left, math.inf)

    def reset(self, env_ids: Tensor | None) -> None:
        """Stop the base in some environments until a phase drives."""
        self._follower.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        """Return the tensors of :meth:`orbit_core.interfaces.Node.memory`."""
        return {**self._follower.memory(), "target": self._target}


# rad or m by which the joint that travels most may lead on a free way.
_JOINT_LEAD = 0.5
# rad or m within which a free way counts as finished, although a swaying base may have moved its end.
_THERE = 0.1


@dataclass(frozen=True)
class Retry:
    """Repetition of phases when a phase has ended without its effect."""

    phases: int
    """Number of phases to go back: 1 repeats the phase itself."""
    unless: TermFunction
    """Returns (N,) bool: True where the phase had its effect."""
    most: int = 2
    """Most repetitions in an episode; after that the expert continues anyway."""


@dataclass(frozen=True)
class Phase:
    """Lead the hand to ``target`` (N, 7), in each environment's frame, with the gripper open or closed.

    The hand goes there in a straight line. Where the way is ``free``, full inverse kinematics finds joint positions
    within limits, and the joints go there together until the hand is near.

    With ``base`` in the place of a target, the robot drives: (N, 3) x and y in m and heading in rad, in each
    environment's frame, are read when the phase begins, the tolerances are the base's, and the arm goes to its home
    meanwhile. In the phases that follow the base stays there.

    The phase is over once the hand is within both tolerances and ``dwell`` seconds have passed since it began; or, if
    ``timeout`` is given, after that many seconds. Then ``retry`` may lead back. The last phase goes on for ever.

    A teaching expert commands at least ``least`` metres until the hand is there, for a student commands less.
    """

    target: TermFunction | None = None
    gripper_open: bool = True
    """True to hold the gripper open, False to close it."""
    position_tolerance: float = 0.01
    """m between hand and target within which the hand is there."""
    rotation_tolerance: float = 0.1
    """rad of the same."""
    dwell: float = 0.0
    timeout: float | None = None
    free: bool = False
    retry: Retry | None = None
    base: TermFunction | None = None
    least: float = 0.0

    def __post_init__(self) -> None:
        if (self.target is None) == (self.base is None):
            raise ConfigurationError("a phase of an expert leads the hand to its target or drives the base: give one")

    @property
    def is_timed(self) -> bool:
        """True if a time decides when it ends, which a policy does not see."""
        return self.dwell > 0.0 or self.timeout is not None


class Expert(Node):
    """State machine that leads each environment through its phases, as actions of the task's own space.

    The commanded pose runs ahead of the hand by at most ``position_lead`` (m) and ``rotation_lead`` (rad), so that the
    same expert suits absolute and relative action spaces; the drives determine how fast the hand follows.

    Where several robots act, ``phases`` holds as many for each, by agent. They wait for each other: a phase is over
    once it is over for all.

    Bases drive around obstacles on the floor if a ``planner`` is given, else straight.

    A joint that is too slow for that lead turns the hand off its straight way; with ``straight`` all wait for it.

    Without gravity compensation the drives hold an arm with a position error. With a ``sag_rate`` (1/s)
    the error near the target is integrated, and added to the command.

    While it :attr:`teaches`, ``stage``, if given, derives the phase from the state only: where a slow student leads,
    phases that end by time would label one state in several ways.

    Raises:
        ConfigurationError: an agent has no phases, or another number than the others; a phase is to be retried that
            never ends, or from before the first; a base is to drive that takes no velocities over the floor; or only
            the hand of a robot on legs is led.
    """

    def __init__(
        self,
        env: Environment,
        phases: Sequence[Phase] | Mapping[str, Sequence[Phase]],
        position_lead: float = 0.1,
        rotation_lead: float = 0.5,
        planner: BasePlannerConfig | None = None,
        sag_rate: float = 0.0,
        straight: bool = False,
        stage: TermFunction | None = None,
    ) -> None:
        self.name = "policy"
        self.outputs = (Port("action", (sum(generator.command_size for generator in env.actions.generators),)),)
        self._env = env
        self._dt = env.step_dt
        by_agent = phases if isinstance(phases, Mapping) else {env.task.agents[0]: phases}
        counts = {len(own) for own in by_agent.values()}
        if {*by_agent} != {*env.task.agents} or len(counts) != 1:
            raise ConfigurationError(
                f"an expert needs equally many phases for each agent: {', '.join(env.task.agents)}"
            )
        self.phase_count = counts.pop()
        """Number of phases."""
        own_phases = tuple(by_agent.values())
        self.timed_phases = tuple(
            number for number in range(self.phase_count - 1) if any(own[number].is_timed for own in own_phases)
        )
        """Numbers of the phases that end after a time; the last one never ends."""
        self._last = self.phase_count - 1
        self._retries = [
            (number, phase.retry) for own in by_agent.values() for number, phase in enumerate(own) if phase.retry
        ]
        for number, retry in self._retries:
            if number == self._last or not 1 <= retry.phases <= number + 1:
                raise ConfigurationError(
                    f"phase {number} of 0 to {self._last} cannot go back {retry.phases} phases: the last "
                    "one never ends, and none comes before the first"
                )
        lead = torch.tensor([position_lead, rotation_lead], device=env.device)
        self._arms = [_Arm(agent, by_agent[agent], lead, env, planner, straight) for agent in env.task.agents]
        self._sag_share = sag_rate * self._dt
        self._stage = stage
        self.teaches = False
        """True if it only labels states, and another policy leads."""
        self.phase = torch.zeros(env.num_envs, dtype=torch.int64, device=env.device)
        """(N,) int64, number of the present phase of each environment."""
        self._elapsed = torch.zeros(env.num_envs, device=env.device)
        self._tries = torch.zeros(env.num_envs, len(self._retries), dtype=torch.int64, device=env.device)

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self.phase[rows] = 0
        self._elapsed[rows] = 0.0
        self._tries[rows] = 0
        for arm in self._arms:
            arm.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        bases = [arm.base for arm in self._arms if arm.base is not None]
        own = {"phase": self.phase, "elapsed": self._elapsed, "tries": self._tries}
        own |= {f"sag_{number}": arm.sag for number, arm in enumerate(self._arms)}
        for number, base in enumerate(bases):
            own |= {f"base_{number}_{key}": value for key, value in base.memory().items()}
        return own

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        # Reset by the step count: the node runs inside a step that is captured, without a call per episode.
        self.reset((self._env.state.episode_step == 0).nonzero().squeeze(-1))
        stage = self._stage(self._env) if self.teaches and self._stage is not None else None
        # The clock restarts where the state is in another phase than before.
        if stage is not None:
            self._elapsed.masked_fill_(stage != self.phase, 0.0)
            self.phase.copy_(stage)
        elapsed = self._elapsed + self._dt
        commands: list[Tensor] = []
        over = self.phase < (self._last if stage is None else 0)
        for arm in self._arms:
            begun = self._elapsed == 0.0
            command, finished = arm.compute(self.phase, elapsed, begun, self._sag_share, self.teaches)
            commands.append(command)
            over = over & finished
        self.phase += torch.where(over, 1 - self._back(over), 0)
        self._elapsed.copy_(elapsed.masked_fill(over, 0.0))
        return {"action": torch.cat(commands, dim=1).clamp(-1.0, 1.0)}

    def follow(self, rows: Tensor) -> None:
        """Advance the phases of the environments in ``rows`` (N,) bool by one step, while another acts.

        It costs the targets and distances of :meth:`compute`, without commands and inverse kinematics.

        Raises:
            ConfigurationError: a phase drives a base, whose path only the acting expert plans.
        """
        if any(arm.base is not None for arm in self._arms):
            raise ConfigurationError(
                f"the expert of task {type(self._env.task).__name__} drives a base, and its phases follow from the "
                "path that it plans: leave expert_phase out"
            )
        begun = self._env.state.episode_step == 0
        self.phase.masked_fill_(begun, 0)
        self._elapsed.masked_fill_(begun, 0.0)
        self._tries.masked_fill_(begun[:, None], 0)
        elapsed = self._elapsed + self._dt
        over = rows & (self.phase < self._last)
        for arm in self._arms:
            over = over & arm.over(self.phase, elapsed)
        self.phase += torch.where(over, 1 - self._back(over), 0)
        self._elapsed.copy_(torch.where(rows, elapsed, self._elapsed).masked_fill(over, 0.0))

    def _back(self, over: Tensor) -> Tensor:
        """Return the number of phases (N,) to go back, for phases (N,) that are over without their effect."""
        back = torch.zeros_like(self.phase)
        for (number, retry), tries in zip(self._retries, self._tries.unbind(1), strict=True):
            failed = over & (self.phase == number) & ~retry.unless(self._env) & (tries < retry.most)
            back = torch.where(failed, retry.phases, back)
            tries += failed
        return back


class _Arm:
    """One robot's part in the phases."""

    def __init__(
        self,
        agent: str,
        phases: Sequence[Phase],
        lead: Tensor,
        env: Environment,
        planner: BasePlannerConfig | None = None,
        straight: bool = False,
    ) -> None:
        world, task = env.world, env.task
        self._env = env
        self._straight = straight
        self._phases = tuple(phases)
        self._lead = lead
        self._robot = world.robots[agent]
        self._frame = self._robot.spec.end_effector.frame
        self._generators = [generator for generator in env.actions.generators if generator.robot is self._robot]
        # Row numbers pick each environment's phase out of the stacked targets.
        self._rows = torch.arange(world.num_envs, device=world.device)
        tolerances = [(phase.position_tolerance, phase.rotation_tolerance) for phase in phases]
        self._tolerances = torch.tensor(tolerances, device=world.device)
        self._dwell = torch.tensor([phase.dwell for phase in phases], device=world.device)
        timeouts = [torch.inf if phase.timeout is None else phase.timeout for phase in phases]
        self._timeouts = torch.tensor(timeouts, device=world.device)
        self._least = torch.tensor([(phase.least, 0.0) for phase in phases], device=world.device)
        self._open = torch.tensor([phase.gripper_open for phase in phases], device=world.device)
        self._free = torch.tensor([phase.free for phase in phases], device=world.device)
        self._drives = torch.tensor([phase.base is not None for phase in phases], device=world.device)
        drives = any(phase.base is not None for phase in phases)
        self._route = _Route(self._robot, self._generators) if drives or any(phase.free for phase in phases) else None
        self.base = DrivenBase(self._robot, self._generators, world, task, planner) if drives else None
        if self._robot.spec.feet and not self._robot.spec.fixed_base and not drives:
            raise ConfigurationError(
                f"the expert of {type(task).__name__} moves the hand of robot '{self._robot.spec.articulation.name}' "
                "alone, and nothing balances its legs: choose an arm, or a task whose expert walks, like Mobile-Reach"
            )
        self.sag = torch.zeros(world.num_envs, 6, device=world.device)
        """Correction (N, 6) in m and rad that is added to the command."""

    def reset(self, env_ids: Tensor | None) -> None:
        """Reset the base's target and the correction for sag."""
        self.sag[slice(None) if env_ids is None else env_ids] = 0.0
        if self.base is not None:
            self.base.reset(env_ids)

    def compute(
        self, phase: Tensor, elapsed: Tensor, begun: Tensor, sag_share: float, teaches: bool
    ) -> tuple[Tensor, Tensor]:
        """Return the command (N, A) in those phases (N,), and whether (N,) they are over after ``elapsed`` seconds
        (N,).

        ``begun`` (N,) says which of them begin now; ``sag_share`` of what the hand lacks is added to :attr:`sag`.
        Where it ``teaches`` it asks for what phases ask at least.
        """
        # Who acts is not captured on a CPU, where targets of phases that no environment is in would cost most.
        present = set(phase.tolist()) if phase.device.type == "cpu" else None
        hand, target, error, distances = self._errors(phase, present)
        asked = torch.minimum(distances, self._lead)
        if teaches:
            asked = torch.where(distances > self._tolerances[phase], asked.maximum(self._least[phase]), asked)
        step = error.view(-1, 2, 3) * (asked / distances.clamp_min(1e-9))[..., None]
        if sag_share:
            # The integral is bounded by half the lead, so that it cannot wind up.
            most = 0.5 * self._lead[:, None]
            self.sag += sag_share * error * (distances < self._lead).all(1, keepdim=True)
            self.sag.copy_((self.sag.view(-1, 2, 3).clamp(-most, most)).view(-1, 6))
            step = step + self.sag.view(-1, 2, 3)
        waypoint = displaced(hand, step.view(-1, 6))
        opened = self._open[phase]
        if self._straight:
            share = torch.stack([generator.share(waypoint) for generator in self._generators]).amin(0)
            waypoint = displaced(hand, share * step.view(-1, 6))
        commands = [generator.encode(waypoint, opened) for generator in self._generators]
        if self._route is not None:
            # A route is found when a phase begins, which a student does not see: a teacher goes straight.
            free, drives = self._free[phase] & (not teaches), self._drives[phase]
            self._route.plan(target, begun & free)
            way, near = self._route.way(drives)
            # Once there the hand leads: on a base that still settled the posture is a little off, and would hold it.
            self._route.reached |= near & free
            far = free & self._route.known & ~self._route.reached & (distances > 0.5 * self._lead).any(1)
            positions, pose = self._route.along(way)
            others = [generator.encode_posture(positions, pose, opened) for generator in self._generators]
            led = (far | drives)[:, None]
            commands = [torch.where(led, other, own) for own, other in zip(commands, others, strict=True)]
        if self.base is not None:
            distances = self._drive(self.base, commands, phase, begun, distances)
        return torch.cat(commands, dim=1), self._ends(phase, elapsed, distances)

    def over(self, phase: Tensor, elapsed: Tensor) -> Tensor:
        """Return (N,) whether those phases (N,) of a hand are over after ``elapsed`` seconds (N,)."""
        return self._ends(phase, elapsed, self._errors(phase)[3])

    def _errors(self, phase: Tensor, present: Collection[int] | None = None) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return the hand's pose (N, 7), its target (N, 7) in those phases (N,), the way there (N, 6), and the
        distances (N, 2) in m and rad.

        ``present`` has all phases that any environment is in, where that is known.
        """
        hand = self._robot.frame_pose(self._frame)
        targets = [
            hand if own.target is None or (present is not None and number not in present) else own.target(self._env)
            for number, own in enumerate(self._phases)
        ]
        # The targets of all phases are computed and one is picked: a branch per environment could not be captured.
        target = torch.stack(targets)[phase, self._rows]
        error = pose_error(hand, target)
        return hand, target, error, torch.stack((error[:, :3].norm(dim=1), error[:, 3:].norm(dim=1)), dim=1)

    def _ends(self, phase: Tensor, elapsed: Tensor, distances: Tensor) -> Tensor:
        arrived = (distances <= self._tolerances[phase]).all(1) & (elapsed >= self._dwell[phase])
        return arrived | (elapsed >= self._timeouts[phase])

    def _drive(self, base: DrivenBase, commands: list[Tensor], phase: Tensor, begun: Tensor, hand: Tensor) -> Tensor:
        """Insert the base's command; return distances (N, 2) of the phase's (N,) hand or base."""
        for number, own in enumerate(self._phases):
            begins = begun & (phase == number)
            if own.base is not None and bool(begins.any()):
                base.begin(own.base(self._env), begins)
        for number, generator in enumerate(self._generators):
            if generator.base_limits is not None:
                commands[number] = base.command()
        return torch.where(self._drives[phase][:, None], base.distances, hand)


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
        """True (N,) if the pose can be reached."""
        self.reached = torch.zeros_like(self.known)
        """True (N,) if the joints have been at the end of the way."""

    def plan(self, target: Tensor, rows: Tensor) -> None:
        """Find the way to poses ``target`` (N, 7), in the environments of ``rows`` (N,) bool."""
        env_ids = rows.nonzero().squeeze(-1)
        if not len(env_ids):
            return
        self.reached[env_ids] = False
        # The solver works in the root's frame, for the root may be anywhere.
        local = pose_multiply(pose_inverse(self._robot.root_pose[env_ids]), target[env_ids])
        solution = self._solver.solve(local, self._robot.joint_positions[env_ids])
        goal = self._robot.joint_positions[env_ids]
        goal[:, self._joints] = solution.positions
        self._goal[env_ids] = goal
        self.known[env_ids] = solution.converged

    def way(self, home: Tensor) -> tuple[Tensor, Tensor]:
        """Return the way left for the joints.

        Args:
            home: (N,) bool; True leads the arm's joints home.

        Returns:
            The way (N, J) in rad or m, and (N,) bool: True where it is as good as finished.
        """
        here = self._robot.joint_positions
        resting = here.clone()
        resting[:, self._joints] = self._robot.home_positions[self._joints]
        way = torch.where(home[:, None], resting, self._goal) - here
        return way, way[:, self._joints].abs().amax(1) < _THERE

    def along(self, way: Tensor) -> tuple[Tensor, Tensor]:
        """Return joint positions (N, J) a step on along the way (N, J), and the hand's pose (N, 7) in the environment
        then.
        """
        longest = way[:, self._joints].abs().amax(1, keepdim=True).clamp_min(1e-9)
        positions = self._robot.joint_positions + way * (_JOINT_LEAD / longest).clamp(max=1.0)
        links = self._tree.forward(self._robot.root_pose, positions)
        return positions, self._tree.frame_pose(links, self._frame)
