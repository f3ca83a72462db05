"""Task: the configuration of an environment, and metadata about it."""

from __future__ import annotations

import functools
import inspect
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field, fields
from enum import Enum
from typing import TYPE_CHECKING, Any, ClassVar

from torch import Tensor

from orbit_core.envs.off_policy import OffPolicySettings
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.interfaces import ConfigurationError, Node
from orbit_core.scene import Pose, RobotSpec, Scene, look_at

if TYPE_CHECKING:
    from orbit_core.actions import ActionTerm
    from orbit_core.envs.environment import Environment

# Name of the robot that acts, where a task has one.
ROBOT = "robot"

# Name of the action space of a task that brings its own action terms.
COMPOSED = "composed"

# Methods that tasks had, and what takes their place.
MOVED_METHODS = {
    "start": "TaskState.start(env)",
    "advance": "TaskState.update(env)",
    "reset": "TaskState.reset(env_ids), which resets the tensors that buffer() declares",
    "subtasks": "metadata.subtasks",
}
# Fields that tasks had, and what takes their place.
MOVED_FIELDS = {
    "ppo": "metadata.ppo",
    "view": "metadata.view",
    "expert_success": "metadata.expert_success",
    "exceptions": "metadata.exceptions",
    "training": "metadata.training",
}
# Attributes that running tasks had, and what takes their place.
MOVED_STATE = {
    "num_envs": "env.num_envs",
    "device": "env.device",
    "generators": "env.actions.generators",
    "action_slices": "env.actions.slices",
    "action_components": "env.actions.components",
    "cache": "env.cache",
    "last_action": "env.state.last_action",
    "action_before": "env.state.action_before",
    "episode_step": "env.state.episode_step",
    "difficulty": "env.state.difficulty",
}


class TaskCheck(Enum):
    """A property of a task that ``orbit check-task`` measures."""

    EXPERT_BEATS_RANDOM = "expert beats random"
    """The expert's mean return is above that of uniformly random actions."""
    EXPERT_BEATS_ZERO = "expert beats zero"
    """The expert's mean return is above that of actions that are all zero."""
    VELOCITY_LIMITS = "velocity limits"
    """The expert's joints are within their velocity limits, but for a small share of samples."""
    EFFORT_LIMITS = "effort limits"
    """The efforts on the expert's joints are within their limits."""
    START_AREA = "start area"
    """Something begins its episodes at places that cover an area."""
    START_YAW = "start yaw"
    """Something begins its episodes turned by many angles about the vertical."""
    TRIVIAL_AGENTS = "trivial agents"
    """No agent that looks at nothing succeeds more often than a stated rate."""


@dataclass(frozen=True)
class TaskException:
    """A task's declaration that it does not meet a check.

    An exception that a measurement contradicts is stale, and fails as the check would; but that of velocity limits,
    which some engines enforce themselves.
    """

    check: TaskCheck
    """Check that the task does not meet."""
    reason: str
    """A sentence for the table of checked tasks."""


@dataclass(frozen=True)
class Subtask:
    """Part of a demonstration in which the hand moves relative to one frame."""

    frame: Callable[..., Tensor]
    """(env) -> (N, 7), read when the subtask begins."""
    over: Callable[..., Tensor]
    """(env) -> (N,) bool, True where it is done; not read for the last subtask."""
    free: bool = True
    """False where the hand begins in what it has grasped and moves that along a given way, as a drawer: the whole
    motion counts, and no other way leads to it."""


@dataclass(frozen=True)
class TaskMetadata:
    """Facts about a task that no step reads: for training, pictures, audits and augmentation."""

    ppo: PpoSettings = PpoSettings()
    """Settings that ``orbit train`` learns it with."""
    off_policy: OffPolicySettings = OffPolicySettings()
    """Settings of ``orbit train --algorithm sac`` and td3."""
    view: Pose = look_at(eye=(1.5, 1.0, 0.85), target=(0.35, 0.0, 0.2))
    """Direction from which pictures and videos are taken, in the environment's frame. The camera stands where what the
    task moves fills the picture; here, if nothing moves."""
    follow: str = ""
    """Entity that the camera of pictures and videos moves with; empty leaves it where it is."""
    expert_success: float = 0.8
    """Success rate that conformance requires of the expert, where there is one, on every engine."""
    exceptions: tuple[TaskException, ...] = ()
    """Checks of ``orbit check-task`` that the task does not meet, with reasons."""
    training: Mapping[str, Any] = field(default_factory=dict)
    """Fields by name that ``orbit train`` sets unless the command line sets them."""
    subtasks: tuple[Subtask, ...] = ()
    """Subtasks of a demonstration, in order (:mod:`orbit_data.augmentation`)."""
    instruction: str = ""
    """The task in words, as a person would ask for it; empty takes the task's name (:func:`instruction_of`)."""


