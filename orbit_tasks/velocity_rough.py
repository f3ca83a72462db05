"""Velocity-Rough: a legged robot follows a commanded velocity on terrain that it sees by a height scan.

Terrain, curriculum and rewards follow Rudin et al., Learning to Walk in Minutes Using Massively Parallel Deep
Reinforcement Learning (2021); settings of the learning are those that the field trains such walkers with since.
"""

# Groups of terms are extended by deriving from them.
# pyright: reportIncompatibleVariableOverride=false

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.envs import (
    CurriculumTerm,
    EventTerm,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task_checks import TaskCheck, TaskException
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.mdp.scans import height_scan
from orbit_core.scene import Pose, RayCasterSpec, Scene, look_at
from orbit_core.sensors import grid_pattern
from orbit_tasks import walking
from orbit_tasks.biped import contacts_of
from orbit_tasks.mdp.terrain import OnTerrain, by_distance, place_on_terrain
from orbit_tasks.velocity_flat import (
    VelocityEvents,
    VelocityFlat,
    VelocityRewards,
    VelocityState,
    command,
    fell,
    tilt,
)

SCAN = "height_scan"
_HEADING_GAIN = 0.5
"""1/s: the yaw rate that is commanded over the heading that is wrong."""
_LEAST_FLIGHT = 0.5
"""Seconds in the air from which on a step is rewarded."""


def scanner(robot: str, trunk: str) -> RayCasterSpec:
    """187 rays straight down, 0.1 m apart over 1.6 m by 1 m around the robot, from 0.5 m above its trunk's frame."""
    origins, directions = grid_pattern((1.6, 1.0), 0.1)
    return RayCasterSpec(
        name=SCAN, entity=robot, frame=trunk, origins=origins, directions=directions,
        pose=Pose((0.0, 0.0, 0.5)), max_distance=3.0, yaw_only=True,
    )  # fmt: skip


def flight(world: World, task: VelocityRough) -> Tensor:
    """(N,) seconds beyond half a second that feet which touch down now were in the air, summed; 0 when told to stand.

    Rudin et al. (2021), feet air time.
    """
    timer = contacts_of(world).timer()
    landed = timer.touched_down(task.physics_dt * task.decimation)[:, task.foot_links]
    longer = (timer.last_air_time[:, task.foot_links] - _LEAST_FLIGHT) * landed
    return longer.sum(1) * (task.command[:, :2].norm(dim=1) > 0.1)


def bumps(world: World, task: VelocityRough) -> Tensor:
    """(N,) how many links that are neither feet nor the trunk touch something."""
    return contacts_of(world).in_contact()[:, task.other_links].float().sum(1)


def turn_to_heading(world: World, task: VelocityRough, env_ids: Tensor) -> None:
    """Draw a velocity in the trunk's axes, within the task's limits, and a heading to turn to."""
    high = torch.tensor([task.max_forward, task.max_sideways], device=world.device)
    task.command[env_ids, :2] = world.random.uniform((2,), -high, high, env_ids)
    task.heading[env_ids] = world.random.uniform((), -torch.pi, torch.pi, env_ids)
    task.command[env_ids, 2] = _yaw_rate(world, task)[env_ids]


def _yaw_rate(world: World, task: VelocityRough) -> Tensor:
    """(N,) rad/s towards the heading."""
    error = common.wrapped(task.heading - walking.heading(common.robot_of(world)))
    return (_HEADING_GAIN * error).clamp(-task.max_yaw_rate, task.max_yaw_rate)


@dataclass
class RoughState(VelocityState):
    """What Velocity-Flat shows, and the distance down to the ground around the robot."""

    height_scan: ObservationTerm | None = None
    """Set by the task, which knows the robot's trunk."""


@dataclass
class RoughObservations:
    """Policy and critic see the state."""

    policy: RoughState = field(default_factory=RoughState)
    critic: ObservationGroup | None = None


@dataclass
class RoughRewards(VelocityRewards):
    """As on the plane, but tilt costs less, for the ground tilts; long steps, no knocks of other links, no falls."""

    tilt: RewardTerm | None = RewardTerm(tilt, -0.5)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -0.04)
    fall: RewardTerm | None = RewardTerm(fell, -100.0)
    effort: RewardTerm | None = RewardTerm(common.joint_effort, -1e-5)
    flight: RewardTerm | None = RewardTerm(flight, 0.5)
    bumps: RewardTerm | None = RewardTerm(bumps, -0.5)


@dataclass
class RoughEvents(VelocityEvents):
    """Robots start on their cells; a heading is commanded in place of a yaw rate."""

    place_robot: EventTerm | None = EventTerm(place_on_terrain)
    sample_command: EventTerm | None = EventTerm(turn_to_heading)


BY_DISTANCE = by_distance(command)


@dataclass
class RoughCurriculum:
    """Robots that leave their cell go a level up."""

    level: CurriculumTerm | None = CurriculumTerm(BY_DISTANCE)


@dataclass(kw_only=True)
class VelocityRough(VelocityFlat, OnTerrain):
    """Velocity-Flat on a grid of terrain, for any robot with feet.

    A velocity in the trunk's own axes and a heading are commanded for one episode; the yaw rate commanded turns the
    robot towards the heading. Succeeds as Velocity-Flat does, within wider tolerances. Metrics: besides those of
    Velocity-Flat, the level of the terrain.
    """

    exceptions: ClassVar[tuple[TaskException, ...]] = (
        TaskException(TaskCheck.EXPERT_BEATS_ZERO, "the gait does not see the ground: it falls, and standing does not"),
        TaskException(
            TaskCheck.VELOCITY_LIMITS,
            "the gait does not see the ground: falls throw its joints about",
        ),
    )
    expert_success: ClassVar[float] = 0.0  # the gait does not see the ground
    episode_length: float = 20.0
    max_sideways: float = 1.0
    action_scale: float | None = 1.0
    linear_tolerance: float = 0.35
    yaw_tolerance: float = 0.35
    ppo: PpoSettings = PpoSettings(
        iterations=1500, hidden_sizes=(512, 256, 128), initial_std=0.3, entropy_weight=0.005, discount=0.99
    )
    view: Pose = look_at(eye=(14.0, 10.0, 9.0), target=(0.0, 0.0, 0.0))
    observations: RoughObservations = field(default_factory=RoughObservations)
    rewards: RoughRewards = field(default_factory=RoughRewards)
    events: RoughEvents = field(default_factory=RoughEvents)
    curriculum: RoughCurriculum = field(default_factory=RoughCurriculum)
    scan: bool = True
    """Whether the policy sees the ground."""
    heading: Tensor = field(init=False)
    """(N,) rad, commanded."""

    def scene(self) -> Scene:
        scene = replace(super().scene(), terrain=self.terrain.shapes())
        if self.scan and self.observations.policy.height_scan is None:
            trunk = scene.robots[0].articulation.root.name
            seen = replace(height_scan(scanner(common.ROBOT, trunk)), noise_std=0.02 * self.domain_randomization)
            self.observations.policy.height_scan = seen
        return scene

    def start(self, world: World) -> None:
        super().start(world)
        self.start_on_terrain(world)
        self.heading = torch.zeros(world.num_envs, device=world.device)

    def advance(self, world: World) -> None:
        super().advance(world)
        self.command[:, 2] = _yaw_rate(world, self)

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {**super().metrics(world), "terrain_level": self.level.float()}
