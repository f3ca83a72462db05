"""Augmentation: a few demonstrations become many, by replaying their subtasks relative to where objects are now.

Within a subtask the hand moves relative to one frame, and the demonstrated motion is repeated relative to that frame in
a new episode. On the way to where it begins the hand goes straight (Mandlekar and others, MimicGen: A Data Generation
System for Scalable Robot Learning using Human Demonstrations, CoRL 2023), or as a planner finds (Garrett and others,
SkillMimicGen: Automated Demonstration Generation for Efficient Skill Learning and Deployment, CoRL 2024).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

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
from orbit_data.formats import check_recordable
from orbit_data.manifest.manifest import Manifest
from orbit_data.recording import DemonstrationRecorder, RecordingFile
from orbit_data.replay import EpisodePlayer

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment, EpisodeEnd
    from orbit_core.envs.task import Subtask

# Steps by which the commanded pose is ahead of the one that must be reached next.
_AHEAD = 2
# Factor by which the command goes beyond that pose, because drives lag behind; limited by the leads below.
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
    """Poses (D, K, L, 7) of the hand in the frame of the subtask; the last one is repeated after the end."""
    gripper_open: Tensor
    """(D, K, L) bool"""
    lengths: Tensor
    """(D, K)"""


class Transits(Protocol):
    """Ways of the hand to where pieces begin, such as :class:`orbit_motion.planning.HandTransits`."""

    @property
    def active(self) -> Tensor:
        """(N,) bool: the hand is on its way."""
        ...

    def begin(self, target: Tensor, rows: Tensor, rise: Tensor) -> None:
        """Begin ways to poses ``target`` (N, 7) where ``rows`` (N,) bool, the hand going up first where ``rise``."""
        ...

    def act(self, gripper_open: Tensor) -> Tensor:
        """Return the action (N, A) that leads on, with the gripper as it is given (N,) bool."""
        ...


@dataclass(frozen=True)
class Augmented:
    """Outcome of an augmentation."""

    kept: int
    """Episodes that were written."""
    successes: int
    """Successful attempts: more than are kept if the last ones gave more than were requested."""
    attempts: int
    """Episodes that were tried."""

    @property
    def share(self) -> Estimate:
        """Yield: attempts that succeeded, with the 95 % interval."""
        return proportion(self.successes, self.attempts)


def cut(environment: Environment, dataset: Dataset, positions: Sequence[int]) -> Pieces:
    """Cut demonstrations at the ends of the task's subtasks, which are found from the recorded states.

    Raises:
        ConfigurationError: the task names no subtasks, there are more demonstrations than environments, or a subtask
            never ends in one of them.
    """
    subtasks = subtasks_of(environment)
    episodes = [dataset.read(place, (ACTIONS, STATES, INITIAL, POSES)) for place in positions]
    # States are set, not simulated: the recorded motion is cut exactly, on any engine.
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
        ends = torch.stack([subtask.over(environment)[:count] for subtask in subtasks[:-1]]) if subtasks[1:] else None
        hands.append(hand_pose(environment)[:count].clone())
        frames.append(torch.stack([subtask.frame(environment)[:count] for subtask in subtasks], 1))
        grips.append(opens_gripper(environment, actions.to(environment.device)))
        stages.append(stage.clone())
        if ends is not None:
            last = stage == len(subtasks) - 1
            stage = stage + (~last & ends[stage.clamp(max=len(subtasks) - 2), torch.arange(count)])
    if bool((stage < len(subtasks) - 1).any()):
        raise ConfigurationError(
            f"a subtask never ends in demonstration {int((stage < len(subtasks) - 1).nonzero()[0])} of {dataset.path}: "
            "keep those that succeed (orbit data filter --success)"
        )
    return _pieces(torch.stack(hands), torch.stack(frames), torch.stack(grips), torch.stack(stages), subtasks)


def _pieces(hands: Tensor, frames: Tensor, grips: Tensor, stages: Tensor, subtasks: Sequence[Subtask]) -> Pieces:
    """Compute the hand relative to where the subtask's frame was when the subtask began, of tensors (T, D, ...)."""
    (steps, demos), count = stages.shape, len(subtasks)
    lengths = torch.stack([(stages == k).sum(0) for k in range(count)], 1)
    first = lengths.cumsum(1) - lengths
    within = torch.arange(int(lengths.max()), device=hands.device)
    # Shorter pieces repeat their last step, so that all fit in one tensor.
    index = (first[..., None] + torch.minimum(within, lengths[..., None] - 1)).clamp(0, steps - 1)
    demo = torch.arange(demos, device=hands.device)
    kinds = torch.arange(count, device=hands.device)
    origin = frames[first, demo[:, None], kinds][:, :, None].expand(-1, -1, len(within), 7)
    relative = pose_multiply(pose_inverse(origin), hands[index, demo[:, None, None]])
    opened = grips[index, demo[:, None, None]]
    # The approach from a distant start is not part of the subtask, and elsewhere it may lead out of the arm's reach.
    free = torch.tensor([subtask.free for subtask in subtasks], device=hands.device)
    skipped = (relative[..., :3].norm(dim=-1) < _REACH).long().argmax(-1) * free
    left = torch.minimum(skipped[..., None] + within, lengths[..., None] - 1).clamp_min(0)
    relative = relative.gather(2, left[..., None].expand(*left.shape, 7))
    return Pieces(relative, opened.gather(2, left), lengths - skipped)


