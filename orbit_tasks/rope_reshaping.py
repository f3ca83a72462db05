"""Rope-Reshaping: bend a straight rope on a table into a corner of a sampled angle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.deformables import line
from orbit_assets.objects import BENCH_HEIGHT, work_bench
from orbit_core.envs import CommandTerm, Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm, Task
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, Bounds, Meaning, once_per_state
from orbit_core.mdp import common
from orbit_core.scene import KeyPoint, MarkerShape, MarkerSpec, Pose, Rope, Scene, look_at
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mdp import matter

ROPE = "rope"
# Evenly along the rope; the goal has a place for each.
KEY_POINTS = 5
# Parts of the angle by which the expert leads the rope's end.
WAYPOINTS = (0.35, 0.7, 1.0)


class RopeMemory(TaskState):
    """State of a rope: its place when the episode began."""

    points: Tensor = buffer(KEY_POINTS, 3)
    """(N, 5, 3) its key points, in the environment's frame."""


@once_per_state
def key_points(env: Environment[RopeReshaping]) -> Tensor:
    """(N, 5, 3) along the rope, in the environment's frame."""
    return env.world.deformables[ROPE].key_points


@once_per_state
def shape_distance(env: Environment[RopeReshaping]) -> Tensor:
    """(N,) metres: mean over the key points of the way to their places."""
    return vector_norm(key_points(env) - goal(env), dim=2).mean(1)


def end(env: Environment[RopeReshaping]) -> Tensor:
    """(N, 3) the key point that is taken: the rope's last, less its half centimetre of end."""
    return key_points(env)[:, -1]


