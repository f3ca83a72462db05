"""Base of tasks of soft blocks: the block before an arm, its observations, and how a hand takes it and puts it down."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.deformables import cuboid
from orbit_assets.objects import BENCH_HEIGHT, work_bench
from orbit_core.envs import Environment, ObservationTerm, Task, TerminationTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import TermFunction, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import Color, KeyPoint, MarkerSpec, ObjectSpec, Pose, Scene, SoftBody
from orbit_core.scene.pose import Vector3
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Phase, Retry
from orbit_tasks.mdp import matter, picking

BLOCK = "block"
# Squares of the block's surface along each edge.
COUNTS = (4, 4, 4)
# Key points of opposite sides.
PAIRS = (("front", "back"), ("left", "right"))
# Metres above the table at which a hand carries a block past other things.
CARRIED = 0.25
# Metres above its place at which a block is let go: it does not press on what is below.
LOOSE = 0.003


@dataclass(kw_only=True)
class SoftTask(Task):
    """A soft block before an arm with a gripper that holds it by friction alone."""

    robot: str = "franka_panda"
    action: str = "joint_position"
    physics_dt: float = 0.0025
    decimation: int = 8
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005),
        exceptions=(TaskException(TaskCheck.START_YAW, "deformables are sampled by their middle, which has no yaw"),),
    )
    size: float = 0.05
    """Metres of the block's edges."""
    # Foam rubber: light enough for 5 N of grip, and soft enough to be seen to yield.
    density: float = 500.0
    """kg/m^3 of the block."""
    youngs_modulus: float = 1e5
    """Pa of the block: rubber foam has 1e4 to 1e6."""
    friction: float = 1.0
    """Of the block with everything."""
    grip_force: float = 5.0
    """Newtons at most that the gripper closes with; 20 N squeeze a block of 5e4 Pa to half its width."""

    def block(self, position: Vector3, name: str = BLOCK, color: Color = SoftBody.color) -> SoftBody:
        """The block at a position, in metres."""
        mesh = cuboid((self.size, self.size, self.size), COUNTS)
        return SoftBody(
            name, mesh, self.density, Pose(position), self.youngs_modulus, friction=self.friction, color=color,
            key_points=key_points(),
        )  # fmt: skip

    def on_bench(
        self, bodies: tuple[SoftBody, ...], *objects: ObjectSpec, markers: tuple[MarkerSpec, ...] = ()
    ) -> Scene:
        """The robot at the work bench, with those things on it."""
        return Scene(
            robots=(matter.with_grip_force(task_robots.arm(self.robot), self.grip_force),),
            objects=(work_bench(), *objects),
            deformables=bodies,
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=markers,
            physics_dt=self.physics_dt,
        )


def key_points() -> tuple[KeyPoint, ...]:
    """Key points of the block: the middles of its sides, and the mean of these."""
    # Vertices are numbered alike at every size, so a block of 2 m has its sides at 1.
    points = cuboid((2.0, 2.0, 2.0), COUNTS).vertices
    sides = {"front": (1, 0, 0), "back": (-1, 0, 0), "left": (0, 1, 0), "right": (0, -1, 0)}
    found = {name: int(abs(points - side).sum(axis=1).argmin()) for name, side in sides.items()}
    return (*(KeyPoint(name, (place,)) for name, place in found.items()), KeyPoint("middle", tuple(found.values())))


@once_per_state
def middle(env: Environment[SoftTask]) -> Tensor:
    """(N, 3) the block's middle, in the environment's frame."""
    return env.world.deformables[BLOCK].key_point("middle")


@once_per_state
def yaw(env: Environment[SoftTask]) -> Tensor:
    """(N,) rad that the block is turned about the vertical, by the way from its middle to its front."""
    # From the middle and not from the other side: a block that is squeezed aslant still faces forwards.
    way = env.world.deformables[BLOCK].key_point("front") - middle(env)
    return torch.atan2(way[:, 1], way[:, 0])


