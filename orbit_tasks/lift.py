"""Lift: grasp a cube on the table and hold it at a sampled position."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.object_kinds import BoxConfig
from orbit_assets.objects import BENCH_HEIGHT, work_bench
from orbit_core.envs import (
    CommandTerm,
    Environment,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
    Task,
    TerminationTerm,
)
from orbit_core.envs.off_policy import OffPolicySettings
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import Subtask, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, POSE, Bounds, Meaning, means, measured_in, once_per_state
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.mdp import common, randomize
from orbit_core.mdp.commands import UniformPositionCommand
from orbit_core.mdp.randomize import Range
from orbit_core.objects import ObjectConfig
from orbit_core.scene import MarkerShape, MarkerSpec, ObjectSpec, Pose, Scene
from orbit_core.scene.pose import Vector3
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import picking, stages
from orbit_tasks.pixels import ArmPixels


class LiftMemory(TaskState):
    """State of a lift, looked up once in a new world."""

    rest_height: float
    """Metres from the table to the middle of a cube that stands on it."""
    surface: float = 0.0
    """Height of the table's top in the environment's frame, m."""

    def start(self, env: Environment) -> None:
        self.rest_height = env.task.cube.rest_height


@means("pose of the cube's origin", ENVIRONMENT)
@measured_in(POSE)
def cube_pose(env: Environment[Lift]) -> Tensor:
    """(N, 7) of the cube in the environment's frame."""
    return env.world.objects["cube"].root_pose


@once_per_state
def cube_position(env: Environment[Lift]) -> Tensor:
    """(N, 3) of the cube in the environment's frame."""
    return cube_pose(env)[:, :3]


@once_per_state
def cube_height(env: Environment[Lift, LiftMemory]) -> Tensor:
    """(N,) metres of the cube's centre above the table."""
    return cube_pose(env)[:, 2] - env.state.surface


@means("position of the cube's origin minus that of the end effector's frame", ENVIRONMENT)
@measured_in("m")
@once_per_state
def hand_to_cube(env: Environment[Lift]) -> Tensor:
    """(N, 3) from the hand to the cube."""
    return cube_position(env) - common.hand_position(env)


@once_per_state
def goal_distance(env: Environment[Lift]) -> Tensor:
    """(N,) between cube and goal."""
    return vector_norm(env.commands["goal"] - cube_position(env), dim=1)


def dropped(env: Environment[Lift]) -> Tensor:
    """(N,) the cube fell off the table."""
    return cube_height(env) < -0.05


