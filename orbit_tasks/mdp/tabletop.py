"""Base of tasks of an arm at the work bench: scene, groups of terms, randomisation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from orbit_assets.objects import BENCH_HEIGHT, work_bench
from orbit_core.envs import (
    Environment,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    PremiseTerm,
    TerminationTerm,
)
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import ROBOT, Task
from orbit_core.envs.terms import TermFunction, meaning_of, measured_in, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common, randomize
from orbit_core.mdp.randomize import Range
from orbit_core.scene import ObjectSpec, RobotSpec, Scene
from orbit_motion import workspace as task_robots
from orbit_tasks.mdp import picking, premises


class TabletopMemory(TaskState):
    """State of tasks at the bench, looked up once in a new world."""

    arm_joints: Tensor
    """(A,) indices of the joints that move the first arm's hand."""

    def start(self, env: Environment) -> None:
        robot = env.world.robots[env.task.agents[0]]
        # Indices and not names, which a captured step could not look up.
        self.arm_joints = torch.tensor(robot.find_joints(*robot.spec.end_effector.arm_joints), device=env.device)


@once_per_state
def piece_poses(env: Environment[TabletopTask]) -> Tensor:
    """(N, B, 7) of the task's pieces, in order."""
    return torch.stack([env.world.objects[name].root_pose for name in env.task.pieces], dim=1)


def piece_turns(env: Environment[TabletopTask]) -> Tensor:
    """(N, B) rad, at most an eighth of a turn: by how much pieces that are square are turned against the hand."""
    hand = common.turn_facing_down(common.hand_pose(env)[:, 3:])
    # A square looks the same after a quarter turn, so that larger angles would describe one state in four ways.
    return picking.quarter(picking.quarter_yaw(piece_poses(env)[..., 3:]) - hand[:, None])


def dropped(env: Environment[TabletopTask]) -> Tensor:
    """(N,) bool: one of the task's pieces fell off the table."""
    # Below the table's top by more than a piece can sink in.
    return (piece_poses(env)[..., 2] < -0.05).any(1)


def fine(term: TermFunction, scale: float = 0.01) -> ObservationTerm:
    """The term in [-1, 1]: its hyperbolic tangent in units of ``scale``, for values to distinguish near zero."""
    own = meaning_of(ObservationTerm(term))
    meaning = replace(own, formula=f"tanh(x / {scale:g}), where x is: {own.formula}")
    return ObservationTerm(lambda env: torch.tanh(term(env) / scale), unit="1", meaning=meaning)


def put(world: World, names: Sequence[str], poses: Tensor, env_ids: Tensor) -> None:
    """Put objects to poses (n, len(names), 7), one each, in the environments' frames."""
    for index, name in enumerate(names):
        world.objects[name].set_root_pose(poses[:, index], env_ids)


def pieces_stand(height: float) -> PremiseTerm:
    """Premise: the pieces stand free on the table, their origins ``height`` (m) above it."""
    return PremiseTerm(
        lambda env: premises.standing(env.world, env.task.pieces, height),
        "a block does not stand still and upright on the table, so that it began inside another thing, or fell over",
    )


@dataclass
class ArmState(ObservationGroup):
    """The arm's joints and its hand. Tasks add what is moved, and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)


@measured_in("rad/s or m/s")
def arm_velocities(env: Environment[TabletopTask, TabletopMemory]) -> Tensor:
    """(N, A) of the joints that move the first arm's hand, without its fingers."""
    return env.world.robots[env.task.agents[0]].joint_velocities.index_select(1, env.state.arm_joints)


@dataclass
class GraspState(ArmState):
    """Without the fingers' velocities: of fingers that rest on what they hold engines report none, or 0.13 m/s."""

    joint_velocities: ObservationTerm | None = ObservationTerm(arm_velocities)


@dataclass
class StateObservations:
    """State for ``policy`` and ``critic``, or for ``critic`` and ``teacher`` where the policy sees less."""

    policy: ObservationGroup
    critic: ObservationGroup | None = None
    teacher: ObservationGroup | None = None


def state(group: Callable[[], ObservationGroup]) -> Callable[[], StateObservations]:
    """Makes a task's observations: the state in that group of terms."""
    return lambda: StateObservations(group())


def sensed(
    sensors: Callable[[], ObservationGroup], group: Callable[[], ObservationGroup]
) -> Callable[[], StateObservations]:
    """Makes a task's observations: the policy sees what sensors show, critic and teacher the state in that group."""
    # A group each for critic and teacher: settings of one must not change the other.
    return lambda: StateObservations(sensors(), group(), group())


@dataclass
class DropTerminations:
    """An episode ends early where one of the task's pieces falls off the table."""

    dropped: TerminationTerm | None = TerminationTerm(dropped)


@dataclass
class ArmEvents:
    """The arm is placed for each episode; with domain randomisation friction and its gains differ between
    environments. Tasks add what else is placed."""  # fmt: skip

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    friction: EventTerm | None = None
    """Friction of the pieces; set by domain randomisation (:meth:`TabletopTask.vary`)."""
    gains: EventTerm | None = None
    """Scales of the arm's stiffness and damping; set by domain randomisation."""


@dataclass(kw_only=True)
class TabletopTask(Task):
    """An arm at the work bench, which moves the task's ``pieces``. Its ``events`` are :class:`ArmEvents`."""

    state_type: ClassVar[type[TaskState]] = TabletopMemory
    robot: str = "franka_panda"
    action: str = "joint_position"

    @property
    def pieces(self) -> tuple[str, ...]:
        """Names of the objects that are moved."""
        return ()

    def bench(self, *objects: ObjectSpec, robot: RobotSpec | None = None) -> Scene:
        """The arm, or the ``robot`` in its place, with objects on the work bench."""
        return Scene(
            robots=(robot or task_robots.arm(self.robot),),
            objects=(*objects, work_bench()),
            terrain=(common.floor(-BENCH_HEIGHT),),
            physics_dt=self.physics_dt,
        )

    def vary(self, rubbing: Sequence[str], friction: tuple[float, float], **noise: float) -> None:
        """Randomise between environments, and give what is observed noise.

        Args:
            rubbing: the entities whose friction is drawn.
            friction: its least and its greatest value.
            noise: standard deviations of observed terms, by name; joints have theirs.
        """
        self.events.friction = EventTerm(randomize.friction(rubbing, Range(*friction)), EventTime.STARTUP)
        self.events.gains = EventTerm(randomize.uncertain_gains(ROBOT), EventTime.STARTUP)
        common.add_noise(self.observations.policy, joint_positions=0.005, joint_velocities=0.05, **noise)
