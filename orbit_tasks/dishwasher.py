"""Dishwasher: open the door against its magnetic seal, then pull the rack out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import BENCH_HEIGHT, dishwasher, work_bench
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import EventTerm, EventTime, ObservationGroup, ObservationTerm, PremiseTerm, RewardTerm, Task
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task_checks import TaskCheck, TaskException
from orbit_core.envs.terms import Meaning, TermFunction, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common, randomize
from orbit_core.mdp.randomize import Range
from orbit_core.scene import MarkerShape, MarkerSpec, Pose, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import held

THING = "dishwasher"
DOOR_BAR, RACK_BAR = "door_bar", "rack_bar"
FRONT, HINGE, REACH = -0.2, 0.14, 0.27
"""Metres in the dishwasher's frame: the door's outer face, its hinge's height, and from the hinge to the door's bar."""
BEHIND, DEEP = 0.03, 0.015
"""Metres by which the hand's middle stands behind a bar that it pulls, and below its middle."""
LET_GO = 0.8
"""rad at which the hand lets go of the door: its weight opens it further."""
STATIONS = (
    (-0.27, 0.49), (-0.16, 0.47), (-0.16, 0.395), (-0.28, 0.38), (-0.38, 0.31),
    (-0.12, 0.45), (-0.12, 0.325), (-0.32, 0.325),
)  # fmt: skip
"""Metres forward and up in the dishwasher's frame: where the hand comes to, to within the phases' tolerances."""


@once_per_state
def door(world: World, task: Dishwasher) -> Tensor:
    """(N,) rad that the door is open."""
    return world.objects[THING].joint_positions[:, task.door]


@once_per_state
def rack(world: World, task: Dishwasher) -> Tensor:
    """(N,) metres that the rack is out."""
    return world.objects[THING].joint_positions[:, task.rack]


def joints(world: World, task: Dishwasher) -> Tensor:
    """(N, 2) positions of the door's hinge and of the rack's rail"""
    return torch.stack((door(world, task), rack(world, task)), dim=1)


@once_per_state
def door_lacks(world: World, task: Dishwasher) -> Tensor:
    """(N,) rad that the door is less open than it should be; zero where it is open wider."""
    return (task.door_goal - door(world, task)).clamp_min(0.0)


@once_per_state
def door_open(world: World, task: Dishwasher) -> Tensor:
    """(N,) bool"""
    return door_lacks(world, task) == 0.0


@once_per_state
def rack_lacks(world: World, task: Dishwasher) -> Tensor:
    """(N,) metres between the rack and where it should be; while the door is not open, all of the way."""
    return torch.where(door_open(world, task), (task.goal - rack(world, task)).abs(), task.goal)


@once_per_state
def bars(world: World, task: Dishwasher) -> Tensor:
    """(N, 2, 3) of the middles of the door's bar and the rack's."""
    thing = world.objects[THING]
    return torch.stack([thing.frame_pose(name)[:, :3] for name in (DOOR_BAR, RACK_BAR)], dim=1)


def hand_to_bars(world: World, task: Dishwasher) -> Tensor:
    """(N, 2, 3) positions of the door's and the rack's bars minus the hand's, in the environment's axes."""
    return bars(world, task) - common.hand_pose(world, task)[:, None, :3]


def inward(world: World, task: Dishwasher) -> Tensor:
    """(N, 3) unit vector from the front into the dishwasher."""
    turn = world.objects[THING].root_pose[:, 3:]
    return quat_rotate(turn, torch.eye(3, device=world.device)[0].expand(world.num_envs, 3))