def reaching(env: Environment[Lift]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the cube."""
    return common.nearness(vector_norm(hand_to_cube(env), dim=1), 0.1)


@once_per_state
def lifted(env: Environment[Lift, LiftMemory]) -> Tensor:
    """(N,) 1 where the cube is off the table, else 0."""
    # By its own half height: a cube that is tilted on an edge is lower than that.
    return (cube_height(env) > 2.0 * env.state.rest_height).float()


def tracking(env: Environment[Lift], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near a lifted cube is to the goal."""
    # Counts once it is lifted: a cube that is pushed along the table comes nearer as well.
    return lifted(env) * common.nearness(goal_distance(env), scale)


def patch(world: World) -> tuple[tuple[float, float], tuple[float, float]]:
    """Corners of the workspace seen from above, less 5 cm at its far side."""
    low, high = common.workspace(world)
    return low[:2], (high[0] - 0.05, high[1])


def narrowed(bounds: Bounds, spread: float) -> Bounds:
    """Return the middle part of a range, a share ``spread`` of it.

    Raises:
        ConfigurationError: the share is not between 0 and 1.
    """
    if not 0.0 <= spread <= 1.0:
        raise ConfigurationError(f"a spread is the share of a range, between 0 and 1, not {spread:g}")
    margin = 0.5 * (1.0 - spread) * (bounds[1] - bounds[0])
    return bounds[0] + margin, bounds[1] - margin


def place_cube(env: Environment[Lift, LiftMemory], env_ids: Tensor) -> None:
    """Place the cube on a patch of the table in the hand's workspace, 20 x 50 cm for a Panda, turned by any angle."""
    height, (low, high), spread = env.state.rest_height, patch(env.world), env.task.start_spread
    (left, right), (near, far) = (narrowed(bounds, spread) for bounds in zip(low, high, strict=True))
    # Starts and turns narrow together, so that a spread of 0 is one start.
    turn = math.pi * spread
    place = env.world.random.uniform((4,), (left, near, height, -turn), (right, far, height, turn), env_ids)
    pose = common.standing(place)
    env.world.objects["cube"].set_root_pose(pose, env_ids)


@dataclass(unsafe_hash=True, kw_only=True)
class LiftGoal(UniformPositionCommand):
    """Position above the patch, from 10 cm above the workspace's lower face to its upper one."""

    marker: str | None = "goal"
    spread: float = 1.0
    """Share of these ranges that goals are drawn from, about the middle; 0 for one fixed goal."""

    def reach(self, env: Environment) -> dict[str, Bounds]:
        (low, high), (bottom, top) = patch(env.world), common.workspace(env.world)
        whole = {"x": (low[0], high[0]), "y": (low[1], high[1]), "z": (bottom[2] + 0.1, top[2])}
        return {name: narrowed(bounds, self.spread) for name, bounds in whole.items()}


def at_cube(env: Environment[Lift]) -> Tensor:
    """(N, 7) the hand around the cube, fingers along the pair of faces that needs the least turn."""
    return common.leaning(env, picking.grasp_square(cube_pose(env)))


def above_cube(env: Environment[Lift]) -> Tensor:
    """(N, 7) the hand 10 cm above the cube."""
    up = torch.tensor([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0], device=env.device)
    # A hand leans by its height, so that the pose is raised first.
    return common.leaning(env, picking.grasp_square(cube_pose(env)) + up)


def off_table(env: Environment[Lift, LiftMemory]) -> Tensor:
    """(N,) bool: the cube hangs in the hand."""
    return cube_height(env) > env.state.rest_height + 0.01


def goal_frame(env: Environment[Lift]) -> Tensor:
    """(N, 7) at the goal, pointing down."""
    # A subtask's frame needs an orientation, which a goal without one gets here.
    return common.leaning(env, common.pointing_down(env.commands["goal"]))


def at_goal(env: Environment[Lift]) -> Tensor:
    """(N, 7) the hand where the cube's centre is at the goal, as the cube sits in the hand now."""
    hand = common.hand_pose(env)
    target = common.pointing_down(env.commands["goal"] + hand[:, :3] - cube_pose(env)[:, :3])
    return common.leaning(env, target)


GOAL = MarkerSpec("goal", MarkerShape.SPHERE, size=0.03)


@dataclass
class LiftState(ObservationGroup):
    """The arm's joints, the cube's pose, the way from the hand to it, the goal and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    cube_pose: ObservationTerm | None = ObservationTerm(cube_pose)
    hand_to_cube: ObservationTerm | None = ObservationTerm(hand_to_cube)
    goal: ObservationTerm | None = ObservationTerm(
        lambda env: env.commands["goal"],
        unit="m",
        meaning=Meaning("position to bring the cube's origin to", ENVIRONMENT),
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class LiftObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: LiftState = field(default_factory=LiftState)
    critic: ObservationGroup | None = None


@dataclass
class LiftPixelObservations:
    """Pictures for ``policy``; the state for ``critic`` and ``teacher``."""

    policy: ArmPixels = field(default_factory=ArmPixels)
    critic: ObservationGroup | None = field(default_factory=LiftState)
    teacher: ObservationGroup | None = field(default_factory=LiftState)


@dataclass
class LiftRewards:
    """Rewards of the hand at the cube, the cube off the table and at its goal, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 15.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 16.0)
    """Nearness of the lifted cube to the goal, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.03), 15.0)
    """The same within 0.03 m, which decides the last centimetres."""
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class LiftTerminations:
    """An episode ends early where the cube is dropped."""

    dropped: TerminationTerm | None = TerminationTerm(dropped)


@dataclass
class LiftCommands:
    """The position that the cube is to be brought to."""

    goal: CommandTerm | None = LiftGoal()


@dataclass
class LiftEvents:
    """Robot and cube are placed for each episode; masses and the like with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cube: EventTerm | None = EventTerm(place_cube)
    cube_mass: EventTerm | None = None
    """Mass of the cube, drawn for each environment; set by domain randomisation."""
    friction: EventTerm | None = None
    """Friction of fingers, cube and table; set by domain randomisation."""
    gains: EventTerm | None = None
    """Scales of the arm's stiffness and damping; set by domain randomisation."""


