"""Task of an authored scene: objects of interest are to be brought into the goal region."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.catalogue import robot
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm, Task
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import ROBOT, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, POSE, means, measured_in, once_per_state
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_core.scene import Box, MarkerSpec, RobotSpec, Scene, Shape
from orbit_scenes.document.build import SceneBuilder
from orbit_scenes.document.edits import rename
from orbit_scenes.document.files import load_document
from orbit_scenes.document.model import TaskPlan

GOAL = "goal"
"""Name of the marker that shows the goal region."""
# Metres of distance at which a reward has fallen by about half.
_NEAR = 0.2


class SceneTaskState(TaskState):
    """State of a task in a scene, looked up once in a new world."""

    goal: Tensor
    """(3,) middle of the goal region, m."""
    half: Tensor
    """(3,) half of its edges, m."""

    def start(self, env: Environment) -> None:
        plan = env.task.plan
        self.goal = torch.tensor(plan.goal, device=env.device)
        self.half = 0.5 * torch.tensor(plan.size, device=env.device)


def _pieces(env: Environment[SceneTask]) -> list[str]:
    parts = ("x", "y", "z", "qw", "qx", "qy", "qz")
    return [f"{name}_{part}" for name in env.task.plan.objects for part in parts]


@means("poses of the objects of interest, one after another", ENVIRONMENT, components=_pieces)
@measured_in(POSE)
@once_per_state
def object_poses(env: Environment[SceneTask]) -> Tensor:
    """(N, 7 K) of the objects of interest in the environment's frame."""
    return torch.cat([env.world.objects[name].root_pose for name in env.task.plan.objects], dim=1)


@once_per_state
def object_positions(env: Environment[SceneTask]) -> Tensor:
    """(N, K, 3) of the objects of interest in the environment's frame."""
    return object_poses(env).unflatten(1, (-1, 7))[..., :3]


@once_per_state
def goal_distances(env: Environment[SceneTask, SceneTaskState]) -> Tensor:
    """(N, K) metres from each object's origin to the goal region; zero inside of it."""
    outside = (object_positions(env) - env.state.goal).abs() - env.state.half
    return vector_norm(outside.clamp_min(0.0), dim=2)


@means("pose of the end effector's frame, or of the root link of a robot without one", ENVIRONMENT)
@measured_in(POSE)
@once_per_state
def hand_pose(env: Environment[SceneTask]) -> Tensor:
    """(N, 7) in the environment's frame."""
    acting = common.robot_of(env.world)
    return common.hand_pose(env) if acting.spec.end_effectors else acting.root_pose


@means("middle of the goal region minus the origin of each object of interest, one after another", ENVIRONMENT)
@measured_in("m")
def to_goal(env: Environment[SceneTask, SceneTaskState]) -> Tensor:
    """(N, 3 K) from each object's origin to the middle of the goal region."""
    return (env.state.goal - object_positions(env)).flatten(1)


def reaching(env: Environment[SceneTask]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the nearest object that is not in the goal region."""
    distances = vector_norm(object_positions(env) - hand_pose(env)[:, None, :3], dim=2)
    # Objects that are there already count as reached, so that nothing is gained by staying with them.
    left = torch.where(goal_distances(env) > 0.0, distances, torch.inf).amin(1)
    return torch.where(left.isfinite(), common.nearness(left.nan_to_num(posinf=0.0), _NEAR), 1.0)


def approaching(env: Environment[SceneTask]) -> Tensor:
    """(N,) in [0, 1]: mean nearness of the objects to the goal region."""
    return common.nearness(goal_distances(env), _NEAR).mean(1)


def inside(env: Environment[SceneTask]) -> Tensor:
    """(N,) in [0, 1]: share of the objects that are in the goal region."""
    return (goal_distances(env) == 0.0).float().mean(1)


def place_objects(env: Environment[SceneTask], env_ids: Tensor) -> None:
    """Place each object of interest where the scene has it, up to ``spread`` metres away along x and y."""
    spread = env.task.plan.spread
    for name in env.task.plan.objects:
        thing = env.world.objects[name]
        pose = thing.spec.pose
        drawn = env.world.random.uniform((2,), (-spread, -spread), (spread, spread), env_ids)
        start = torch.tensor((*pose.position, *pose.orientation), device=env.device).repeat(len(drawn), 1)
        start[:, :2] += drawn
        thing.set_root_pose(start, env_ids)


@dataclass
class SceneState(ObservationGroup):
    """The robot's joints, its hand, the objects of interest, the way to the goal and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(hand_pose)
    object_poses: ObservationTerm | None = ObservationTerm(object_poses)
    to_goal: ObservationTerm | None = ObservationTerm(to_goal)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class SceneObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: SceneState = field(default_factory=SceneState)
    critic: ObservationGroup | None = None


@dataclass
class SceneRewards:
    """Rewards of the hand at the objects and of the objects at the goal, less what is abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    approach: RewardTerm | None = RewardTerm(approaching, 5.0)
    inside: RewardTerm | None = RewardTerm(inside, 10.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)


@dataclass
class SceneEvents:
    """Robot and objects are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.02))
    place_objects: EventTerm | None = EventTerm(place_objects)


