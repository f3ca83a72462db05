"""Ant and Humanoid: a robot of many legs or of two runs along x, as fast as it can.

Rewards follow Schulman et al., High-Dimensional Continuous Control Using Generalized Advantage Estimation (2015), and
their scale Makoviychuk et al., Isaac Gym (2021).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.constants import constant
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import (
    Environment,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
    Task,
    TerminationTerm,
)
from orbit_core.envs.off_policy import OffPolicySettings
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import measured_in, once_per_state
from orbit_core.mdp import common, randomize
from orbit_core.mdp.randomize import Range
from orbit_core.scene import Scene, look_at
from orbit_motion import workspace as task_robots
from orbit_tasks.trunk import angular_velocity, linear_velocity, projected_gravity


class RunningMemory(TaskState):
    """State of a run: the distance in the episode."""

    way: Tensor = buffer()
    """(N,) m along x since the episode began."""

    def update(self, env: Environment) -> None:
        self.way += speed(env) * env.step_dt


def mean_speed(env: Environment[Any, RunningMemory]) -> Tensor:
    """(N,) m/s along x in the episode so far."""
    # At least one step, because metrics are also read before the first.
    return env.state.way / (env.state.episode_step.clamp_min(1) * env.step_dt)


@measured_in("m")
def height(env: Environment[Running]) -> Tensor:
    """(N, 1) of the trunk above the ground."""
    return common.robot_of(env.world).root_pose[:, 2:3]


@measured_in("1")
@once_per_state
def heading(env: Environment[Running]) -> Tensor:
    """(N, 2) cosine and sine of the angle between the way that the trunk faces, seen from above, and x."""
    pose = common.robot_of(env.world).root_pose
    ahead = constant((1.0, 0.0, 0.0), env.device)
    # Normalised, because a trunk that leans forward projects to less than one.
    return torch.nn.functional.normalize(quat_rotate(pose[:, 3:], ahead)[:, :2], dim=1)


@once_per_state
def speed(env: Environment[Running]) -> Tensor:
    """(N,) m/s of the trunk along x."""
    return common.robot_of(env.world).root_velocity[:, 0]


def alive(env: Environment[Running]) -> Tensor:
    """(N,) ones."""
    # A wage for every step, so that running on pays more than falling early.
    return torch.ones_like(speed(env))


def facing_ahead(env: Environment[Running]) -> Tensor:
    """(N,) in [-1, 1]: 1 where the robot faces along x."""
    return heading(env)[:, 0]


def standing_up(env: Environment[Running]) -> Tensor:
    """(N,) in [-1, 1]: 1 where the trunk stands upright."""
    # Gravity in the trunk's axes points down along its z where it stands.
    return -projected_gravity(env)[:, 2]


def energy(env: Environment[Running]) -> Tensor:
    """(N,) sum over joints of the action's size times how fast the joint turns, in rad/s."""
    return (env.state.last_action * common.robot_of(env.world).joint_velocities).abs().sum(1)


@once_per_state
def fallen(env: Environment[Running]) -> Tensor:
    """(N,) bool: the trunk is lower than the task allows."""
    return height(env)[:, 0] < env.task.least_height


def place_robot(env: Environment[Running], env_ids: Tensor) -> None:
    """Place the robot at home, joints within 0.1 rad of theirs."""
    body = common.robot_of(env.world)
    pose = torch.tensor((*body.spec.pose.position, *body.spec.pose.orientation), device=env.device)
    body.set_root_pose(pose.expand(len(env_ids), 7), env_ids)
    # After the root: joints are drawn around home in a robot that stands.
    common.randomize_robot_start(0.1)(env, env_ids)


@dataclass
class RunningState(ObservationGroup):
    """Height, velocities and gravity in the trunk's axes, where it faces, the joints, and the last action."""

    height: ObservationTerm | None = ObservationTerm(height)
    linear_velocity: ObservationTerm | None = ObservationTerm(linear_velocity)
    angular_velocity: ObservationTerm | None = ObservationTerm(angular_velocity, scale=0.25)
    projected_gravity: ObservationTerm | None = ObservationTerm(projected_gravity)
    heading: ObservationTerm | None = ObservationTerm(heading)
    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities, scale=0.1)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class RunningObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: RunningState = field(default_factory=RunningState)
    critic: ObservationGroup | None = None