@dataclass(kw_only=True)
class Lift(Task):
    """The cube starts anywhere on a patch of the table, turned by any angle; the goal hangs above the table.

    Succeeds when the cube's centre is within ``tolerance`` of the goal at the episode's end. Metric: that distance.
    """

    state_type: ClassVar[type[TaskState]] = LiftMemory
    renamed: ClassVar[Mapping[str, str]] = {"events.sample_goal": "commands.goal"}
    observation_presets: ClassVar[Mapping[str, Callable[[], Any]]] = {"pixels": LiftPixelObservations}
    robot: str = "franka_panda"
    action: str = "joint_position"
    episode_length: float = 5.0
    metadata: TaskMetadata = TaskMetadata(
        instruction="lift the cube to the goal",
        subtasks=(Subtask(at_cube, off_table), Subtask(goal_frame, lifted)),
        ppo=PpoSettings(
            iterations=1500,
            steps_per_iteration=16,
            initial_std=0.7,
            entropy_weight=0.002,
            target_kl=0.03,
            clip_value=False,
        ),
        off_policy=OffPolicySettings(updates_per_step=4),
    )
    cube: ObjectConfig = BoxConfig(size=(0.05, 0.05, 0.05), mass=0.1, color=(0.8, 0.2, 0.15, 1.0))
    """What is lifted; :func:`orbit_core.objects.object_kinds` has other kinds."""
    tolerance: float = 0.02
    """Metres."""
    start_spread: float = 1.0
    """Share of the patch and of the turns that the cube's start is drawn from, about the middle; 0 for one start."""
    observations: LiftObservations | LiftPixelObservations = field(default_factory=LiftObservations)
    rewards: LiftRewards = field(default_factory=LiftRewards)
    terminations: LiftTerminations = field(default_factory=LiftTerminations)
    events: LiftEvents = field(default_factory=LiftEvents)
    commands: LiftCommands = field(default_factory=LiftCommands)

    def scene(self) -> Scene:
        return Scene(
            robots=(task_robots.arm(self.robot, leans=True),),
            objects=(self.cube_at((0.5, 0.0, 0.0)), work_bench()),
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=(GOAL,),
            physics_dt=self.physics_dt,
        )

    def cube_at(self, place: Vector3) -> ObjectSpec:
        """Return the object to be lifted, standing at a place.

        Raises:
            ConfigurationError: its base is fixed.
        """
        x, y, z = place
        cube = self.cube.build("cube", Pose((x, y, z + self.cube.rest_height)))
        if cube.fixed_base:
            raise ConfigurationError(
                f"field 'cube' of task Lift is a '{self.cube.name}' whose base is fixed, which nothing lifts: choose a "
                "solid, such as 'box' or 'sphere', that is free to move"
            )
        return cube

    def randomize(self) -> None:
        """The cube's mass, its friction and the fingers', the arm's gains, and noise on joints and cube."""
        self.events.cube_mass = EventTerm(randomize.masses("cube", Range(0.5, 2.0)), EventTime.STARTUP)
        friction = randomize.friction((common.ROBOT, "cube", "table"), Range(0.5, 1.2))
        self.events.friction = EventTerm(friction, EventTime.STARTUP)
        self.events.gains = EventTerm(randomize.uncertain_gains(common.ROBOT), EventTime.STARTUP)
        common.add_noise(self.observations.policy, joint_positions=0.005, joint_velocities=0.05, cube_pose=0.002)

    def success(self, env: Environment) -> Tensor:
        return goal_distance(env) < self.tolerance

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(env)}

    def expert(self, env: Environment) -> Expert:
        # At least 0.4 s: the fingers must be still on the cube before it is lifted.
        closing = max(0.4, common.closing_time(env.world))
        lead = position_lead(env)
        return Expert(
            env,
            (
                Phase(above_cube, position_tolerance=0.02, free=True),
                Phase(at_cube, position_tolerance=0.006, timeout=1.5),
                Phase(at_cube, gripper_open=False, dwell=closing, timeout=closing + 0.1),
                Phase(at_goal, gripper_open=False, free=True),
            ),
            position_lead=lead,
            rotation_lead=5.0 * lead,
            stage=partial(_stage, opening=common.GripperOpening(env.world)),
        )


def position_lead(env: Environment) -> float:
    """Return the metres by which an expert's commanded pose runs ahead of the hand."""
    # An arm that leans is a small one, whose jaw lets go of what it jerks up.
    return 0.1 if env.world.robots[common.ROBOT].spec.end_effector.lean is None else 0.03


def _stage(env: Environment[Lift], opening: common.GripperOpening) -> Tensor:
    """(N,) int64: the expert's phase, by the state alone."""
    # A gripper that has stopped on its way holds something, of whatever size.
    held = (opening() < 0.95) & (opening.speed() < 0.1)
    return stages.lifting(common.hand_pose(env), at_cube(env), held)
