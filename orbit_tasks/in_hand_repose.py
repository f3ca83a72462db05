"""Task In-Hand-Repose: a hand, its palm up, turns an object to one sampled orientation after another.

The task and its reward follow Makoviychuk et al., Isaac Gym: High Performance GPU-Based Physics Simulation For Robot
Learning (2021), section 5.3, after OpenAI et al., Learning Dexterous In-Hand Manipulation (2018).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.catalogue import robot
from orbit_assets.object_kinds import BoxConfig
from orbit_core.dynamics import transforms
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
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, POSE, Meaning, once_per_state
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common, randomize
from orbit_core.mdp.commands import UniformOrientationCommand, generated_command
from orbit_core.mdp.randomize import Range
from orbit_core.objects import ObjectConfig
from orbit_core.scene import MarkerSpec, Pose, RobotSpec, Scene, ghost, look_at
from orbit_core.scene.pose import Vector3

OBJECT = "object"
ABOVE_PALM: Vector3 = (-0.015, -0.01, -0.03)
# Where objects start in hands that would drop more of them at :data:`ABOVE_PALM`.
OFFSETS: Mapping[str, Vector3] = {
    "allegro_left": (0.005, 0.0, -0.03),
    "shadow_hand": (0.0, 0.0, -0.03),
    "dex3_left": (0.0, 0.0, -0.03),
}


def hand(name: str) -> RobotSpec:
    """A robot of the catalogue that is a hand with several fingers, as the task's robot.

    Raises:
        UnknownNameError: there is none of that name.
        ConfigurationError: it is carried by an arm, or has fewer than three fingers.
    """
    spec = robot(name, name=common.ROBOT)
    if not spec.end_effectors or len(spec.end_effector.finger_tips) < 3 or spec.has_arm:
        raise ConfigurationError(
            f"robot '{name}' is no hand of three or more fingers by itself, which In-Hand-Repose needs: choose "
            "another, such as allegro_right or shadow_hand"
        )
    return spec


class HandMemory(TaskState):
    """Goals that were reached in an episode."""

    place: Tensor
    """(3,) metres, where the object starts."""
    beside: Tensor
    """(3,) metres, where the axes are drawn that the object shall have."""
    distance: Tensor = buffer()
    """(N,) rad that the object was from its goal after the last step, before a new goal followed."""
    reached: Tensor = buffer(dtype=torch.bool)
    """(N,) bool, True where the last step reached a goal."""
    count: Tensor = buffer()
    """(N,) goals that were reached in the episode."""

    def start(self, env: Environment[InHandRepose]) -> None:
        body, task = common.robot_of(env.world), env.task
        frame = body.frame_pose(body.spec.end_effector.frame)[0, :3]
        self.place = frame + torch.tensor(task.offset or OFFSETS.get(task.robot, ABOVE_PALM), device=env.device)
        self.beside = self.place + torch.tensor((0.15, 0.0, 0.05), device=env.device)

    def update(self, env: Environment[InHandRepose]) -> None:
        # Kept before the goal changes, because rewards and metrics judge the goal that was pursued.
        self.distance.copy_(rotation_distance(env))
        torch.lt(self.distance, env.task.tolerance, out=self.reached)
        self.count += self.reached


def object_pose(env: Environment[InHandRepose, HandMemory]) -> Tensor:
    """(N, 7) from the place above the palm where the object starts."""
    pose = env.world.objects[OBJECT].root_pose
    # Relative to the palm, so that one policy serves hands that are mounted at different heights.
    return torch.cat((pose[:, :3] - env.state.place, pose[:, 3:]), dim=1)


def object_velocity(env: Environment[InHandRepose]) -> Tensor:
    """(N, 6) m/s and rad/s."""
    return env.world.objects[OBJECT].root_velocity


def finger_tips(env: Environment[InHandRepose, HandMemory]) -> Tensor:
    """(N, 3 fingers) of the tips, from the place above the palm where the object starts."""
    body = common.robot_of(env.world)
    tips = torch.stack([body.frame_pose(tip)[:, :3] for tip in body.spec.end_effector.finger_tips], dim=1)
    return (tips - env.state.place).flatten(1)


def turn(env: Environment[InHandRepose]) -> Tensor:
    """(N, 3) rad, the rotation vector in world axes that takes the object to the goal."""
    return transforms.rotation_error(env.world.objects[OBJECT].root_pose[:, 3:], env.commands["goal"])


def rotation_distance(env: Environment[InHandRepose]) -> Tensor:
    """(N,) rad between the object's orientation and the goal."""
    return transforms.quat_distance(env.world.objects[OBJECT].root_pose[:, 3:], env.commands["goal"])


