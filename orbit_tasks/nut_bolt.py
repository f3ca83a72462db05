"""Nut-Bolt: pick up a nut, set it on a bolt and screw it down."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import WOOD, box
from orbit_assets.threads import Thread, ThreadOptions, bolt_on_base, hexagonal_nut
from orbit_core.envs import Environment, EventTerm, ObservationTerm, PremiseTerm, RewardTerm, TerminationTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import POSE, TermFunction, once_per_state
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_core.scene import PhysicsMaterial, Pose, Scene
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import picking, premises, tabletop

# Metres: of M16, and of the finest lead and fit that fields of distances resolve.
RADIUS, COARSE, CLEARANCE = 0.008, 0.004, 4e-4
# Metres: of the bolt above its base, of the nut, and across the nut's flats.
LENGTH, HEIGHT, WIDTH = 0.032, 0.016, 0.04
# Metres of height of the bolt's base, and of the nut's stand.
BASE, STAND = 0.02, 0.03
OILED = PhysicsMaterial(0.1, 0.1)
# Metres above the nut's underside at which a hand holds it.
GRIP = 0.6 * HEIGHT
# Metres below itself to which the hand is led while it turns the nut.
PUSH = 1e-3
# Hand's turns, about, from which and to which it turns the nut: within the range of a Panda's wrist.
FROM, TO = math.radians(165.0), math.radians(-80.0)
# rad between them, and how far from there a hand takes the nut off its stand.
MIDDLE, REACH = 0.5 * (FROM + TO), 0.5 * (FROM - TO) - math.radians(10.0)
SIXTH = math.pi / 3.0
# rad by which the hand's turn is asked to go ahead; back, with open fingers, twice as far.
STRIDE = 0.4


@once_per_state
def nut_pose(env: Environment[NutBolt]) -> Tensor:
    """(N, 7) of the middle of the nut's underside."""
    return env.world.objects["nut"].root_pose


@once_per_state
def place(env: Environment[NutBolt]) -> Tensor:
    """(N, 3) where the nut's underside belongs: so many turns below where the bolt's thread begins."""
    up = torch.tensor([0.0, 0.0, BASE + LENGTH - (1.0 + env.task.turns) * env.task.lead], device=env.device)
    return env.world.objects["bolt"].root_pose[:, :3] + up


@once_per_state
def nut_to_place(env: Environment[NutBolt]) -> Tensor:
    """(N, 3) position of the nut's place minus the nut's, in the environment's axes."""
    return place(env) - nut_pose(env)[:, :3]


@once_per_state
def distance(env: Environment[NutBolt]) -> Tensor:
    """(N,) metres between the nut and its place on the bolt."""
    return vector_norm(nut_to_place(env), dim=1)


@once_per_state
def upright(env: Environment[NutBolt]) -> Tensor:
    """(N,) cosine of the nut's tilt."""
    return 1.0 - 2.0 * nut_pose(env)[:, 4:6].square().sum(dim=1)


def hand_to_nut(env: Environment[NutBolt]) -> Tensor:
    """(N, 3) from the hand to where it holds the nut."""
    return grasp(env)[:, :3] - common.hand_pose(env)[:, :3]


def aligned(env: Environment[NutBolt]) -> Tensor:
    """(N,) in [0, 1]: how near the nut is to the bolt's axis, once it is off its stand."""
    way, height = nut_to_place(env), nut_pose(env)[:, 2]
    return (height > STAND + 0.005) * common.nearness(vector_norm(way[:, :2], dim=1), 0.05)


def dropped(env: Environment[NutBolt]) -> Tensor:
    """(N,) the nut fell off its stand onto the table, either side up."""
    return nut_pose(env)[:, 2] + 0.5 * HEIGHT * upright(env) < BASE + 0.25 * HEIGHT


