"""Jenga: pull a given block out of a tower and put it on top."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import BLOCK_SIZE as SIZE
from orbit_assets.objects import WOOD, box, cell_poses, tower
from orbit_core.dynamics.transforms import pose_inverse, pose_multiply, quat_multiply, quat_rotate, quat_rotate_inverse
from orbit_core.envs import Environment, EventTerm, ObservationTerm, PremiseTerm, RewardTerm, TerminationTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import Subtask, TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import POSE, TermFunction, once_per_state
from orbit_core.mdp import common
from orbit_core.scene import Color, PhysicsMaterial, Pose, RobotSpec, Scene, look_at
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import picking, tabletop

# Metres of the plinth's height, on which the tower stands: arms reach no lower with such a hand.
PLINTH = 0.2
SMOOTH = PhysicsMaterial(0.3, 0.3)
RED: Color = (0.8, 0.25, 0.2, 1.0)
# Metres above a block's middle at which a hand holds it, so that no finger reaches below the block.
LIFT = 0.004
GIVEN = "given"


class JengaMemory(tabletop.TabletopMemory):
    """State of a tower: its layout, and the given block's place in it."""

    foot: Tensor = buffer(7)
    """(N, 7) the middle of the tower's underside."""
    rest: Tensor = buffer(7)
    """(N, 7) of the given block while it is in the tower."""
    heights: Tensor
    """(N, B) metres of the other blocks' middles where they were put."""
    cells: Tensor
    """(K,) int64: where the given block may lie."""

    def start(self, env: Environment[Jenga]) -> None:
        super().start(env)
        layers = env.task.layers
        self.heights = torch.zeros(env.num_envs, len(env.task.others), device=env.device)
        # Layers alternate in direction, and the arm pulls along its own; foot and top stay as they are.
        pointing = [layer for layer in range(3, layers - 2) if (layers - layer) % 2 == 0]
        self.cells = torch.tensor([3 * layer + slot for layer in pointing for slot in range(3)], device=env.device)

    def update(self, env: Environment[Jenga]) -> None:
        # Followed while it is in the tower, whose blocks shift a little under the hand.
        inside = out(env) < env.task.protrusion + 0.002
        self.rest.copy_(torch.where(inside[:, None], given_pose(env), self.rest))


@once_per_state
def given_pose(env: Environment[Jenga]) -> Tensor:
    """(N, 7) of the given block."""
    return env.world.objects[GIVEN].root_pose


@once_per_state
def other_positions(env: Environment[Jenga]) -> Tensor:
    """(N, B, 3) of the other blocks, from the lowest layer to the highest."""
    return torch.stack([env.world.objects[name].root_pose[:, :3] for name in env.task.others], dim=1)


@once_per_state
def place(env: Environment[Jenga, JengaMemory]) -> Tensor:
    """(N, 7) where the given block belongs: on the middle of the highest layer, across it."""
    position = other_positions(env)[:, -3:].mean(1) + torch.tensor([0.0, 0.0, SIZE[2]], device=env.device)
    return torch.cat((position, env.state.foot[:, 3:]), dim=1)


@once_per_state
def distance(env: Environment[Jenga]) -> Tensor:
    """(N,) metres between the given block and its place."""
    return vector_norm(block_to_place(env), dim=1)


@once_per_state
def fallen(env: Environment[Jenga, JengaMemory]) -> Tensor:
    """(N,) bool: another block is lower, by half its height, than where it was."""
    return (other_positions(env)[..., 2] < env.state.heights - 0.5 * SIZE[2]).any(1)


@once_per_state
def put_down(env: Environment[Jenga]) -> Tensor:
    """(N,) bool: the given block is at its place, and the hand away from it."""
    return (distance(env) < env.task.tolerance) & (vector_norm(hand_to_block(env), dim=1) > 0.04)


def block_to_place(env: Environment[Jenga]) -> Tensor:
    """(N, 3) position of the given block's place minus the block's, in the environment's axes."""
    return place(env)[:, :3] - given_pose(env)[:, :3]


