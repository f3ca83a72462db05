"""Stack-Pyramid: build pyramids of coloured blocks; Stack: put one block on another."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import box
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import Environment, EventTerm, ObservationTerm, PremiseTerm, RewardTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import Subtask, TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import POSE, TermFunction, once_per_state
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.mdp import common
from orbit_core.scene import Color, Pose, Scene
from orbit_motion.experts import Expert, Phase, Retry
from orbit_tasks.mdp import picking, stages, tabletop
from orbit_tasks.pixels import ArmLabels

# Of the blocks of each pyramid, by name, the first one first.
COLORS: tuple[dict[str, Color], ...] = (
    {"red": (0.8, 0.12, 0.1, 1.0), "orange": (0.95, 0.5, 0.1, 1.0), "yellow": (0.95, 0.85, 0.15, 1.0)},
    {"blue": (0.1, 0.2, 0.8, 1.0), "turquoise": (0.1, 0.7, 0.7, 1.0), "green": (0.15, 0.55, 0.15, 1.0)},
)
# Metres, of a block's edges: every gripper of the catalogue opens that far.
SIZE = 0.05
# Metres between the two blocks of a pyramid's base.
GAP = 0.004
# Values of :attr:`StackPyramid.starts`.
ANYWHERE, CORNERS = "anywhere", "corners"
# Metres between the centres of two blocks that start anywhere: the open hand fits around one of them.
APART = 0.12
# Places drawn for the second block. A place is too near for at most a third of them.
_TRIES = 16


class StackMemory(tabletop.TabletopMemory):
    """State of pyramids, looked up once in a new world."""

    opening: common.GripperOpening
    """Reader of the share by which the gripper is open."""
    ways: tuple[Tensor, ...]
    """(3,) from a pyramid's first block to the places of its others, in the first one's frame."""

    def start(self, env: Environment[StackPyramid]) -> None:
        super().start(env)
        self.opening = common.GripperOpening(env.world)
        beside, above = SIZE + GAP, SIZE
        ways = ((0.0, 0.0, above),) if env.task.blocks == 2 else ((beside, 0.0, 0.0), (0.5 * beside, 0.0, above))
        self.ways = tuple(torch.tensor(way, device=env.device) for way in ways)


@once_per_state
def moved_positions(env: Environment[StackPyramid]) -> Tensor:
    """(N, M, 3) of the blocks that are to be moved."""
    return tabletop.piece_poses(env)[:, env.task.pyramids :, :3]


@once_per_state
def places(env: Environment[StackPyramid, StackMemory]) -> Tensor:
    """(N, M, 3) where those belong: next to the first block of their pyramid along its x axis, or on top."""
    first = tabletop.piece_poses(env)[:, : env.task.pyramids]
    position, turn = first[..., :3], common.turned(picking.quarter_yaw(first[..., 3:].flatten(0, 1)))
    return torch.cat([position + quat_rotate(turn, way).view_as(position) for way in env.state.ways], dim=1)


@once_per_state
def distances(env: Environment[StackPyramid]) -> Tensor:
    """(N, M) metres between blocks and their places."""
    return vector_norm(blocks_to_places(env), dim=2)


@once_per_state
def put_down(env: Environment[StackPyramid]) -> Tensor:
    """(N, M) bool: the block is at its place and the hand away from it."""
    return (distances(env) < env.task.tolerance) & (vector_norm(hand_to_blocks(env), dim=2) > SIZE)


@once_per_state
def hand_to_blocks(env: Environment[StackPyramid]) -> Tensor:
    """(N, M, 3) from the hand to the blocks that are to be moved."""
    return moved_positions(env) - common.hand_pose(env)[:, None, :3]


def blocks_to_places(env: Environment[StackPyramid]) -> Tensor:
    """(N, M, 3) from the blocks to their places."""
    return places(env) - moved_positions(env)


@once_per_state
def done(env: Environment[StackPyramid]) -> Tensor:
    """(N,) int64: how many blocks are put down, one after the other."""
    return put_down(env).long().cumprod(dim=1).sum(dim=1)


def staged(env: Environment[StackPyramid], values: Tensor) -> Tensor:
    """(N,) in [0, 1]: the share of blocks put down, and for the next one its own value, of ``values`` (N, M)."""
    count = done(env)
    following = values.gather(1, count.clamp(max=len(env.task.moved) - 1)[:, None])[:, 0]
    return (count + torch.where(count < len(env.task.moved), following, 0.0)) / len(env.task.moved)


def reaching(env: Environment[StackPyramid]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the next block."""
    return staged(env, common.nearness(vector_norm(hand_to_blocks(env), dim=2), 0.1))


