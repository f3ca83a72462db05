"""Handover: one arm passes a rod to another, which brings it to a sampled position."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import BENCH_HEIGHT, box, table
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import (
    CommandTerm,
    Environment,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, POSE, Bounds, Meaning, TermFunction, measured_in, once_per_state
from orbit_core.mdp import common, randomize
from orbit_core.mdp.commands import UniformPositionCommand, generated_command
from orbit_core.mdp.randomize import Range
from orbit_core.scene import MarkerShape, MarkerSpec, Pose, Scene, look_at
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import picking, tabletop

GIVER, RECEIVER = "giver", "receiver"
# Metres, of the rod.
LENGTH, WIDTH = 0.24, 0.03
# Metres from the rod's middle to where a hand holds it: the giver the end on its own side, the receiver the other.
GRIP = 0.065
SIDES = {GIVER: -1.0, RECEIVER: 1.0}
# Metres above the table at which the rod is passed on, in the middle between the arms.
HEIGHT = 0.25


class HandoverMemory(tabletop.TabletopMemory):
    """State of a handover: the place of the handover, and how near the rod was to it."""

    place: Tensor
    """(N, 3) where the rod is passed on."""
    along: Tensor
    """(3,) the rod's length, in its own frame."""
    nearest: Tensor = buffer(initial=torch.inf)
    """(N,) metres, the least distance in the episode between the rod and that place."""

    def start(self, env: Environment[Handover]) -> None:
        super().start(env)
        self.along = torch.tensor([1.0, 0.0, 0.0], device=env.device)
        # Half-way between the arms, which both reach.
        middle = torch.tensor([0.5 * env.task.spacing, 0.0, HEIGHT], device=env.device)
        self.place = middle.repeat(env.num_envs, 1)

    def update(self, env: Environment[Handover]) -> None:
        self.nearest.copy_(torch.minimum(self.nearest, place_distance(env)))


@measured_in(POSE)
def rod_pose(env: Environment[Handover]) -> Tensor:
    """(N, 7) pose of the rod in the environment's frame."""
    return env.world.objects["rod"].root_pose


@once_per_state
def rod_direction(env: Environment[Handover, HandoverMemory]) -> Tensor:
    """(N, 3) unit vector along the rod, from the giver's side to the receiver's."""
    along = quat_rotate(rod_pose(env)[:, 3:], env.state.along)
    # A rod has no front: its direction is chosen so that each arm always takes the same end.
    return torch.where(along[:, :1] < 0.0, -along, along)


@once_per_state
def grip(env: Environment[Handover], agent: str) -> Tensor:
    """(N, 3) where that agent holds the rod."""
    return rod_pose(env)[:, :3] + SIDES[agent] * GRIP * rod_direction(env)


@measured_in("m")
@once_per_state
def hand_to_grip(env: Environment[Handover], agent: str) -> Tensor:
    """(N, 3) from that agent's hand to where it holds the rod."""
    return grip(env, agent) - common.hand_position(env, agent)


@once_per_state
def goal_distance(env: Environment[Handover]) -> Tensor:
    """(N,) between rod and goal."""
    return vector_norm(env.commands["goal"] - rod_pose(env)[:, :3], dim=1)


@once_per_state
def place_distance(env: Environment[Handover, HandoverMemory]) -> Tensor:
    """(N,) between the rod and the place where it is passed on."""
    return vector_norm(env.state.place - rod_pose(env)[:, :3], dim=1)


@once_per_state
def lifted(env: Environment[Handover]) -> Tensor:
    """(N,) 1 where the rod is off the table, else 0."""
    return (rod_pose(env)[:, 2] > 1.5 * WIDTH).float()


@once_per_state
def received(env: Environment[Handover]) -> Tensor:
    """(N,) 1 where the rod is off the table and beyond the middle, where the receiver alone can have brought it."""
    # By a grip beyond the middle, where the giver's hand would have to be past the place of the handover.
    beyond = rod_pose(env)[:, 0] > 0.5 * env.task.spacing + GRIP
    # Off the table as well, because a rod that was pushed across has not been handed over.
    return lifted(env) * beyond.float()