def reaching(env: Environment[RopeReshaping]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the rope's end."""
    return common.nearness(vector_norm(end(env) - common.hand_pose(env)[:, :3], dim=1), 0.1)


def shaping(env: Environment[RopeReshaping], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the rope is to its shape."""
    return common.nearness(shape_distance(env), scale)


def remember_rope(env: Environment[RopeReshaping, RopeMemory], env_ids: Tensor) -> None:
    """Note where the rope's key points lie when the episode begins."""
    env.state.points[env_ids] = key_points(env)[env_ids]


@once_per_state
def goal(env: Environment[RopeReshaping, RopeMemory]) -> Tensor:
    """(N, 5, 3) places of the key points, in the environment's frame."""
    return _bent(env.state.points, env.commands["bend"][:, 0])


@dataclass(unsafe_hash=True, kw_only=True)
class BendCommand(CommandTerm):
    """Angle (N, 1) in rad by which the rope's second half is to be turned about its middle, to either side."""

    angle: Bounds = (math.radians(40.0), math.radians(80.0))
    """rad, to either side"""

    def ranges(self, env: Environment) -> dict[str, Bounds]:
        return {"angle": self.angle, "side": (0.0, 1.0)}

    def command(self, env: Environment, drawn: Tensor, env_ids: Tensor) -> Tensor:
        # A second number draws the side: one range through zero would include ropes that need no bend.
        return drawn[:, :1] * torch.where(drawn[:, 1:] < 0.5, -1.0, 1.0)

    def show(self, env: Environment, command: Tensor, env_ids: Tensor) -> None:
        places = _bent(env.state.points[env_ids], command[:, 0])
        common.place_markers(env.world, [f"goal{number}" for number in range(KEY_POINTS)], places, env_ids)


def _bent(points: Tensor, angle: Tensor) -> Tensor:
    """(n, 5, 3) with those behind the middle turned about it by an angle (n,)."""
    middle = points[:, KEY_POINTS // 2 : KEY_POINTS // 2 + 1]
    turned = middle + _turn(points - middle, angle[:, None])
    # The middle itself stays: it is what the half turns about.
    behind = torch.arange(KEY_POINTS, device=points.device) > KEY_POINTS // 2
    return torch.where(behind[:, None], turned, points)


def _turn(arms: Tensor, angle: Tensor) -> Tensor:
    """Vectors (..., 3) turned about the vertical."""
    x, y, z = arms.unbind(-1)
    return torch.stack(
        (angle.cos() * x - angle.sin() * y, angle.sin() * x + angle.cos() * y, z.expand_as(x * angle)), -1
    )


def led(env: Environment[RopeReshaping, RopeMemory], part: float, height: float) -> Tensor:
    """(N, 7) the hand with the rope's end on its arc about the middle, across the rope there, at a height."""
    angle, middle = env.commands["bend"][:, 0], env.state.points[:, KEY_POINTS // 2]
    arm = _turn(env.state.points[:, -1] - middle, part * angle)
    # A bent rope is as long as a straight one, but not its chord: a little nearer leaves the middle where it is.
    position = middle + arm * (1.0 - 0.03 * part)
    position = torch.cat((position[:, :2], torch.full_like(position[:, :1], env.task.radius + height)), dim=1)
    return torch.cat((position, _across(env, arm)), dim=1)


def at_end(env: Environment[RopeReshaping], height: float) -> Tensor:
    """(N, 7) the hand around the rope's end, at a height above its middle line."""
    points = key_points(env)
    position = points[:, -1].clone()
    position[:, 2] = env.task.radius + height
    return torch.cat((position, _across(env, points[:, -1] - points[:, -2])), dim=1)


def _across(env: Environment[RopeReshaping], along: Tensor) -> Tensor:
    """(N, 4) pointing down, fingers on both sides of a rope that goes along (N, 3).

    Of the two ways to do so it is the one from which the rope's turn is towards the wrist's middle.
    """
    yaw = torch.atan2(along[:, 1], along[:, 0])
    return common.facing_down(torch.where(env.commands["bend"][:, 0] > 0.0, yaw - math.pi, yaw))


@dataclass
class RopeReshapingState(ObservationGroup):
    """The arm's joints and hand, the rope's key points, their places and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    key_points: ObservationTerm | None = ObservationTerm(matter.key_points(ROPE))
    goal: ObservationTerm | None = ObservationTerm(
        lambda env: goal(env).flatten(1),
        unit="m",
        meaning=Meaning("positions that the rope's key points are to have, one after the other", ENVIRONMENT),
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class RopeReshapingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: RopeReshapingState = field(default_factory=RopeReshapingState)
    critic: ObservationGroup | None = None


@dataclass
class RopeReshapingRewards:
    """Rewards of the hand at the rope's end and the rope in its shape, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    shape: RewardTerm | None = RewardTerm(lambda env: shaping(env, 0.1), 10.0)
    """Nearness of the rope's points to their places, within some 0.1 m."""
    shape_finely: RewardTerm | None = RewardTerm(lambda env: shaping(env, 0.02), 5.0)
    """The same within 0.02 m, which decides the last centimetres."""
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class RopeReshapingTerminations:
    """Only the time limit ends an episode."""


@dataclass
class RopeReshapingCommands:
    """Commanded turn of half of the rope."""

    bend: CommandTerm | None = BendCommand()


@dataclass
class RopeReshapingEvents:
    """Robot and rope are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_rope: EventTerm | None = EventTerm(matter.place_deformable(ROPE, (0.04, 0.04), 0.3))
    remember_rope: EventTerm | None = EventTerm(remember_rope)


@dataclass(kw_only=True)
class RopeReshaping(Task):
    """The rope is straight across the robot's front, a little off and turned; half of it is to be turned.

    Succeeds when the key points are within ``tolerance`` of their places, on average, at the episode's end. Metric:
    that mean distance.
    """

    state_type: ClassVar[type[TaskState]] = RopeMemory
    renamed: ClassVar[Mapping[str, str]] = {"events.sample_goal": "commands.bend"}
    metadata: TaskMetadata = TaskMetadata(
        instruction="lay the rope into the shown shape",
        ppo=PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005),
        view=look_at(eye=(1.3, 0.8, 0.7), target=(0.45, 0.0, 0.05)),
        exceptions=(
            TaskException(TaskCheck.VELOCITY_LIMITS, "fingers snap shut on a thin rope; the arm keeps its limits"),
            TaskException(TaskCheck.START_YAW, "deformables are sampled by their middle, which has no yaw"),
        ),
    )
    robot: str = "franka_panda"
    action: str = "joint_position"
    physics_dt: float = 0.0025
    decimation: int = 8
    episode_length: float = 8.0
    length: float = 0.4
    """Metres."""
    radius: float = 0.008
    """Metres."""
    particles: int = 41
    """Particles along the rope."""
    grip_force: float = 10.0
    """Newtons at most that the gripper closes with."""
    tolerance: float = 0.03
    """Metres."""
    observations: RopeReshapingObservations = field(default_factory=RopeReshapingObservations)
    rewards: RopeReshapingRewards = field(default_factory=RopeReshapingRewards)
    terminations: RopeReshapingTerminations = field(default_factory=RopeReshapingTerminations)
    events: RopeReshapingEvents = field(default_factory=RopeReshapingEvents)
    commands: RopeReshapingCommands = field(default_factory=RopeReshapingCommands)

    def scene(self) -> Scene:
        points = line(self.length, self.particles)
        # Not the very ends, so that fingers around the last key point hold rope on both sides.
        places = torch.linspace(1, self.particles - 2, KEY_POINTS).round().int().tolist()
        named = tuple(KeyPoint(f"point{number}", (place,)) for number, place in enumerate(places))
        pose = Pose.from_euler(0.0, 0.0, 0.5 * math.pi, (0.5, 0.0, self.radius))
        rope = Rope(ROPE, points, 0.15, pose, self.radius, bending_stiffness=5e-4, friction=0.8, key_points=named)
        markers = (MarkerSpec(f"goal{number}", MarkerShape.SPHERE, size=0.02) for number in range(KEY_POINTS))
        return Scene(
            robots=(matter.with_grip_force(task_robots.arm(self.robot), self.grip_force),),
            objects=(work_bench(),),
            deformables=(rope,),
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=tuple(markers),
            physics_dt=self.physics_dt,
        )

    def success(self, env: Environment) -> Tensor:
        return shape_distance(env) < self.tolerance

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"shape_distance_m": shape_distance(env)}

    def expert(self, env: Environment) -> Expert:
        def over(env: Environment[RopeReshaping]) -> Tensor:
            return at_end(env, 0.1)

        def around(env: Environment[RopeReshaping]) -> Tensor:
            return at_end(env, 0.003)  # the pads reach 9 mm further, not quite to the table

        def lead(part: float):
            return lambda env: led(env, part, 0.01)

        def above(env: Environment[RopeReshaping]) -> Tensor:
            return led(env, 1.0, 0.12)

        return Expert(
            env,
            (
                Phase(over, position_tolerance=0.02, free=True),
                Phase(around, position_tolerance=0.005, timeout=1.2),
                Phase(around, gripper_open=False, dwell=0.4, timeout=0.4),
                *(Phase(lead(part), False, position_tolerance=0.015, timeout=1.0) for part in WAYPOINTS),
                # Tolerances that are always met: the hand only opens here, and waits until the rope is free.
                Phase(lead(1.0), position_tolerance=1.0, rotation_tolerance=4.0, dwell=0.3),
                Phase(above),
            ),
            position_lead=0.06,
        )
