"""Fluid-Transport: take a full cup by its handle and carry it to a sampled position without spilling."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import CommandTerm, Environment, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, Bounds, Meaning, once_per_state
from orbit_core.mdp import common
from orbit_core.mdp.commands import UniformPositionCommand, generated_command
from orbit_core.scene import Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks.lift import GOAL
from orbit_tasks.mdp import fluid, tabletop
from orbit_tasks.mdp.fluid import RAISED, in_cup

LIFTED = 0.02
"""Metres off the stand at which the cup counts as lifted."""


RAISING = 0.03
"""Metres above its stand from which on a cup is carried aside."""


@once_per_state
def cup_to_goal(env: Environment[FluidTransport]) -> Tensor:
    """(N, 3) m from the cup's middle to the goal."""
    return env.commands["goal"] - fluid.middle(env)


@once_per_state
def goal_distance(env: Environment[FluidTransport]) -> Tensor:
    """(N,) metres between the cup's middle and the goal."""
    return vector_norm(cup_to_goal(env), dim=1)


@once_per_state
def lifted(env: Environment[FluidTransport]) -> Tensor:
    """(N,) 1 where the cup is off its stand, else 0."""
    return (fluid.cup_pose(env)[:, 2] > RAISED + fluid.WALL + LIFTED).float()


def tracking(env: Environment[FluidTransport], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near a lifted cup is to the goal, times the part of the liquid that is in it."""
    # Counts once it is lifted: tipping the cup towards the goal would pay as well.
    return lifted(env) * in_cup(env) * common.nearness(goal_distance(env), scale)


@dataclass(unsafe_hash=True, kw_only=True)
class CupGoal(UniformPositionCommand):
    """Position of the cup's middle, 5 to 20 cm above where it stands and to the robot's left."""

    marker: str | None = "goal"

    def reach(self, env: Environment[FluidTransport]) -> dict[str, Bounds]:
        x, y = env.task.place
        height = RAISED + 0.5 * fluid.INNER[2]
        return {"x": (x - 0.08, x + 0.05), "y": (y + 0.1, y + 0.3), "z": (height + 0.05, height + 0.2)}


def at_goal(env: Environment[FluidTransport]) -> Tensor:
    """(N, 7) the hand that brings the cup's middle to the goal, upright, as it hangs in the hand now."""
    return fluid.carrying(lambda env: env.commands["goal"])(env)


def raised(env: Environment[FluidTransport]) -> Tensor:
    """(N, 7) the hand with the cup 5 cm above its stand."""

    def place(env: Environment[FluidTransport]) -> Tensor:
        height = RAISED + 0.5 * fluid.INNER[2] + 0.05
        above = fluid.middle(env).clone()
        above[:, 2] = height
        return above

    return fluid.carrying(place)(env)


def _stage(env: Environment[FluidTransport], opening: common.GripperOpening) -> Tensor:
    """(N,) int64: the expert's phase, by the state only."""
    stage, held = fluid.taking_stage(env, opening())
    low = fluid.cup_pose(env)[:, 2] < RAISED + fluid.WALL + RAISING
    return torch.where(held, torch.where(low, 3, 4), stage)


@dataclass
class FluidTransportState(fluid.CupState):
    """The arm's joints and hand, the cup, how much is in it, ways to handle and goal, the goal and the last action."""

    joint_velocities: ObservationTerm | None = ObservationTerm(tabletop.arm_velocities)
    fine_hand_to_handle: ObservationTerm | None = tabletop.fine(fluid.hand_to_handle)
    fine_cup_to_goal: ObservationTerm | None = tabletop.fine(cup_to_goal)
    hand_to_handle: ObservationTerm | None = ObservationTerm(fluid.hand_to_handle, unit="m")
    cup_to_goal: ObservationTerm | None = ObservationTerm(cup_to_goal, unit="m")
    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"),
        unit="m",
        meaning=Meaning("position that the cup's middle is to be carried to", ENVIRONMENT),
    )


@dataclass
class FluidTransportObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: FluidTransportState = field(default_factory=FluidTransportState)
    critic: ObservationGroup | None = None


@dataclass
class FluidTransportRewards(fluid.CupRewards):
    """Rewards of the hand at the handle, the cup off its stand and at its goal, less what is spilt or abrupt."""

    lift: RewardTerm | None = RewardTerm(lifted, 4.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 16.0)
    """Nearness of the lifted cup to the goal within some 0.3 m, times the share of liquid in it."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    """The same within 0.05 m, which decides the last centimetres."""
    spill: RewardTerm | None = RewardTerm(fluid.spilt((in_cup,)), -8.0)


@dataclass
class FluidTransportCommands:
    """The position that the cup's middle is to be carried to."""

    goal: CommandTerm | None = CupGoal()


@dataclass(kw_only=True)
class FluidTransport(fluid.CupTask):
    """A filled cup stands anywhere on a patch of the table; its goal is in the air to the robot's left.

    Succeeds when the cup's middle is within ``tolerance`` of the goal and ``least_kept`` of the liquid is in it at the
    episode's end. Metrics: that distance, and that part.
    """

    state_type: ClassVar[type[TaskState]] = tabletop.TabletopMemory
    metadata: TaskMetadata = replace(
        fluid.CupTask.metadata,
        view=look_at(eye=(1.25, 0.55, 0.75), target=(0.5, 0.0, 0.2)),
        training={"expert_starts": 0.5, "action": "ik_relative"},
    )
    episode_length: float = 7.0
    tolerance: float = 0.03
    """Metres."""
    least_kept: float = 0.95
    observations: FluidTransportObservations = field(default_factory=FluidTransportObservations)
    rewards: FluidTransportRewards = field(default_factory=FluidTransportRewards)
    events: fluid.CupEvents = field(default_factory=fluid.CupEvents)
    commands: FluidTransportCommands = field(default_factory=FluidTransportCommands)

    def scene(self) -> Scene:
        return self.with_cup(markers=(GOAL,))

    def success(self, env: Environment) -> Tensor:
        return (goal_distance(env) < self.tolerance) & (in_cup(env) >= self.least_kept)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(env), "kept": in_cup(env)}

    def expert(self, env: Environment) -> Expert:
        return Expert(
            env,
            (
                *fluid.taking(env.world),
                # Straight up first: led aslant, the cup would scrape along its stand.
                Phase(raised, gripper_open=False, position_tolerance=0.02, timeout=1.5),
                Phase(at_goal, gripper_open=False, least=0.01),
            ),
            stage=partial(_stage, opening=common.GripperOpening(env.world)),
        )
