"""Cloth-Folding: take a corner of a flat cloth and lay it on the opposite one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import Environment, EventTerm, ObservationGroup, RewardTerm
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import ROBOT, TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import TermFunction, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import PhysicsMaterial, Scene, look_at
from orbit_motion.experts import Expert, Phase, Retry
from orbit_tasks import cloth
from orbit_tasks.cloth import CLOTH, TRAY
from orbit_tasks.mdp import matter

# Key points that the fold along the other diagonal lays on each other; the first is taken.
PAIRS = (("corner--", "corner++"), ("side-", "back"), ("front", "side+"))
# Of the tray, as of a rubber mat: the lower half stays in place while the other is carried over it.
MAT = PhysicsMaterial(static_friction=1.0, dynamic_friction=1.0)
# Metres by which the hand's way over the fold ends short of its mirror image: cloth drawn tight would draw the fold
# along. Where the hand lets go it looks where the sides are.
SHORT = 0.03
# Metres at most that it then goes off that end.
ASTRAY = 0.05
# Metres below the tray's top to which the open fingers are sent: hardly, for a mat would hold them by its friction.
# Those that close on arcs are not sent below it: a stiff arm would jam them when they are 0.7 closed.
PRESSED = 0.001
# m/s of the hand. Twice as fast, as an arm of stiffer drives is with the same lead, the cloth swings on.
SPEED = 0.2
# Metres, at least and at most, by which commands lead the hand for that.
LEADS = (0.01, 0.04)
# Metres above the tray's top of the finger tips that open.
LOW = 0.03
# Metres above the tray's top of the tips of open fingers at both ends of the way over the fold.
CLEAR = 0.02
# Height of the hand's way over the fold, in parts of its half width: a full arc draws the lower half along.
ARC = 0.5
# On that way, from the tray to the tray again.
ANGLES = tuple(math.radians(degrees) for degrees in (25, 50, 75, 100, 125, 150))
# m/s of the cloth's particles at most, root mean square, that count as rest.
AT_REST = 0.02


class FoldMemory(TaskState):
    """State of a fold: the cloth's place when the episode began."""

    fold: Tensor = buffer(3)
    """(N, 3) where the cloth's middle was, in the environment's frame."""
    ahead: Tensor = buffer(3)
    """(N, 3) unit vector from the corner that is taken to the one opposite."""


@once_per_state
def pair_distances(env: Environment[ClothFolding]) -> Tensor:
    """(N, 3) metres between the key points of each pair."""
    thing = env.world.deformables[CLOTH]
    apart = [thing.key_point(one) - thing.key_point(other) for one, other in PAIRS]
    return vector_norm(torch.stack(apart, dim=1), dim=2)


@once_per_state
def distance(env: Environment[ClothFolding]) -> Tensor:
    """(N,) metres: the sum over pairs."""
    return pair_distances(env).sum(1)


def remember_fold(env: Environment[ClothFolding, FoldMemory], env_ids: Tensor) -> None:
    """Note where the cloth is to be folded, and which way: at its middle, away from the corner that is taken."""
    thing = env.world.deformables[CLOTH]
    one, other = (thing.key_point(name)[env_ids] for name in PAIRS[0])
    env.state.fold[env_ids] = 0.5 * (one + other)
    env.state.ahead[env_ids] = (other - one) / vector_norm(other - one, dim=1, keepdim=True)


@once_per_state
def at_rest(env: Environment[ClothFolding]) -> Tensor:
    """(N,) bool: True where the cloth is still."""
    return env.world.deformables[CLOTH].velocities.square().sum(2).mean(1) < AT_REST**2


def hand_at(env: Environment[ClothFolding, FoldMemory], position: Tensor, height: float | Tensor) -> Tensor:
    """(N, 7) the hand pointing down over a position (N, 3), at a height or heights (N,), across the diagonal.

    So both fingers are next to the cloth near its corner, and drag none of it along the mat as they close.
    """
    yaw = torch.atan2(env.state.ahead[:, 1], env.state.ahead[:, 0]) - math.pi
    return torch.cat((cloth.at_height(position, height)[:, :3], common.facing_down(yaw)), dim=1)


