"""Velocity-Flat: a legged robot follows a commanded velocity on a plane.

Rewards follow Rudin et al., Learning to Walk in Minutes Using Massively Parallel Deep Reinforcement Learning (2021).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import (
    CommandTerm,
    CurriculumTerm,
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
from orbit_core.envs.terms import means, measured_in, once_per_state
from orbit_core.mdp import common, randomize
from orbit_core.mdp.commands import UniformVelocityCommand
from orbit_core.mdp.randomize import Range
from orbit_core.scene import ContactSensorSpec, MarkerShape, MarkerSpec, Scene, look_at
from orbit_tasks import biped, walking
from orbit_tasks.gait import FootholdGait
from orbit_tasks.trunk import TRUNK, angular_velocity, linear_velocity, projected_gravity

CONTACTS = biped.CONTACTS


class VelocityMemory(biped.WalkingMemory):
    """Errors of an episode."""

    errors: Tensor = buffer(2)
    """(N, 2) linear and yaw error summed over the episode."""

    def update(self, env: Environment[Any, VelocityMemory]) -> None:
        self.errors += torch.stack((linear_error(env), yaw_error(env)), dim=1)


def mean_errors(env: Environment[Any, VelocityMemory]) -> Tensor:
    """(N, 2) m/s and rad/s, over the episode so far."""
    # Terms are evaluated after a step, when at least one has been counted.
    return env.state.errors / env.state.episode_step[:, None]


@means("velocity that is commanded", frame=TRUNK, components=("forward", "left", "yaw rate"))
@measured_in("m/s, m/s, rad/s")
def command(env: Environment[VelocityFlat]) -> Tensor:
    """(N, 3) velocity forward and to the left in m/s, yaw rate in rad/s."""
    return env.commands["velocity"][:, :3]


@once_per_state
def linear_error(env: Environment[VelocityFlat]) -> Tensor:
    """(N,) m/s."""
    return vector_norm(env.commands["velocity"][:, :2] - linear_velocity(env)[:, :2], dim=1)


@once_per_state
def yaw_error(env: Environment[VelocityFlat]) -> Tensor:
    """(N,) rad/s."""
    return (env.commands["velocity"][:, 2] - angular_velocity(env)[:, 2]).abs()


def linear_tracking(env: Environment[VelocityFlat]) -> Tensor:
    """(N,) in (0, 1]."""
    # Half a metre a second off leaves 37 % of the reward.
    return torch.exp(-linear_error(env).square() / 0.25)


def yaw_tracking(env: Environment[VelocityFlat]) -> Tensor:
    """(N,) in (0, 1]."""
    return torch.exp(-yaw_error(env).square() / 0.25)


def bouncing(env: Environment[VelocityFlat]) -> Tensor:
    """(N,) squared vertical velocity."""
    return linear_velocity(env)[:, 2].square()


def rolling(env: Environment[VelocityFlat]) -> Tensor:
    """(N,) squared roll and pitch rates."""
    return common.squared_norm(angular_velocity(env)[:, :2])


def tilt(env: Environment[VelocityFlat]) -> Tensor:
    """(N,) squared sine of the tilt."""
    return common.squared_norm(projected_gravity(env)[:, :2])


@once_per_state
def fallen(env: Environment[VelocityFlat]) -> Tensor:
    """(N,) the trunk touches something, or leans by more than 60 degrees."""
    # Squares are compared, which saves a root; a newton is far above rounding and far below a fall.
    touching = biped.contacts_of(env.world).forces[:, 0].square().sum(1) > 1.0
    # Minus one upright: beyond a half the trunk leans by more than 60 degrees.
    return touching | (projected_gravity(env)[:, 2] > -0.5)


def fell(env: Environment[VelocityFlat]) -> Tensor:
    """(N,) 1 where the robot has fallen."""
    return fallen(env).float()


def place_robot(env: Environment[VelocityFlat], env_ids: Tensor) -> None:
    """Place the robot at home height, facing anywhere, joints around their home; an arm that it carries anyhow."""
    position = torch.tensor(common.robot_of(env.world).spec.pose.position, device=env.device)
    common.stand_facing_anywhere(env.world, position.expand(len(env_ids), 3), env_ids)
    common.randomize_robot_start(0.05)(env, env_ids)
    walking.carry_anyhow(env.world, env_ids)


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
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

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
class VelocityCommands:
    """Velocity in the trunk's axes, one for each episode; a curriculum starts with a quarter of it."""

    velocity: CommandTerm | None = UniformVelocityCommand(easy_share=0.25)