def place_things(env: Environment[NutBolt], env_ids: Tensor) -> None:
    """Bolt on the left, nut on its stand on the right, each up to 2 cm off its place; the nut turned by any angle."""
    low, high = common.workspace(env.world)
    x, y = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])
    most = torch.tensor([0.02, 0.02, 0.02, 0.02, math.pi], device=env.device)
    spread = most * env.world.random.uniform((5,), -1.0, 1.0, env_ids)
    middle = torch.tensor([x, y + 0.08, 0.0, 0.0], device=env.device).repeat(len(env_ids), 1)
    middle[:, :2] += spread[:, :2]
    env.world.objects["bolt"].set_root_pose(common.standing(middle), env_ids)
    middle[:, 0], middle[:, 1], middle[:, 2] = x + spread[:, 2], y - 0.08 + spread[:, 3], 0.5 * STAND
    env.world.objects["stand"].set_root_pose(common.standing(middle), env_ids)
    middle[:, 2], middle[:, 3] = STAND, spread[:, 4]
    env.world.objects["nut"].set_root_pose(common.standing(middle), env_ids)


def wound(yaw: Tensor) -> Tensor:
    """The same turns (N,), rad, at most half a turn from :data:`MIDDLE`."""
    return MIDDLE + common.wrapped(yaw - MIDDLE)


def hand_yaw(env: Environment[NutBolt]) -> Tensor:
    """(N,) rad, by which the hand is turned as :func:`common.facing_down` counts, :func:`wound`."""
    return wound(common.turn_facing_down(common.hand_pose(env)[:, 3:]))


def first_grasp(env: Environment[NutBolt]) -> Tensor:
    """(N, 7) the hand around the nut at those flats with which, turned from ``FROM`` on, its thread soonest meets the
    bolt's: those a sixth of a turn before its x axis, or the next ones that the wrist reaches."""  # fmt: skip
    target, nut = grasp(env), nut_pose(env)
    yaw = wound(2.0 * torch.atan2(nut[:, 6], nut[:, 3]) + SIXTH)
    for _ in range(2):
        yaw = torch.where((yaw - MIDDLE).abs() > REACH, wound(yaw - SIXTH), yaw)
    return torch.cat((target[:, :3], common.facing_down(yaw)), dim=1)


def grasp(env: Environment[NutBolt]) -> Tensor:
    """(N, 7) the hand around the nut, its fingers at two flats, turned as nearly as can be by ``FROM``."""
    nut = nut_pose(env)
    # The fingers open along the hand's y, and a corner is along the nut's x: flats are across its y.
    yaw = 2.0 * torch.atan2(nut[:, 6], nut[:, 3])
    yaw = yaw + SIXTH * torch.round((FROM - yaw) / SIXTH)
    position = nut[:, :3] + torch.tensor([0.0, 0.0, GRIP], device=env.device)
    return torch.cat((position, common.facing_down(yaw)), dim=1)


def carried(height: float) -> TermFunction:
    """(N, 7) the hand as it is turned, with the nut on the bolt's axis, so many metres above the bolt's top."""

    def pose(env: Environment[NutBolt]) -> Tensor:
        hand, nut = common.hand_pose(env), nut_pose(env)
        way = env.world.objects["bolt"].root_pose[:, :3] - nut[:, :3]
        way[:, 2] += BASE + LENGTH + height
        # Drives are slow to take away the last tenths of a millimetre: ask for three times as much.
        near = (vector_norm(way[:, :2], dim=1) < 0.01)[:, None]
        way[:, :2] = torch.where(near, 3.0 * way[:, :2], way[:, :2])
        yaw = (hand_yaw(env) + 2.0 * STRIDE).clamp_max(FROM)
        return torch.cat((hand[:, :3] + way, common.facing_down(yaw)), dim=1)

    return pose


def turning(env: Environment[NutBolt]) -> Tensor:
    """(N, 7) the hand turned on towards ``TO`` with the nut, which it presses down; as it is once that is done."""
    hand, yaw, way = common.hand_pose(env), hand_yaw(env), nut_to_place(env)
    done = way[:, 2] > -1e-4
    wanted = torch.where(done, yaw, torch.maximum(yaw - STRIDE, torch.full_like(yaw, TO).minimum(yaw)))
    position = torch.cat((hand[:, :2] + 3.0 * way[:, :2], (hand[:, 2] - PUSH * ~done)[:, None]), dim=1)
    return torch.cat((position, common.facing_down(wanted)), dim=1)


