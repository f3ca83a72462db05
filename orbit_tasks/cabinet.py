"""Cabinet: pull a drawer open by its handle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import SolidOptions, box, cabinet
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import (
    CommandTerm,
    Environment,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
    Task,
)
from orbit_core.envs.off_policy import OffPolicySettings
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import Subtask, TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import POSE, Bounds, Meaning, measured_in, once_per_state
from orbit_core.mdp import common, randomize
from orbit_core.mdp.commands import UniformScalarCommand, generated_command
from orbit_core.mdp.randomize import Range
from orbit_core.scene import MarkerShape, MarkerSpec, Pose, RobotSpec, Scene, look_at
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase

DRAWER = "drawer_joint"
HANDLE = "drawer_handle"
# Height in metres of what the cabinet stands on.
PLINTH = 0.18


class CabinetMemory(TaskState):
    """State of a cabinet, looked up once in a new world."""

    drawer: int
    """Index of the drawer's joint."""

    def start(self, env: Environment) -> None:
        (self.drawer,) = env.world.objects["cabinet"].find_joints(DRAWER)


@once_per_state
def opening(env: Environment[Cabinet, CabinetMemory]) -> Tensor:
    """(N,) metres that the drawer is open."""
    return env.world.objects["cabinet"].joint_positions[:, env.state.drawer]


@measured_in("m")
def drawer_position(env: Environment[Cabinet]) -> Tensor:
    """(N, 1) opening of the drawer along its rail."""
    return opening(env)[:, None]


@measured_in(POSE)
@once_per_state
def handle_pose(env: Environment[Cabinet]) -> Tensor:
    """(N, 7) as a hand takes it: z into the cabinet, y across the bar."""
    return env.world.objects["cabinet"].frame_pose(HANDLE)


@once_per_state
def goal_distance(env: Environment[Cabinet]) -> Tensor:
    """(N,) metres between the drawer and where it should be."""
    return (env.commands["goal"][:, 0] - opening(env)).abs()


