"""Peg-In-Hole: put blocks into the holes of a board that match them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.pegs import BOARD_HEIGHT, COLORS, GRIP_HEIGHT, block, board, section
from orbit_core.dynamics import transforms
from orbit_core.envs import Environment, EventTerm, ObservationTerm, PremiseTerm, RewardTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import Subtask, TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import POSE, once_per_state
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_core.scene import PhysicsMaterial, Scene
from orbit_motion.experts import Expert, Phase, Retry
from orbit_tasks.mdp import picking, stages, tabletop

SMOOTH = PhysicsMaterial(static_friction=0.3, dynamic_friction=0.3)
# Metres below itself to which a block is led near its hole's rim: a stronger push turns it in the hand.
GENTLE = 0.0015
# How many times what a block lacks sideways is asked for: drives are slow, and a push on the rim moves them.
HASTE = 6.0
# Metres below the rim from which on a block is in its hole, whose walls lead it.
IN = 0.0005
# Metres by which an error in rotation counts as one in position: a radian moves a block's rim about so far.
ARM = 0.03


class PegMemory(tabletop.TabletopMemory):
    """State of pegs and holes, looked up once in a new world."""

    turn: Tensor
    """(B,) rad of the least turn that brings each section onto itself; zero where any does."""
    grip: Tensor
    """(7,) of the knob's middle in a block's frame."""

    def start(self, env: Environment[PegInHole]) -> None:
        super().start(env)
        self.turn = torch.tensor([section(shape).turn for shape in env.task.shapes], device=env.device)
        self.grip = torch.tensor([0.0, 0.0, GRIP_HEIGHT, 1.0, 0.0, 0.0, 0.0], device=env.device)


@once_per_state
def seats(env: Environment[PegInHole]) -> Tensor:
    """(N, B, 7) of each block all the way in its hole, in the turn that is nearest to how it is turned now."""
    return turned_seats(env, transforms.yaw_angle(tabletop.piece_poses(env)[..., 3:]))


def turned_seats(env: Environment[PegInHole, PegMemory], wanted: Tensor) -> Tensor:
    """(N, B, 7) of blocks in their holes, in the turn that is nearest to ``wanted`` (N, B) rad about the vertical."""
    holes = torch.stack(
        [env.world.objects["board"].frame_pose(f"hole_{k}") for k in range(len(env.task.pieces))], dim=1
    )
    way = wanted - transforms.yaw_angle(holes[..., 3:])
    turn = torch.where(env.state.turn > 0.0, env.state.turn * torch.round(way / env.state.turn.clamp_min(1e-6)), way)
    turned = common.turned(turn.flatten()).view(*turn.shape, 4)
    return torch.cat((holes[..., :3], transforms.quat_multiply(holes[..., 3:], turned)), dim=-1)


@once_per_state
def offsets(env: Environment[PegInHole]) -> Tensor:
    """(N, B, 7) each block's pose as its seat sees it."""
    return transforms.pose_multiply(transforms.pose_inverse(seats(env)), tabletop.piece_poses(env))


@once_per_state
def distances(env: Environment[PegInHole]) -> Tensor:
    """(N, B) metres between each block's base and its place in the hole."""
    return vector_norm(offsets(env)[..., :3], dim=-1)


@once_per_state
def errors(env: Environment[PegInHole]) -> Tensor:
    """(N, B) metres from each block to its place, with its turn and tilt counted as well."""
    off = offsets(env)
    return torch.hypot(vector_norm(off[..., :3], dim=-1), ARM * transforms.rotation_angle(off[..., 3:]))


def fine_offsets(env: Environment[PegInHole]) -> Tensor:
    """(N, B, 6) in [-1, 1] way from each block's seat, and its turn there; 0.76 is a centimetre, or 0.33 rad."""
    way, turn = tabletop.piece_poses(env) - seats(env), offsets(env)[..., 3:]
    return torch.tanh(torch.cat((way[..., :3], ARM * transforms.quat_to_rotation_vector(turn)), dim=-1) / 0.01)


@once_per_state
def inserted(env: Environment[PegInHole]) -> Tensor:
    """(N, B) 1 where the block is in its hole, else 0."""
    return (distances(env) < env.task.tolerance).float()


@once_per_state
def lifted(env: Environment[PegInHole]) -> Tensor:
    """(N, B) 1 where the block is off the table or in its hole, else 0."""
    return torch.maximum((tabletop.piece_poses(env)[..., 2] > 0.01).float(), inserted(env))


@once_per_state
def hand_to_knobs(env: Environment[PegInHole, PegMemory]) -> Tensor:
    """(N, B, 3) from the hand to the middle of each block's knob."""
    blocks = tabletop.piece_poses(env)
    knobs = transforms.pose_multiply(blocks, env.state.grip.expand_as(blocks))
    return knobs[..., :3] - common.hand_pose(env)[:, None, :3]


