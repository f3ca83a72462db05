"""Velocity-Rough: a legged robot follows a commanded velocity on terrain that it sees by a height scan.

Terrain, curriculum and rewards follow Rudin et al., Learning to Walk in Minutes Using Massively Parallel Deep
Reinforcement Learning (2021); settings of the learning are those that the field trains such walkers with since.
"""

# Groups of terms are extended by deriving from them.
# pyright: reportIncompatibleVariableOverride=false

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from torch import Tensor

from orbit_core.envs import (
    CommandTerm,
    CurriculumTerm,
    Environment,
    EventTerm,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.mdp import common
from orbit_core.mdp.commands import HeadingVelocityCommand
from orbit_core.mdp.sensing import height_scan
from orbit_core.scene import Pose, RayCasterSpec, Scene
from orbit_core.sensors import grid_pattern
from orbit_tasks.biped import contacts_of
from orbit_tasks.mdp.terrain import OnTerrain, TerrainMemory, by_distance, place_on_terrain
from orbit_tasks.velocity_flat import (
    VelocityCommands,
    VelocityEvents,
    VelocityFlat,
    VelocityMemory,
    VelocityRewards,
    VelocityState,
    command,
    fell,
    tilt,
)

SCAN = "height_scan"
# Seconds in the air from which on a step is rewarded.
_LEAST_FLIGHT = 0.5


def scanner(robot: str, trunk: str) -> RayCasterSpec:
    """187 rays straight down, 0.1 m apart over 1.6 m by 1 m around the robot, from 0.5 m above its trunk's frame."""
    origins, directions = grid_pattern((1.6, 1.0), 0.1)
    return RayCasterSpec(
        name=SCAN, entity=robot, frame=trunk, origins=origins, directions=directions,
        pose=Pose((0.0, 0.0, 0.5)), max_distance=3.0, yaw_only=True,
    )  # fmt: skip


class RoughMemory(VelocityMemory, TerrainMemory):
    """State of walking and of terrain."""

    def start(self, env: Environment[VelocityRough]) -> None:
        super().start(env)
        self.start_on_terrain(env)


def flight(env: Environment[VelocityRough, RoughMemory]) -> Tensor:
    """(N,) seconds beyond half a second that feet which land now were in the air, summed; 0 if commanded to stand.

    Rudin et al. (2021), feet air time.
    """
    timer = contacts_of(env.world).timer()
    landed = timer.touched_down(env.step_dt)[:, env.state.foot_links]
    # Less the threshold, so that short, hasty steps cost and long ones pay.
    longer = (timer.last_air_time[:, env.state.foot_links] - _LEAST_FLIGHT) * landed
    return longer.sum(1) * (env.commands["velocity"][:, :2].norm(dim=1) > 0.1)


def bumps(env: Environment[VelocityRough, RoughMemory]) -> Tensor:
    """(N,) how many links that are neither feet nor the trunk touch something."""
    return contacts_of(env.world).in_contact()[:, env.state.other_links].float().sum(1)


@dataclass
class RoughState(VelocityState):
    """State of Velocity-Flat, and the distance down to the ground around the robot."""

    height_scan: ObservationTerm | None = None
    """Set by the task, which knows the robot's trunk."""


@dataclass
class RoughObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: RoughState = field(default_factory=RoughState)
    critic: ObservationGroup | None = None


@dataclass
class RoughRewards(VelocityRewards):
    """Rewards of the plane, but tilt costs less, for the ground tilts; long steps, no knocks and no falls."""

    tilt: RewardTerm | None = RewardTerm(tilt, -0.5)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -0.04)
    fall: RewardTerm | None = RewardTerm(fell, -100.0)
    effort: RewardTerm | None = RewardTerm(common.joint_effort, -1e-5)
    flight: RewardTerm | None = RewardTerm(flight, 0.5)
    bumps: RewardTerm | None = RewardTerm(bumps, -0.5)


@dataclass
class RoughCommands(VelocityCommands):
    """Velocity in the trunk's axes, and a heading that the robot turns to."""

    velocity: CommandTerm | None = HeadingVelocityCommand(left=(-1.0, 1.0))


@dataclass
class RoughEvents(VelocityEvents):
    """Robots start on their cells."""

    place_robot: EventTerm | None = EventTerm(place_on_terrain)


BY_DISTANCE = by_distance(command)


@dataclass
class RoughCurriculum:
    """Robots that leave their cell go a level up."""

    level: CurriculumTerm | None = CurriculumTerm(BY_DISTANCE)
    """Change of the terrain's level after each episode, by the distance walked."""


@dataclass(kw_only=True)
class VelocityRough(VelocityFlat, OnTerrain):
    """Velocity-Flat on a grid of terrain, for any robot with feet.

    A velocity in the trunk's own axes and a heading are commanded for one episode; the yaw rate commanded turns the
    robot towards the heading. Succeeds as Velocity-Flat does, within wider tolerances. Metrics: those of
    Velocity-Flat, and, the level of the terrain.
    """

    state_type: ClassVar[type[TaskState]] = RoughMemory
    renamed: ClassVar[Mapping[str, str]] = {
        "events.sample_command": "commands.velocity",
        "max_forward": "commands.velocity.forward",
        "max_sideways": "commands.velocity.left",
        "max_yaw_rate": "commands.velocity.max_yaw_rate",
    }
    metadata: TaskMetadata = replace(
        VelocityFlat.metadata,
        ppo=PpoSettings(
            iterations=1500, hidden_sizes=(512, 256, 128), initial_std=0.3, entropy_weight=0.005, discount=0.99
        ),
        expert_success=0.0,  # the gait does not see the ground
        exceptions=(
            TaskException(
                TaskCheck.EXPERT_BEATS_ZERO, "the gait does not see the ground: it falls, and standing does not"
            ),
            TaskException(
                TaskCheck.VELOCITY_LIMITS,
                "the gait does not see the ground: falls throw its joints about",
            ),
        ),
    )
    episode_length: float = 20.0
    action_scale: float | None = 1.0
    linear_tolerance: float = 0.35
    yaw_tolerance: float = 0.35
    observations: RoughObservations = field(default_factory=RoughObservations)
    rewards: RoughRewards = field(default_factory=RoughRewards)
    events: RoughEvents = field(default_factory=RoughEvents)
    commands: VelocityCommands = field(default_factory=RoughCommands)
    curriculum: RoughCurriculum = field(default_factory=RoughCurriculum)
    scan: bool = True
    """Whether the policy sees the ground."""

    def scene(self) -> Scene:
        scene = replace(super().scene(), terrain=self.terrain.shapes())
        # The trunk's name is known from the robot only, so that the term is made with the scene.
        if self.scan and self.observations.policy.height_scan is None:
            trunk = scene.robots[0].articulation.root.name
            seen = replace(height_scan(scanner(common.ROBOT, trunk)), noise_std=0.02 * self.domain_randomization)
            self.observations.policy.height_scan = seen
        return scene

    def metrics(self, env: Environment[Any, RoughMemory]) -> dict[str, Tensor]:
        return {**super().metrics(env), "terrain_level": env.state.level.float()}
