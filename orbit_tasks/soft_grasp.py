"""Soft-Grasp: lift a fragile fruit with soft fingers, which must not press it harder than it bears."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import BENCH_HEIGHT, sphere, work_bench
from orbit_core.envs import (
    CommandTerm,
    Environment,
    EventTerm,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
    Task,
    TerminationTerm,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, Bounds, Meaning, measured_in, once_per_state
from orbit_core.mdp import common
from orbit_core.mdp.commands import UniformPositionCommand, generated_command
from orbit_core.scene import Pose, Scene, look_at
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.cloth import Smoothness
from orbit_tasks.lift import GOAL
from orbit_tasks.mdp import matter, picking, soft_fingers
from orbit_tasks.mdp.soft_fingers import FINGERS

FRUIT = "fruit"
# Metres in x and y by which the fruit starts off its place.
SPREAD = (0.08, 0.2)
# Metres that the hand is led ahead: fingers that hold by a newton let go of what is jerked.
SLOW = 0.05
# Metres off the table at which it counts as lifted.
LIFTED = 0.02


@measured_in("m")
@once_per_state
def fruit(env: Environment[SoftGrasp]) -> Tensor:
    """(N, 3) the fruit's middle, in the environment's frame."""
    return env.world.objects[FRUIT].root_pose[:, :3]


@measured_in("Pa")
@once_per_state
def pressure(env: Environment[SoftGrasp]) -> Tensor:
    """(N,) Pa: the largest with which a soft finger presses on the fruit."""
    bodies = [env.world.deformables[name] for name in FINGERS]
    return torch.stack([body.contact_pressure(FRUIT, FRUIT) for body in bodies]).amax(0)


def crushed(env: Environment[SoftGrasp]) -> Tensor:
    """(N,) bool: a finger presses harder than the fruit bears."""
    return pressure(env) > env.task.bears


@once_per_state
def goal_distance(env: Environment[SoftGrasp]) -> Tensor:
    """(N,) metres between the fruit's middle and the goal."""
    return vector_norm(env.commands["goal"] - fruit(env), dim=1)


@once_per_state
def lifted(env: Environment[SoftGrasp]) -> Tensor:
    """(N,) 1 where the fruit is off the table, else 0."""
    return (fruit(env)[:, 2] > env.task.radius + LIFTED).float()