def reaching(env: Environment[Handover], agent: str) -> Tensor:
    """(N,) in [0, 1]: how near that agent's hand is to where it holds the rod; for the giver, 1 once it has given."""
    near = common.nearness(vector_norm(hand_to_grip(env, agent), dim=1), 0.1)
    # The giver keeps its reward once it has given; otherwise it would hold on to the rod.
    return torch.maximum(near, received(env)) if agent == GIVER else near * lifted(env)


def offering(env: Environment[Handover], agent: str) -> Tensor:
    """(N,) in [0, 1]: how near the lifted rod is to where it is passed on; 1 once it has been."""
    return torch.maximum(lifted(env) * common.nearness(place_distance(env), 0.2), received(env))


def tracking(env: Environment[Handover], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the lifted rod is to the goal."""
    # Counts once it is lifted: a rod that is pushed across the table comes nearer as well.
    return lifted(env) * common.nearness(goal_distance(env), scale)


@dataclass(unsafe_hash=True, kw_only=True)
class HandoverGoal(UniformPositionCommand):
    """Position 15 to 35 cm above an 8 x 40 cm patch before the receiver."""

    def reach(self, env: Environment[Handover]) -> dict[str, Bounds]:
        spacing = env.task.spacing
        return {"x": (spacing - 0.43, spacing - 0.35), "y": (-0.2, 0.2), "z": (0.15, 0.35)}


def around_rod(agent: str) -> TermFunction:
    """(N, 7) that agent's hand around its end of the rod, pointing down."""

    def target(env: Environment[Handover]) -> Tensor:
        direction = rod_direction(env)
        yaw = torch.atan2(direction[:, 1], direction[:, 0])
        return torch.cat((grip(env, agent), _facing_down(agent, yaw)), dim=1)

    return target


def beside_place(agent: str, back: float, height: float) -> TermFunction:
    """(N, 7) that agent's hand above its side of the place where the rod is passed on, and behind by ``back``."""

    def target(env: Environment[Handover, HandoverMemory]) -> Tensor:
        position = env.state.place + torch.tensor([SIDES[agent] * (GRIP + back), 0.0, height], device=env.device)
        return torch.cat((position, _facing_down(agent, torch.zeros_like(position[:, 0]))), dim=1)

    return target


def carried(agent: str, goal: TermFunction) -> TermFunction:
    """(N, 7) that agent's hand where the rod's middle is at a goal (N, 3), as the rod sits in the hand now."""

    def target(env: Environment[Handover]) -> Tensor:
        wanted = goal(env)
        position = wanted + common.hand_position(env, agent) - rod_pose(env)[:, :3]
        return torch.cat((position, _facing_down(agent, torch.zeros_like(wanted[:, 0]))), dim=1)

    return target


def _facing_down(agent: str, yaw: Tensor) -> Tensor:
    """(N, 4) that agent's hand pointing down, its fingers opening across a rod at ``yaw`` (N,)."""
    return common.facing_down(yaw if agent == GIVER else yaw + math.pi)


@dataclass
class HandoverState(ObservationGroup):
    """Both arms' joints, their hands to the rod, their last actions, the rod's pose and the goal."""

    giver_joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions, agent=GIVER)
    giver_joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities, agent=GIVER)
    giver_to_grip: ObservationTerm | None = ObservationTerm(hand_to_grip, agent=GIVER)
    giver_last_action: ObservationTerm | None = ObservationTerm(common.last_action, agent=GIVER)
    receiver_joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions, agent=RECEIVER)
    receiver_joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities, agent=RECEIVER)
    receiver_to_grip: ObservationTerm | None = ObservationTerm(hand_to_grip, agent=RECEIVER)
    receiver_last_action: ObservationTerm | None = ObservationTerm(common.last_action, agent=RECEIVER)
    rod_pose: ObservationTerm | None = ObservationTerm(rod_pose)
    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"),
        unit="m",
        meaning=Meaning("position that the rod is to be brought to", ENVIRONMENT),
    )