def reaching(env: Environment[PegInHole]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the nearest block that is not in its hole; 1 once all are."""
    near, done = common.nearness(vector_norm(hand_to_knobs(env), dim=-1), 0.1), inserted(env)
    return torch.maximum((near * (1.0 - done)).amax(1), done.amin(1))


def tracking(env: Environment[PegInHole], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near lifted blocks are to their places, on average."""
    return (lifted(env) * common.nearness(errors(env), scale)).mean(1)


def aligned(env: Environment[PegInHole]) -> Tensor:
    """(N,) in [0, 1]: how well lifted blocks stand above or in their holes, at any height, on average."""
    off = offsets(env)
    error = torch.hypot(vector_norm(off[..., :2], dim=-1), ARM * transforms.rotation_angle(off[..., 3:]))
    return (lifted(env) * common.nearness(error, 0.01)).mean(1)


def depth(env: Environment[PegInHole]) -> Tensor:
    """(N,) in [0, 1]: how deep blocks are in their holes, on average."""
    off = offsets(env)
    # Over its hole only: a block on the table next to the board is as low.
    return ((vector_norm(off[..., :2], dim=-1) < 0.01) * (1.0 - off[..., 2] / BOARD_HEIGHT).clamp(0.0, 1.0)).mean(1)


def place_board(env: Environment[PegInHole], env_ids: Tensor) -> None:
    """Place the board at the far side of the workspace; a short one is placed and turned more than a long one."""
    low, high = common.workspace(env.world)
    spread, far, middle = 1.0 / len(env.task.pieces), high[0] - 0.06, 0.5 * (low[1] + high[1])
    bounds = (far - 0.03, middle - 0.08 * spread, 0.0, -0.3 * spread), (far, middle + 0.08 * spread, 0.0, 0.3 * spread)
    env.world.objects["board"].set_root_pose(common.standing(env.world.random.uniform((4,), *bounds, env_ids)), env_ids)


def place_blocks(env: Environment[PegInHole], env_ids: Tensor) -> None:
    """Stand the blocks in a row before the board, 11 cm apart, in any order, each turned by any angle."""
    count, (low, high) = len(env.task.pieces), common.workspace(env.world)
    draw = env.world.random.uniform((4 * count,), -1.0, 1.0, env_ids).view(-1, count, 4)
    # The ranks of random numbers are a random order, drawn without a loop over environments.
    slots = draw[..., 0].argsort(dim=1).float() - 0.5 * (count - 1)
    poses = torch.zeros(len(env_ids), count, 7, device=env.device)
    poses[..., 0] = low[0] + 0.01 + 0.02 * draw[..., 1]
    poses[..., 1] = 0.5 * (low[1] + high[1]) + 0.11 * slots + (0.1 / count) * draw[..., 2]
    poses[..., 3:] = common.turned(math.pi * draw[..., 3].flatten()).view(-1, count, 4)
    tabletop.put(env.world, env.task.pieces, poses, env_ids)


def grasp(env: Environment[PegInHole, PegMemory], index: int, height: float = 0.0) -> Tensor:
    """(N, 7) the hand around a block's knob, or above it, in the quarter turn that turns the hand least in all."""
    knob = transforms.pose_multiply(tabletop.piece_poses(env)[:, index], env.state.grip.expand(env.num_envs, 7))
    # A gripper takes a knob by any two opposite faces, at four turns of the hand.
    quarters = 0.5 * math.pi * torch.tensor([-1.0, 0.0, 1.0, 2.0], device=env.device)
    before = transforms.yaw_angle(knob[:, 3:])[:, None] + quarters
    ahead = [turned_seats(env, (-turn).expand(env.num_envs, len(env.task.pieces)))[:, index] for turn in quarters]
    after = transforms.yaw_angle(torch.stack(ahead, dim=1)[..., 3:]) + quarters
    position = knob[:, :3] + torch.tensor([0.0, 0.0, height], device=env.device)
    return torch.cat((position, common.facing_down(picking.least_turn(before, after))), dim=1)


def carried(env: Environment[PegInHole], index: int, height: float, push: float = 1.0, haste: float = 1.0) -> Tensor:
    """(N, 7) the hand where the block stands ``height`` (m) above its place, as it sits in the hand now.

    It goes down by at most ``push`` (m), near the rim by :data:`GENTLE`, and until it is in the hole asks for ``haste``
    times what it lacks sideways."""  # fmt: skip
    held, hand = tabletop.piece_poses(env)[:, index], common.hand_pose(env)
    wanted = transforms.yaw_angle(held[:, 3:]) - common.turn_facing_down(hand[:, 3:])
    seat = turned_seats(env, wanted[:, None].expand(-1, len(env.task.pieces)))[:, index]
    above = held[:, 2] - seat[:, 2]
    up = (above - torch.where((above - BOARD_HEIGHT).abs() < 0.003, min(push, GENTLE), push)).clamp_min(height)
    target = torch.cat((seat[:, :2], (seat[:, 2] + up)[:, None], seat[:, 3:]), dim=1)
    pose = transforms.pose_multiply(target, transforms.pose_multiply(transforms.pose_inverse(held), hand))
    more = torch.where(above > BOARD_HEIGHT - IN, haste - 1.0, 0.0)[:, None]
    pose[:, :2] += more * (pose[:, :2] - hand[:, :2])
    return pose


@dataclass
class PegState(tabletop.GraspState):
    """The arm's joints, the hand, the blocks, as hand and seats see them as well, the seats, and the last action."""

    block_poses: ObservationTerm | None = ObservationTerm(tabletop.piece_poses, unit=POSE)
    block_turns: ObservationTerm | None = ObservationTerm(tabletop.piece_turns, unit="rad")
    fine_hand_to_knobs: ObservationTerm | None = tabletop.fine(hand_to_knobs)
    hand_to_knobs: ObservationTerm | None = ObservationTerm(hand_to_knobs, unit="m")
    seats: ObservationTerm | None = ObservationTerm(seats, unit=POSE)
    offsets: ObservationTerm | None = ObservationTerm(offsets, unit=POSE)
    fine_offsets: ObservationTerm | None = ObservationTerm(fine_offsets, unit="1")
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class PegRewards:
    """Rewards of the hand at a block, blocks off the table, above and in their holes, five times as much, not fast."""

    reach: RewardTerm | None = RewardTerm(reaching, 0.3)
    lift: RewardTerm | None = RewardTerm(lambda env: lifted(env).mean(1), 0.4)
    """Share of the blocks that are off the table or in their holes."""
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.2), 0.6)
    """Nearness of lifted blocks to their places, turned as they must be, within some 0.2 m."""
    align: RewardTerm | None = RewardTerm(aligned, 0.6)
    depth: RewardTerm | None = RewardTerm(depth, 2.0)
    insert: RewardTerm | None = RewardTerm(lambda env: inserted(env).mean(1), 6.0)
    """Share of the blocks that are in their holes."""
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class PegEvents(tabletop.ArmEvents):
    """Robot, board and blocks are placed for each episode; masses and the like with domain randomisation."""

    place_board: EventTerm | None = EventTerm(place_board)
    place_blocks: EventTerm | None = EventTerm(place_blocks)