@once_per_state
def lifted(env: Environment[StackPyramid]) -> Tensor:
    """(N, M) 1 where the block is off the table, or over its place."""
    way = blocks_to_places(env)
    # At its place a block of the lowest row is on the table.
    return ((moved_positions(env)[..., 2] > SIZE) | (vector_norm(way[..., :2], dim=2) < 0.02)).float()


def tracking(env: Environment[StackPyramid], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the next block is to its place, once it is lifted."""
    return staged(env, lifted(env) * common.nearness(distances(env), scale))


def letting_go(env: Environment[StackPyramid, StackMemory]) -> Tensor:
    """(N,) in [0, 1]: how far the gripper is open, and the hand has left, where a block is at its place."""
    away = (vector_norm(hand_to_blocks(env), dim=2) / SIZE).clamp(max=1.0)
    wider = (4.0 * env.state.opening() - 3.0).clamp_min(0.0)  # than any gripper that still holds a block
    return staged(env, 0.5 * (wider[:, None] + away) * (distances(env) < env.task.tolerance))


def place_blocks(env: Environment[StackPyramid], env_ids: Tensor) -> None:
    """Place the blocks for an episode, as ``task.starts`` says."""
    if env.task.starts == ANYWHERE:
        place_pair(env, env_ids)
    else:
        place_in_corners(env, env_ids)


def place_pair(env: Environment[StackPyramid], env_ids: Tensor) -> None:
    """Place two blocks anywhere in the hand's workspace less its rim, turned by any angle, :data:`APART` or more.

    The second block takes the first of :data:`_TRIES` places that is far enough, or else the farthest of them.
    """
    low, high = common.workspace(env.world)
    lower = low[0] + 0.5 * SIZE, low[1] + 0.5 * SIZE
    upper = high[0] - 0.05, high[1] - 0.5 * SIZE
    height, count = 0.5 * SIZE, len(env_ids)
    kept = env.world.random.uniform((4,), (*lower, height, -math.pi), (*upper, height, math.pi), env_ids)
    other = env.world.random.uniform((4,), (*lower, height, -math.pi), (*upper, height, math.pi), env_ids)
    tries = env.world.random.uniform((_TRIES, 2), lower, upper, env_ids)
    distance = vector_norm(tries - kept[:, None, :2], dim=2)
    # The first that is far enough counts most; where none is, the distance decides.
    rank = torch.where(distance >= APART, 2.0 * _TRIES - torch.arange(_TRIES, device=distance.device), distance)
    other[:, :2] = tries[torch.arange(count, device=tries.device), rank.argmax(dim=1)]
    for name, place in zip(env.task.pieces, (kept, other), strict=True):
        env.world.objects[name].set_root_pose(common.standing(place), env_ids)


def place_in_corners(env: Environment[StackPyramid], env_ids: Tensor) -> None:
    """First blocks stand in the middle, turned by up to 0.3 rad; others, by any angle, at four places next to them."""
    low, high = common.workspace(env.world)
    near, far, width = low[0], high[0] - 0.05, 0.5 * (high[1] - low[1])
    middle, height = 0.5 * (low[1] + high[1]), 0.5 * SIZE
    # One pyramid has the whole width, two have a side each.
    bands = ((-0.11, 0.11),) if env.task.pyramids == 1 else ((-0.11, -0.07), (0.07, 0.11))
    for name, (right, left) in zip(env.task.first, bands, strict=True):
        bounds = (near + 0.03, middle + right, height, -0.3), (near + 0.07, middle + left, height, 0.3)
        env.world.objects[name].set_root_pose(
            common.standing(env.world.random.uniform((4,), *bounds, env_ids)), env_ids
        )
    cells = [(x, middle + y) for x in (near + 0.035, far - 0.035) for y in (0.015 - width, width - 0.015)]
    chosen = torch.tensor(cells, device=env.device)[env.world.random.uniform((4,), env_ids=env_ids).argsort(dim=1)]
    for index, name in enumerate(env.task.moved):
        bounds = (-0.02, -0.015, height, -math.pi), (0.02, 0.015, height, math.pi)
        place = env.world.random.uniform((4,), *bounds, env_ids)
        place[:, :2] += chosen[:, index]
        env.world.objects[name].set_root_pose(common.standing(place), env_ids)


@dataclass
class StackState(tabletop.GraspState):
    """The arm's joints and hand, blocks, their turns against the hand, ways to them and their places, last action."""

    block_poses: ObservationTerm | None = ObservationTerm(tabletop.piece_poses, unit=POSE)
    block_turns: ObservationTerm | None = ObservationTerm(tabletop.piece_turns, unit="rad")
    fine_hand_to_blocks: ObservationTerm | None = tabletop.fine(hand_to_blocks)
    fine_blocks_to_places: ObservationTerm | None = tabletop.fine(blocks_to_places)
    hand_to_blocks: ObservationTerm | None = ObservationTerm(hand_to_blocks, unit="m")
    blocks_to_places: ObservationTerm | None = ObservationTerm(blocks_to_places, unit="m")
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class StackRewards:
    """Rewards of the hand at the next block, the block lifted, at its place and let go, less what is abrupt.

    Who holds a block at its place for ever earns less than a third of what it earns there by itself.
    """

    reach: RewardTerm | None = RewardTerm(reaching, 0.3)
    lift: RewardTerm | None = RewardTerm(lambda env: staged(env, lifted(env)), 0.6)
    """Progress of the blocks, of which the next counts while it is off the table."""
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 0.9)
    """Nearness of the next, lifted block to its place, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 0.6)
    """The same within 0.05 m, which decides the last centimetres."""
    let_go: RewardTerm | None = RewardTerm(letting_go, 6.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class StackEvents(tabletop.ArmEvents):
    """Robot and blocks are placed for each episode; masses and the like with domain randomisation."""

    place_blocks: EventTerm | None = EventTerm(place_blocks)


@dataclass
class StackPremises:
    """Blocks stand free on the table."""

    standing: PremiseTerm | None = tabletop.pieces_stand(0.5 * SIZE)
    apart: PremiseTerm | None = PremiseTerm(
        lambda env: distances(env).amin(1) > env.task.tolerance, "a block is at its place already"
    )


@dataclass(kw_only=True)
class StackPyramid(tabletop.TabletopTask):
    """Pyramids of coloured blocks, each built where its first block stands: a second next to it, and a third on both.

    A pyramid of two blocks has the second on the first. Succeeds when at the episode's end every block is within
    ``tolerance`` of its place and the hand has let go. Metric: the sum of the distances between blocks and places.
    """

    state_type: ClassVar[type[TaskState]] = StackMemory
    metadata: TaskMetadata = TaskMetadata(
        instruction="stack the cubes to a pyramid",
        ppo=PpoSettings(iterations=3000, initial_std=0.3, entropy_weight=0.005),
        exceptions=(
            TaskException(TaskCheck.START_AREA, "pyramids and hand leave cells of 4 x 3 cm for the other blocks"),
        ),
    )
    observation_presets: ClassVar[Mapping[str, Callable[[], Any]]] = {
        "semantic": tabletop.sensed(ArmLabels, StackState)  # whose labels say the blocks' colours
    }
    episode_length: float = 27.0
    pyramids: int = 2
    """One or two."""
    blocks: int = 3
    """Of each pyramid: two or three."""
    starts: str = CORNERS
    """Where blocks begin: ``"corners"``, the first ones in the middle and the others in cells of 4 x 3 cm around
    them, or ``"anywhere"`` in the hand's workspace, for one pyramid of two blocks."""
    tolerance: float = 0.015
    """Metres."""
    observations: tabletop.StateObservations = field(default_factory=tabletop.state(StackState))
    rewards: StackRewards = field(default_factory=StackRewards)
    terminations: tabletop.DropTerminations = field(default_factory=tabletop.DropTerminations)
    events: StackEvents = field(default_factory=StackEvents)
    premises: StackPremises = field(default_factory=StackPremises)

    @property
    def first(self) -> tuple[str, ...]:
        """The block of each pyramid that stays."""
        return tuple(next(iter(colors)) for colors in COLORS[: self.pyramids])

    @property
    def moved(self) -> tuple[str, ...]:
        """The blocks to be moved, in order: all second ones, then all third ones."""
        return tuple(list(colors)[level] for level in range(1, self.blocks) for colors in COLORS[: self.pyramids])

    @property
    def pieces(self) -> tuple[str, ...]:
        return (*self.first, *self.moved)

    def scene(self) -> Scene:
        self.bound(pyramids=(1, 2), blocks=(2, 3), tolerance=(1e-6, 0.5 * SIZE))
        self._check_starts()
        colors, cube = COLORS[0] | COLORS[1], (SIZE, SIZE, SIZE)
        parts = [(name, Pose((0.5, 0.1 * index - 0.25, 0.5 * SIZE))) for index, name in enumerate(self.pieces)]
        return self.bench(*(box(name, cube, mass=0.1, color=colors[name], pose=pose) for name, pose in parts))

    def _check_starts(self) -> None:
        """Raise ConfigurationError if ``starts`` is unknown, or has no room for so many blocks."""
        if self.starts not in (ANYWHERE, CORNERS):
            raise ConfigurationError(
                f"field 'starts' of task {type(self).__name__} is '{self.starts}': give '{ANYWHERE}' or '{CORNERS}'"
            )
        if self.starts == ANYWHERE and len(self.pieces) > 2:
            raise ConfigurationError(
                f"field 'starts' of task {type(self).__name__} is '{ANYWHERE}', which has room for two blocks, not "
                f"{len(self.pieces)}: give '{CORNERS}', or one pyramid of two blocks"
            )

    def randomize(self) -> None:
        """The friction of blocks and fingers, the arm's gains, and noise on joints and blocks."""
        ways = {"block_poses": 0.002, "hand_to_blocks": 0.002, "blocks_to_places": 0.002, "block_turns": 0.02}
        fine = {"fine_hand_to_blocks": 0.2, "fine_blocks_to_places": 0.2}
        self.vary((common.ROBOT, *self.pieces, "table"), (0.5, 1.2), **ways, **fine)

    def success(self, env: Environment) -> Tensor:
        return put_down(env).all(1)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"distance_m": distances(env).sum(1)}

    def __post_init__(self) -> None:
        # Their number follows from the fields, which are checked when the scene is made.
        parts = tuple(part for index in range(self.pyramids * (self.blocks - 1)) for part in _parts(index))
        self.metadata = replace(self.metadata, subtasks=parts)

    def expert(self, env: Environment) -> Expert:
        phases = [phase for index in range(len(self.moved)) for phase in _moving(env.world, index)]
        return Expert(env, phases, stage=_stage)