@dataclass(kw_only=True)
class SceneTask(Task):
    """Objects of an authored scene are to be in its goal region at the episode's end.

    Metric: the distance of the object that is farthest from it.
    """

    state_type: ClassVar[type[TaskState]] = SceneTaskState
    file: str
    """Scene file."""
    plan: TaskPlan
    """Objects, goal region and start of episodes; the scene file's own by default."""
    observations: SceneObservations = field(default_factory=SceneObservations)
    rewards: SceneRewards = field(default_factory=SceneRewards)
    events: SceneEvents = field(default_factory=SceneEvents)

    def scene(self) -> Scene:
        plan = self.plan
        # The robot that acts has one name in all tasks.
        document = replace(load_document(Path(self.file)), task=plan)
        document = document if plan.robot == ROBOT else rename(document, plan.robot, ROBOT)
        builder = SceneBuilder(Path(self.file).parent)
        if not isinstance(builder.entity(document.item(ROBOT)), RobotSpec):
            raise ConfigurationError(f"'{plan.robot}' of {self.file} is no robot: name one in its task")
        for name in plan.objects:
            if name == plan.robot:
                raise ConfigurationError(f"'{name}' of {self.file} is the robot that acts: take another object")
            if not builder.entity(document.item(name)).is_free_body:
                raise ConfigurationError(f"object of interest '{name}' of {self.file} cannot be moved: take another")
        scene = builder.scene(document)
        acting = tuple(self._chosen(each) if each.name == ROBOT else each for each in scene.robots)
        x, y, z = plan.size
        region = Shape(Box((0.5 * x, 0.5 * y, 0.5 * z)), color=(0.15, 0.7, 0.25, 0.25))
        marker = MarkerSpec(GOAL, size=0.0, shapes=(region,))
        return replace(scene, robots=acting, markers=(marker,), physics_dt=self.physics_dt)

    def mark(self, env: Environment) -> None:
        """Show the goal region."""
        goal = env.state.goal.expand(env.num_envs, 1, 3)
        common.place_markers(env.world, (GOAL,), goal)

    def success(self, env: Environment) -> Tensor:
        return goal_distances(env).amax(1) == 0.0

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distances(env).amax(1)}

    def _chosen(self, spec: RobotSpec) -> RobotSpec:
        """Return the scene's robot, or the one of the catalogue that took its place, at the same pose."""
        if self.robot == type(self).robot:
            return spec
        return replace(robot(self.robot), name=ROBOT, pose=spec.pose)


def task_of_file(path: str) -> type[SceneTask]:
    """Return the class of the task that a scene file describes, its fields' defaults those of the file.

    Raises:
        ConfigurationError: the file cannot be read, is damaged, or has no task.
    """
    document = load_document(Path(path))
    asked = document.task
    if asked is None:
        raise ConfigurationError(f"scene file {path} has no task: make one in 'orbit edit {path}', or a table [task]")
    acting = document.item(asked.robot)
    words = asked.instruction or f"bring {' and '.join(asked.objects)} to the goal".replace("_", " ")

    described = TaskMetadata(instruction=words)

    @dataclass(kw_only=True)
    class FileTask(SceneTask):
        file: str = path
        plan: TaskPlan = asked
        robot: str = acting.robot or acting.name
        action: str = asked.action
        physics_dt: float = document.physics_dt
        episode_length: float = asked.episode_length
        metadata: TaskMetadata = described

    FileTask.__doc__ = f"Task of the scene file {path}."
    FileTask.__name__ = Path(path).stem
    return FileTask