def held(env: Environment[NutBolt]) -> Tensor:
    """(N, 7) the hand at the nut, its fingers along those flats that need the least turn."""
    hand, target = hand_yaw(env), grasp(env)
    yaw = common.turn_facing_down(target[:, 3:])
    return torch.cat((target[:, :3], common.facing_down(yaw + SIXTH * torch.round((hand - yaw) / SIXTH))), dim=1)


def around(env: Environment[NutBolt]) -> Tensor:
    """(N, 7) the hand to where its fingers meet the nut's flats at once; else one would push it off its axis."""
    target, hand = held(env), common.hand_pose(env)
    way = target[:, :2] - hand[:, :2]
    near = (vector_norm(way, dim=1) < 0.01)[:, None]
    return torch.cat((torch.where(near, hand[:, :2] + 3.0 * way, target[:, :2]), target[:, 2:]), dim=1)


def turning_back(env: Environment[NutBolt]) -> Tensor:
    """(N, 7) the open hand around the nut, turned on towards its next grasp."""
    target, yaw = grasp(env), hand_yaw(env)
    goal = wound(common.turn_facing_down(target[:, 3:]))
    wanted = torch.where(goal > yaw, torch.minimum(yaw + 2.0 * STRIDE, goal), goal)
    return torch.cat((target[:, :3], common.facing_down(wanted)), dim=1)


