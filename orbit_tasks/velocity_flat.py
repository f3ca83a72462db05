"""Velocity-Flat: a legged robot follows a commanded velocity on a plane.

Rewards follow Rudin et al., Learning to Walk in Minutes Using Massively Parallel Deep Reinforcement Learning (2021).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import (
    CurriculumTerm,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
    Task,
    TerminationTerm,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task_checks import TaskCheck, TaskException
from orbit_core.envs.terms import means, measured_in, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common, randomize
from orbit_core.mdp.randomize import Range
from orbit_core.scene import ContactSensorSpec, Pose, Scene, look_at
from orbit_tasks import biped, walking
from orbit_tasks.gait import FootholdGait
from orbit_tasks.trunk import TRUNK, angular_velocity, linear_velocity, projected_gravity

CONTACTS = biped.CONTACTS


@means("velocity that is commanded", frame=TRUNK, components=("forward", "left", "yaw rate"))
@measured_in("m/s, m/s, rad/s")
def command(world: World, task: VelocityFlat) -> Tensor:
    """(N, 3) velocity forward and to the left in m/s, yaw rate in rad/s."""
    return task.command


@once_per_state
def linear_error(world: World, task: VelocityFlat) -> Tensor:
    """(N,) m/s."""
    return vector_norm(task.command[:, :2] - linear_velocity(world, task)[:, :2], dim=1)


@once_per_state
def yaw_error(world: World, task: VelocityFlat) -> Tensor:
    """(N,) rad/s."""
    return (task.command[:, 2] - angular_velocity(world, task)[:, 2]).abs()


def linear_tracking(world: World, task: VelocityFlat) -> Tensor:
    """(N,) in (0, 1]."""
    return torch.exp(-linear_error(world, task).square() / 0.25)


def yaw_tracking(world: World, task: VelocityFlat) -> Tensor:
    """(N,) in (0, 1]."""
    return torch.exp(-yaw_error(world, task).square() / 0.25)


def bouncing(world: World, task: VelocityFlat) -> Tensor:
    """(N,) squared vertical velocity."""
    return linear_velocity(world, task)[:, 2].square()


def rolling(world: World, task: VelocityFlat) -> Tensor:
    """(N,) squared roll and pitch rates."""
    return common.squared_norm(angular_velocity(world, task)[:, :2])


def tilt(world: World, task: VelocityFlat) -> Tensor:
    """(N,) squared sine of the tilt."""
    return common.squared_norm(projected_gravity(world, task)[:, :2])


@once_per_state
def fallen(world: World, task: VelocityFlat) -> Tensor:
    """(N,) the trunk touches something, or leans by more than 60 degrees."""
    touching = biped.contacts_of(world).forces[:, 0].square().sum(1) > 1.0
    return touching | (projected_gravity(world, task)[:, 2] > -0.5)


def fell(world: World, task: VelocityFlat) -> Tensor:
    """(N,) 1 where the robot has fallen."""
    return fallen(world, task).float()


def place_robot(world: World, task: VelocityFlat, env_ids: Tensor) -> None:
    """Place the robot at home height, facing anywhere, joints around their home; an arm that it carries anyhow."""
    position = torch.tensor(common.robot_of(world).spec.pose.position, device=world.device)
    common.stand_facing_anywhere(world, position.expand(len(env_ids), 3), env_ids)
    common.randomize_robot_start(0.05)(world, task, env_ids)
    walking.carry_anyhow(world, env_ids)


def sample_command(world: World, task: VelocityFlat, env_ids: Tensor) -> None:
    """Uniform within the task's limits; within a quarter of them where nothing is difficult yet."""
    high = torch.tensor([task.max_forward, task.max_sideways, task.max_yaw_rate], device=world.device)
    sample = world.random.uniform((3,), -high, high, env_ids)
    task.command[env_ids] = sample * (0.25 + 0.75 * task.difficulty[env_ids])[:, None]


@dataclass
class VelocityState(ObservationGroup):
    """Velocity and the direction of gravity in the trunk's axes, the command, the joints, and the last action."""

    linear_velocity: ObservationTerm | None = ObservationTerm(linear_velocity)
    angular_velocity: ObservationTerm | None = ObservationTerm(angular_velocity)
    projected_gravity: ObservationTerm | None = ObservationTerm(projected_gravity)
    command: ObservationTerm | None = ObservationTerm(command)
    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities, scale=walking.JOINT_SPEED_SCALE)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class VelocityObservations:
    """Policy and critic see the state."""

    policy: VelocityState = field(default_factory=VelocityState)
    critic: ObservationGroup | None = None


