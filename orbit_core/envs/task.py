"""What every task is made of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor

from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task_checks import TaskException
from orbit_core.envs.terms import CurriculumTerm
from orbit_core.interfaces import ConfigurationError, Node
from orbit_core.scene import Pose, RobotSpec, Scene, look_at

if TYPE_CHECKING:
    from orbit_core.actions import ActionTerm, MotionGenerator
    from orbit_core.interfaces import World

ROBOT = "robot"
"""The robot that acts, where a task has one."""

COMPOSED = "composed"
"""The word that stands for an action space's name where a task has action terms of its own."""


@dataclass(frozen=True)
class Subtask:
    """A stretch of a demonstration in which the hand moves relative to one frame, wherever that is."""

    frame: Callable[..., Tensor]
    """(world, task) -> (N, 7), read when the subtask begins."""
    over: Callable[..., Tensor]
    """(world, task) -> (N,) bool whether it is done; of no meaning for the last."""


@dataclass(kw_only=True)
class Task(ABC):
    """A goal over a world. Subclasses are dataclasses: their fields are the task's configuration.

    ``rewards``, ``terminations``, ``events``, ``curriculum`` and ``premises`` are dataclasses of terms,
    ``observations`` is one of :class:`~orbit_core.envs.ObservationGroup`. The attributes that are set by :meth:`start`
    hold what a task remembers while it runs; terms read and write them.
    """

    agents: ClassVar[tuple[str, ...]] = (ROBOT,)
    """Names of the scene's robots that act, in the order of the action."""
    observation_presets: ClassVar[Mapping[str, Callable[[], Any]]] = {}
    """Other observations, by the word that takes the place of ``observations``; ``"state"`` stands for the default."""
    training: ClassVar[Mapping[str, Any]] = {}
    """Fields by name that ``orbit train`` sets unless it is told otherwise."""
    expert_success: ClassVar[float] = 0.8
    """Success rate that the expert, where there is one, is held to on every engine: conformance fails those where it is
    beyond chance below."""
    exceptions: ClassVar[tuple[TaskException, ...]] = ()
    """Checks of ``orbit check-task`` that the task does not meet, with reasons."""
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
    with fields of :class:`~orbit_core.actions.ActionTerm`. None takes those that ``action`` stands for."""
    observations: Any = None
    rewards: Any = None
    terminations: Any = None
    events: Any = None
    curriculum: Any = None
    premises: Any = None
    """What must hold when an episode begins, a dataclass of :class:`~orbit_core.envs.PremiseTerm`; None: nothing. Each
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
    view: Pose = look_at(eye=(1.5, 1.0, 0.85), target=(0.35, 0.0, 0.2))
    """Pose of the camera that takes pictures and videos, in the environment's frame."""
    expert_starts: float = 0.0
    """Share of episodes that begin on the expert's way (:class:`orbit_core.envs.ExpertStarts`), for learning what a
    beginner would not come to."""
    backend_presets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Engine settings by backend name, where this task needs other than an engine's defaults."""

    ppo: PpoSettings = PpoSettings()
    """How it is learned."""

    # Remembered while running

    num_envs: int = field(init=False, default=0)
    device: torch.device = field(init=False, default_factory=lambda: torch.device("cpu"))
    generators: tuple[MotionGenerator, ...] = field(init=False, default=())
    """What turns actions into joint commands, in the order of the action's components."""
    action_slices: Mapping[str, slice] = field(init=False, default_factory=dict)
    """Which components of the action are each agent's."""
    action_components: tuple[str, ...] = field(init=False, default=())
    """Name of each component of the action: of its term, then its own."""
    last_action: Tensor = field(init=False)
    """(N, A) the action in effect; zero after a reset."""
    action_before: Tensor = field(init=False)
    """(N, A) the action of the step before that."""
    episode_step: Tensor = field(init=False)
    """(N,) int64 steps since reset."""
    difficulty: Tensor = field(init=False)
    """(N,) in [0, 1], for terms to read. It starts at 0 where the curriculum is enabled and has a
    :class:`~orbit_core.envs.CurriculumTerm`, and else stays 1; resets do not change it."""
    cache: dict[Hashable, tuple[int, Tensor | None]] = field(init=False, default_factory=dict)

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
        """The action terms that the word ``action`` stands for, of one of the robots that act. Extend where a task's
        robots are moved by more.

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
        """What to simulate."""

    def bound(self, **limits: tuple[float, float]) -> None:
        """Hold fields to the least and the most that they may be.

        Raises:
            ConfigurationError: one is not within them.
        """
        for name, (least, most) in limits.items():
            if not least <= getattr(self, name) <= most:
                raise ConfigurationError(
                    f"field '{name}' of task {type(self).__name__} must be {least} to {most}, not {getattr(self, name)}"
                )

    def start(self, world: World) -> None:
        """Look things up in a new world and allocate what the task remembers. Extend, and call this first."""
        self.num_envs = world.num_envs
        self.device = world.device
        self.episode_step = torch.zeros(world.num_envs, dtype=torch.int64, device=world.device)
        curriculum = () if self.curriculum is None else vars(self.curriculum).values()
        easy = self.curriculum_enabled and any(isinstance(term, CurriculumTerm) for term in curriculum)
        self.difficulty = torch.full((world.num_envs,), float(not easy), device=world.device)

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget some environments' past. Extend where a subclass remembers more than its events set anew."""
        rows = slice(None) if env_ids is None else env_ids
        self.episode_step[rows] = 0
        self.last_action[rows] = 0.0

    def advance(self, world: World) -> None:
        """Called after each step of the world, before rewards: accumulate, resample. Extend where needed."""

    @abstractmethod
    def success(self, world: World) -> Tensor:
        """(N,) bool: whether the goal is reached now. An episode succeeds if it holds at its last step."""

    @abstractmethod
    def metrics(self, world: World) -> dict[str, Tensor]:
        """What a run reports, by name with its unit, (N,) each, taken at an episode's last step; the first leads."""

    def subtasks(self) -> tuple[Subtask, ...]:
        """What a demonstration is made of, in order (:mod:`orbit_data.augmentation`). Override where it is known.

        Raises:
            ConfigurationError: nobody says it.
        """
        raise ConfigurationError(
            f"task {type(self).__name__} does not say what subtasks it is made of: override Task.subtasks"
        )

    def expert(self, world: World) -> Node:
        """A scripted node that reaches the goal, with the output port ``action``, in the cut's place. Override where
        there is one.

        Raises:
            ConfigurationError: nobody wrote one.
        """
        raise ConfigurationError(
            f"task {type(self).__name__} has no scripted expert: learn it (orbit train), or take another agent, "
            "--agent random or a policy"
        )

    @classmethod
    def has_expert(cls) -> bool:
        """Whether the task overrides :meth:`expert`."""
        return cls.expert is not Task.expert
