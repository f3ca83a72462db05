"""Recover: a legged robot stands up from any posture on the ground.

After Hwangbo et al., Learning Agile and Dynamic Motor Skills for Legged Robots (2019), and Lee et al., Robust Recovery
Controller for a Quadrupedal Robot Using Deep Reinforcement Learning (2019).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.envs import Environment, EventTerm, EventTime, ObservationGroup, ObservationTerm, RewardTerm, Task
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import once_per_state
from orbit_core.interfaces import Node, Port
from orbit_core.mdp import common, randomize
from orbit_core.mdp.randomize import Range
from orbit_core.scene import Scene, look_at
from orbit_motion import workspace as task_robots
from orbit_tasks import walking
from orbit_tasks.trunk import angular_velocity, projected_gravity

# Height from which a robot is dropped, over that of its home pose.
_FALL = 1.25


class RecoverMemory(walking.SpeedLimited):
    """State of a recovery, looked up once in a new world."""

    home_height: float
    """Metres."""

    def start(self, env: Environment) -> None:
        super().start(env)
        self.home_height = common.robot_of(env.world).spec.pose.position[2]


@once_per_state
def tilt(env: Environment[Recover]) -> Tensor:
    """(N,) rad between the trunk's upward axis and the vertical."""
    # Clamped: rounding beyond one would make the angle NaN.
    return torch.acos((-projected_gravity(env)[:, 2]).clamp(-1.0, 1.0))


@once_per_state
def height(env: Environment[Recover, RecoverMemory]) -> Tensor:
    """(N,) of the trunk, over that of the home pose; 1 when it stands."""
    return common.robot_of(env.world).root_pose[:, 2] / env.state.home_height


@once_per_state
def stance(env: Environment[Recover]) -> Tensor:
    """(N,) rad: root mean square of the joints' distance from home."""
    robot = common.robot_of(env.world)
    return (robot.joint_positions - robot.home_positions).square().mean(1).sqrt()


def upright(env: Environment[Recover]) -> Tensor:
    """(N,) 0 upside down to 1 upright."""
    return 0.5 * (1.0 - projected_gravity(env)[:, 2])


def raised(env: Environment[Recover]) -> Tensor:
    """(N,) 0 to 1: how high the trunk is, where it is upright."""
    # Squared, so that height counts little until the trunk is nearly upright; jumping higher earns nothing.
    return upright(env).square() * height(env).clamp(0.0, 1.0)


def at_home(env: Environment[Recover]) -> Tensor:
    """(N,) 0 to 1: how near the joints are to home, where the trunk is upright."""
    # Squared here too: on its back a robot needs its joints to roll over, not to bring them home.
    return upright(env).square() * torch.exp(-stance(env).square() / 0.25)


def restless(env: Environment[Recover]) -> Tensor:
    """(N,) squared speed of the trunk, linear and angular."""
    return common.squared_norm(common.robot_of(env.world).root_velocity)


def drop(env: Environment[Recover, RecoverMemory], env_ids: Tensor) -> None:
    """Drop the robot in any orientation and any posture."""
    robot = common.robot_of(env.world)
    pose = torch.zeros(len(env_ids), 7, device=env.device)
    # Higher than at home, because stretched legs reach further down than bent ones.
    pose[:, 2] = _FALL * env.state.home_height
    pose[:, 3:] = common.random_rotations(env.world, env_ids)
    robot.set_root_pose(pose, env_ids)
    low, high = robot.position_limits.unbind(1)
    home = robot.home_positions
    # Half a turn around home at most: limits of joints that turn without end are no range to draw from.
    reach = (high - low).clamp_max(torch.pi)
    low, high = low.maximum(home - 0.5 * reach), high.minimum(home + 0.5 * reach)
    share = env.world.random.uniform((len(robot.joint_names),), env_ids=env_ids)
    robot.set_joint_state(low + (high - low) * share, env_ids=env_ids)


@dataclass
class RecoverState(ObservationGroup):
    """Observations of a robot of itself, and its last action."""

    angular_velocity: ObservationTerm | None = ObservationTerm(angular_velocity)
    projected_gravity: ObservationTerm | None = ObservationTerm(projected_gravity)
    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities, scale=walking.JOINT_SPEED_SCALE)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class RecoverObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: RecoverState = field(default_factory=RecoverState)
    critic: ObservationGroup | None = None


@dataclass
class RecoverRewards:
    """Upright first, then high, then with the joints at home; less speed, effort, abrupt acts and joints too fast."""

    upright: RewardTerm | None = RewardTerm(upright, 1.0)
    raised: RewardTerm | None = RewardTerm(raised, 1.0)
    at_home: RewardTerm | None = RewardTerm(at_home, 1.0)
    restless: RewardTerm | None = RewardTerm(restless, -0.003)
    effort: RewardTerm | None = RewardTerm(common.joint_effort, -1e-5)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -0.003)
    overspeed: RewardTerm | None = RewardTerm(walking.overspeed, -0.1)