@dataclass
class PegPremises:
    """Blocks stand free on the table."""

    standing: PremiseTerm | None = tabletop.pieces_stand(0.0)
    outside: PremiseTerm | None = PremiseTerm(lambda env: ~inserted(env).any(1), "a block is in a hole")


@dataclass(kw_only=True)
class PegInHole(tabletop.TabletopTask):
    """Blocks stand before a board with a hole for each; each is to be put into its own.

    Succeeds when every block's base is within ``tolerance`` of its place, the bottom of its hole, at the episode's end.
    Metric: the sum of those distances.
    """

    state_type: ClassVar[type[TaskState]] = PegMemory
    metadata: TaskMetadata = TaskMetadata(
        instruction="put the peg into the hole",
        ppo=PpoSettings(iterations=1500, initial_std=0.4, entropy_weight=0.001),
        exceptions=(
            TaskException(TaskCheck.START_AREA, "the board takes the middle, a block starts on 80 cm² at its side"),
        ),
        training={"expert_starts": 0.5, "action": "ik_relative", "episode_length": 10.0},
    )
    episode_length: float = 24.0
    shapes: tuple[str, ...] = ("square",)
    """Sections of the blocks, :data:`orbit_assets.pegs.SECTIONS`, a block each: give each about 24 s."""
    clearance: float = 0.002
    """Metres by which a hole is wider than its block."""
    tolerance: float = 0.005
    """Metres."""
    observations: tabletop.StateObservations = field(default_factory=tabletop.state(PegState))
    rewards: PegRewards = field(default_factory=PegRewards)
    terminations: tabletop.DropTerminations = field(default_factory=tabletop.DropTerminations)
    events: PegEvents = field(default_factory=PegEvents)
    premises: PegPremises = field(default_factory=PegPremises)

    @property
    def pieces(self) -> tuple[str, ...]:
        return tuple(f"block_{index}" for index in range(len(self.shapes)))

    def scene(self) -> Scene:
        self.bound(tolerance=(1e-6, 0.02))
        if len(self.shapes) > len(COLORS):
            raise ConfigurationError(f"{len(self.shapes)} shapes do not fit before an arm: give {len(COLORS)} at most")
        # There are more colours than blocks.
        parts = zip(self.pieces, self.shapes, COLORS, strict=False)
        blocks = [block(name, shape, color=color, material=SMOOTH) for name, shape, color in parts]
        return self.bench(*blocks, board("board", self.shapes, self.clearance, material=SMOOTH))

    def randomize(self) -> None:
        """The blocks' friction, the board's and the fingers', the arm's gains, and noise on joints and blocks."""
        ways = dict.fromkeys(("block_poses", "hand_to_knobs", "seats", "offsets"), 0.0005)
        fine = {"block_turns": 0.005, "fine_hand_to_knobs": 0.05, "fine_offsets": 0.05}
        self.vary((*self.pieces, "board"), (0.2, 0.5), **ways, **fine)

    def success(self, env: Environment) -> Tensor:
        return inserted(env).amin(1) > 0.0

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"distance_m": distances(env).sum(1)}

    def __post_init__(self) -> None:
        # Their number follows from the shapes.
        parts = tuple(part for index in range(len(self.shapes)) for part in _parts(index))
        self.metadata = replace(self.metadata, subtasks=parts)

    def expert(self, env: Environment) -> Expert:
        closing = max(0.4, common.closing_time(env.world))
        insertions = [phase for index in range(len(self.shapes)) for phase in _insertion(index, closing)]
        return Expert(env, insertions, 0.06, stage=partial(_stage, opening=common.GripperOpening(env.world)))