def hand_to_block(env: Environment[Jenga]) -> Tensor:
    """(N, 3) from the hand to where it holds the block."""
    return grasp(env)[:, :3] - common.hand_pose(env)[:, :3]


def out(env: Environment[Jenga, JengaMemory]) -> Tensor:
    """(N,) metres of the given block that stand out of the tower, or its whole length where it is above."""
    way = given_pose(env)[:, :3] - env.state.foot[:, :3]
    ahead = -quat_rotate_inverse(env.state.foot[:, 3:], way)[:, 0]
    above = given_pose(env)[:, 2] > place(env)[:, 2] - 0.5 * SIZE[2]
    return torch.where(above, SIZE[0], ahead.clamp(0.0, SIZE[0]))


def tracking(env: Environment[Jenga], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the block is to its place, once it is out of the tower."""
    # Once it is nearly out: before, going up would tear the tower down.
    return (out(env) > 0.9 * SIZE[0]) * common.nearness(distance(env), scale)


def grasp(env: Environment[Jenga]) -> Tensor:
    """(N, 7) the hand around the end of the block that stands out."""
    block = given_pose(env)
    end = torch.tensor([0.5 * (env.task.protrusion - SIZE[0]), 0.0, LIFT], device=env.device).expand(len(block), 3)
    return torch.cat((block[:, :3] + quat_rotate(block[:, 3:], end), slanting(block[:, 3:])), dim=1)


def slanting(turn: Tensor) -> Tensor:
    """(N, 4) of a hand that points down and along the x axis of what is turned (N, 4), 45 degrees below it, its fingers
    opening sideways."""  # fmt: skip
    angle = math.pi / 8.0
    own = torch.tensor([0.0, math.cos(angle), 0.0, math.sin(angle)], device=turn.device)
    return quat_multiply(turn, own.expand_as(turn))


def pulled(env: Environment[Jenga, JengaMemory]) -> Tensor:
    """(N, 7) the hand, with the block straight out of the tower: neither lifted, nor moved aside or turned from how it
    lay, for then it would press on its neighbours and drag them along."""  # fmt: skip
    hand, block = common.hand_pose(env), given_pose(env)
    along = torch.tensor([-SIZE[0] - 0.02 + env.task.protrusion, 0.0, 0.0], device=env.device).expand(len(hand), 3)
    goal = torch.cat((env.state.rest[:, :3] + quat_rotate(env.state.rest[:, 3:], along), env.state.rest[:, 3:]), dim=1)
    return pose_multiply(goal, pose_multiply(pose_inverse(block), hand))


def above(env: Environment[Jenga, JengaMemory]) -> Tensor:
    """(N, 7) the hand, with the block straight above where it is, higher than the tower."""
    block = given_pose(env)
    position = torch.cat((block[:, :2], place(env)[:, 2:3] + 0.05), dim=1)
    return torch.cat((position, slanting(env.state.foot[:, 3:])), dim=1)


def seat(height: float) -> TermFunction:
    """The hand, with the block so many metres above its place."""

    def pose(env: Environment[Jenga]) -> Tensor:
        goal = place(env)
        up = torch.tensor([0.0, 0.0, height], device=env.device)
        return torch.cat((goal[:, :3] + up, slanting(goal[:, 3:])), dim=1)

    return pose


def place_tower(env: Environment[Jenga, JengaMemory], env_ids: Tensor) -> None:
    """Build the tower again, up to 2 cm off its place and turned by up to 0.1 rad; the given block is in one of those
    layers between the third and the last but two whose blocks point to the robot."""  # fmt: skip
    middle = distance_of_tower(env.world.robots[common.ROBOT].spec)
    bounds = (middle - 0.02, -0.02, PLINTH, -0.1), (middle + 0.02, 0.02, PLINTH, 0.1)
    foot = common.standing(env.world.random.uniform((4,), *bounds, env_ids))
    number = (
        env.world.random.uniform((), 0.0, float(len(env.state.cells)), env_ids)
        .long()
        .clamp(max=len(env.state.cells) - 1)
    )
    chosen = env.state.cells[number][:, None]
    # The others fill the cells that are left, from the lowest.
    order = torch.arange(len(env.task.others), device=env.device).expand(len(env_ids), -1)
    poses = cell_poses(foot, order + (order >= chosen), env.task.layers)
    tabletop.put(env.world, env.task.others, poses, env_ids)
    own = cell_poses(foot, chosen, env.task.layers)[:, 0]
    out_and_down = torch.tensor([-env.task.protrusion, 0.0, -0.5 * env.task.slack], device=env.device).expand(
        len(own), 3
    )
    own = torch.cat((own[:, :3] + quat_rotate(own[:, 3:], out_and_down), own[:, 3:]), dim=1)
    env.world.objects[GIVEN].set_root_pose(own, env_ids)
    env.state.foot[env_ids], env.state.heights[env_ids], env.state.rest[env_ids] = foot, poses[..., 2], own


def distance_of_tower(robot: RobotSpec) -> float:
    """Metres from the robot to the tower's middle."""
    return common.workspace_of(robot).low[0] + 0.22


@dataclass
class JengaState(tabletop.ArmState):
    """The arm's joints and hand, the given block, the ways to it and on to its place, and the last action."""

    given_pose: ObservationTerm | None = ObservationTerm(given_pose, unit=POSE)
    hand_to_block: ObservationTerm | None = ObservationTerm(hand_to_block, unit="m")
    block_to_place: ObservationTerm | None = ObservationTerm(block_to_place, unit="m")
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class JengaRewards:
    """Rewards of the hand at the block, the block out of the tower and at its place, less a fall and what is abrupt."""

    reach: RewardTerm | None = RewardTerm(lambda env: common.nearness(vector_norm(hand_to_block(env), dim=1), 0.1), 1.0)
    """Nearness of the hand to its grasp of the block, within some 0.1 m."""
    pull: RewardTerm | None = RewardTerm(lambda env: out(env) / SIZE[0], 5.0)
    """Share of the block's length that is out of the tower, in [0, 1]."""
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 10.0)
    """Nearness of the drawn block to its place, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 10.0)
    """The same within 0.05 m, which decides the last centimetres."""
    let_go: RewardTerm | None = RewardTerm(lambda env: put_down(env).float(), 20.0)
    """1 in each step in which the block is at its place and the hand away from it."""
    fall: RewardTerm | None = RewardTerm(lambda env: fallen(env).float(), -50.0)
    """Penalty of the step in which the tower falls; it ends the episode."""
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-3)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-3)


@dataclass
class JengaTerminations:
    """An episode ends early where the tower falls."""

    fallen: TerminationTerm | None = TerminationTerm(fallen)


@dataclass
class JengaEvents(tabletop.ArmEvents):
    """Robot and tower are placed for each episode; friction and gains with domain randomisation."""

    place_tower: EventTerm | None = EventTerm(place_tower)


@dataclass
class JengaPremises:
    """The tower stands, and the given block is in it."""

    standing: PremiseTerm | None = PremiseTerm(
        lambda env: ~fallen(env) & (out(env) < env.task.protrusion + 0.005),
        "the tower does not stand by itself: a block has fallen, or the given one has slid out",
    )


@dataclass(kw_only=True)
class Jenga(tabletop.TabletopTask):
    """A tower of layers of three blocks each. One, which stands out a little, is to be pulled out and put on top.

    Succeeds when at the episode's end that block is within ``tolerance`` of its place, the hand has let go and the
    tower stands. Metric: the distance between block and place, and ``penalty`` more where the tower has fallen.
    """

    state_type: ClassVar[type[TaskState]] = JengaMemory
    metadata: TaskMetadata = TaskMetadata(
        instruction="pull a block out of the tower and put it on top",
        subtasks=(Subtask(grasp, lambda env: out(env) > 0.9 * SIZE[0]), Subtask(place, put_down)),
        ppo=PpoSettings(iterations=2000, initial_std=0.3, entropy_weight=0.005),
        view=look_at(eye=(0.1, 1.3, 0.75), target=(0.5, 0.0, 0.3)),
        exceptions=(
            TaskException(TaskCheck.START_AREA, "the tower must stand where the hand reaches around it"),
            TaskException(TaskCheck.START_YAW, "the given block must face the arm"),
        ),
    )
    episode_length: float = 10.0
    layers: int = 12
    """Of three blocks each: 7 to 16."""
    protrusion: float = 0.03
    """Metres of the given block that stand out, by which a gripper takes it: 0.02 to 0.05."""
    slack: float = 0.001
    """Metres by which the given block is lower than the others, so that it is loose: 0 to 0.003."""
    tolerance: float = 0.015
    """Metres."""
    penalty: float = 1.0
    """Metres that a fallen tower adds to the metric."""
    observations: tabletop.StateObservations = field(default_factory=tabletop.state(JengaState))
    rewards: JengaRewards = field(default_factory=JengaRewards)
    terminations: JengaTerminations = field(default_factory=JengaTerminations)
    events: JengaEvents = field(default_factory=JengaEvents)
    premises: JengaPremises = field(default_factory=JengaPremises)

    @property
    def others(self) -> tuple[str, ...]:
        """All blocks but the given one."""
        return tuple(f"block_{index}" for index in range(3 * self.layers - 1))

    def scene(self) -> Scene:
        self.bound(
            layers=(7, 16), protrusion=(0.02, 0.05), slack=(0.0, 0.003), tolerance=(1e-6, 0.05), penalty=(0.0, 1e3)
        )
        at = distance_of_tower(robot := task_robots.arm(self.robot))
        middle = Pose((at, 0.0, 0.5 * PLINTH))
        plinth = box("plinth", (0.2, 0.2, PLINTH), fixed_base=True, material=SMOOTH, pose=middle)
        looser = (*SIZE[:2], SIZE[2] - self.slack)
        kinds = (*((name, SIZE, WOOD) for name in self.others), (GIVEN, looser, RED))
        blocks = [
            box(name, size, color=color, material=SMOOTH, pose=pose)
            for (name, size, color), pose in zip(kinds, tower((at, 0.0, PLINTH), self.layers), strict=True)
        ]
        return self.bench(*blocks, plinth, robot=robot)

    def randomize(self) -> None:
        """The blocks' friction, the arm's gains, and noise on joints and the given block."""
        self.vary((*self.others, GIVEN), (0.2, 0.5), given_pose=0.001)

    def success(self, env: Environment) -> Tensor:
        return put_down(env) & ~fallen(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"distance_m": distance(env) + self.penalty * fallen(env)}

    def expert(self, env: Environment) -> Expert:
        closing, held = max(0.4, common.closing_time(env.world)), picking.hand_for
        phases = (
            Phase(picking.back(grasp, 0.1), position_tolerance=0.02, timeout=4.0, free=True),
            Phase(grasp, position_tolerance=0.003, rotation_tolerance=0.03, timeout=2.0),
            Phase(grasp, False, dwell=closing, timeout=closing + 0.1),
            Phase(pulled, False, position_tolerance=0.01, timeout=3.0),
            Phase(held(above, given_pose), False, position_tolerance=0.015, timeout=2.0),
            Phase(held(seat(0.03), given_pose), False, position_tolerance=0.006, rotation_tolerance=0.03, timeout=2.0),
            Phase(held(seat(0.001), given_pose), False, position_tolerance=0.002, rotation_tolerance=0.03, timeout=1.5),
            Phase(held(seat(0.001), given_pose), dwell=closing, timeout=closing + 0.1),
            Phase(picking.back(grasp, 0.12)),
        )
        return Expert(env, phases, position_lead=0.04, rotation_lead=0.2)