def subtasks_of(environment: Environment) -> tuple[Subtask, ...]:
    """Return the subtasks of a task.

    Raises:
        ConfigurationError: its metadata names none.
    """
    task = environment.task
    if not task.metadata.subtasks:
        raise ConfigurationError(
            f"the metadata of task {type(task).__name__} names no subtasks: give it "
            "TaskMetadata(subtasks=(Subtask(frame, over), ...))"
        )
    return task.metadata.subtasks


def hand_pose(environment: Environment) -> Tensor:
    """Return the pose (N, 7) of the end effector of the robot that acts."""
    robot = environment.world.robots[environment.task.agents[0]]
    return robot.frame_pose(robot.spec.end_effector.frame)


def opens_gripper(environment: Environment, actions: Tensor) -> Tensor:
    """Return whether (D,) actions (D, A) open the gripper: closer to the action that opens it than to its opposite."""
    hand = hand_pose(environment)
    yes = torch.ones(environment.num_envs, dtype=torch.bool, device=environment.device)
    opened, closed = (
        torch.cat([generator.encode(hand, which) for generator in environment.actions.generators], 1)[: len(actions)]
        for which in (yes, ~yes)
    )
    # Only the gripper's components differ between the two.
    moved = (opened - closed).abs() > 1e-6
    return ((actions - opened).abs() * moved).sum(1) <= ((actions - closed).abs() * moved).sum(1)