@dataclass
class HandoverRewards:
    """Rewards of each arm for its own part, and of both for the rod at the goal, less what is fast or abrupt."""

    giver_reach: RewardTerm | None = RewardTerm(reaching, 1.0, agent=GIVER)
    giver_offer: RewardTerm | None = RewardTerm(offering, 8.0, agent=GIVER)
    giver_action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4, agent=GIVER)
    giver_joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4, agent=GIVER)
    receiver_reach: RewardTerm | None = RewardTerm(reaching, 4.0, agent=RECEIVER)
    receiver_action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4, agent=RECEIVER)
    receiver_joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4, agent=RECEIVER)
    lift: RewardTerm | None = RewardTerm(lifted, 4.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 16.0)
    """Nearness of the lifted rod to the goal, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    """The same within 0.05 m, which decides the last centimetres."""


@dataclass
class HandoverCommands:
    """The position that the rod is to be brought to."""

    goal: CommandTerm | None = HandoverGoal(marker="goal")


@dataclass
class HandoverEvents:
    """Arms and rod are placed for each episode; masses and the like with domain randomisation."""

    place_giver: EventTerm | None = EventTerm(common.randomize_robot_start(0.05, GIVER))
    place_receiver: EventTerm | None = EventTerm(common.randomize_robot_start(0.05, RECEIVER))
    place_rod: EventTerm | None = EventTerm(
        common.place_object("rod", x=(0.37, 0.47), y=(-0.2, 0.2), z=0.5 * WIDTH, yaw=(-0.5, 0.5))
    )  # on a patch that only the giver reaches
    rod_mass: EventTerm | None = None
    """Mass of the rod, drawn for each environment; set by domain randomisation."""
    friction: EventTerm | None = None
    """Friction of both hands, rod and table; set by domain randomisation."""
    giver_gains: EventTerm | None = None
    """Scales of the giver's stiffness and damping; set by domain randomisation."""
    receiver_gains: EventTerm | None = None
    """Scales of the receiver's stiffness and damping; set by domain randomisation."""


