"""Dishwasher: open the door against its magnetic seal, then pull the rack out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import BENCH_HEIGHT, dishwasher, work_bench
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import (
    CommandTerm,
    Environment,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    PremiseTerm,
    RewardTerm,
    Task,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import Bounds, Meaning, TermFunction, once_per_state
from orbit_core.mdp import common, randomize
from orbit_core.mdp.commands import UniformScalarCommand, generated_command
from orbit_core.mdp.randomize import Range
from orbit_core.scene import MarkerShape, MarkerSpec, Pose, Scene, look_at
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import held

THING = "dishwasher"
DOOR_BAR, RACK_BAR = "door_bar", "rack_bar"
# Metres in the dishwasher's frame: the door's outer face, its hinge's height, and from the hinge to the door's bar.
FRONT, HINGE, REACH = -0.2, 0.14, 0.27
# Metres by which the hand's middle stands behind a bar that it pulls, and below its middle.
BEHIND, DEEP = 0.03, 0.015
# rad at which the hand lets go of the door: its weight opens it further.
LET_GO = 0.8
# Metres forward and up in the dishwasher's frame: where the hand goes, to within the phases' tolerances.
STATIONS = (
    (-0.27, 0.49), (-0.16, 0.47), (-0.16, 0.395), (-0.28, 0.38), (-0.38, 0.31),
    (-0.12, 0.45), (-0.12, 0.325), (-0.32, 0.325),
)  # fmt: skip


class DishwasherMemory(TaskState):
    """State of a dishwasher, looked up once in a new world."""

    door: int
    """Column of the door's hinge among the joints of the dishwasher."""
    rack: int
    """Indices of the joints."""

    def start(self, env: Environment) -> None:
        self.door, self.rack = env.world.objects[THING].find_joints("door_joint", "rack_joint")


@once_per_state
def door(env: Environment[Dishwasher, DishwasherMemory]) -> Tensor:
    """(N,) rad that the door is open."""
    return env.world.objects[THING].joint_positions[:, env.state.door]


@once_per_state
def rack(env: Environment[Dishwasher, DishwasherMemory]) -> Tensor:
    """(N,) metres that the rack is out."""
    return env.world.objects[THING].joint_positions[:, env.state.rack]


def joints(env: Environment[Dishwasher]) -> Tensor:
    """(N, 2) positions of the door's hinge and of the rack's rail"""
    return torch.stack((door(env), rack(env)), dim=1)


@once_per_state
def door_lacks(env: Environment[Dishwasher]) -> Tensor:
    """(N,) rad that the door is less open than it should be; zero where it is open wider."""
    return (env.task.door_goal - door(env)).clamp_min(0.0)


@once_per_state
def door_open(env: Environment[Dishwasher]) -> Tensor:
    """(N,) bool"""
    return door_lacks(env) == 0.0


@once_per_state
def rack_lacks(env: Environment[Dishwasher]) -> Tensor:
    """(N,) metres between the rack and where it should be; while the door is not open, all of the way."""
    # All of it while the door is shut, so that pulling at a rack behind it earns nothing.
    return torch.where(door_open(env), (env.commands["goal"][:, 0] - rack(env)).abs(), env.commands["goal"][:, 0])


@once_per_state
def bars(env: Environment[Dishwasher]) -> Tensor:
    """(N, 2, 3) of the middles of the door's bar and the rack's."""
    thing = env.world.objects[THING]
    return torch.stack([thing.frame_pose(name)[:, :3] for name in (DOOR_BAR, RACK_BAR)], dim=1)


def hand_to_bars(env: Environment[Dishwasher]) -> Tensor:
    """(N, 2, 3) positions of the door's and the rack's bars minus the hand's, in the environment's axes."""
    return bars(env) - common.hand_pose(env)[:, None, :3]


def inward(env: Environment[Dishwasher]) -> Tensor:
    """(N, 3) unit vector from the front into the dishwasher."""
    turn = env.world.objects[THING].root_pose[:, 3:]
    return quat_rotate(turn, torch.eye(3, device=env.device)[0].expand(env.num_envs, 3))