@dataclass
class VelocityRewards:
    """Rewards of velocities as commanded, less bouncing, rolling, tilt, effort, abrupt actions and joints too fast.

    ``offset`` is for a walker that learns on: of ``linear_tracking`` an error of 0.05 m/s takes but a hundredth.
    Robots on two feet have other weights and the last five terms, which others lack (:func:`orbit_tasks.biped.suited`).
    """

    linear_tracking: RewardTerm | None = RewardTerm(linear_tracking, 1.0)
    yaw_tracking: RewardTerm | None = RewardTerm(yaw_tracking, 0.5)
    offset: RewardTerm | None = RewardTerm(linear_error, 0.0)
    bouncing: RewardTerm | None = RewardTerm(bouncing, -2.0)
    rolling: RewardTerm | None = RewardTerm(rolling, -0.05)
    tilt: RewardTerm | None = RewardTerm(tilt, -5.0)
    effort: RewardTerm | None = RewardTerm(common.joint_effort, -2.5e-5)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -0.01)
    overspeed: RewardTerm | None = RewardTerm(walking.overspeed, -0.2)
    stride: RewardTerm | None = RewardTerm(biped.stride, 0.75)
    slide: RewardTerm | None = RewardTerm(biped.slide, -0.1)
    stray: RewardTerm | None = RewardTerm(biped.stray, -0.1)
    near_limits: RewardTerm | None = RewardTerm(biped.near_limits, -1.0)
    fall: RewardTerm | None = RewardTerm(fell, 0.0)


@dataclass
class VelocityTerminations:
    """An episode ends early where the robot has fallen."""

    fallen: TerminationTerm | None = TerminationTerm(fallen)


@dataclass
class VelocityEvents:
    """Start and command are drawn for each episode; masses, pushes and the like with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(place_robot)
    sample_command: EventTerm | None = EventTerm(sample_command)
    masses: EventTerm | None = None
    friction: EventTerm | None = None
    gains: EventTerm | None = None
    push: EventTerm | None = None


BY_SUCCESS = randomize.by_success()


@dataclass
class VelocityCurriculum:
    """Commands, and pushes where there are some, grow with the robot's skill."""

    skill: CurriculumTerm | None = CurriculumTerm(BY_SUCCESS)