def half_diagonal(env: Environment[ClothFolding]) -> float:
    """Metres from the fold to a corner."""
    return 0.5 * math.sqrt(2.0) * env.task.size


def lead(world: World) -> float:
    """Return the metres by which commands lead the hand for it to go at :data:`SPEED`.

    A damped drive follows a lead at ``lead * stiffness / damping``, which is 5 1/s for a Panda and 13 1/s for a UR10.
    """
    robot = world.robots[ROBOT]
    arm = set(robot.find_joints(*robot.spec.end_effector.arm_joints))
    drives = [drive for drive in robot.spec.actuators if arm & set(robot.find_joints(*drive.joints))]
    lags = [drive.damping / drive.stiffness for drive in drives if drive.stiffness > 0.0]
    least, most = LEADS
    return min(most, max(least, SPEED * max(lags, default=math.inf)))


def at_corner(height: float, depth: float) -> TermFunction:
    """Term: (N, 7) the hand around the cloth, at a height, ``depth`` metres from the corner's tip."""

    def pose(env: Environment[ClothFolding, FoldMemory]) -> Tensor:
        corner = env.world.deformables[CLOTH].key_point(PAIRS[0][0])
        return hand_at(env, corner + depth * env.state.ahead, height)

    return pose


def always(height: float) -> TermFunction:
    """Term: (N,) that height, in metres."""
    return lambda env: torch.full((env.num_envs,), height, device=env.device)


def here(height: TermFunction) -> TermFunction:
    """Term: (N, 7) the hand where it is, at heights (N,) that a term gives."""
    return lambda env: hand_at(env, common.hand_pose(env)[:, :3], height(env))


def over_fold(angle: float, base: float, depth: float) -> TermFunction:
    """Term: (N, 7) the hand on its way over the fold.

    Args:
        angle: rad along the way.
        base: metres of the hand's height at both ends.
        depth: metres from the corner's tip to the hand.
    """

    def pose(env: Environment[ClothFolding, FoldMemory]) -> Tensor:
        radius = half_diagonal(env) - depth - SHORT * 0.5 * (1.0 - math.cos(angle))
        height = base + ARC * radius * math.sin(angle)
        return hand_at(env, env.state.fold - env.state.ahead * (radius * math.cos(angle)), height)

    return pose


@once_per_state
def overshot(env: Environment[ClothFolding, FoldMemory]) -> Tensor:
    """(N,) metres, mean of both sides, that the folded half is beyond its place."""
    thing = env.world.deformables[CLOTH]
    apart = [thing.key_point(one) - thing.key_point(other) for one, other in PAIRS[1:]]
    return (torch.stack(apart).mean(0) * env.state.ahead).sum(1)


def at_place(height: float, depth: float) -> TermFunction:
    """Term: (N, 7) the hand where the folded half is in its place, at a height, ``depth`` metres from the corner."""

    def pose(env: Environment[ClothFolding, FoldMemory]) -> Tensor:
        end = half_diagonal(env) - depth - SHORT
        along = ((common.hand_pose(env)[:, :3] - env.state.fold) * env.state.ahead).sum(1) - overshot(env)
        along = along.clamp(end - ASTRAY, end + ASTRAY)
        return hand_at(env, env.state.fold + env.state.ahead * along[:, None], height)

    return pose


def taken(env: Environment[ClothFolding]) -> Tensor:
    """(N,) bool: whether the corner is 1 cm above the tray."""
    return env.world.deformables[CLOTH].key_point(PAIRS[0][0])[:, 2] > TRAY + 0.01


@dataclass
class ClothFoldingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: cloth.ClothState = field(default_factory=cloth.ClothState)
    critic: ObservationGroup | None = None


@dataclass
class ClothFoldingRewards(cloth.Smoothness):
    """Rewards of the hand at the corner and of pairs that lie on each other, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(cloth.reaching(PAIRS[0][0]), 1.0)
    fold: RewardTerm | None = RewardTerm(lambda env: common.nearness(distance(env), 0.4), 10.0)
    """Nearness of the points that are to meet, by the sum over pairs, within some 0.4 m."""
    fold_finely: RewardTerm | None = RewardTerm(lambda env: common.nearness(distance(env), 0.1), 10.0)
    """The same within 0.1 m, which decides the last centimetres."""


@dataclass
class ClothFoldingEvents:
    """Robot and cloth are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cloth: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.04, 0.04), 0.3))
    remember_fold: EventTerm | None = EventTerm(remember_fold)