@once_per_state
def slipped(env: Environment[InHandRepose, HandMemory]) -> Tensor:
    """(N,) metres between the object and the place where it started."""
    return vector_norm(env.world.objects[OBJECT].root_pose[:, :3] - env.state.place, dim=1)


def dropped(env: Environment[InHandRepose]) -> Tensor:
    """(N,) the object has left the hand."""
    return slipped(env) > env.task.reach


def place_object(env: Environment[InHandRepose, HandMemory], env_ids: Tensor) -> None:
    """Place the object above the palm, within 5 mm and turned anyhow; it falls into the fingers."""
    # Small, because the fingers catch what falls on the palm's middle, and not what falls on its edge.
    offset = env.world.random.uniform((3,), -0.005, 0.005, env_ids)
    pose = torch.cat((env.state.place + offset, common.random_rotations(env.world, env_ids)), dim=1)
    env.world.objects[OBJECT].set_root_pose(pose, env_ids)


@dataclass(unsafe_hash=True, kw_only=True)
class HandGoal(UniformOrientationCommand):
    """Orientation that the object is to have; another one follows as soon as it is reached."""

    def expired(self, env: Environment[Any, HandMemory]) -> Tensor:
        return env.state.reached

    def follow(self, env: Environment[Any, HandMemory], command: Tensor) -> bool:
        held, markers = env.world.objects[OBJECT].root_pose, env.world.markers
        # Axes on the object and on the goal next to it let a viewer compare both.
        markers["object_axes"].set_pose(held)
        markers["goal"].set_pose(torch.cat((env.state.beside.expand(len(held), 3), command), dim=1))
        return False


@dataclass
class HandState(ObservationGroup):
    """Joints, finger tips, the object's pose and velocity, the goal and the turn that leads there, the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    finger_tips: ObservationTerm | None = ObservationTerm(finger_tips, unit="m")
    object_pose: ObservationTerm | None = ObservationTerm(object_pose, unit=POSE)
    object_velocity: ObservationTerm | None = ObservationTerm(object_velocity, unit="m/s, rad/s")
    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"),
        unit="quaternion (w, x, y, z)",
        meaning=Meaning("orientation that the object is to have", ENVIRONMENT),
    )
    turn: ObservationTerm | None = ObservationTerm(turn, unit="rad")
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class HandObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: HandState = field(default_factory=HandState)
    critic: ObservationGroup | None = None


@dataclass
class HandRewards:
    """Rewards of an orientation near the goal and of each goal that is reached, less what slips or hurries."""

    turned: RewardTerm | None = RewardTerm(lambda env: 1.0 / (env.state.distance + 0.1), 1.0)
    """Inverse of the angle to the goal plus 0.1 rad: at most 10, and steepest near the goal."""
    # As in Isaac Gym's task: a goal takes many steps, at each of which nearness is paid.
    reached: RewardTerm | None = RewardTerm(lambda env: env.state.reached.float(), 250.0)
    """1 in the step that reaches a goal."""
    slipped: RewardTerm | None = RewardTerm(slipped, -10.0)
    action: RewardTerm | None = RewardTerm(common.action_size, -1e-3)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -0.01)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -2.5e-5)


@dataclass
class HandTerminations:
    """An episode ends early where the object is dropped."""

    dropped: TerminationTerm | None = TerminationTerm(dropped)


@dataclass
class HandCommands:
    """The orientation that the object is to have."""

    goal: CommandTerm | None = HandGoal()


@dataclass
class HandEvents:
    """Hand and object are placed for each episode; masses and the like with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.1))
    place_object: EventTerm | None = EventTerm(place_object)
    object_mass: EventTerm | None = None
    """Mass of the object, drawn for each environment; set by domain randomisation."""
    friction: EventTerm | None = None
    """Friction of hand and object; set by domain randomisation."""
    gains: EventTerm | None = None
    """Scales of the fingers' stiffness and damping; set by domain randomisation."""