@dataclass(kw_only=True)
class Task(ABC):
    """Configuration of an environment: the scene, and collections of terms. Subclasses are dataclasses.

    ``rewards``, ``terminations``, ``events``, ``commands``, ``curriculum`` and ``premises`` are dataclasses of terms,
    ``observations`` is one of :class:`~orbit_core.envs.ObservationGroup`; None is an empty collection. What a run
    remembers is in ``env.state``, of the class :attr:`state_type`.

    Raises:
        ConfigurationError: a subclass has methods or fields of the form that tasks had before; names the new ones.
    """

    agents: ClassVar[tuple[str, ...]] = (ROBOT,)
    """Names of the scene's robots that act, in the order of the action."""
    state_type: ClassVar[type[TaskState]] = TaskState
    """Class of the state that a run of the task has."""
    observation_presets: ClassVar[Mapping[str, Callable[[], Any]]] = {}
    """Other observations, by the word that takes the place of ``observations``; ``"state"`` is the default's."""
    renamed: ClassVar[Mapping[str, str]] = {}
    """New paths of fields that the task had before, by their old paths, for errors."""
    robot: str
    """Name of a robot in the catalogue."""
    action: str
    """Name of an action space, :func:`orbit_core.actions.preset_terms`; ``"composed"`` where ``actions`` are given."""
    physics_dt: float = 0.005
    """Seconds."""
    decimation: int = 4
    """Physics steps in one step of the environment."""
    episode_length: float = 5.0
    """Seconds."""
    actions: Any = None
    """Action terms in place of an action space: :class:`orbit_core.actions.ActionTerms`, or a dataclass of one's own
    with fields of :class:`~orbit_core.actions.ActionTerm`. None takes the preset that ``action`` names."""
    observations: Any = None
    rewards: Any = None
    terminations: Any = None
    events: Any = None
    commands: Any = None
    """Commands, a dataclass of :class:`~orbit_core.envs.CommandTerm`."""
    curriculum: Any = None
    premises: Any = None
    """Premises of an episode's start, a dataclass of :class:`~orbit_core.envs.PremiseTerm`. Each
    premise is a metric, ``premise_<name>``: 1 where it held at the episode's start."""
    settle_time: float = 0.0
    """Seconds simulated after each reset, commands held, before premises are checked and anything is observed. They
    cost a step of all environments each time, whoever begins; zero costs nothing."""
    premise_time: float = 0.5
    """Seconds simulated in the starts that are sampled when an environment is built, where a task has premises."""
    domain_randomization: bool = False
    """Whether physical parameters and noise are randomised between environments, as :meth:`randomize` says."""
    curriculum_enabled: bool = False
    """Whether the curriculum sets how difficult episodes are; else they are as difficult as can be."""
    expert_starts: float = 0.0
    """Share of episodes that begin on the expert's way (:class:`orbit_motion.experts.starts.ExpertStarts`), for
    learning what a beginner would not reach."""
    expert_phase: bool = False
    """True to show the policy the phase that the expert is in (:mod:`orbit_core.envs.expert_phase`), for cloning an
    expert whose phases end after a time."""
    backend_presets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Engine settings by backend name, where this task needs other than an engine's defaults."""
    metadata: TaskMetadata = TaskMetadata()
    """Facts that no step reads, such as the settings of its training."""

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        _check_form(cls)

    def __setattr__(self, name: str, value: object) -> None:
        # A trace would freeze what a term keeps here, and a copy of the task for another environment would share it.
        if name not in _field_names(type(self)):
            raise ConfigurationError(
                f"task {type(self).__name__} has no field '{name}': a task is configuration, and its fields are "
                f"declared in its class. What a run remembers is a tensor of the task's TaskState, "
                f"{name}: Tensor = buffer(), which terms write as env.state.{name}"
            )
        object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        # Only called for attributes that are not found: the usual reads of a field cost nothing.
        moved = {**MOVED_FIELDS, **MOVED_STATE, **MOVED_METHODS}
        if name in moved:
            raise AttributeError(f"'{name}' of task {type(self).__name__} is now {moved[name]}")
        if hasattr(vars(self).get("commands"), name):
            raise AttributeError(f"'{name}' of task {type(self).__name__} is a command: env.commands['{name}']")
        if hasattr(self.state_type, name) or name in getattr(self.state_type, "__annotations__", ()):
            raise AttributeError(f"'{name}' of task {type(self).__name__} is state: env.state.{name}")
        raise AttributeError(f"task {type(self).__name__} has no attribute '{name}'")

    def randomize(self) -> None:
        """Give the task the terms of ``domain_randomization``. Override where a task has some.

        Raises:
            ConfigurationError: it has none.
        """
        raise ConfigurationError(
            f"task {type(self).__name__} has no randomisation of its own: leave domain_randomization out, and set "
            "its terms yourself (orbit_core.mdp.randomize)"
        )

    def preset_terms(self, spec: RobotSpec, prefix: str) -> dict[str, ActionTerm]:
        """Return the action terms of the preset that ``action`` names, for one of the robots that act. Extend where a
        task's robots are moved by more.

        Args:
            spec: of the robot.
            prefix: begins the terms' names.

        Raises:
            UnknownNameError: there is no such action space.
        """
        from orbit_core.actions import preset_terms  # heavier than what is needed to list tasks

        return preset_terms(spec, self.action, prefix)

    @abstractmethod
    def scene(self) -> Scene:
        """Return the scene to simulate."""

    def mark(self, env: Environment) -> None:
        """Place markers that people look at. Called before a spectator's picture is drawn, and never within a step."""

    def bound(self, **limits: tuple[float, float]) -> None:
        """Check that fields are within the least and the most that they may be.

        Raises:
            ConfigurationError: one is not within them.
        """
        for name, (least, most) in limits.items():
            if not least <= getattr(self, name) <= most:
                raise ConfigurationError(
                    f"field '{name}' of task {type(self).__name__} must be {least} to {most}, not {getattr(self, name)}"
                )

    @abstractmethod
    def success(self, env: Environment) -> Tensor:
        """Return (N,) bool, True where the goal is reached now. An episode succeeds if it is at its last step."""

    @abstractmethod
    def metrics(self, env: Environment) -> dict[str, Tensor]:
        """Return what a run reports of an episode's last step, (N,) each, by name with its unit; the first leads."""

    def expert(self, env: Environment) -> Node:
        """Return a scripted node that reaches the goal, with the output port ``action``. Override where there is one.

        Raises:
            ConfigurationError: the task has no expert.
        """
        raise ConfigurationError(
            f"task {type(self).__name__} has no scripted expert: learn it (orbit train), or take another agent, "
            "--agent random or a policy"
        )

    @classmethod
    def has_expert(cls) -> bool:
        """Return True if the task overrides :meth:`expert`."""
        return cls.expert is not Task.expert