@dataclass
class RecoverTerminations:
    """An episode lasts its time: fallen robots are what the task is about."""


@dataclass
class RecoverEvents:
    """The robot is dropped; masses, friction and gains with domain randomisation."""

    drop: EventTerm | None = EventTerm(drop)
    masses: EventTerm | None = None
    """Masses of all links, drawn for each environment; set by domain randomisation."""
    friction: EventTerm | None = None
    """Friction of robot and ground; set by domain randomisation."""
    gains: EventTerm | None = None
    """Scales of the legs' stiffness and damping; set by domain randomisation."""


class HomePosture(Node):
    """Drives every joint to its home: stands a robot up whose feet are below it. Something to compare policies with."""

    def __init__(self, env: Environment[Recover]) -> None:
        self.name = "policy"
        """Name of the node in the agent's graph, where it takes the policy's place."""
        self._action = torch.zeros(env.num_envs, env.state.last_action.shape[1], device=env.device)
        self.outputs = (Port("action", (self._action.shape[1],)),)
        """Port of the action, whose numbers are the home's joint targets as the action space takes them."""

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        return {"action": self._action}


@dataclass(kw_only=True)
class Recover(Task):
    """A robot with feet is dropped in any orientation with its joints anywhere within their limits, and stands up.

    Succeeds when, at the episode's end, the trunk is level within ``tilt_tolerance``, as high as at home within
    ``height_tolerance``, and the joints are at home within ``stance_tolerance``. Metrics: those three. In place of an
    expert stands :class:`HomePosture`.
    """

    state_type: ClassVar[type[TaskState]] = RecoverMemory
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(
            iterations=1000, hidden_sizes=(512, 256, 128), initial_std=0.5, entropy_weight=0.005, discount=0.99
        ),
        view=look_at(eye=(2.4, 1.8, 1.2), target=(0.0, 0.0, 0.25)),
        follow=common.ROBOT,
        expert_success=0.0,  # the home posture turns nobody over
        exceptions=(
            TaskException(TaskCheck.EXPERT_BEATS_ZERO, "the expert drives joints home, as zero actions do"),
            TaskException(TaskCheck.START_AREA, "the plane is the same everywhere"),
            TaskException(TaskCheck.TRIVIAL_AGENTS, "a robot that lies on its feet stands up as its joints go home"),
        ),
    )
    robot: str = "anymal_c"
    action: str = "joint_position"
    episode_length: float = 6.0
    action_scale: float = 1.5
    """rad from home for one unit of action ``joint_position``: a robot on its back pushes off far from home."""
    tilt_tolerance: float = 0.25
    """rad"""
    height_tolerance: float = 0.2
    """Of the home pose's height."""
    stance_tolerance: float = 0.35
    """rad, root mean square."""
    observations: RecoverObservations = field(default_factory=RecoverObservations)
    rewards: RecoverRewards = field(default_factory=RecoverRewards)
    terminations: RecoverTerminations = field(default_factory=RecoverTerminations)
    events: RecoverEvents = field(default_factory=RecoverEvents)

    def scene(self) -> Scene:
        robot = walking.scaled(task_robots.legged(self.robot), self.action_scale)
        return Scene(robots=(robot,), terrain=(common.floor(),), physics_dt=self.physics_dt)

    def randomize(self) -> None:
        """All masses, the ground's friction, the legs' gains, and noise on what a real robot estimates."""
        friction = randomize.friction((common.ROBOT, randomize.TERRAIN), Range(0.5, 1.25))
        self.events.masses = EventTerm(randomize.masses(common.ROBOT, Range(0.85, 1.15)), EventTime.STARTUP)
        self.events.friction = EventTerm(friction, EventTime.STARTUP)
        self.events.gains = EventTerm(randomize.uncertain_gains(common.ROBOT), EventTime.STARTUP)
        common.add_noise(
            self.observations.policy,
            angular_velocity=0.2,
            projected_gravity=0.03,
            joint_positions=0.01,
            joint_velocities=0.05,
        )

    def success(self, env: Environment) -> Tensor:
        level = tilt(env) < self.tilt_tolerance
        high = (height(env) - 1.0).abs() < self.height_tolerance
        return level & high & (stance(env) < self.stance_tolerance)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {
            "tilt_rad": tilt(env),
            "height_over_home": height(env),
            "stance_rad": stance(env),
        }

    def expert(self, env: Environment) -> HomePosture:
        return HomePosture(env)