@dataclass(kw_only=True)
class VelocityFlat(Task):
    """Forward, sideways and turning velocities are commanded for one episode, in the trunk's own axes.

    Succeeds when the robot has not fallen and both errors, averaged over the episode, are within
    tolerance. Metrics: those errors, and falls. The expert, of robots with four feet, is :class:`FootholdGait`.
    """

    exceptions: ClassVar[tuple[TaskException, ...]] = (
        TaskException(TaskCheck.START_AREA, "the plane is the same everywhere"),
    )
    robot: str = "anymal_c"
    action: str = "joint_position"
    episode_length: float = 10.0
    ppo: PpoSettings = PpoSettings(iterations=600, initial_std=0.6, entropy_weight=0.005, discount=0.99)
    view: Pose = look_at(eye=(3.0, 2.2, 1.5), target=(0.0, 0.0, 0.35))
    max_forward: float = 1.0
    """m/s."""
    max_sideways: float = 0.5
    """m/s."""
    max_yaw_rate: float = 1.0
    """rad/s."""
    linear_tolerance: float = 0.25
    """m/s."""
    yaw_tolerance: float = 0.25
    """rad/s."""
    across_engines: bool = False
    """Whether domain randomisation draws friction and drives widely enough to span what engines make of the same
    values, for a policy that is to walk on an engine that it has not seen."""
    action_scale: float | None = None
    """rad from home for one unit of action ``joint_position``; None: as :func:`orbit_tasks.walking.walker` says."""
    observations: VelocityObservations = field(default_factory=VelocityObservations)
    rewards: VelocityRewards = field(default_factory=VelocityRewards)
    terminations: VelocityTerminations = field(default_factory=VelocityTerminations)
    events: VelocityEvents = field(default_factory=VelocityEvents)
    curriculum: VelocityCurriculum = field(default_factory=VelocityCurriculum)
    command: Tensor = field(init=False)
    """(N, 3)"""
    speed_limits: Tensor = field(init=False)
    """(joints,) rad/s."""
    foot_links: Tensor = field(init=False)
    """(feet,) int64 among the links of the contact sensor."""
    other_links: Tensor = field(init=False)
    """(k,) int64: links that are neither trunk nor feet."""
    still_joints: Tensor = field(init=False)
    """(joints,) 1 for those that swing no leg forward, 0 for others."""
    errors: Tensor = field(init=False)
    """(N, 2) linear and yaw error summed over the episode."""

    def scene(self) -> Scene:
        walking.check_commands(self.max_forward, self.max_sideways, self.max_yaw_rate)
        robot = walking.walker(self.robot, self.action_scale)
        biped.suited(self.rewards, len(robot.feet))
        return Scene(
            robots=(robot,),
            terrain=(common.floor(),),
            sensors=(ContactSensorSpec(name=CONTACTS, entity=common.ROBOT),),
            physics_dt=self.physics_dt,
        )

    def start(self, world: World) -> None:
        super().start(world)
        self.command = torch.zeros(world.num_envs, 3, device=world.device)
        self.errors = torch.zeros(world.num_envs, 2, device=world.device)
        robot = common.robot_of(world)
        self.speed_limits = walking.speed_limits(robot)
        names = list(biped.contacts_of(world).link_names)
        touching = [names.index(robot.spec.articulation.frame(foot).link) for foot in robot.spec.feet]
        others = [link for link in range(1, len(names)) if link not in touching]
        self.foot_links = torch.tensor(touching, device=world.device)
        self.other_links = torch.tensor(others, dtype=torch.int64, device=world.device)
        self.still_joints = biped.still_joints(robot)

    def reset(self, env_ids: Tensor | None) -> None:
        super().reset(env_ids)
        self.errors[slice(None) if env_ids is None else env_ids] = 0.0

    def advance(self, world: World) -> None:
        self.errors += torch.stack((linear_error(world, self), yaw_error(world, self)), dim=1)

    def mean_errors(self) -> Tensor:
        """(N, 2) m/s and rad/s."""
        return self.errors / self.episode_step[:, None]

    def randomize(self) -> None:
        """All masses, the ground's friction, the legs' gains, pushes, and noise on what a real robot estimates."""
        self.events.masses = EventTerm(randomize.masses(common.ROBOT, Range(0.85, 1.15)), EventTime.STARTUP)
        friction = Range(0.5, 1.25)
        gains = randomize.uncertain_gains(common.ROBOT)
        if self.across_engines:
            # Soft friction creeps where a rigid one holds; a joint that is kept to its velocity limit lags as a damped
            # one does.
            friction = Range(0.3, 1.25)
            gains = randomize.gains(common.ROBOT, stiffness=Range(0.7, 1.3), damping=Range(0.5, 3.0))
        event = randomize.friction((common.ROBOT, randomize.TERRAIN), friction)
        self.events.friction = EventTerm(event, EventTime.STARTUP)
        self.events.gains = EventTerm(gains, EventTime.STARTUP)
        push = randomize.push(common.ROBOT, Range(0.0, 0.7, easy=0.0))
        self.events.push = EventTerm(push, EventTime.INTERVAL, interval=(3.0, 6.0))
        common.add_noise(
            self.observations.policy,
            linear_velocity=0.1,
            angular_velocity=0.2,
            projected_gravity=0.03,
            joint_positions=0.01,
            joint_velocities=0.05,
        )

    def success(self, world: World) -> Tensor:
        tolerances = torch.tensor([self.linear_tolerance, self.yaw_tolerance], device=self.device)
        return (self.mean_errors() < tolerances).all(1) & ~fallen(world, self)

    def metrics(self, world: World) -> dict[str, Tensor]:
        linear, yaw = self.mean_errors().unbind(1)
        return {"linear_error_m_s": linear, "yaw_rate_error_rad_s": yaw, "falls": fallen(world, self).float()}

    def expert(self, world: World) -> FootholdGait:
        return FootholdGait(world, self, self.command)