def reaching(env: Environment[Cabinet]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the handle."""
    distance = vector_norm(handle_pose(env)[:, :3] - common.hand_pose(env)[:, :3], dim=1)
    return common.nearness(distance, 0.2)


def opened(env: Environment[Cabinet]) -> Tensor:
    """(N,) in (-inf, 1]: the part of the way that is done."""
    return 1.0 - goal_distance(env) / env.commands["goal"][:, 0]


def place_cabinet(env: Environment[Cabinet], env_ids: Tensor) -> None:
    """Place the cabinet up to 5 cm off its place each way, turned by up to 0.1 rad."""
    u = 2.0 * env.world.random.uniform((3,), env_ids=env_ids) - 1.0
    cabinet = env.world.objects["cabinet"]
    # Not raised or lowered: the cabinet stands on its plinth.
    zero = torch.zeros_like(u[:, 0])
    nominal = torch.tensor(cabinet.spec.pose.position, device=env.device)
    position = nominal + torch.stack((0.05 * u[:, 0], 0.05 * u[:, 1], zero), dim=1)
    cabinet.set_root_pose(torch.cat((position, common.turned(0.1 * u[:, 2])), dim=1), env_ids)


@dataclass(unsafe_hash=True, kw_only=True)
class CabinetGoal(UniformScalarCommand):
    """Metres that the drawer is to be open; a marker shows where its handle is then."""

    value: Bounds = (0.15, 0.3)
    """Least and most opening, m."""

    def show(self, env: Environment, command: Tensor, env_ids: Tensor) -> None:
        handle = handle_pose(env)[env_ids]
        env.world.markers["goal"].set_pose(_moved_in(handle, handle[:, :3], -command[:, 0]), env_ids)


def at_handle(env: Environment[Cabinet]) -> Tensor:
    """(N, 7) the fingers around the bar."""
    return handle_pose(env)


def before_handle(env: Environment[Cabinet]) -> Tensor:
    """(N, 7) twelve centimetres in front of the handle."""
    handle = handle_pose(env)
    return _moved_in(handle, handle[:, :3], torch.full_like(env.commands["goal"][:, 0], -0.12))


def ajar(env: Environment[Cabinet]) -> Tensor:
    """(N,) bool: the drawer has begun to follow the hand."""
    return opening(env) > 0.005


def opened_handle(env: Environment[Cabinet]) -> Tensor:
    """(N, 7) the handle where the drawer is as far open as it should be."""
    handle = handle_pose(env)
    return _moved_in(handle, handle[:, :3], opening(env) - env.commands["goal"][:, 0])


def pulled(env: Environment[Cabinet]) -> Tensor:
    """(N, 7) the hand moved by what the drawer lacks, however the bar sits in it."""
    position = common.hand_pose(env)[:, :3]
    return _moved_in(handle_pose(env), position, opening(env) - env.commands["goal"][:, 0])


def _moved_in(handle: Tensor, position: Tensor, distance: Tensor) -> Tensor:
    """(n, 7) oriented like the handle, at ``position`` (n, 3) moved into the cabinet by ``distance`` (n,)."""
    along = torch.zeros_like(position)
    # The handle's z points into the cabinet.
    along[:, 2] = distance
    return torch.cat((position + quat_rotate(handle[:, 3:], along), handle[:, 3:]), dim=1)


def distance_to_cabinet(robot: RobotSpec) -> float:
    """Metres from the robot to the cabinet's middle.

    The handle is 8 cm within the far side of the workspace, for it must be in reach 30 cm nearer as well; and as high
    as a shoulder, for the arm reaches it with a level hand only there.
    """
    return common.workspace_of(robot).high[0] + 0.23


# The expert's phases from before the handle on.
PULLING = (
    Phase(before_handle, position_tolerance=0.02, timeout=3.0),
    Phase(at_handle, position_tolerance=0.008, timeout=1.5),
    Phase(at_handle, gripper_open=False, dwell=0.4, timeout=0.5),
    Phase(pulled, gripper_open=False),
)
# m and rad by which it leads: a stronger pull takes the fingers off the bar.
POSITION_LEAD, ROTATION_LEAD = 0.05, 0.2


@dataclass
class CabinetState(ObservationGroup):
    """The arm's joints and hand, the handle, how far the drawer is open and is to be, and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    handle_pose: ObservationTerm | None = ObservationTerm(handle_pose)
    drawer: ObservationTerm | None = ObservationTerm(drawer_position)
    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"), unit="m", meaning=Meaning("opening that the drawer is to have")
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class CabinetObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: CabinetState = field(default_factory=CabinetState)
    critic: ObservationGroup | None = None


@dataclass
class CabinetRewards:
    """Rewards of the hand at the handle and the drawer at its goal, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    open: RewardTerm | None = RewardTerm(opened, 5.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-3)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-3)


@dataclass
class CabinetTerminations:
    """Only the time limit ends an episode."""


@dataclass
class CabinetCommands:
    """Commanded opening of the drawer."""

    goal: CommandTerm | None = CabinetGoal()


@dataclass
class CabinetEvents:
    """Robot and cabinet are placed for each episode; masses and the like with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cabinet: EventTerm | None = EventTerm(place_cabinet)
    masses: EventTerm | None = None
    """Masses of the cabinet's parts, drawn for each environment; set by domain randomisation."""
    friction: EventTerm | None = None
    """Friction of fingers and cabinet; set by domain randomisation."""
    gains: EventTerm | None = None
    """Scales of the arm's stiffness and damping; set by domain randomisation."""


@dataclass(kw_only=True)
class Cabinet(Task):
    """The cabinet stands before the robot, a little off and turned; the drawer is to be opened so far.

    Succeeds when the drawer is within ``tolerance`` of the goal at the episode's end. Metric: that distance.
    """

    state_type: ClassVar[type[TaskState]] = CabinetMemory
    renamed: ClassVar[Mapping[str, str]] = {"events.sample_goal": "commands.goal"}
    metadata: TaskMetadata = TaskMetadata(
        instruction="open the drawer",
        subtasks=(Subtask(handle_pose, ajar), Subtask(opened_handle, ajar, free=False)),
        ppo=PpoSettings(iterations=600, initial_std=0.3),
        off_policy=OffPolicySettings(updates_per_step=4),
        view=look_at(eye=(-0.4, 1.7, 1.3), target=(0.5, 0.0, 0.5)),
        exceptions=(TaskException(TaskCheck.START_YAW, "the drawer must open towards the arm to stay in reach"),),
    )
    robot: str = "franka_panda"
    action: str = "joint_position"
    episode_length: float = 8.0
    tolerance: float = 0.02
    """Metres."""
    observations: CabinetObservations = field(default_factory=CabinetObservations)
    rewards: CabinetRewards = field(default_factory=CabinetRewards)
    terminations: CabinetTerminations = field(default_factory=CabinetTerminations)
    events: CabinetEvents = field(default_factory=CabinetEvents)
    commands: CabinetCommands = field(default_factory=CabinetCommands)

    def scene(self) -> Scene:
        return self.scene_with(task_robots.arm(self.robot), PLINTH)

    def scene_with(self, robot: RobotSpec, plinth: float) -> Scene:
        """The cabinet before a robot, on a plinth of that height in metres."""
        away = distance_to_cabinet(robot)
        # The plinth raises the cabinet; fixed, as it would tip when the drawer is pulled.
        options = SolidOptions(mass=10.0, fixed_base=True, pose=Pose((away, 0.0, 0.5 * plinth)))
        return Scene(
            robots=(robot,),
            objects=(cabinet(pose=Pose((away, 0.0, plinth))), box("plinth", size=(0.62, 0.62, plinth), **options)),
            terrain=(common.floor(),),
            markers=(MarkerSpec("goal", MarkerShape.FRAME, size=0.12),),
            physics_dt=self.physics_dt,
        )

    def randomize(self) -> None:
        """The cabinet's masses, its friction and the fingers', the arm's gains, and noise on joints and drawer."""
        self.events.masses = EventTerm(randomize.masses("cabinet", Range(0.7, 1.5)), EventTime.STARTUP)
        friction = randomize.friction((common.ROBOT, "cabinet"), Range(0.6, 1.2))
        self.events.friction = EventTerm(friction, EventTime.STARTUP)
        self.events.gains = EventTerm(randomize.uncertain_gains(common.ROBOT), EventTime.STARTUP)
        common.add_noise(self.observations.policy, joint_positions=0.005, joint_velocities=0.05, drawer=0.002)

    def success(self, env: Environment) -> Tensor:
        return goal_distance(env) < self.tolerance

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(env)}

    def expert(self, env: Environment) -> Expert:
        return Expert(env, PULLING, position_lead=POSITION_LEAD, rotation_lead=ROTATION_LEAD)