def reaching(world: World, task: Dishwasher) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to behind the bar that is to be pulled next."""
    behind = torch.stack((hook(DOOR_BAR)(world, task), hook(RACK_BAR)(world, task)), dim=1)[..., :3]
    distance = vector_norm(behind - common.hand_pose(world, task)[:, None, :3], dim=2)
    return common.nearness(torch.where(door_open(world, task), distance[:, 1], distance[:, 0]), 0.15)


def place(world: World, task: Dishwasher, env_ids: Tensor) -> None:
    """Place the dishwasher up to 2 cm nearer or further, 4 cm to either side, turned by up to 0.1 rad."""
    u = 2.0 * world.random.uniform((3,), env_ids=env_ids) - 1.0
    thing = world.objects[THING]
    x, y, z = thing.spec.pose.position
    where = torch.stack((x + 0.02 * u[:, 0], y + 0.04 * u[:, 1], torch.full_like(u[:, 0], z), 0.1 * u[:, 2]), dim=1)
    thing.set_root_pose(common.standing(where), env_ids)


def sample_goal(world: World, task: Dishwasher, env_ids: Tensor) -> None:
    """The rack 12 to 20 cm out; a marker shows where its bar is then."""
    task.goal[env_ids] = world.random.uniform((), 0.12, 0.2, env_ids)
    bar = world.objects[THING].frame_pose(RACK_BAR)[env_ids]
    out = inward(world, task)[env_ids] * task.goal[env_ids, None]
    world.markers["goal"].set_pose(torch.cat((bar[:, :3] - out, bar[:, 3:]), dim=1), env_ids)


def hook(bar: str, height: float = -DEEP, behind: float = BEHIND) -> TermFunction:
    """(N, 7) the hand behind a bar, ``height`` metres above it."""

    def pose(world: World, task: Dishwasher) -> Tensor:
        position = world.objects[THING].frame_pose(bar)[:, :3] + behind * inward(world, task)
        return _down(world, task, position, height)

    return pose


def pull_door(world: World, task: Dishwasher) -> Tensor:
    """(N, 7) the hand a little further on the bar's way than the door is open, and no further than to let go."""
    thing, into = world.objects[THING], inward(world, task)
    angle = (door(world, task) + 0.25).clamp(max=LET_GO + 0.05)[:, None]
    up = torch.eye(3, device=world.device)[2]
    hinge = thing.root_pose[:, :3] + FRONT * into + HINGE * up
    # The bar lies 9 mm behind the plane of the hinge.
    bar = hinge + (0.009 * angle.cos() - REACH * angle.sin()) * into + (REACH * angle.cos() + 0.009 * angle.sin()) * up
    return _down(world, task, bar + 0.5 * BEHIND * into, -DEEP)


def pull_rack(world: World, task: Dishwasher) -> Tensor:
    """(N, 7) the hand moved by what the rack lacks, however the bar lies at it."""
    hand, bar = common.hand_pose(world, task)[:, :3], bars(world, task)[:, 1]
    position = hand - (task.goal - rack(world, task))[:, None] * inward(world, task)
    return _down(world, task, torch.cat((position[:, :2], bar[:, 2:]), dim=1), -DEEP)


def _down(world: World, task: Dishwasher, position: Tensor, height: float) -> Tensor:
    """(N, 7) the hand that points down, turned as the dishwasher is."""
    yaw = 2.0 * torch.atan2(*world.objects[THING].root_pose[:, [6, 3]].unbind(1))
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
        lambda world, task: task.goal[:, None], unit="m", meaning=Meaning("travel that the rack is to have")
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class DishwasherObservations:
    """Policy and critic see the state."""

    policy: DishwasherState = field(default_factory=DishwasherState)
    critic: ObservationGroup | None = None


@dataclass
class DishwasherRewards:
    """Rewards of the hand at the next bar, the door open, the rack at its goal, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    open: RewardTerm | None = RewardTerm(lambda world, task: 1.0 - door_lacks(world, task) / task.door_goal, 4.0)
    pull: RewardTerm | None = RewardTerm(lambda world, task: 1.0 - rack_lacks(world, task) / task.goal, 8.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-3)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-3)


@dataclass
class DishwasherTerminations:
    """Only the time limit ends an episode."""


@dataclass
class DishwasherEvents:
    """Robot, dishwasher and goal are placed anew for each episode; seal, friction, gains with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place: EventTerm | None = EventTerm(place)
    sample_goal: EventTerm | None = EventTerm(sample_goal)
    seal: EventTerm | None = None
    friction: EventTerm | None = None
    gains: EventTerm | None = None