@dataclass(kw_only=True)
class ClothFolding(cloth.ClothTask):
    """The cloth is flat on a mat, up to 4 cm off its place each way and turned by up to 0.3 rad.

    Succeeds when the key points of each of three pairs, which the fold along the diagonal lays on each other, are
    within ``tolerance`` sides of each other, the cloth is at rest and the gripper does not touch it at the episode's
    end. Metric: the sum of the three distances; layers of cloth that touch are 8 mm apart.
    """

    state_type: ClassVar[type[TaskState]] = FoldMemory
    metadata: TaskMetadata = replace(
        cloth.ClothTask.metadata,
        view=look_at(eye=(1.2, 0.3, 0.55), target=(0.5, 0.0, 0.05)),
        expert_success=0.6,
        exceptions=(
            TaskException(
                TaskCheck.START_AREA, "the cloth must lie within reach, corner to corner: it starts on 64 cm²"
            ),
            TaskException(TaskCheck.START_YAW, "deformables are sampled by their middle, which has no yaw"),
        ),
    )
    episode_length: float = 8.0
    size: float = 0.24
    particles: int = 25
    """Along each side."""
    area_density: float = 0.3
    """kg/m^2: a heavy cotton towel."""
    bending_stiffness: float = 5e-6
    """N m, of soft cotton. Its bending length, the third root of stiffness by weight per area, is 12 mm, far below
    the fold's 17 cm, so that the fold does not roll open."""
    tolerance: float = 0.15
    """Of the cloth's side, that the two key points of a pair may be apart."""
    taken: float = 0.018
    """Metres from the corner's tip, along the diagonal, to the expert's hand that takes it."""
    observations: ClothFoldingObservations = field(default_factory=ClothFoldingObservations)
    rewards: ClothFoldingRewards = field(default_factory=ClothFoldingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: ClothFoldingEvents = field(default_factory=ClothFoldingEvents)

    def scene(self) -> Scene:
        flat = self.cloth((0.5, 0.0, TRAY), yaw=0.25 * math.pi)
        soft = replace(flat, bending_stiffness=self.bending_stiffness)
        return self.on_bench(soft, cloth.tray((0.5, 0.6, TRAY), 0.5, material=MAT))

    def success(self, env: Environment) -> Tensor:
        folded = (pair_distances(env) < self.tolerance * self.size).all(1)
        return folded & at_rest(env) & cloth.let_go(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"pair_distance_m": distance(env)}

    def expert(self, env: Environment) -> Expert:
        world, depth = env.world, self.taken
        tray, open_reach = TRAY - cloth.pressed(world, PRESSED), cloth.finger_reach(world, closed=False)
        # Pads hold the cloth at the hand's frame, however far fingers that closed on arcs reach below it.
        low, base = TRAY + LOW + open_reach, tray + CLEAR + open_reach
        closing = max(0.7, common.closing_time(world))
        way = (over_fold(angle, base, depth) for angle in ANGLES)
        first, *others = (Phase(target, False, position_tolerance=0.02, timeout=1.2) for target in way)
        phases = (
            Phase(at_corner(tray + open_reach + 0.1, depth), position_tolerance=0.02, free=True),
            Phase(at_corner(tray + open_reach, depth), position_tolerance=0.002, timeout=1.4),
            Phase(here(cloth.following(world, tray)), gripper_open=False, dwell=closing, timeout=closing),
            replace(first, retry=Retry(3, taken, most=1)),
            *others,
            Phase(at_place(low, depth), gripper_open=False, position_tolerance=0.01, dwell=0.5, timeout=1.2),
            Phase(here(always(low)), position_tolerance=1.0, rotation_tolerance=4.0, dwell=0.4),
            Phase(here(always(low + 0.1))),
        )
        return Expert(env, phases, position_lead=lead(world))