def _block(index: int) -> TermFunction:
    """Term: (N, 7) a block that is to be moved."""
    return lambda env: tabletop.piece_poses(env)[:, env.task.pyramids + index]


def _grasp(index: int) -> TermFunction:
    """Term: (N, 7) the hand around it, its palm next to the pyramid that was built before."""
    return lambda env: picking.beside(picking.grasp_square(_block(index)(env)), places(env)[:, max(index - 1, 0)])


def _place(index: int) -> TermFunction:
    """Term: (N, 7) its place, with the hand turned as the pyramid is."""
    return lambda env: picking.over_square(
        places(env)[:, index], tabletop.piece_poses(env)[:, index % env.task.pyramids, 3:]
    )


def _moving(world: World, index: int) -> tuple[Phase, ...]:
    """Pick a block up and put it to its place, 3 mm too high, so that it does not press; again where it was lost."""
    place = picking.hand_for(picking.raised(_place(index), 0.003), _block(index))
    came = Retry(4, lambda env: moved_positions(env)[:, index, 2] > SIZE)
    put = picking.put(place, height=0.22, over=1.25 * GAP, came=came)
    return picking.pick(world, _grasp(index), clearance=0.12) + put


def _stage(env: Environment[StackPyramid, StackMemory]) -> Tensor:
    """(N,) int64: the expert's phase, by the state alone."""
    hand, closed = common.hand_pose(env), env.state.opening() < 0.7  # of which a block needs 0.6
    ways = enumerate(blocks_to_places(env).unbind(1))
    own = [stages.moving(hand, _grasp(k)(env), _place(k)(env), way, closed) for k, way in ways]
    return stages.following(own, put_down(env), 8)


def _parts(index: int) -> tuple[Subtask, Subtask]:
    """Pick a block up; put it to its place."""
    return (
        Subtask(_grasp(index), lambda env: moved_positions(env)[:, index, 2] > SIZE),
        Subtask(_place(index), lambda env: put_down(env)[:, index]),
    )


@dataclass(kw_only=True)
class Stack(StackPyramid):
    """One block on another: the smallest of the pyramids. Both start anywhere in the hand's workspace by default.

    The kept policy ``stack`` was learned with ``starts="corners"``, which its own fields say.
    """

    metadata: TaskMetadata = replace(
        StackPyramid.metadata,
        ppo=PpoSettings(iterations=1500, initial_std=0.4, entropy_weight=0.002),
        exceptions=(),
        training={"expert_starts": 0.5, "action": "ik_relative"},
    )
    episode_length: float = 8.0
    pyramids: int = 1
    blocks: int = 2
    starts: str = ANYWHERE
