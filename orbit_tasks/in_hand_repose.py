"""In-Hand-Repose: a hand, its palm up, turns an object to one sampled orientation after another.

The task and its reward follow Makoviychuk et al., Isaac Gym: High Performance GPU-Based Physics Simulation For Robot
Learning (2021), section 5.3, after OpenAI et al., Learning Dexterous In-Hand Manipulation (2018).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.object_kinds import BoxConfig
from orbit_core.dynamics import transforms
from orbit_core.envs import EventTerm, EventTime, ObservationGroup, ObservationTerm, RewardTerm, Task, TerminationTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task_checks import TaskCheck, TaskException
from orbit_core.envs.terms import ENVIRONMENT, POSE, Meaning, once_per_state
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.mdp import common, randomize
from orbit_core.mdp.randomize import Range
from orbit_core.objects import ObjectConfig
from orbit_core.robots import robot
from orbit_core.scene import MarkerSpec, Pose, RobotSpec, Scene, look_at
from orbit_core.scene.pose import Vector3

OBJECT = "object"
ABOVE_PALM: Vector3 = (-0.015, -0.01, -0.03)
OFFSETS: Mapping[str, Vector3] = {
    "allegro_left": (0.005, 0.0, -0.03),
    "shadow_hand": (0.0, 0.0, -0.03),
    "dex3_left": (0.0, 0.0, -0.03),
}
"""Where objects start in hands that would drop more of them at :data:`ABOVE_PALM`."""


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


def object_pose(world: World, task: InHandRepose) -> Tensor:
    """(N, 7) from the place above the palm where the object starts."""
    pose = world.objects[OBJECT].root_pose
    return torch.cat((pose[:, :3] - task.place, pose[:, 3:]), dim=1)


def object_velocity(world: World, task: InHandRepose) -> Tensor:
    """(N, 6) m/s and rad/s."""
    return world.objects[OBJECT].root_velocity


def finger_tips(world: World, task: InHandRepose) -> Tensor:
    """(N, 3 fingers) of the tips, from the place above the palm where the object starts."""
    body = common.robot_of(world)
    tips = torch.stack([body.frame_pose(tip)[:, :3] for tip in body.spec.end_effector.finger_tips], dim=1)
    return (tips - task.place).flatten(1)


def turn(world: World, task: InHandRepose) -> Tensor:
    """(N, 3) rad, the rotation vector in world axes that takes the object to the goal."""
    return transforms.rotation_error(world.objects[OBJECT].root_pose[:, 3:], task.goal)


def rotation_distance(world: World, task: InHandRepose) -> Tensor:
    """(N,) rad between the object's orientation and the goal."""
    return transforms.quat_distance(world.objects[OBJECT].root_pose[:, 3:], task.goal)


@once_per_state
def slipped(world: World, task: InHandRepose) -> Tensor:
    """(N,) metres between the object and the place where it started."""
    return vector_norm(world.objects[OBJECT].root_pose[:, :3] - task.place, dim=1)


def dropped(world: World, task: InHandRepose) -> Tensor:
    """(N,) the object has left the hand."""
    return slipped(world, task) > task.reach


def place_object(world: World, task: InHandRepose, env_ids: Tensor) -> None:
    """Place the object above the palm, within 5 mm and turned anyhow; it falls into the fingers."""
    offset = world.random.uniform((3,), -0.005, 0.005, env_ids)
    pose = torch.cat((task.place + offset, common.random_rotations(world, env_ids)), dim=1)
    world.objects[OBJECT].set_root_pose(pose, env_ids)


def sample_goal(world: World, task: InHandRepose, env_ids: Tensor) -> None:
    """Sample the first goal of an episode."""
    task.goal[env_ids] = common.random_rotations(world, env_ids)


@dataclass
class HandState(ObservationGroup):
    """Joints, finger tips, the object's pose and velocity, the goal and the turn that leads there, the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    finger_tips: ObservationTerm | None = ObservationTerm(finger_tips, unit="m")
    object_pose: ObservationTerm | None = ObservationTerm(object_pose, unit=POSE)
    object_velocity: ObservationTerm | None = ObservationTerm(object_velocity, unit="m/s, rad/s")
    goal: ObservationTerm | None = ObservationTerm(
        lambda world, task: task.goal,
        unit="quaternion (w, x, y, z)",
        meaning=Meaning("orientation that the object is to have", ENVIRONMENT),
    )
    turn: ObservationTerm | None = ObservationTerm(turn, unit="rad")
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class HandObservations:
    """Policy and critic see the state."""

    policy: HandState = field(default_factory=HandState)
    critic: ObservationGroup | None = None


@dataclass
class HandRewards:
    """Rewards of an orientation near the goal and of each goal that is reached, less what slips or hurries."""

    turned: RewardTerm | None = RewardTerm(lambda world, task: 1.0 / (task.distance + 0.1), 1.0)
    reached: RewardTerm | None = RewardTerm(lambda world, task: task.reached.float(), 250.0)
    slipped: RewardTerm | None = RewardTerm(slipped, -10.0)
    action: RewardTerm | None = RewardTerm(common.action_size, -1e-3)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -0.01)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -2.5e-5)


@dataclass
class HandTerminations:
    """An episode ends early where the object is dropped."""

    dropped: TerminationTerm | None = TerminationTerm(dropped)


@dataclass
class HandEvents:
    """Hand, object and first goal are placed anew for each episode; masses and the like with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.1))
    place_object: EventTerm | None = EventTerm(place_object)
    sample_goal: EventTerm | None = EventTerm(sample_goal)
    object_mass: EventTerm | None = None
    friction: EventTerm | None = None
    gains: EventTerm | None = None


