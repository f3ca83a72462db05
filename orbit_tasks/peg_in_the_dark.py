"""Peg-In-The-Dark: put a block into its hole by touch, whose place is known within a centimetre only."""

# Groups of terms, and what a task remembers, are extended by deriving from them.
# pyright: reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar

import torch
from torch import Tensor

from orbit_assets.pegs import BOARD_HEIGHT, TILE, section
from orbit_core.envs import Environment, EventTerm, ObservationTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, means, measured_in
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_core.scene import Scene
from orbit_motion.experts import Expert, Phase, Retry
from orbit_tasks.mdp import picking, tabletop, touch
from orbit_tasks.peg_in_hole import (
    GENTLE,
    HASTE,
    PegEvents,
    PegInHole,
    PegMemory,
    PegState,
)

# Newtons on both pads together, along the hand's way, that count as a touch: a block of 0.1 kg that starts to move
# pushes with less, and a hand that goes on pushes with some 10 N.
_TOUCH = 0.8
# Metres beyond the place that is looked for at which a hand begins to feel for it, and up to which it goes on.
_MARGIN = 0.006
# Metres by which a hand that feels its way is led: it moves by some 2 cm/s, and stops within 0.2 mm of a touch.
_FEELING = 0.005
# Metres from a block's base to where the pads hold it: low, so that it does not turn between them where it is pushed
# at its base, and as high as the fingers' ends stay above the board.
_GRIP = 0.042
# Metres of the block's base above the table while it feels for the board's sides, and while it is carried.
_LOW, _HIGH = 0.012, 0.06
# Metres to either side up to which the block is swept over the rim, and m/s: it turns a little between the pads while
# it is carried and pushed. At this speed it is over a hole of 2 mm more than its width for 0.4 s.
_SWEEP, _SPEED = 0.0025, 0.006
# Metres below the height at which the block is on the rim from which on it is in the hole.
_SUNK = 0.004


class DarkMemory(PegMemory):
    """State of a block and a hole in the dark: where the hole is said to be, and how pads are turned in the hand."""

    stated: Tensor = buffer(2)
    """(N, 2) m, the hole's place as far as it is known."""
    turns: Tensor
    """(2, 4) rotations from the pads' axes to the hand's."""

    def start(self, env: Environment[PegInTheDark]) -> None:
        super().start(env)
        self.turns = env.task.pads(env.world.robots[common.ROBOT].spec).turns.to(env.device)


@means("place of the hole, off by up to the task's 'uncertainty' along x and y", ENVIRONMENT)
@measured_in("m")
def stated_place(env: Environment[PegInTheDark, DarkMemory]) -> Tensor:
    """(N, 2) the hole's place as far as it is known, in the environment's frame."""
    return env.state.stated


def place_board(env: Environment[PegInTheDark, DarkMemory], env_ids: Tensor) -> None:
    """Place the board at the far side of the workspace, not turned, and draw by how much its place is known wrongly."""
    low, high = common.workspace(env.world)
    far, middle, off = high[0] - 0.06, 0.5 * (low[1] + high[1]), env.task.uncertainty
    bounds = (far - 0.03, middle - 0.06, -off, -off), (far, middle + 0.06, off, off)
    drawn = env.world.random.uniform((4,), *bounds, env_ids)
    env.state.stated[env_ids] = drawn[:, :2] + drawn[:, 2:]
    pose = torch.cat((drawn[:, :2], torch.zeros_like(drawn[:, :2])), dim=1)
    env.world.objects["board"].set_root_pose(common.standing(pose), env_ids)


def place_block(env: Environment[PegInTheDark], env_ids: Tensor) -> None:
    """Stand the block on its place before the board, off by up to 2 mm, and turned by up to 0.05 rad."""
    x, y = rack(env)
    bounds = (x - 0.002, y - 0.002, 0.0, -0.05), (x + 0.002, y + 0.002, 0.0, 0.05)
    poses = common.standing(env.world.random.uniform((4,), *bounds, env_ids))
    tabletop.put(env.world, env.task.pieces, poses[:, None], env_ids)


def rack(env: Environment[PegInTheDark]) -> tuple[float, float]:
    """Return where the block stands at first, within 2 mm, in the environment's frame."""
    low, high = common.workspace(env.world)
    return low[0] + 0.01, 0.5 * (low[1] + high[1])


@dataclass
class DarkState(tabletop.GraspState):
    """The arm's joints, the hand, the hole's place as far as it is known, the taxels of both pads, the last action."""

    stated_place: ObservationTerm | None = ObservationTerm(stated_place)
    first_pad: ObservationTerm | None = None
    """Forces on the taxels of one finger; given by the task where it has touch."""
    second_pad: ObservationTerm | None = None
    """The same of the other finger."""
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class DarkEvents(PegEvents):
    """Robot, board and block are placed for each episode, and the hole's place is stated wrongly."""

    place_board: EventTerm | None = EventTerm(place_board)
    place_blocks: EventTerm | None = EventTerm(place_block)