@dataclass
class NutState(tabletop.ArmState):
    """The arm's joints and hand, the nut, the ways to it and on to its place, and the last action."""

    nut_pose: ObservationTerm | None = ObservationTerm(nut_pose, unit=POSE)
    hand_to_nut: ObservationTerm | None = ObservationTerm(hand_to_nut, unit="m")
    nut_to_place: ObservationTerm | None = ObservationTerm(nut_to_place, unit="m")
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class NutRewards:
    """Rewards of the hand at the nut, the nut over the bolt and at its place, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(lambda env: common.nearness(vector_norm(hand_to_nut(env), dim=1), 0.1), 1.0)
    """Nearness of the hand to the nut, within some 0.1 m."""
    align: RewardTerm | None = RewardTerm(aligned, 4.0)
    near: RewardTerm | None = RewardTerm(lambda env: common.nearness(distance(env), 0.1), 4.0)
    """Nearness of the nut to its place on the bolt, within some 0.1 m."""
    screw: RewardTerm | None = RewardTerm(lambda env: common.nearness(distance(env), 0.005), 20.0)
    """The same within 5 mm: what is left is turned down the thread."""
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-3)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-3)


@dataclass
class NutTerminations:
    """An episode ends early where the nut is dropped."""

    dropped: TerminationTerm | None = TerminationTerm(dropped)


@dataclass
class NutEvents(tabletop.ArmEvents):
    """Robot, bolt and nut are placed for each episode; friction and gains with domain randomisation."""

    place_things: EventTerm | None = EventTerm(place_things)


@dataclass
class NutPremises:
    """The nut is free of the bolt."""

    lying: PremiseTerm | None = PremiseTerm(
        lambda env: premises.standing(env.world, ("nut",), STAND),
        "the nut does not lie still and level on its stand",
    )


@dataclass(kw_only=True)
class NutBolt(tabletop.TabletopTask):
    """A nut rests on a stand next to a bolt, onto which it is to be screwed, ``turns`` down.

    Succeeds when at the episode's end the nut is upright and within ``tolerance`` of its place. Metric: that distance.
    """

    metadata: TaskMetadata = TaskMetadata(
        instruction="screw the nut onto the bolt",
        ppo=PpoSettings(iterations=3000, initial_std=0.3, entropy_weight=0.005),
        exceptions=(
            TaskException(
                TaskCheck.START_AREA, "bolt and stand need room for the hand to turn: each starts on 4 x 4 cm"
            ),
        ),
    )
    episode_length: float = 36.0
    turns: float = 2.0
    """By which the nut is to be screwed down, counted from where the bolt's thread begins: 0.25 to 3."""
    tolerance: float = 0.001
    """Metres: a quarter of a turn."""
    lead: float = COARSE
    """Metres by which a turn moves the nut: 0.004, or with threads of boxes down to M16's own 0.002."""
    thread: str = "field"
    """How threads collide: ``field``, by their distance fields, or ``boxes``, square ones that every engine has."""
    observations: tabletop.StateObservations = field(default_factory=tabletop.state(NutState))
    rewards: NutRewards = field(default_factory=NutRewards)
    terminations: NutTerminations = field(default_factory=NutTerminations)
    events: NutEvents = field(default_factory=NutEvents)
    premises: NutPremises = field(default_factory=NutPremises)

    @property
    def pieces(self) -> tuple[str, ...]:
        return ("nut",)

    def scene(self) -> Scene:
        self.bound(turns=(0.25, 3.0), tolerance=(1e-6, COARSE), lead=(0.002, COARSE))
        if self.thread not in ("field", "boxes"):
            raise ConfigurationError("field 'thread' of task Nut-Bolt must be 'field' or 'boxes'")
        if self.thread == "field" and self.lead < COARSE:
            raise ConfigurationError("fields of distances resolve no lead below 0.004: take thread=boxes in Nut-Bolt")
        thread = Thread(radius=RADIUS, lead=self.lead)
        metal = ThreadOptions(material=OILED, boxes=self.thread == "boxes")
        steel, brass = (0.55, 0.57, 0.6, 1.0), (0.8, 0.6, 0.2, 1.0)
        return self.bench(
            hexagonal_nut("nut", HEIGHT, WIDTH, thread, clearance=CLEARANCE, color=brass, **metal),
            bolt_on_base("bolt", LENGTH, thread, base=BASE, color=steel, **metal),
            box("stand", (0.024, 0.024, STAND), fixed_base=True, color=WOOD, pose=Pose((0.5, -0.1, 0.5 * STAND))),
        )

    def randomize(self) -> None:
        """The friction of nut and bolt, the arm's gains, and noise on joints and nut."""
        self.vary(("nut", "bolt"), (0.05, 0.15), nut_pose=0.0005)

    def success(self, env: Environment) -> Tensor:
        return (distance(env) < self.tolerance) & (upright(env) > 0.99)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"distance_m": distance(env)}

    def expert(self, env: Environment) -> Expert:
        closing = max(0.4, common.closing_time(env.world))
        let_go = Phase(common.hand_pose, dwell=0.3, timeout=0.4)
        turn = Phase(turning, False, position_tolerance=math.inf, rotation_tolerance=0.03, timeout=5.0)
        settle = Phase(around, position_tolerance=0.0006, rotation_tolerance=0.02, timeout=1.5)
        grip = Phase(held, False, dwell=closing, timeout=closing + 0.1)
        phases = [
            Phase(picking.raised(first_grasp, 0.1), position_tolerance=0.02, timeout=4.0, free=True),
            Phase(first_grasp, position_tolerance=0.0015, rotation_tolerance=0.03, timeout=2.5),
            settle,
            grip,
            Phase(picking.straight_up(0.15), False, position_tolerance=0.03, rotation_tolerance=math.inf, timeout=2.0),
            Phase(carried(0.02), False, position_tolerance=0.002, rotation_tolerance=0.03, timeout=5.0),
            Phase(carried(0.003), False, position_tolerance=0.0008, rotation_tolerance=0.02, timeout=2.5),
            Phase(carried(-COARSE), False, position_tolerance=0.0005, timeout=1.5),
            turn,
        ]
        next_flats = Phase(turning_back, position_tolerance=0.003, rotation_tolerance=0.03, timeout=4.0)
        phases += [let_go, next_flats, settle, grip, turn] * (math.ceil(self.turns / 0.6) + 1)
        return Expert(env, [*phases, let_go, Phase(picking.straight_up(0.2))], position_lead=0.06)