def reaching(env: Environment[Dishwasher]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to behind the bar that is to be pulled next."""
    behind = torch.stack((hook(DOOR_BAR)(env), hook(RACK_BAR)(env)), dim=1)[..., :3]
    distance = vector_norm(behind - common.hand_pose(env)[:, None, :3], dim=2)
    # One bar at a time: a hand between both would otherwise earn from each.
    return common.nearness(torch.where(door_open(env), distance[:, 1], distance[:, 0]), 0.15)


def place(env: Environment[Dishwasher], env_ids: Tensor) -> None:
    """Place the dishwasher up to 2 cm nearer or further, 4 cm to either side, turned by up to 0.1 rad."""
    u = 2.0 * env.world.random.uniform((3,), env_ids=env_ids) - 1.0
    thing = env.world.objects[THING]
    x, y, z = thing.spec.pose.position
    where = torch.stack((x + 0.02 * u[:, 0], y + 0.04 * u[:, 1], torch.full_like(u[:, 0], z), 0.1 * u[:, 2]), dim=1)
    thing.set_root_pose(common.standing(where), env_ids)


@dataclass(unsafe_hash=True, kw_only=True)
class DishwasherGoal(UniformScalarCommand):
    """Metres that the rack is to be out; a marker shows where its bar is then."""

    value: Bounds = (0.12, 0.2)
    """Least and most travel of the rack, m."""

    def show(self, env: Environment, command: Tensor, env_ids: Tensor) -> None:
        bar = env.world.objects[THING].frame_pose(RACK_BAR)[env_ids]
        out = inward(env)[env_ids] * command
        env.world.markers["goal"].set_pose(torch.cat((bar[:, :3] - out, bar[:, 3:]), dim=1), env_ids)


def hook(bar: str, height: float = -DEEP, behind: float = BEHIND) -> TermFunction:
    """(N, 7) the hand behind a bar, ``height`` metres above it."""

    def pose(env: Environment[Dishwasher]) -> Tensor:
        position = env.world.objects[THING].frame_pose(bar)[:, :3] + behind * inward(env)
        return _down(env, position, height)

    return pose


def pull_door(env: Environment[Dishwasher]) -> Tensor:
    """(N, 7) the hand a little further on the bar's way than the door is open, and no further than to let go."""
    thing, into = env.world.objects[THING], inward(env)
    # Ahead of the door, so that the hand pulls it along.
    angle = (door(env) + 0.25).clamp(max=LET_GO + 0.05)[:, None]
    up = torch.eye(3, device=env.device)[2]
    hinge = thing.root_pose[:, :3] + FRONT * into + HINGE * up
    # The bar is 9 mm behind the plane of the hinge.
    bar = hinge + (0.009 * angle.cos() - REACH * angle.sin()) * into + (REACH * angle.cos() + 0.009 * angle.sin()) * up
    return _down(env, bar + 0.5 * BEHIND * into, -DEEP)


def pull_rack(env: Environment[Dishwasher]) -> Tensor:
    """(N, 7) the hand moved by what the rack lacks, however the bar touches it."""
    hand, bar = common.hand_pose(env)[:, :3], bars(env)[:, 1]
    position = hand - (env.commands["goal"][:, 0] - rack(env))[:, None] * inward(env)
    return _down(env, torch.cat((position[:, :2], bar[:, 2:]), dim=1), -DEEP)


def _down(env: Environment[Dishwasher], position: Tensor, height: float) -> Tensor:
    """(N, 7) the hand that points down, turned as the dishwasher is."""
    yaw = 2.0 * torch.atan2(*env.world.objects[THING].root_pose[:, [6, 3]].unbind(1))
    place = torch.cat((position[:, :2], position[:, 2:] + height), dim=1)
    return torch.cat((place, common.facing_down(yaw)), dim=1)


@dataclass
class DishwasherState(ObservationGroup):
    """The arm's joints and hand, the bars as the hand sees them, door and rack and where it is to be, last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    hand_to_bars: ObservationTerm | None = ObservationTerm(hand_to_bars, unit="m")
    joints: ObservationTerm | None = ObservationTerm(joints, unit="rad, m")
    inward: ObservationTerm | None = ObservationTerm(inward, unit="1")
    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"), unit="m", meaning=Meaning("travel that the rack is to have")
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class DishwasherObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: DishwasherState = field(default_factory=DishwasherState)
    critic: ObservationGroup | None = None


@dataclass
class DishwasherRewards:
    """Rewards of the hand at the next bar, the door open, the rack at its goal, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    open: RewardTerm | None = RewardTerm(lambda env: 1.0 - door_lacks(env) / env.task.door_goal, 4.0)
    """Share of the way to ``door_goal`` that the door is open, in [0, 1]."""
    pull: RewardTerm | None = RewardTerm(lambda env: 1.0 - rack_lacks(env) / env.commands["goal"][:, 0], 8.0)
    """Share of the commanded travel that the rack is out, in [0, 1]."""
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-3)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-3)


@dataclass
class DishwasherTerminations:
    """Only the time limit ends an episode."""


@dataclass
class DishwasherCommands:
    """Commanded travel of the rack."""

    goal: CommandTerm | None = DishwasherGoal()


@dataclass
class DishwasherEvents:
    """Robot and dishwasher are placed for each episode; seal, friction, gains with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place: EventTerm | None = EventTerm(place)
    seal: EventTerm | None = None
    """Force of the magnetic seal, drawn for each environment; set by domain randomisation."""
    friction: EventTerm | None = None
    """Friction of fingers and bars; set by domain randomisation."""
    gains: EventTerm | None = None
    """Scales of the arm's stiffness and damping; set by domain randomisation."""