@dataclass(kw_only=True)
class PegInTheDark(PegInHole):
    """A block stands at a known place, and a board somewhere near where it is said to be. Nothing is seen.

    The policy observes the arm, the hole's place, wrong by up to ``uncertainty`` along x and y, and the taxels of two
    pads on the fingers. Success and metric are those of Peg-In-Hole.
    """

    state_type: ClassVar[type[TaskState]] = DarkMemory
    metadata: TaskMetadata = TaskMetadata(
        instruction="feel for the hole and put the peg into it",
        ppo=PpoSettings(iterations=1500, initial_std=0.4, entropy_weight=0.001),
        exceptions=(TaskException(TaskCheck.START_AREA, "the block starts at a known place, as nothing is seen"),),
        training={"expert_starts": 0.5, "action": "ik_relative"},
    )
    episode_length: float = 16.0
    uncertainty: float = 0.01
    """Metres by which the hole's place is known wrongly at most, along x and along y."""
    touch: bool = True
    """False takes the pads away, for comparison: the expert then pushes where the hole is said to be."""
    observations: tabletop.StateObservations = field(default_factory=tabletop.sensed(DarkState, PegState))
    events: DarkEvents = field(default_factory=DarkEvents)

    def __post_init__(self) -> None:
        # The base's subtasks are those of a hand that sees.
        self.metadata = replace(self.metadata, subtasks=())

    def pads(self, robot: touch.RobotSpec) -> touch.Pads:
        """Return the pads of the robot's fingers."""
        return touch.finger_pads(robot, size=(0.016, 0.018), taxels=(4, 4))

    def scene(self) -> Scene:
        self.bound(uncertainty=(0.0, 0.015))
        if len(self.shapes) != 1:
            raise ConfigurationError(
                f"task PegInTheDark has {len(self.shapes)} shapes: give one, whose hole's place is stated"
            )
        scene = super().scene()
        if not self.touch:
            return scene
        pads = self.pads(scene.robots[0]).specs
        policy = self.observations.policy
        if isinstance(policy, DarkState):
            policy.first_pad, policy.second_pad = (touch.taxels(index, pad) for index, pad in enumerate(pads))
        return replace(scene, sensors=(*scene.sensors, *pads))

    def randomize(self) -> None:
        """The blocks' friction, the board's and the fingers', the arm's gains, and noise on joints."""
        self.vary((*self.pieces, "board"), (0.2, 0.5))

    def expert(self, env: Environment) -> Expert:
        return FeelingExpert(env)


class FeelingExpert(Expert):
    """Expert that brings the block against two sides of the board, and knows then where the hole is.

    It reads the arm, the place that is stated and the pads. Without pads it goes to the place that is stated.
    """  # fmt: skip

    def __init__(self, env: Environment[PegInTheDark]) -> None:
        self._task_env = env
        self._sides = torch.zeros(env.num_envs, 2, device=env.device)
        self._felt = torch.zeros(env.num_envs, 2, dtype=torch.bool, device=env.device)
        # Metres that the block has been swept over the rim.
        self._swept = torch.zeros(env.num_envs, device=env.device)
        # Metres between hand and hole, along x and along y, while the block touches a side of the board.
        self._apart = 0.5 * TILE + 0.5 * section(env.task.shapes[0]).width
        closing = max(0.4, common.closing_time(env.world))
        phases, self._probes, self._search = _phases(self, env, closing)
        # Slowly: what accelerates the hand turns the block between the pads.
        super().__init__(env, phases, 0.03)

    def reset(self, env_ids: Tensor | None = None) -> None:
        super().reset(env_ids)
        rows = slice(None) if env_ids is None else env_ids
        self._felt[rows] = False
        self._swept[rows] = 0.0

    def memory(self) -> Mapping[str, Tensor]:
        return {**super().memory(), "sides": self._sides, "felt": self._felt, "swept": self._swept}

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        env = self._task_env
        if env.task.touch:
            hand = common.hand_pose(env)
            # Pushed back by the board, the block pushes the fingers against their way, which is x and then y.
            push = touch.forces(env.world, env.state.turns, hand[:, 3:]).sum(1)
            for axis, phase in enumerate(self._probes):
                new = (self.phase == phase) & (push[:, axis] < -_TOUCH) & ~self._felt[:, axis]
                self._sides[:, axis] = torch.where(new, hand[:, axis], self._sides[:, axis])
                self._felt[:, axis] |= new
            # The rim bears the block: pads are pushed up by it instead of being pulled down by its weight.
            on_rim = (self.phase == self._search) & (push[:, 2] > 0.0)
            self._swept += torch.where(on_rim, _SPEED * env.step_dt, 0.0)
        return super().compute(inputs)

    def hole(self) -> Tensor:
        """(N, 2) m where the hand is when the block is over the hole, by what was felt and else by what is stated."""
        return torch.where(self._felt, self._sides + self._apart, self._task_env.state.stated)

    def before(self, env: Environment[PegInTheDark, DarkMemory], axis: int, height: float) -> Tensor:
        """(N, 7) the hand with the block before a side of the board, as far off as the place may be wrong."""
        place = self.hole().clone()
        place[:, axis] = env.state.stated[:, axis] - self._apart - env.task.uncertainty - _MARGIN
        return _down(place, _GRIP + height)

    def probing(self, env: Environment[PegInTheDark, DarkMemory], axis: int) -> Tensor:
        """(N, 7) the hand on its way along an axis to a side of the board; where it is once it has felt that."""
        hand, start = common.hand_pose(env), self.before(env, axis, _LOW)
        end = start[:, axis] + 2.0 * (env.task.uncertainty + _MARGIN)
        ahead = torch.minimum(hand[:, axis] + _FEELING, end)
        done = self._felt[:, axis] | (not env.task.touch)
        target = start.clone()
        target[:, axis] = ahead
        return torch.where(done[:, None], hand, target)

    def over(self, env: Environment, height: float) -> Tensor:
        """(N, 7) the hand with the block ``height`` (m) above the table, over the hole, with its sweep."""
        place = self.hole().clone()
        # A triangle: from the middle to one side, to the other and back.
        turn = torch.remainder(self._swept + _SWEEP, 4.0 * _SWEEP)
        place[:, 0] += torch.minimum(turn, 4.0 * _SWEEP - turn) - _SWEEP
        return _down(place, _GRIP + height)

    def searching(self, env: Environment) -> Tensor:
        """(N, 7) the hand that presses the block on the rim and sweeps it, or where it is once the block is in."""
        hand, goal = common.hand_pose(env), self.over(env, 0.0)
        # Drives are slow near their target: several times the way is asked for.
        place = hand[:, :2] + HASTE * (goal[:, :2] - hand[:, :2])
        down = torch.where(hand[:, 2] > _GRIP + BOARD_HEIGHT + 0.006, 0.006, GENTLE)
        return torch.where(self.sunk(env)[:, None], hand, _down(place, hand[:, 2] - down))

    def sunk(self, env: Environment) -> Tensor:
        """(N,) bool: the hand is lower than it would be with the block on the board."""
        return common.hand_pose(env)[:, 2] < _GRIP + BOARD_HEIGHT - _SUNK

    def pushing(self, env: Environment) -> Tensor:
        """(N, 7) the hand that pushes the block down, wherever it is."""
        hand = common.hand_pose(env)
        return _down(hand[:, :2], torch.clamp(hand[:, 2] - 0.006, min=_GRIP - 0.003))