@dataclass(kw_only=True)
class InHandRepose(Task):
    """A goal is reached when the object is turned to within ``tolerance`` of it; the next one follows at once.

    Succeeds when ``goals`` were reached in the episode before the object was dropped. Metrics: how many were reached,
    how far the object is from the last goal, and drops.
    """

    state_type: ClassVar[type[TaskState]] = HandMemory
    renamed: ClassVar[Mapping[str, str]] = {"events.sample_goal": "commands.goal"}
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(
            iterations=3000,
            hidden_sizes=(512, 256, 128),
            initial_std=0.6,
            entropy_weight=0.002,
            discount=0.995,
        ),
        view=look_at(eye=(0.35, -0.4, 0.95), target=(0.0, 0.03, 0.6)),
        exceptions=(TaskException(TaskCheck.START_AREA, "the object starts in the hand"),),
    )
    robot: str = "allegro_right"
    action: str = "joint_position"
    physics_dt: float = 1.0 / 120.0
    episode_length: float = 20.0
    object: ObjectConfig = BoxConfig(size=(0.065, 0.065, 0.065), mass=0.08, color=(0.85, 0.6, 0.2, 1.0))
    """What is turned; :func:`orbit_core.objects.object_kinds` has other kinds."""
    offset: Vector3 | None = None
    """Metres from the hand's frame to the place, above the palm, where the object starts; None: :data:`OFFSETS`'."""
    reach: float = 0.15
    """Metres from there, beyond which the object has been dropped."""
    tolerance: float = 0.2
    """rad."""
    goals: int = 10
    """How many are success."""
    observations: HandObservations = field(default_factory=HandObservations)
    rewards: HandRewards = field(default_factory=HandRewards)
    terminations: HandTerminations = field(default_factory=HandTerminations)
    events: HandEvents = field(default_factory=HandEvents)
    commands: HandCommands = field(default_factory=HandCommands)

    def scene(self) -> Scene:
        self.bound(tolerance=(1e-3, torch.pi), goals=(1, 1000))
        item = self.object.build(OBJECT, Pose((0.0, 0.0, 1.0)))
        # Refused here: it would hang in the air above the palm, and every episode would run to its end.
        if item.fixed_base:
            raise ConfigurationError(
                f"field 'object' of task In-Hand-Repose is a '{self.object.name}' whose base is fixed, which no hand "
                "turns: choose a solid, such as 'box' or 'cylinder', that is free to move"
            )
        return Scene(
            robots=(hand(self.robot),),
            objects=(item,),
            terrain=(common.floor(),),
            markers=(ghost("goal", item, axes=0.08), MarkerSpec("object_axes", size=0.08)),
            physics_dt=self.physics_dt,
        )

    def randomize(self) -> None:
        """The object's mass, its friction and the hand's, the fingers' gains, and noise on joints and object."""
        gains = randomize.gains(common.ROBOT, stiffness=Range(0.75, 1.5), damping=Range(0.5, 2.0))
        self.events.object_mass = EventTerm(randomize.masses(OBJECT, Range(0.5, 1.5)), EventTime.STARTUP)
        friction = randomize.friction((common.ROBOT, OBJECT), Range(0.7, 1.3))
        self.events.friction = EventTerm(friction, EventTime.STARTUP)
        self.events.gains = EventTerm(gains, EventTime.STARTUP)
        common.add_noise(self.observations.policy, joint_positions=0.005, joint_velocities=0.05, object_pose=0.002)

    def success(self, env: Environment[Any, HandMemory]) -> Tensor:
        return env.state.count >= self.goals

    def metrics(self, env: Environment[Any, HandMemory]) -> dict[str, Tensor]:
        return {
            "goals_reached": env.state.count,
            "rotation_distance_rad": rotation_distance(env),
            "drops": dropped(env).float(),
        }
