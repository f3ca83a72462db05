"""A few demonstrations become many: cut at the boundaries of subtasks, moved to where things are now, done again.

The method is that of MimicGen (Mandlekar and others, MimicGen: A Data Generation System for Scalable Robot Learning
using Human Demonstrations, CoRL 2023): within a subtask the hand moves relative to one frame, wherever that is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import (
    pose_error,
    pose_inverse,
    pose_multiply,
    quat_from_rotation_vector,
    quat_multiply,
)
from orbit_core.interfaces import ConfigurationError
from orbit_core.rollout.estimates import Estimate, proportion
from orbit_core.rollout.stepping import StepObserver, roll_out
from orbit_data.episodes import ACTIONS, INITIAL, POSES, STATES, Dataset
from orbit_data.manifest.manifest import Manifest
from orbit_data.recording import DemonstrationRecorder, RecordingFile
from orbit_data.replay import EpisodePlayer

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment, EpisodeEnd

# Steps by which the pose asked for is ahead of the one that is to be reached.
_AHEAD = 2
# How much farther than that pose the hand is sent, for drives follow late; at most by the leads below.
_GAIN = 4.0
# m and rad
_LEADS = (0.06, 0.4)
# m and rad within which a pose counts as reached, and the next is due.
_NEAR = (0.01, 0.1)
# m from the subtask's frame at which a piece begins; where the hand never comes so near, it is whole.
_REACH = 0.13
# Steps after which the next pose is due all the same: where a piece begins, and within it.
_PATIENCE = (60, 10)


@dataclass(frozen=True)
class Pieces:
    """Demonstrations (D) cut into subtasks (K), each of up to L steps."""

    poses: Tensor
    """(D, K, L, 7) of the hand in the frame of the subtask; the last stands for those after the end."""
    gripper_open: Tensor
    """(D, K, L) bool"""
    lengths: Tensor
    """(D, K)"""


@dataclass(frozen=True)
class Augmented:
    """What came of it."""

    kept: int
    successes: int
    """More than are kept, where the last attempts gave more than were wanted."""
    attempts: int

    @property
    def share(self) -> Estimate:
        """Yield: attempts that succeeded, with the 95 % interval."""
        return proportion(self.successes, self.attempts)


def cut(environment: Environment, dataset: Dataset, positions: Sequence[int]) -> Pieces:
    """Cut demonstrations at the ends of the task's subtasks, which their states tell.

    Raises:
        ConfigurationError: the task names no subtasks, there are more demonstrations than environments, or a subtask
            never ends in one of them.
    """
    task, world = environment.task, environment.world
    subtasks = task.subtasks()
    episodes = [dataset.read(place, (ACTIONS, STATES, INITIAL, POSES)) for place in positions]
    player = EpisodePlayer(environment)
    rows, count = player.begin(episodes), len(episodes)
    longest = max(episode.info.length for episode in episodes)
    hands, frames, grips = [], [], []
    stage = torch.zeros(count, dtype=torch.int64, device=environment.device)
    stages: list[Tensor] = []
    for step in range(longest):
        now = [min(step, episode.info.length - 1) for episode in episodes]
        player.set_states([e.arrays[STATES][t] for e, t in zip(episodes, now, strict=True)], rows)
        actions = torch.stack([torch.from_numpy(e.arrays[ACTIONS][t]) for e, t in zip(episodes, now, strict=True)])
        ends = torch.stack([subtask.over(world, task)[:count] for subtask in subtasks[:-1]]) if subtasks[1:] else None
        hands.append(hand_pose(environment)[:count].clone())
        frames.append(torch.stack([subtask.frame(world, task)[:count] for subtask in subtasks], 1))
        grips.append(_opens(environment, actions.to(environment.device)))
        stages.append(stage.clone())
        if ends is not None:
            last = stage == len(subtasks) - 1
            stage = stage + (~last & ends[stage.clamp(max=len(subtasks) - 2), torch.arange(count)])
    if bool((stage < len(subtasks) - 1).any()):
        raise ConfigurationError(
            f"a subtask never ends in demonstration {int((stage < len(subtasks) - 1).nonzero()[0])} of {dataset.path}: "
            "keep those that succeed (orbit data filter --success)"
        )
    return _pieces(torch.stack(hands), torch.stack(frames), torch.stack(grips), torch.stack(stages), len(subtasks))


def _pieces(hands: Tensor, frames: Tensor, grips: Tensor, stages: Tensor, count: int) -> Pieces:
    """Of tensors (T, D, ...): the hand relative to where the subtask's frame was when the subtask began."""
    steps, demos = stages.shape
    lengths = torch.stack([(stages == k).sum(0) for k in range(count)], 1)
    first = lengths.cumsum(1) - lengths
    within = torch.arange(int(lengths.max()), device=hands.device)
    index = (first[..., None] + torch.minimum(within, lengths[..., None] - 1)).clamp(0, steps - 1)
    demo = torch.arange(demos, device=hands.device)
    kinds = torch.arange(count, device=hands.device)
    origin = frames[first, demo[:, None], kinds][:, :, None].expand(-1, -1, len(within), 7)
    relative = pose_multiply(pose_inverse(origin), hands[index, demo[:, None, None]])
    opened = grips[index, demo[:, None, None]]
    # How the hand came near, from wherever it was, is no part of the subtask, and may lead where no arm reaches.
    skipped = (relative[..., :3].norm(dim=-1) < _REACH).long().argmax(-1)
    left = torch.minimum(skipped[..., None] + within, lengths[..., None] - 1).clamp_min(0)
    relative = relative.gather(2, left[..., None].expand(*left.shape, 7))
    return Pieces(relative, opened.gather(2, left), lengths - skipped)