def reaching(env: Environment[SoftGrasp]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to where it would take the fruit."""
    return common.nearness(vector_norm(at_fruit(env)[:, :3] - common.hand_position(env), dim=1), 0.1)


def tracking(env: Environment[SoftGrasp], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near a lifted fruit is to the goal."""
    # Counts once it is lifted: a fruit that is rolled along the table comes nearer as well.
    return lifted(env) * common.nearness(goal_distance(env), scale)


def dropped(env: Environment[SoftGrasp]) -> Tensor:
    """(N,) bool: the fruit fell off the table."""
    return fruit(env)[:, 2] < -0.05


def place_fruit(env: Environment[SoftGrasp], env_ids: Tensor) -> None:
    """Place the fruit on a patch of the table."""
    x, y, z = env.world.objects[FRUIT].spec.pose.position
    low, high = (x - SPREAD[0], y - SPREAD[1], z, 0.0), (x + SPREAD[0], y + SPREAD[1], z, 0.0)
    place = common.standing(env.world.random.uniform((4,), low, high, env_ids))
    env.world.objects[FRUIT].set_root_pose(place, env_ids)


@dataclass(unsafe_hash=True, kw_only=True)
class FruitGoal(UniformPositionCommand):
    """Position 15 to 35 cm above the table, within 10 cm and 20 cm of the fruit's place in x and y."""

    marker: str | None = "goal"

    def reach(self, env: Environment[SoftGrasp]) -> dict[str, Bounds]:
        x = env.world.objects[FRUIT].spec.pose.position[0]
        return {"x": (x - 0.1, x + 0.1), "y": (-0.2, 0.2), "z": (0.15, 0.35)}


def at_fruit(env: Environment[SoftGrasp]) -> Tensor:
    """(N, 7) the hand whose soft fingers have the fruit between them, pointing down."""
    up = torch.tensor([0.0, 0.0, env.state.grasp_depth], device=env.device)
    return common.pointing_down(fruit(env) + up)


def at_goal(env: Environment[SoftGrasp]) -> Tensor:
    """(N, 7) the hand that brings the fruit to the goal, as it hangs in the fingers now."""
    return common.pointing_down(env.commands["goal"] + common.hand_position(env) - fruit(env))


class SoftGraspMemory(soft_fingers.FingerMemory):
    """Places of soft fingers on their links and of what they grasp, looked up once in a new world."""

    grasp_depth: float
    """Metres from the hand's frame to where the fingers take the fruit."""

    def start(self, env: Environment) -> None:
        super().start(env)
        self.grasp_depth = soft_fingers.grasp_depth(env.world.robots[env.task.agents[0]].spec)


@dataclass
class SoftGraspState(ObservationGroup):
    """The arm's joints and hand, the fruit and how hard it is pressed, the goal and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    fruit: ObservationTerm | None = ObservationTerm(
        fruit, unit="m", meaning=Meaning("position of the fruit's middle", ENVIRONMENT)
    )
    pressure: ObservationTerm | None = ObservationTerm(
        lambda env: pressure(env) / env.task.bears,
        unit="1",
        meaning=Meaning("largest pressure of the soft fingers on the fruit, as a part of what it bears"),
    )
    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"),
        unit="m",
        meaning=Meaning("position that the fruit's middle is to be lifted to", ENVIRONMENT),
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class SoftGraspObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: SoftGraspState = field(default_factory=SoftGraspState)
    critic: ObservationGroup | None = None


@dataclass
class SoftGraspRewards(Smoothness):
    """Rewards of the hand at the fruit, the fruit off the table and at its goal, less pressure and abruptness."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 15.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 16.0)
    """Nearness of the lifted fruit to the goal, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    """The same within 0.05 m, which decides the last centimetres."""
    press: RewardTerm | None = RewardTerm(lambda env: (pressure(env) / env.task.bears).clamp(max=1.0), -2.0)
    """Pressure as a part of what the fruit bears."""


@dataclass
class SoftGraspTerminations:
    """An episode ends early where the fruit is crushed or falls off the table."""

    crushed: TerminationTerm | None = TerminationTerm(crushed)
    dropped: TerminationTerm | None = TerminationTerm(dropped)


@dataclass
class SoftGraspEvents:
    """Robot with its soft fingers, and fruit, are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(soft_fingers.place_robot(0.05))
    place_fruit: EventTerm | None = EventTerm(place_fruit)


@dataclass
class SoftGraspCommands:
    """The position that the fruit's middle is to be brought to."""

    goal: CommandTerm | None = FruitGoal()


@dataclass(kw_only=True)
class SoftGrasp(Task):
    """A fruit is anywhere on a patch of the table; two soft fingers on the arm's gripper lift it to a goal in the air.

    Succeeds when the fruit's middle is within ``tolerance`` of the goal at the episode's end and no finger ever pressed
    on it harder than it bears. Metrics: that distance and the pressure at the end.
    """

    state_type: ClassVar[type[TaskState]] = SoftGraspMemory
    robot: str = "franka_panda"
    action: str = "joint_position"
    physics_dt: float = 0.0025
    decimation: int = 8
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005),
        view=look_at(eye=(1.15, 0.6, 0.5), target=(0.5, 0.0, 0.12)),
        exceptions=(TaskException(TaskCheck.START_YAW, "a ball looks alike at every angle"),),
    )
    episode_length: float = 5.0
    tolerance: float = 0.02
    """Metres."""
    radius: float = 0.025
    """Metres of the fruit, a ball."""
    mass: float = 0.06
    """kg of the fruit."""
    # Raspberries are bruised at some 20 kPa, ripe tomatoes and peaches at some 100.
    bears: float = 3.8e4
    """Pa that the fruit bears; a finger that presses harder ends the episode."""
    density: float = 1000.0
    """kg/m^3 of the fingers."""
    youngs_modulus: float = 5e5
    """Pa of the fingers: silicone has 1e5 to 3e6."""
    friction: float = 1.0
    """Coefficient of friction of the fingers with all that they touch."""
    grip_force: float = 4.0
    """Newtons at most that the gripper closes with."""
    observations: SoftGraspObservations = field(default_factory=SoftGraspObservations)
    rewards: SoftGraspRewards = field(default_factory=SoftGraspRewards)
    terminations: SoftGraspTerminations = field(default_factory=SoftGraspTerminations)
    events: SoftGraspEvents = field(default_factory=SoftGraspEvents)
    commands: SoftGraspCommands = field(default_factory=SoftGraspCommands)

    def scene(self) -> Scene:
        robot = matter.with_grip_force(task_robots.arm(self.robot), self.grip_force)
        place = Pose((0.5, 0.0, self.radius))
        return Scene(
            robots=(robot,),
            objects=(work_bench(), sphere(FRUIT, self.radius, mass=self.mass, pose=place, color=(0.8, 0.15, 0.1, 1.0))),
            deformables=soft_fingers.soft_fingers(robot, self.density, self.youngs_modulus, self.friction),
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=(GOAL,),
            physics_dt=self.physics_dt,
        )

    def success(self, env: Environment) -> Tensor:
        return (goal_distance(env) < self.tolerance) & ~crushed(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(env), "pressure_pa": pressure(env)}

    def expert(self, env: Environment) -> Expert:
        closing = max(0.6, common.closing_time(env.world))
        return Expert(
            env,
            (
                Phase(picking.raised(at_fruit, 0.1), position_tolerance=0.02, free=True),
                Phase(at_fruit, position_tolerance=0.006, timeout=1.5),
                # Where it is: a hand that followed a ball that it touches would roll it along.
                Phase(common.hand_pose, gripper_open=False, dwell=closing, timeout=closing + 0.1),
                Phase(at_goal, gripper_open=False),
            ),
            position_lead=SLOW,
        )