@once_per_state
def block_turn(env: Environment[SoftTask]) -> Tensor:
    """(N,) rad, at most an eighth of a turn: by how much the block is turned against the hand."""
    return picking.quarter(yaw(env) - common.turn_facing_down(common.hand_pose(env)[:, 3:]))


@once_per_state
def tilt(env: Environment[SoftTask]) -> Tensor:
    """(N,) rad between the block's bottom and the horizontal."""
    body = env.world.deformables[BLOCK]
    a, b = (body.key_point(front) - body.key_point(back) for front, back in PAIRS)
    up = torch.linalg.cross(a, b)
    return torch.atan2(vector_norm(up[:, :2], dim=1), up[:, 2])


@once_per_state
def squeeze(env: Environment[SoftTask]) -> Tensor:
    """(N,) part of its width that the block is narrower by, between its two sides that are nearer to each other."""
    points = env.world.deformables[BLOCK].key_points
    names = [point.name for point in env.world.deformables[BLOCK].spec.key_points]
    # The hand takes it by either pair of sides, and the one that it takes is the narrower.
    ends = [vector_norm(points[:, names.index(a)] - points[:, names.index(b)], dim=1) for a, b in PAIRS]
    return 1.0 - torch.minimum(*ends) / env.task.size


def reaching(env: Environment[SoftTask]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the block."""
    return common.nearness(vector_norm(middle(env) - common.hand_pose(env)[:, :3], dim=1), 0.1)


@once_per_state
def lifted(env: Environment[SoftTask]) -> Tensor:
    """(N,) 1 where the block's middle is its size above the table, else 0."""
    return (middle(env)[:, 2] > env.task.size).float()


@once_per_state
def let_go(env: Environment[SoftTask]) -> Tensor:
    """(N,) bool: no vertex of the block is between the fingers."""
    return vector_norm(middle(env) - common.hand_pose(env)[:, :3], dim=1) > env.task.size


def dropped(env: Environment[SoftTask]) -> Tensor:
    """(N,) bool: the block fell off the table."""
    return middle(env)[:, 2] < -0.05


def at_block(env: Environment[SoftTask]) -> Tensor:
    """(N, 7) the hand around the block, fingers along the pair of faces that needs the least turn from here."""
    # From the hand and not from home: of a block that is turned by 45 degrees, fingers that touch it choose again.
    turn = common.turn_facing_down(common.hand_pose(env)[:, 3:]) + block_turn(env)
    return torch.cat((middle(env), common.facing_down(turn)), dim=1)


def closing_time(world: World) -> float:
    """Seconds in which the fingers have closed on the block: it yields before they hold it."""
    return max(0.6, common.closing_time(world))


def taking(world: World) -> tuple[Phase, ...]:
    """Phases that take the block where it stands."""
    closing = closing_time(world)
    return (
        Phase(picking.raised(at_block, 0.1), position_tolerance=0.02, free=True),
        Phase(at_block, position_tolerance=0.006, timeout=1.5, least=0.02),
        Phase(at_block, gripper_open=False, dwell=closing, timeout=closing + 0.1),
    )


def moving(world: World, place: TermFunction) -> tuple[Phase, ...]:
    """Phases that take the block and put it to a place.

    Args:
        world: with the arm.
        place: (N, 7) where the block's middle shall be, and how the hand shall then be turned.
    """
    held = picking.hand_for(picking.raised(place, LOOSE), lambda env: common.pointing_down(middle(env)))
    came = Retry(4, lambda env: lifted(env) > 0.0)
    return (*taking(world), *picking.put(held, CARRIED, came=came))


@dataclass
class SoftState(matter.DeformableState):
    """The arm's joints and hand, the block's key points and the last action."""

    key_points: ObservationTerm | None = ObservationTerm(matter.key_points(BLOCK))


@dataclass
class SoftTerminations:
    """An episode ends early where the block is dropped off the table."""

    dropped: TerminationTerm | None = TerminationTerm(dropped)