def _down(place: Tensor, height: float | Tensor) -> Tensor:
    """(N, 7) the hand at (N, 2) m, pointing down and not turned."""
    z = height if isinstance(height, Tensor) else torch.full_like(place[:, 0], height)
    return common.pointing_down(torch.cat((place, z[:, None]), dim=1))


def _phases(
    expert: FeelingExpert, env: Environment[PegInTheDark], closing: float
) -> tuple[Sequence[Phase], tuple[int, int], int]:
    """Return the phases of an expert, the numbers of those that feel along x and y, and of the search."""
    x, y = rack(env)
    at = partial(_grasp, x=x, y=y)
    grasping = (
        Phase(picking.raised(at, 0.1), position_tolerance=0.02, free=True),
        Phase(at, position_tolerance=0.004, timeout=1.5),
        Phase(at, gripper_open=False, dwell=closing, timeout=closing + 0.1),
        Phase(picking.straight_up(_GRIP + _HIGH), False, position_tolerance=0.02, timeout=1.5),
    )
    sides = []
    for axis in (0, 1):
        high, low = (partial(expert.before, axis=axis, height=height) for height in (_HIGH, _LOW))
        sides += [
            Phase(high, False, position_tolerance=0.02, timeout=3.0),
            Phase(low, False, position_tolerance=0.004, timeout=1.5),
            Phase(partial(expert.probing, axis=axis), False, position_tolerance=0.001, timeout=4.0),
            Phase(low, False, position_tolerance=0.01, timeout=1.0),
            Phase(high, False, position_tolerance=0.02, timeout=1.5),
        ]
    above = partial(expert.over, height=BOARD_HEIGHT + 0.015)
    insertion = (
        Phase(above, False, position_tolerance=0.004, rotation_tolerance=0.03, timeout=3.0),
        Phase(expert.searching, False, position_tolerance=0.001, timeout=5.0, retry=Retry(2, expert.sunk, most=1)),
        Phase(expert.pushing, False, position_tolerance=0.004, timeout=2.0),
        Phase(picking.straight_up(_GRIP), dwell=closing, timeout=closing + 0.1),
        Phase(picking.straight_up(_GRIP + 0.1), position_tolerance=0.04, timeout=1.0),
    )
    first, last = len(grasping), len(grasping) + len(sides)
    return (*grasping, *sides, *insertion), (first + 2, first + 7), last + 1


def _grasp(env: Environment, x: float, y: float) -> Tensor:
    """(N, 7) the hand around the knob of a block that stands at its place."""
    hand = common.hand_pose(env)
    place = torch.tensor([x, y], device=hand.device).expand(len(hand), 2)
    return _down(place, _GRIP)