def hand_pose(environment: Environment) -> Tensor:
    """(N, 7) of the end effector of the robot that acts."""
    robot = environment.world.robots[environment.task.agents[0]]
    return robot.frame_pose(robot.spec.end_effector.frame)


def _opens(environment: Environment, actions: Tensor) -> Tensor:
    """(D,) bool whether actions (D, A) open the gripper: nearer to what opens it here than to what closes it."""
    hand = hand_pose(environment)
    yes = torch.ones(environment.num_envs, dtype=torch.bool, device=environment.device)
    opened, closed = (
        torch.cat([generator.encode(hand, which) for generator in environment.task.generators], 1)[: len(actions)]
        for which in (yes, ~yes)
    )
    moved = (opened - closed).abs() > 1e-6
    return ((actions - opened).abs() * moved).sum(1) <= ((actions - closed).abs() * moved).sum(1)


class PiecewiseActor:
    """Leads the hand, in each environment, through the pieces of a demonstration drawn at random.

    Args:
        environment: to act in.
        pieces: of demonstrations.
        seed: of the drawing.
    """

    def __init__(self, environment: Environment, pieces: Pieces, seed: int) -> None:
        self._environment, self._pieces = environment, pieces
        self._subtasks = environment.task.subtasks()
        self._draw = torch.Generator().manual_seed(seed)
        count, device = environment.num_envs, environment.device
        self._rows = torch.arange(count, device=device)
        self._demo = torch.zeros(count, dtype=torch.int64, device=device)
        self._stage = torch.zeros_like(self._demo)
        self._step = torch.zeros_like(self._demo)
        """Of the piece."""
        self._waited = torch.zeros_like(self._demo)
        self._frame = torch.zeros(count, 7, device=device)

    def act(self) -> Tensor:
        """(N, A) the next action."""
        hand, task = hand_pose(self._environment), self._environment.task
        begun = task.episode_step == 0
        drawn = torch.randint(len(self._pieces.lengths), begun.shape, generator=self._draw).to(hand.device)
        self._demo = torch.where(begun, drawn, self._demo)
        last = self._step >= self._pieces.lengths[self._demo, self._stage]
        onward = ~begun & last & (self._stage < len(self._subtasks) - 1)
        self._stage = torch.where(begun, 0, self._stage + onward)
        self._enter(begun | onward)
        pose = self._beyond(hand, self._at(self._step + _AHEAD * (self._step > 0)))
        grip = self._pieces.gripper_open[self._demo, self._stage, self._index(self._step)]
        action = torch.cat([generator.encode(pose, grip) for generator in task.generators], 1)
        self._advance(hand)
        return action.clamp(-1.0, 1.0)

    def _enter(self, new: Tensor) -> None:
        """Begin a piece where the subtask's frame is now."""
        world, task = self._environment.world, self._environment.task
        frames = torch.stack([subtask.frame(world, task) for subtask in self._subtasks], 1)
        self._frame = torch.where(new[:, None], frames[self._rows, self._stage], self._frame)
        self._step = torch.where(new, 0, self._step)
        self._waited = torch.where(new, 0, self._waited)

    def _advance(self, hand: Tensor) -> None:
        """The next pose is due once this one is reached, or has been waited for long enough."""
        error = pose_error(hand, self._at(self._step))
        near = (error[:, :3].norm(dim=1) < _NEAR[0]) & (error[:, 3:].norm(dim=1) < _NEAR[1])
        due = near | (self._waited >= torch.where(self._step == 0, *_PATIENCE))
        self._step = self._step + due
        self._waited = torch.where(due, 0, self._waited + 1)

    def _beyond(self, hand: Tensor, target: Tensor) -> Tensor:
        """(N, 7) on the straight way from the hand to a pose and beyond it."""
        error = pose_error(hand, target)
        parts = [error[:, :3], error[:, 3:]]
        lengths = [part.norm(dim=1, keepdim=True).clamp_min(1e-9) for part in parts]
        move, turn = (
            part * (lead / length).clamp(max=_GAIN) for part, length, lead in zip(parts, lengths, _LEADS, strict=True)
        )
        return torch.cat((hand[:, :3] + move, quat_multiply(quat_from_rotation_vector(turn), hand[:, 3:])), 1)

    def _at(self, step: Tensor) -> Tensor:
        """(N, 7) the hand's pose at a step of its piece, in the environment."""
        return pose_multiply(self._frame, self._pieces.poses[self._demo, self._stage, self._index(step)])

    def _index(self, step: Tensor) -> Tensor:
        return torch.minimum(step, self._pieces.lengths[self._demo, self._stage] - 1).clamp_min(0)