@dataclass(kw_only=True)
class Handover(tabletop.TabletopTask):
    """Two arms face each other across a table. The rod starts where only the giver reaches it, the goal hangs where
    only the receiver does.

    Succeeds when the rod's middle is within ``tolerance`` of the goal at the episode's end. Metrics: that distance, the
    receiver's to close, and the least between the rod and the place where it is passed on, the giver's."""  # fmt: skip

    state_type: ClassVar[type[TaskState]] = HandoverMemory
    renamed: ClassVar[Mapping[str, str]] = {"events.sample_goal": "commands.goal"}
    metadata: TaskMetadata = TaskMetadata(
        instruction="hand the object over to the other hand",
        ppo=PpoSettings(iterations=2000, initial_std=0.3, entropy_weight=0.005),
        view=look_at(eye=(0.75, 1.9, 0.95), target=(0.75, 0.0, 0.2)),
        exceptions=(TaskException(TaskCheck.START_YAW, "the rod must lie across for both arms to reach an end each"),),
    )
    agents: ClassVar[tuple[str, ...]] = (GIVER, RECEIVER)
    robot: str = "franka_panda"
    """Name of both arms in the catalogue."""
    episode_length: float = 8.0
    spacing: float = 1.5
    """Metres between the arms' bases. A Franka Panda reaches 0.95 m from its shoulder: not to the rod's start from the
    receiver's side, nor to the goal from the giver's."""
    rod_mass: float = 0.04
    """Kilograms."""
    tolerance: float = 0.03
    """Metres."""
    observations: tabletop.StateObservations = field(default_factory=tabletop.state(HandoverState))
    rewards: HandoverRewards = field(default_factory=HandoverRewards)
    terminations: tabletop.DropTerminations = field(default_factory=tabletop.DropTerminations)
    events: HandoverEvents = field(default_factory=HandoverEvents)
    commands: HandoverCommands = field(default_factory=HandoverCommands)

    @property
    def pieces(self) -> tuple[str, ...]:
        return ("rod",)

    def scene(self) -> Scene:
        self.bound(spacing=(1.0, 2.0), tolerance=(1e-6, 0.1))
        start = Pose((0.42, 0.0, 0.5 * WIDTH))
        rod = box("rod", size=(LENGTH, WIDTH, WIDTH), mass=self.rod_mass, pose=start, color=(0.8, 0.2, 0.15, 1.0))
        middle = Pose((0.5 * self.spacing, 0.0, 0.0))
        bench = table("table", size=(self.spacing + 0.6, 1.4, BENCH_HEIGHT), pose=middle)
        facing_giver = Pose((self.spacing, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        return Scene(
            robots=(
                task_robots.arm(self.robot, agent=GIVER),
                task_robots.arm(self.robot, agent=RECEIVER, pose=facing_giver),
            ),
            objects=(rod, bench),
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=(MarkerSpec("goal", MarkerShape.SPHERE, size=0.03),),
            physics_dt=self.physics_dt,
        )

    def randomize(self) -> None:
        """The rod's mass, its friction and the fingers', the arms' gains, and noise on joints and rod."""
        self.events.rod_mass = EventTerm(randomize.masses("rod", Range(0.5, 2.0)), EventTime.STARTUP)
        friction = randomize.friction((*self.agents, "rod", "table"), Range(0.5, 1.2))
        self.events.friction = EventTerm(friction, EventTime.STARTUP)
        self.events.giver_gains = EventTerm(randomize.uncertain_gains(GIVER), EventTime.STARTUP)
        self.events.receiver_gains = EventTerm(randomize.uncertain_gains(RECEIVER), EventTime.STARTUP)
        for agent in self.agents:
            noise = {f"{agent}_joint_positions": 0.005, f"{agent}_joint_velocities": 0.05}
            common.add_noise(self.observations.policy, rod_pose=0.002, **noise)

    def success(self, env: Environment) -> Tensor:
        return goal_distance(env) < self.tolerance

    def metrics(self, env: Environment[Any, HandoverMemory]) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(env), "handover_distance_m": env.state.nearest}

    def expert(self, env: Environment[Any, HandoverMemory]) -> Expert:
        ready = Phase(beside_place(RECEIVER, back=0.05, height=0.12))
        wait = Phase(ready.target, position_tolerance=math.inf, rotation_tolerance=math.inf)
        offer = Phase(carried(GIVER, lambda env: env.state.place), gripper_open=False, position_tolerance=0.02)
        hold = Phase(offer.target, False, position_tolerance=math.inf, rotation_tolerance=math.inf)
        keep = Phase(around_rod(RECEIVER), False, position_tolerance=math.inf, rotation_tolerance=math.inf)
        back_off = Phase(beside_place(GIVER, back=0.1, height=0.15), position_tolerance=0.05, timeout=1.5)
        steps = (
            (Phase(picking.raised(around_rod(GIVER), 0.1), position_tolerance=0.02), wait),
            (Phase(around_rod(GIVER), position_tolerance=0.006, timeout=1.5), wait),
            (Phase(around_rod(GIVER), gripper_open=False, dwell=0.4, timeout=0.5), wait),
            (offer, ready),
            (hold, Phase(around_rod(RECEIVER), position_tolerance=0.006, timeout=1.5)),
            (hold, Phase(around_rod(RECEIVER), gripper_open=False, dwell=0.4, timeout=0.5)),
            (Phase(around_rod(GIVER), dwell=0.3, timeout=0.4), keep),
            (back_off, keep),
            (back_off, Phase(carried(RECEIVER, generated_command("goal")), gripper_open=False)),
        )
        phases = {agent: [pair[index] for pair in steps] for index, agent in enumerate(self.agents)}
        return Expert(env, phases)