@dataclass(kw_only=True)
class InHandRepose(Task):
    """A goal is reached when the object is turned to within ``tolerance`` of it; the next one follows at once.

    Succeeds when ``goals`` were reached in the episode before the object was dropped. Metrics: how many were reached,
    how far the object is from the last goal, and drops.
    """

    exceptions: ClassVar[tuple[TaskException, ...]] = (
        TaskException(TaskCheck.START_AREA, "the object starts in the hand"),
    )
    robot: str = "allegro_right"
    action: str = "joint_position"
    physics_dt: float = 1.0 / 120.0
    episode_length: float = 20.0
    view: Pose = look_at(eye=(0.35, -0.4, 0.95), target=(0.0, 0.03, 0.6))
    ppo: PpoSettings = PpoSettings(
        iterations=3000,
        hidden_sizes=(512, 256, 128),
        initial_std=0.6,
        entropy_weight=0.002,
        discount=0.995,
    )
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
    place: Tensor = field(init=False)
    """(3,) metres, where the object starts."""
    beside: Tensor = field(init=False)
    """(3,) metres, where the axes are drawn that the object shall have."""
    goal: Tensor = field(init=False)
    """(N, 4) orientation that the object shall have."""
    distance: Tensor = field(init=False)
    """(N,) rad that the object was from its goal after the last step, before a new goal followed."""
    reached: Tensor = field(init=False)
    """(N,) bool, whether the last step reached a goal."""
    count: Tensor = field(init=False)
    """(N,) goals that were reached in the episode."""

    def scene(self) -> Scene:
        self.bound(tolerance=(1e-3, torch.pi), goals=(1, 1000))
        item = self.object.build(OBJECT, Pose((0.0, 0.0, 1.0)))
        if item.fixed_base:
            raise ConfigurationError(
                f"field 'object' of task In-Hand-Repose is a '{self.object.name}' whose base is fixed, which no hand "
                "turns: choose a solid, such as 'box' or 'cylinder', that is free to move"
            )
        return Scene(
            robots=(hand(self.robot),),
            objects=(item,),
            terrain=(common.floor(),),
            markers=(MarkerSpec("goal", size=0.08), MarkerSpec("object_axes", size=0.08)),
            physics_dt=self.physics_dt,
        )

    def start(self, world: World) -> None:
        super().start(world)
        body = common.robot_of(world)
        frame = body.frame_pose(body.spec.end_effector.frame)[0, :3]
        self.place = frame + torch.tensor(self.offset or OFFSETS.get(self.robot, ABOVE_PALM), device=world.device)
        self.goal = torch.zeros(world.num_envs, 4, device=world.device)
        self.goal[:, 0] = 1.0
        self.distance, self.count = (torch.zeros(world.num_envs, device=world.device) for _ in range(2))
        self.reached = torch.zeros(world.num_envs, dtype=torch.bool, device=world.device)
        self.beside = self.place + torch.tensor((0.15, 0.0, 0.05), device=world.device)

    def reset(self, env_ids: Tensor | None) -> None:
        super().reset(env_ids)
        self.count[slice(None) if env_ids is None else env_ids] = 0.0

    def advance(self, world: World) -> None:
        """Count the goals that are reached, and follow each with the next."""
        self.distance.copy_(rotation_distance(world, self))
        torch.lt(self.distance, self.tolerance, out=self.reached)
        self.count += self.reached
        self.goal.copy_(torch.where(self.reached[:, None], common.random_rotations(world, None), self.goal))
        held = world.objects[OBJECT].root_pose
        world.markers["object_axes"].set_pose(held)
        world.markers["goal"].set_pose(torch.cat((self.beside.expand(len(held), 3), self.goal), dim=1))

    def randomize(self) -> None:
        """The object's mass, its friction and the hand's, the fingers' gains, and noise on joints and object."""
        gains = randomize.gains(common.ROBOT, stiffness=Range(0.75, 1.5), damping=Range(0.5, 2.0))
        self.events.object_mass = EventTerm(randomize.masses(OBJECT, Range(0.5, 1.5)), EventTime.STARTUP)
        friction = randomize.friction((common.ROBOT, OBJECT), Range(0.7, 1.3))
        self.events.friction = EventTerm(friction, EventTime.STARTUP)
        self.events.gains = EventTerm(gains, EventTime.STARTUP)
        common.add_noise(self.observations.policy, joint_positions=0.005, joint_velocities=0.05, object_pose=0.002)

    def success(self, world: World) -> Tensor:
        return self.count >= self.goals

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {
            "goals_reached": self.count,
            "rotation_distance_rad": rotation_distance(world, self),
            "drops": dropped(world, self).float(),
        }