@dataclass
class DishwasherPremises:
    """It is shut."""

    shut: PremiseTerm | None = PremiseTerm(
        lambda world, task: (joints(world, task).abs() < 0.01).all(1),
        "the door is ajar or the rack has slid out, so that the seal does not hold, or something pushes them",
    )


@dataclass(kw_only=True)
class Dishwasher(Task):
    """A small dishwasher stands before the robot. Its door is to be pulled off its magnetic seal, then its rack out.

    Succeeds when at the episode's end the door is open by ``door_goal`` at least, and the rack within ``tolerance`` of
    its goal. Metrics: what door and rack lack, in that order: while the door is not open, the rack lacks all.
    """

    exceptions: ClassVar[tuple[TaskException, ...]] = (
        TaskException(TaskCheck.START_AREA, "door and rack travel through most of the arm's reach"),
        TaskException(TaskCheck.START_YAW, "the door must open towards the arm to stay in reach"),
    )
    robot: str = "franka_panda"
    action: str = "joint_position"
    episode_length: float = 10.0
    ppo: PpoSettings = PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005)
    view: Pose = look_at(eye=(-0.2, 1.35, 0.95), target=(0.6, 0.0, 0.2))
    door_goal: float = 1.3
    """rad"""
    tolerance: float = 0.02
    """Metres."""
    observations: DishwasherObservations = field(default_factory=DishwasherObservations)
    rewards: DishwasherRewards = field(default_factory=DishwasherRewards)
    terminations: DishwasherTerminations = field(default_factory=DishwasherTerminations)
    events: DishwasherEvents = field(default_factory=DishwasherEvents)
    premises: DishwasherPremises = field(default_factory=DishwasherPremises)
    goal: Tensor = field(init=False)
    """(N,) metres that the rack is to be out."""
    door: int = field(init=False, default=0)
    rack: int = field(init=False, default=1)
    """Indices of the joints."""

    def scene(self) -> Scene:
        self.bound(door_goal=(0.1, 1.45), tolerance=(1e-6, 0.1))
        robot = common.arm(self.robot)
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

    def start(self, world: World) -> None:
        super().start(world)
        self.goal = torch.zeros(world.num_envs, device=world.device)
        self.door, self.rack = world.objects[THING].find_joints("door_joint", "rack_joint")

    def randomize(self) -> None:
        """The seal's force, the bars' friction and the fingers', the arm's gains, and noise on joints and bars."""
        seal = randomize.active_model(THING, "seal", "force", Range(0.6, 1.4))
        self.events.seal = EventTerm(seal, EventTime.STARTUP)
        friction = randomize.friction((common.ROBOT, THING), Range(0.4, 1.0))
        self.events.friction = EventTerm(friction, EventTime.STARTUP)
        self.events.gains = EventTerm(randomize.uncertain_gains(common.ROBOT), EventTime.STARTUP)
        noise = {"joint_positions": 0.005, "joint_velocities": 0.05, "hand_to_bars": 0.002}
        common.add_noise(self.observations.policy, **noise)

    def success(self, world: World) -> Tensor:
        return door_open(world, self) & (rack_lacks(world, self) < self.tolerance)

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {"door_lacks_rad": door_lacks(world, self), "rack_lacks_m": rack_lacks(world, self)}

    def expert(self, world: World) -> Expert:
        closing = common.closing_time(world)
        phases = (
            Phase(hook(DOOR_BAR, 0.12, -0.08), False, position_tolerance=0.05, dwell=closing, timeout=closing + 1.0),
            Phase(hook(DOOR_BAR, 0.08), False, position_tolerance=0.02, timeout=2.0),
            Phase(hook(DOOR_BAR), False, position_tolerance=0.008, timeout=1.5),
            Phase(pull_door, False, position_tolerance=0.03, rotation_tolerance=math.inf, timeout=3.0),
            Phase(hook(RACK_BAR, 0.14), False, position_tolerance=0.03, dwell=0.8, timeout=2.0),
            Phase(hook(RACK_BAR), False, position_tolerance=0.008, timeout=1.5),
            Phase(pull_rack, False),
        )
        return Expert(world, self, phases, position_lead=0.06)