@dataclass
class DishwasherPremises:
    """Premise that the dishwasher is shut."""

    shut: PremiseTerm | None = PremiseTerm(
        lambda env: (joints(env).abs() < 0.01).all(1),
        "the door is ajar or the rack has slid out, so that the seal does not hold, or something pushes them",
    )


@dataclass(kw_only=True)
class Dishwasher(Task):
    """A small dishwasher stands before the robot. Its door is to be pulled off its magnetic seal, then its rack out.

    Succeeds when at the episode's end the door is open by ``door_goal`` at least, and the rack within ``tolerance`` of
    its goal. Metrics: what door and rack lack, in that order: while the door is not open, the rack lacks all.
    """

    state_type: ClassVar[type[TaskState]] = DishwasherMemory
    renamed: ClassVar[Mapping[str, str]] = {"events.sample_goal": "commands.goal"}
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005),
        view=look_at(eye=(-0.2, 1.35, 0.95), target=(0.6, 0.0, 0.2)),
        exceptions=(
            TaskException(TaskCheck.START_AREA, "door and rack travel through most of the arm's reach"),
            TaskException(TaskCheck.START_YAW, "the door must open towards the arm to stay in reach"),
        ),
    )
    robot: str = "franka_panda"
    action: str = "joint_position"
    episode_length: float = 10.0
    door_goal: float = 1.3
    """rad"""
    tolerance: float = 0.02
    """Metres."""
    observations: DishwasherObservations = field(default_factory=DishwasherObservations)
    rewards: DishwasherRewards = field(default_factory=DishwasherRewards)
    terminations: DishwasherTerminations = field(default_factory=DishwasherTerminations)
    events: DishwasherEvents = field(default_factory=DishwasherEvents)
    premises: DishwasherPremises = field(default_factory=DishwasherPremises)
    commands: DishwasherCommands = field(default_factory=DishwasherCommands)

    def scene(self) -> Scene:
        self.bound(door_goal=(0.1, 1.45), tolerance=(1e-6, 0.1))
        robot = task_robots.arm(self.robot)
        box = common.placed_workspace(robot)
        # The door's bar as far as the hand reaches: it comes nearer by its height, and the rack's by a hand's breadth.
        pose = Pose((box.high[0] - 0.03 - FRONT, 0.5 * (box.low[1] + box.high[1]), 0.0))
        stations = common.pointing_down(torch.tensor([(forward, 0.0, up) for forward, up in STATIONS]))
        pose = held.furthest(robot, stations, pose)
        # From home some arms would push the door.
        start = torch.tensor([[pose.position[0] + FRONT - 0.12, pose.position[1], HINGE + REACH + 0.08]])
        return Scene(
            robots=(held.starting_at(robot, common.pointing_down(start)[0]),),
            objects=(dishwasher(THING, pose=pose), work_bench()),
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=(MarkerSpec("goal", MarkerShape.FRAME, size=0.1),),
            physics_dt=self.physics_dt,
        )

    def randomize(self) -> None:
        """The seal's force, the bars' friction and the fingers', the arm's gains, and noise on joints and bars."""
        seal = randomize.active_model(THING, "seal", "force", Range(0.6, 1.4))
        self.events.seal = EventTerm(seal, EventTime.STARTUP)
        friction = randomize.friction((common.ROBOT, THING), Range(0.4, 1.0))
        self.events.friction = EventTerm(friction, EventTime.STARTUP)
        self.events.gains = EventTerm(randomize.uncertain_gains(common.ROBOT), EventTime.STARTUP)
        noise = {"joint_positions": 0.005, "joint_velocities": 0.05, "hand_to_bars": 0.002}
        common.add_noise(self.observations.policy, **noise)

    def success(self, env: Environment) -> Tensor:
        return door_open(env) & (rack_lacks(env) < self.tolerance)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"door_lacks_rad": door_lacks(env), "rack_lacks_m": rack_lacks(env)}

    def expert(self, env: Environment) -> Expert:
        closing = common.closing_time(env.world)
        phases = (
            Phase(hook(DOOR_BAR, 0.12, -0.08), False, position_tolerance=0.05, dwell=closing, timeout=closing + 1.0),
            Phase(hook(DOOR_BAR, 0.08), False, position_tolerance=0.02, timeout=2.0),
            Phase(hook(DOOR_BAR), False, position_tolerance=0.008, timeout=1.5),
            Phase(pull_door, False, position_tolerance=0.03, rotation_tolerance=math.inf, timeout=3.0),
            Phase(hook(RACK_BAR, 0.14), False, position_tolerance=0.03, dwell=0.8, timeout=2.0),
            Phase(hook(RACK_BAR), False, position_tolerance=0.008, timeout=1.5),
            Phase(pull_rack, False),
        )
        return Expert(env, phases, position_lead=0.06)