@functools.cache
def _field_names(kind: type[Task]) -> frozenset[str]:
    return frozenset(each.name for each in fields(kind))


def _check_form(kind: type[Task]) -> None:
    """Refuse a class of the form that tasks had when they held their state, with the new names.

    Raises:
        ConfigurationError: a method, field or signature is an old one.
    """
    # Only what the class itself defines: a base was checked when it was made.
    own = vars(kind)
    for name, now in {**MOVED_METHODS, **MOVED_FIELDS}.items():
        if name in own or name in own.get("__annotations__", ()):
            raise ConfigurationError(
                f"task {kind.__name__} has '{name}', which is now {now}: a task is configuration, and its state and "
                "metadata stand in classes of their own (docs/write-a-task.md)"
            )
    for name, value in own.items():
        if isinstance(value, Field) and not value.init:
            raise ConfigurationError(
                f"field '{name}' of task {kind.__name__} has init=False, as what a task remembered had: declare it in "
                f"a TaskState, {name}: Tensor = buffer(), name that class in state_type, and write env.state.{name}"
            )
    for name in ("success", "metrics", "expert"):
        method = own.get(name)
        if inspect.isfunction(method) and list(inspect.signature(method).parameters)[1:2] == ["world"]:
            raise ConfigurationError(
                f"{name}(self, world) of task {kind.__name__} is now {name}(self, env): the world is env.world, what "
                "the task remembers env.state"
            )


def instruction_of(task: Task, name: str, given: str | None = None) -> str:
    """Return a task in words, as a person would ask for it.

    Args:
        task: whose metadata may have the words.
        name: name that the task was made by, whose words serve where there are none.
        given: words that take precedence.
    """
    return given or task.metadata.instruction or re.sub(r"[-_]|(?<=[a-z])(?=[A-Z])", " ", name).lower()