@dataclass
class RunningRewards:
    """Rewards of speed along x, of facing there and standing up, less effort and energy."""

    speed: RewardTerm | None = RewardTerm(speed, 1.0)
    alive: RewardTerm | None = RewardTerm(alive, 0.5)
    facing_ahead: RewardTerm | None = RewardTerm(facing_ahead, 0.5)
    standing_up: RewardTerm | None = RewardTerm(standing_up, 0.1)
    effort: RewardTerm | None = RewardTerm(common.action_size, -0.005)
    energy: RewardTerm | None = RewardTerm(energy, -0.01)


@dataclass
class RunningTerminations:
    """An episode ends early where the robot has fallen."""

    fallen: TerminationTerm | None = TerminationTerm(fallen)


@dataclass
class RunningEvents:
    """The robot is placed for each episode; masses and friction with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(place_robot)
    masses: EventTerm | None = None
    """Masses of all links, drawn for each environment; set by domain randomisation."""
    friction: EventTerm | None = None
    """Friction of robot and ground; set by domain randomisation."""


@dataclass(kw_only=True)
class Running(Task):
    """Base of both tasks. Success: the robot has not fallen, and came along x at the task's ``least_speed`` or more
    on average. Metrics: that speed, and falls.
    """  # fmt: skip

    state_type: ClassVar[type[TaskState]] = RunningMemory
    metadata: TaskMetadata = TaskMetadata(
        view=look_at(eye=(2.5, -4.5, 2.0), target=(1.0, 0.0, 0.5)),
        follow=common.ROBOT,
        exceptions=(
            TaskException(TaskCheck.START_AREA, "a run starts at one place"),
            TaskException(TaskCheck.START_YAW, "a run starts along x"),
        ),
    )
    action: str = "joint_effort"
    episode_length: float = 10.0
    least_height: float
    """m, of the trunk."""
    least_speed: float
    """m/s."""
    observations: RunningObservations = field(default_factory=RunningObservations)
    rewards: RunningRewards = field(default_factory=RunningRewards)
    terminations: RunningTerminations = field(default_factory=RunningTerminations)
    events: RunningEvents = field(default_factory=RunningEvents)

    def scene(self) -> Scene:
        return Scene(robots=(task_robots.legged(self.robot),), terrain=(common.floor(),), physics_dt=self.physics_dt)

    def randomize(self) -> None:
        """All masses, the ground's friction, and noise on what a real robot estimates."""
        self.events.masses = EventTerm(randomize.masses(common.ROBOT, Range(0.85, 1.15)), EventTime.STARTUP)
        friction = randomize.friction((common.ROBOT, randomize.TERRAIN), Range(0.6, 1.2))
        self.events.friction = EventTerm(friction, EventTime.STARTUP)
        common.add_noise(
            self.observations.policy, linear_velocity=0.1, angular_velocity=0.2, joint_positions=0.01,
            joint_velocities=0.05,
        )  # fmt: skip

    def success(self, env: Environment) -> Tensor:
        return (mean_speed(env) > self.least_speed) & ~fallen(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"speed_m_s": mean_speed(env), "falls": fallen(env).float()}


@dataclass(kw_only=True)
class Ant(Running):
    """Four legs of two joints. It has no expert: it is learned."""

    robot: str = "ant"
    least_height: float = 0.27
    least_speed: float = 1.0
    metadata: TaskMetadata = replace(
        Running.metadata,
        ppo=PpoSettings(iterations=1000, initial_std=0.6, entropy_weight=0.0, discount=0.99),
    )


@dataclass(kw_only=True)
class Humanoid(Running):
    """Two legs, two arms and a waist of three joints. It has no expert: it is learned."""

    robot: str = "humanoid"
    least_height: float = 0.9
    least_speed: float = 1.0
    # More for staying up than the Ant gets: two legs fall sooner than four.
    rewards: RunningRewards = field(default_factory=lambda: RunningRewards(alive=RewardTerm(alive, 2.0)))
    metadata: TaskMetadata = replace(
        Running.metadata,
        ppo=PpoSettings(
            iterations=2000, hidden_sizes=(400, 200, 100), initial_std=0.6, entropy_weight=0.0, discount=0.99
        ),
        off_policy=OffPolicySettings(
            hidden_sizes=(512, 256, 128), critic_sizes=(512, 512), updates_per_step=4, target_rate=0.05
        ),
    )