def augment(
    environment: Environment,
    pieces: Pieces,
    file: RecordingFile,
    task: str,
    episodes: int,
    seed: int,
    most_attempts: int,
    progress: Callable[[int], None] = lambda kept: None,
) -> Augmented:
    """Do the pieces of demonstrations in new episodes, and record those that succeed.

    Args:
        environment: that they are done in.
        pieces: of demonstrations.
        file: takes what succeeds.
        task: the name that the environment was made by.
        episodes: that are wanted.
        seed: of the environments' streams, and of which demonstration is drawn.
        most_attempts: after which to end with fewer.
        progress: told, after each step, how many are kept.
    """
    file.parts.begin(Manifest.of(environment, task, seed))
    environment.reset(seed)

    successes: list[int] = []

    def wanted(end: EpisodeEnd, _: Tensor) -> Tensor:
        successes.append(int(end.success.sum()))
        return end.success & (end.success.cumsum(0) + recorder.kept <= episodes)

    recorder = DemonstrationRecorder(environment, file.parts, wanted, seed)

    class Teller(StepObserver):
        def before_step(self) -> None:
            progress(recorder.kept)

    def complete() -> bool:
        return recorder.kept >= episodes or int(recorder.ended.sum()) >= most_attempts

    roll_out(environment, PiecewiseActor(environment, pieces, seed), (recorder, Teller()), complete)
    progress(recorder.kept)
    attempts = int(recorder.ended.sum())
    if not recorder.kept:
        raise ConfigurationError(f"none of {attempts} attempts succeeded: give other demonstrations")
    file.gather()
    return Augmented(recorder.kept, sum(successes), attempts)