def _stage(env: Environment[PegInHole], opening: common.GripperOpening) -> Tensor:
    """(N,) int64: the expert's phase, by the state alone."""
    hand, rim, closed = common.hand_pose(env), (BOARD_HEIGHT, 0.4 * env.task.clearance), opening() < 0.45
    pairs = enumerate(offsets(env).unbind(1))
    own = [stages.inserting(hand, grasp(env, k), offset, *rim, closed) for k, offset in pairs]
    return stages.following(own, inserted(env) * (vector_norm(hand_to_knobs(env), dim=-1) > ARM), 10)


def _parts(index: int) -> tuple[Subtask, Subtask]:
    """Pick a block up; put it into its hole."""
    at, seated = partial(grasp, index=index), partial(carried, index=index, height=0.0)
    return (
        Subtask(at, lambda env: tabletop.piece_poses(env)[:, index, 2] > 0.01),
        Subtask(seated, lambda env: (inserted(env)[:, index] > 0.0) & _let_go(env, index)),
    )


def _let_go(env: Environment[PegInHole], index: int) -> Tensor:
    """(N,) bool: the hand is away from a block."""
    return vector_norm(hand_to_knobs(env)[:, index], dim=-1) > ARM


def _insertion(index: int, closing: float) -> tuple[Phase, ...]:
    """Grasp a block, bring it above its hole, lower it until it is in, else lift it and do so again; push it down."""
    at, over, held = partial(grasp, index=index), partial(grasp, index=index, height=0.1), partial(carried, index=index)
    above, down = partial(held, height=BOARD_HEIGHT + 0.02), partial(held, height=-0.003, push=0.006)
    close = partial(held, height=BOARD_HEIGHT + 0.002, push=0.02, haste=HASTE)
    lower = partial(held, height=BOARD_HEIGHT - 0.006, push=0.002, haste=HASTE)
    reaches = Retry(2, lambda env: offsets(env)[:, index, 2] < BOARD_HEIGHT - 0.003, most=5)
    is_in = Retry(3, lambda env: inserted(env)[:, index] > 0.0, most=1)
    return (
        Phase(over, position_tolerance=0.02, free=True),
        Phase(at, position_tolerance=0.004, timeout=1.5),
        Phase(at, gripper_open=False, dwell=closing, timeout=closing + 0.1),
        Phase(picking.straight_up(0.12 + GRIP_HEIGHT), False, position_tolerance=0.03, timeout=1.5),
        Phase(above, gripper_open=False, position_tolerance=0.004, rotation_tolerance=0.03, timeout=2.0),
        Phase(close, gripper_open=False, position_tolerance=0.001, rotation_tolerance=0.005, timeout=1.5),
        Phase(lower, False, position_tolerance=0.0015, timeout=1.5, retry=reaches),
        Phase(down, gripper_open=False, position_tolerance=0.004, timeout=2.0, retry=is_in),
        Phase(at, dwell=closing, timeout=closing + 0.1),
        Phase(over, position_tolerance=0.04, timeout=1.0),
    )