@dataclass
class VelocityEvents:
    """The start is drawn for each episode; masses, pushes and the like with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(place_robot)
    masses: EventTerm | None = None
    """Masses of all links, drawn for each environment; set by domain randomisation."""
    friction: EventTerm | None = None
    """Friction of robot and ground; set by domain randomisation."""
    gains: EventTerm | None = None
    """Scales of the legs' stiffness and damping; set by domain randomisation."""
    push: EventTerm | None = None
    """Horizontal velocity added to the trunk every few seconds; set by domain randomisation."""


ARROW = "command"
"""Marker of the commanded velocity."""
STANDS = 0.05
"""m/s, below which a commanded velocity is to stand."""
BY_SUCCESS = randomize.by_success()


@dataclass
class VelocityCurriculum:
    """Commands, and pushes where there are some, grow with the robot's skill."""

    skill: CurriculumTerm | None = CurriculumTerm(BY_SUCCESS)
    """Change of difficulty after each episode, up where it succeeded."""


@dataclass(kw_only=True)
class VelocityFlat(Task):
    """Forward, sideways and turning velocities are commanded for one episode, in the trunk's own axes.

    Succeeds when the robot has not fallen and both errors, averaged over the episode, are within
    tolerance. Metrics: those errors, and falls. The expert, of robots with four feet, is :class:`FootholdGait`.
    """

    state_type: ClassVar[type[TaskState]] = VelocityMemory
    renamed: ClassVar[Mapping[str, str]] = {
        "events.sample_command": "commands.velocity",
        "max_forward": "commands.velocity.forward",
        "max_sideways": "commands.velocity.left",
        "max_yaw_rate": "commands.velocity.yaw_rate",
    }
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(iterations=600, initial_std=0.6, entropy_weight=0.005, discount=0.99),
        off_policy=OffPolicySettings(
            hidden_sizes=(512, 256, 128), critic_sizes=(512, 512), updates_per_step=4, target_rate=0.05
        ),
        view=look_at(eye=(3.0, 2.2, 1.5), target=(0.0, 0.0, 0.35)),
        follow=common.ROBOT,
        exceptions=(TaskException(TaskCheck.START_AREA, "the plane is the same everywhere"),),
    )
    robot: str = "anymal_c"
    action: str = "joint_position"
    episode_length: float = 10.0
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
    commands: VelocityCommands = field(default_factory=VelocityCommands)

    def scene(self) -> Scene:
        robot = walking.walker(self.robot, self.action_scale)
        # Here, because the number of feet is known once the robot is.
        biped.suited(self.rewards, len(robot.feet))
        return Scene(
            robots=(robot,),
            terrain=(common.floor(),),
            sensors=(ContactSensorSpec(name=CONTACTS, entity=common.ROBOT),),
            markers=(MarkerSpec(ARROW, MarkerShape.ARROW, size=0.5, color=(0.1, 0.45, 0.95, 0.9)),),
            physics_dt=self.physics_dt,
        )

    def mark(self, env: Environment) -> None:
        """Place the arrow of the commanded velocity above the robot; a robot that shall stand has none."""
        body, asked = common.robot_of(env.world), command(env)[:, :2]
        root = body.root_pose
        forward = quat_rotate(root[:, 3:], torch.tensor([[1.0, 0.0, 0.0]], device=env.device).expand(len(root), 3))
        heading = torch.atan2(forward[:, 1], forward[:, 0]) + torch.atan2(asked[:, 1], asked[:, 0])
        above = torch.where(vector_norm(asked, dim=1) > STANDS, 0.7 * body.spec.pose.position[2], -1e3)
        place = root[:, :3] + above[:, None] * torch.tensor([0.0, 0.0, 1.0], device=env.device)
        env.world.markers[ARROW].set_pose(torch.cat((place, common.turned(heading)), dim=1))

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
        # Pushes grow with the curriculum: a robot that cannot stand yet learns nothing from falling.
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

    def success(self, env: Environment) -> Tensor:
        tolerances = torch.tensor([self.linear_tolerance, self.yaw_tolerance], device=env.device)
        return (mean_errors(env) < tolerances).all(1) & ~fallen(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        linear, yaw = mean_errors(env).unbind(1)
        return {"linear_error_m_s": linear, "yaw_rate_error_rad_s": yaw, "falls": fallen(env).float()}

    def expert(self, env: Environment) -> FootholdGait:
        return FootholdGait(env, env.commands["velocity"][:, :3])