class PiecewiseActor:
    """Actor that leads the hand, in each environment, through the pieces of a randomly chosen demonstration.

    Args:
        environment: environment to act in.
        pieces: pieces of demonstrations.
        seed: seed of the random choice.
        transits: ways to where pieces begin; None goes straight.
    """

    def __init__(self, environment: Environment, pieces: Pieces, seed: int, transits: Transits | None = None) -> None:
        self._environment, self._pieces, self._transits = environment, pieces, transits
        self._subtasks = subtasks_of(environment)
        self._free = torch.tensor([subtask.free for subtask in self._subtasks], device=environment.device)
        self._draw = torch.Generator().manual_seed(seed)
        count, device = environment.num_envs, environment.device
        self._rows = torch.arange(count, device=device)
        self._demo = torch.zeros(count, dtype=torch.int64, device=device)
        self._stage = torch.zeros_like(self._demo)
        # Step (N,) within the piece.
        self._step = torch.zeros_like(self._demo)
        self._waited = torch.zeros_like(self._demo)
        self._frame = torch.zeros(count, 7, device=device)

    def act(self) -> Tensor:
        """Return the next action (N, A)."""
        hand, generators = hand_pose(self._environment), self._environment.actions.generators
        begun = self._environment.state.episode_step == 0
        drawn = torch.randint(len(self._pieces.lengths), begun.shape, generator=self._draw).to(hand.device)
        self._demo = torch.where(begun, drawn, self._demo)
        last = self._step >= self._pieces.lengths[self._demo, self._stage]
        onward = ~begun & last & (self._stage < len(self._subtasks) - 1)
        self._stage = torch.where(begun, 0, self._stage + onward)
        self._enter(begun | onward)
        if self._transits is not None:
            entered = (begun | onward) & self._free[self._stage]
            self._transits.begin(self._at(torch.zeros_like(self._step)), entered, ~begun)
        pose = self._beyond(hand, self._at(self._step + _AHEAD * (self._step > 0)))
        grip = self._pieces.gripper_open[self._demo, self._stage, self._index(self._step)]
        action = torch.cat([generator.encode(pose, grip) for generator in generators], 1)
        away = torch.zeros_like(begun)
        if self._transits is not None:
            led = self._transits.act(grip)
            # Read after it acted, which ends ways: the piece begins in the same step.
            away = self._transits.active
            action = torch.where(away[:, None], led, action)
        self._advance(hand, away)  # after the action, so that each pose is commanded for a step at least
        return action.clamp(-1.0, 1.0)

    def _enter(self, new: Tensor) -> None:
        """Begin a piece where the subtask's frame is now."""
        frames = torch.stack([subtask.frame(self._environment) for subtask in self._subtasks], 1)
        self._frame = torch.where(new[:, None], frames[self._rows, self._stage], self._frame)
        self._step = torch.where(new, 0, self._step)
        self._waited = torch.where(new, 0, self._waited)

    def _advance(self, hand: Tensor, away: Tensor) -> None:
        """Go on to the next pose once this one is reached, or the wait for it is over; not where ``away`` (N,)."""
        error = pose_error(hand, self._at(self._step))
        near = (error[:, :3].norm(dim=1) < _NEAR[0]) & (error[:, 3:].norm(dim=1) < _NEAR[1])
        due = near | (self._waited >= torch.where(self._step == 0, *_PATIENCE))
        self._step = self._step + (due & ~away)
        self._waited = torch.where(due | away, 0, self._waited + 1)

    def _beyond(self, hand: Tensor, target: Tensor) -> Tensor:
        """Return a pose (N, 7) on the straight line from the hand through the target and beyond it."""
        error = pose_error(hand, target)
        parts = [error[:, :3], error[:, 3:]]  # m and rad, each limited by its own lead
        lengths = [part.norm(dim=1, keepdim=True).clamp_min(1e-9) for part in parts]
        move, turn = (
            part * (lead / length).clamp(max=_GAIN) for part, length, lead in zip(parts, lengths, _LEADS, strict=True)
        )
        return torch.cat((hand[:, :3] + move, quat_multiply(quat_from_rotation_vector(turn), hand[:, 3:])), 1)

    def _at(self, step: Tensor) -> Tensor:
        """Return the hand's pose (N, 7) at a step of its piece, in the environment's frame."""
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
    instruction: str = "",
    transits: Transits | None = None,
) -> Augmented:
    """Repeat the pieces of demonstrations in new episodes, and record those that succeed.

    Args:
        environment: environment that runs the episodes.
        pieces: pieces of demonstrations.
        file: recording that receives the successful episodes.
        task: name that the environment was made by.
        episodes: number of successful episodes to keep.
        seed: seed of the environments' streams and of the choice of demonstrations.
        most_attempts: attempts after which to stop, even with fewer episodes.
        progress: called after each step with the number of kept episodes.
        instruction: what the episodes show, in words.
        transits: ways to where pieces begin; None goes straight.
    """
    manifest = Manifest.of(environment, task, seed)
    check_recordable(file.path, manifest)
    file.parts.begin(manifest)
    environment.reset(seed)

    successes: list[int] = []

    def wanted(end: EpisodeEnd, _: Tensor) -> Tensor:
        successes.append(int(end.success.sum()))
        # Of the episodes that end in one step only as many are kept as are still missing.
        return end.success & (end.success.cumsum(0) + recorder.kept <= episodes)

    recorder = DemonstrationRecorder(environment, file.parts, wanted, seed, instruction=instruction)

    class Teller(StepObserver):
        def before_step(self) -> None:
            progress(recorder.kept)

    def complete() -> bool:
        return recorder.kept >= episodes or int(recorder.ended.sum()) >= most_attempts

    roll_out(environment, PiecewiseActor(environment, pieces, seed, transits), (recorder, Teller()), complete)
    progress(recorder.kept)
    attempts = int(recorder.ended.sum())
    if not recorder.kept:
        raise ConfigurationError(f"none of {attempts} attempts succeeded: use other demonstrations")
    file.gather()
    return Augmented(recorder.kept, sum(successes), attempts)
