"""The vectorised environment: a task's agent, cut at its policy, over a world."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Hashable, Mapping
from typing import Any, Generic, cast

import numpy as np
import torch
from torch import Tensor
from typing_extensions import TypeVar

from orbit_core.agent import AgentGraph, Edge, FunctionNode
from orbit_core.backends import default_backend
from orbit_core.configuration import settings_table
from orbit_core.dynamics.arguments import (
    FINITE,
    MOST_ENVIRONMENTS,
    as_floats,
    check_numbers,
    seed_number,
    usable_device,
    whole_number,
)
from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.linear import SingleThreaded
from orbit_core.envs.action_manager import ActionManager, action_terms, driven_scene
from orbit_core.envs.captured_step import CapturedStep, StepResult, needs_python, remembered, where_rows
from orbit_core.envs.command_manager import CommandManager
from orbit_core.envs.configuration import (
    ConfigurationWatch,
    Modifiers,
    check_no_backend,
    curriculum_of,
    modifiers_of,
    whole_steps,
)
from orbit_core.envs.episode import EpisodeEnd, LostEpisodes, StepInfo
from orbit_core.envs.event_manager import EventManager
from orbit_core.envs.expert_phase import show_expert_phase
from orbit_core.envs.multi_agent import MultiAgentView, check_owners
from orbit_core.envs.observation_layout import (
    POLICY,
    Observation,
    leaf_shapes,
    leaves_of,
    observation_of,
    with_sensors_of_terms,
)
from orbit_core.envs.observation_layout import check_finite as check_observation
from orbit_core.envs.observation_manager import ObservationManager
from orbit_core.envs.policy_loop import PolicyLoop
from orbit_core.envs.premises import PremiseManager
from orbit_core.envs.registry import episode_starts
from orbit_core.envs.reward_manager import RewardManager
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import Task
from orbit_core.envs.terms import TerminationTerm, per_environment, terms_of
from orbit_core.interfaces import ConfigurationError, Node, Port, ShapeError
from orbit_core.world import WorldFactory, simulate
from orbit_core.world.lifetime import mark_closed

TaskT = TypeVar("TaskT", bound=Task, covariant=True, default=Any)
StateT = TypeVar("StateT", bound=TaskState, covariant=True, default=Any)

# Bounds of an action's components, as arrays, which NumPy does not convert in each step.
_LOWEST, _HIGHEST = np.array(-1.0, np.float32), np.array(1.0, np.float32)


class Environment(Generic[TaskT, StateT]):
    """N environments of a task, stepped together, each reset as soon as its episode ends (same-step autoreset).

    Observations are groups by name, as :attr:`observation` says; every task has the group ``"policy"``. Actions are
    (N, A) in [-1, 1]; values outside are clipped. All tensors are on ``device``.

    Args:
        task: copied, so that one configuration may start many environments.
        num_envs: how many.
        backend: name of the physics backend; the default one if None.
        device: where tensors live.
        seed: of every environment's random stream.
        renderer: name of the backend that draws; the physics backend if None.
        settings: of the physics backend, by field name, over the task's preset.
        renderer_settings: of the renderer, by field name.
        compile: whether to compile the layer's part of a step; the first step then takes seconds.
        check_finite: whether to look for observations that are NaN or infinite on a GPU too, where each step then waits
            for the device; on a CPU they always are.
        world: makes the world instead of a backend: one of recorded states, or of real robots.
        matter: name of the matter solver, or ``"native"``, as :func:`orbit_core.world.simulate` takes it.
        matter_settings: of the matter solver, by field name.
        reset_diverged: whether an environment that diverges begins a new episode (:class:`LostEpisodes`), rather than
            that the step raises.
        capture: whether a step on a GPU is captured once and repeated without its Python. Without, a task's terms may
            count and decide in plain Python, and each step waits for the device. On a CPU only ``compile`` captures.
        autoreset: whether the next episode begins in the step that ends one; without, which is for one environment, the
            world stays as it ended until :meth:`reset`, and no step is taken before.

    Raises:
        ConfigurationError: among others, nothing compiles here, or the task's step cannot be compiled.
        NonFiniteError: a term gives what is not finite; names it. :meth:`reset` and :meth:`step` raise it too.
        PremiseError: the task's premise of that name holds in no start in this engine; where it fails in some, there
            is a warning.
    """

    def __init__(
        self,
        task: TaskT,
        num_envs: int,
        backend: str | None = None,
        device: str | torch.device = "cpu",
        seed: int = 0,
        renderer: str | None = None,
        settings: Mapping[str, Any] | None = None,
        renderer_settings: Mapping[str, Any] | None = None,
        compile: bool = False,
        check_finite: bool = False,
        world: WorldFactory | None = None,
        matter: str | None = None,
        matter_settings: Mapping[str, Any] | None = None,
        reset_diverged: bool = False,
        capture: bool = True,
        autoreset: bool = True,
    ) -> None:
        if not isinstance(task, Task):
            raise ConfigurationError(f"an environment needs a Task, not a {type(task).__name__}: orbit_core.envs.make")
        num_envs, seed = whole_number(num_envs, "num_envs", 1, MOST_ENVIRONMENTS), seed_number(seed)
        self.task = task = copy.deepcopy(task)
        if task.domain_randomization:
            task.randomize()
        if task.expert_phase:
            show_expert_phase(task)
        self.max_episode_steps = whole_steps(task)
        """Steps until the time limit."""
        scene = task.scene()
        terms = action_terms(task, scene)
        scene = with_sensors_of_terms(driven_scene(scene, terms), task)
        if world is None:
            backend = default_backend() if backend is None else backend
            preset = task.backend_presets.get(backend, {}) if isinstance(backend, str) else {}
            merged = {**preset, **settings_table(settings, f"backend '{backend}'")}
            others = (renderer, renderer_settings, matter, matter_settings)
            self.world = simulate(scene, num_envs, backend, merged, device, seed, *others)
        else:
            drawn = {"renderer": renderer, "renderer_settings": renderer_settings}
            matters = {"matter": matter, "matter_settings": matter_settings}
            check_no_backend({"backend": backend, "settings": settings, **drawn, **matters})
            self.world = world(scene, num_envs, usable_device(device), seed)
        self.num_envs = num_envs
        self.device = self.world.device
        self.step_dt = task.physics_dt * task.decimation
        """Seconds of a step: physics step times decimation."""
        check_owners(task)
        self.cache: dict[Hashable, tuple[int, Tensor]] = {}
        """Values of terms that are computed once per state of the world (:func:`once_per_state`)."""
        self.termination_terms = terms_of(task.terminations, TerminationTerm)
        """Terms that end episodes early, by name."""
        self._curriculum = curriculum_of(task)
        self._modifiers = Modifiers(task, modifiers_of(task))
        self.steps = 0
        """Steps made since the environment was made."""
        self.all_ids = torch.arange(num_envs, device=self.device)
        """(N,) indices of all environments."""
        self.done = torch.zeros(num_envs, dtype=torch.bool, device=self.device)
        """(N,) whose episode ended in the last step."""
        # NumPy's view: on few numbers its operations cost a third of torch's.
        self._ended = self.done.numpy() if self.device.type == "cpu" else self.done
        self.lost = LostEpisodes(self.world) if reset_diverged else None
        """Episodes that diverged, where these do not raise."""
        self._limit = torch.tensor(self.max_episode_steps, device=self.device)
        self._never = torch.zeros(num_envs, dtype=torch.bool, device=self.device)
        self.actions = ActionManager(self.world, task, terms, self.step_dt)
        """Manager of the action terms."""
        self.action_size = self.actions.size
        """Components A of an action."""
        self._action = self.actions.action
        self._clipped = self._action.numpy() if self.device.type == "cpu" else None
        self.state: StateT = cast(StateT, task.state_type(self))
        """Memory of the run, of the class that :attr:`Task.state_type` names."""
        # A step's time is that of its Python calls: what a task does not override is not called.
        self._state_updates = type(self.state).update is not TaskState.update
        self.actions.attach(self.state)
        self.state.start(self)
        self.commands = CommandManager(self)
        """What each environment is told to do: ``env.commands["goal"]``, (N, K)."""
        self._rewards = RewardManager(self)
        self.reward_terms, self.reward_sums = self._rewards.terms, self._rewards.sums
        """Reward terms by name, and their sums (rewards, N) over the present episodes."""
        self.observer = ObservationManager(self)
        """Manager of the observation groups."""
        self.observation = self.observer.layouts
        """Layout of each group of the observation, by name."""
        self._checks = check_finite or self.device.type == "cpu"
        # Observation of the present state; None until it is computed, which draws its noise.
        self._seen: Observation | None = None
        several = len(task.agents) > 1
        self.multi_agent = MultiAgentView(self, self.observation[POLICY]) if several else None
        """Whose each part of observation, action and reward is, where several robots act."""
        if compile and not capture:
            raise ConfigurationError("compile=True needs the step to be captured: leave capture=False out, or compile")
        if not autoreset and num_envs > 1:
            raise ConfigurationError(f"autoreset=False is for one environment that waits for reset, not for {num_envs}")
        self._compile, self._capture, self._autoreset = compile, capture, autoreset
        # True if the episode has ended and waits for a reset.
        self._over = False
        # Whether a step was made, and with it all that is made at first use, which a trace would make again each time.
        self._started = False
        self.premises = PremiseManager(self, simulated=world is None)
        """What the task takes for granted of an episode's start, and how often it does not hold."""
        self.starts = episode_starts().get("expert")(self) if task.expert_starts else None
        """Which episodes begin on the expert's way, where the task asks for such."""
        self._watch = ConfigurationWatch(task)
        self._closed = self._close_step()
        self._events = EventManager(self, lambda: remembered(self))
        # Without a capture nothing is frozen, and a task may count in plain Python.
        if capture:
            self.state.lock()
        self._events.startup()
        self.premises.sample(self.begin)
        if self.starts is not None:
            self.starts.record(self, self._action)
        self.begin(None)
        self._observe()

    # Gymnasium's way ------------------------------------------------------------------------------------------------

    def reset(self, seed: int | None = None, env_ids: Tensor | None = None) -> tuple[Observation, dict[str, Any]]:
        """Begin new episodes in some environments; with a seed, restart their random streams.

        Args:
            seed: 0 to 2^63 - 1.
            env_ids: indices (n,) int64 or a mask (N,) bool; all environments if None.

        Raises:
            ArgumentError, ShapeError: the seed or ``env_ids`` cannot be; nothing has changed then.
        """
        env_ids = self.world.selector.resolve(env_ids)
        if seed is not None:
            self.world.random.seed(seed, env_ids)
        self._over = False
        with SingleThreaded():
            self.begin(env_ids)
            if env_ids is None:
                return self._observe(), {}
            return self._observe_new(torch.zeros_like(self.done).index_fill_(0, env_ids, True)), {}

    def spread_episodes(self) -> None:
        """Give every environment's episode a random age, by torch's own generator, so that they do not end together."""
        self.state.episode_step.random_(self.max_episode_steps)

    @property
    def observation_size(self) -> int:
        """Components of the group ``"policy"``.

        Raises:
            ConfigurationError: it is a dictionary of its terms.
        """
        return self.observation[POLICY].size

    def step(self, action: Tensor) -> StepResult:
        """One step of all environments.

        Returns:
            observation of the new state (of the new episode where one ended), reward (N,), terminated (N,) bool,
            truncated (N,) bool (the time limit), and info. Where an episode ended, info holds under ``"final"`` an
            :class:`EpisodeEnd` with the last observation, success and metrics.

        Raises:
            ShapeError: the action is not (N, A).
            ArgumentError: it is no dense tensor of real numbers on the environment's device. Float64 and integers are
                converted, and gradients do not go through a step.
            NonFiniteError: the action holds a NaN or infinite number; names environment and component. On a GPU the
                engine's SimulationError of the next step names the environment.
        """
        with SingleThreaded():
            return self._step(action)

    def _step(self, action: Tensor) -> StepResult:
        if self._over:
            raise ConfigurationError("the episode is over: reset the environment, then step")
        self._take(action)
        closed = self._next_step()
        if closed is not None:
            return self._step_closed(closed)
        self._started = True
        reward, terminated, truncated = self.advance()
        if self._checks:
            self._rewards.check_finite(reward)
        # Most steps end no episode, and NumPy's look at a few booleans costs less than torch's.
        if not self._ended.any():
            return self._observe(), reward, terminated, truncated, {}
        ended = self.done.nonzero().squeeze(-1)
        final = self._everyone(last := self._observe()).only(ended)
        self.progress()
        if not self._autoreset:
            self._over = True
            return last, reward, terminated, truncated, {"final": final}
        self.begin(ended)
        return self._observe_new(self.done), reward, terminated, truncated, {"final": final}

    def step_by(self, loop: PolicyLoop) -> None:
        """Take one step by a policy, as one recording where the engine records (:class:`PolicyLoop`).

        Each observation holds until the next step. Raises what :meth:`step` raises.
        """
        closed = self._closed if self._started and not self._checks else None
        if closed is None or not closed.composable:
            result = self.step(loop.act(self.observe()))
            loop.keep(result)
            loop.take(result[0])
            return
        if self._seen is not loop.observation:  # after a reset, or a step of another kind
            loop.take(self._observe())
        if self._next_step() is closed and closed.composable:
            loop.replay(closed)
        else:  # a value of plain Python has changed: this step captures it again
            torch.clamp(loop.act(loop.observation), -1.0, 1.0, out=self._action)
            result = self._step_closed(closed)
            loop.keep(result)
            loop.take(result[0])
        self._seen = loop.observation

    def observe(self) -> Observation:
        """Return the observation of the present state, as the last reset or step returned it."""
        with SingleThreaded():
            return self._observe()

    def agent(self, policy: Node) -> AgentGraph:
        """Build the graph of the whole agent: observation, a policy, what turns its action into joint targets.

        ``agent.step()`` and then ``environment.world.step(task.decimation)`` moves the robots as :meth:`step` does.
        Rewards, ends of episodes and resets are the environment's alone: reset the agent with it.

        Args:
            policy: node with an input for each tensor of the observation, named ``group`` or ``group/term``, and the
                output ``action`` (N, A).

        Raises:
            UnknownNameError, ConfigurationError, ShapeError: the policy's ports do not fit.
        """
        seen = tuple(Port(name, shape) for name, shape in leaf_shapes(self.observation).items())

        def observe(inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
            return {port.name: leaf for port, leaf in zip(seen, leaves_of(self.observer()), strict=True)}

        nodes = [FunctionNode("observation", observe, outputs=seen), policy, *self.actions.nodes]
        edges = [Edge(f"observation.{port.name}", f"{policy.name}.{port.name}") for port in seen]
        edges += self.actions.edges(f"{policy.name}.action")
        return AgentGraph(nodes, edges, rate=1.0 / self.step_dt)

    def expert(self) -> Node:
        """The task's scripted policy: call its ``compute({})`` for an action."""
        return self.task.expert(self)

    def close(self) -> None:
        """Free what the world holds; idempotent. Every later use raises a ClosedError."""
        self.world.close()
        mark_closed(self, "the environment")

    def _refresh(self) -> None:
        """Take in the terms that the task has now."""
        check_owners(self.task)
        self._rewards.refresh()
        if self.multi_agent is not None:
            self.multi_agent.refresh()
        self.termination_terms = terms_of(self.task.terminations, TerminationTerm)
        self._curriculum = curriculum_of(self.task)
        self._modifiers = Modifiers(self.task, modifiers_of(self.task))
        self.commands.refresh()
        self._events.refresh()
        self.premises.refresh()
        self.observer.refresh()

    # One step -------------------------------------------------------------------------------------------------------

    def _close_step(self) -> CapturedStep | None:
        """The step without its Python, where that is asked for or the device is not Python's own."""
        reason = needs_python(self.world, self.actions, self.task.decimation)
        if self._compile and reason:
            raise ConfigurationError(f"the step cannot be compiled, for it needs Python each time: {reason}")
        if reason or not self._capture or (self.device.type == "cpu" and not self._compile):
            return None
        whole, settles = self.device.type != "cpu", self.premises.settle_steps > 0
        return CapturedStep(self, self._compile, whole, settles, self._autoreset)

    def _next_step(self) -> CapturedStep | None:
        """Take in what was changed since the last step, count the next, and return it if it was captured."""
        # Before the configuration is compared, so that what a modifier sets holds from this step on.
        if self._modifiers.terms:
            self._modifiers.run(self.steps)
        closed = self._closed if self._started else None
        if closed is None or not closed.holds():
            if self._watch.changed():
                self._refresh()
            if closed is not None:
                closed.look_again()
        self.steps += 1
        return closed

    def _step_closed(self, closed: CapturedStep) -> StepResult:
        result = closed()
        self._seen = result[0]
        if self._checks and closed.doubtful:
            check_observation(result[0], self.observation)
            self._rewards.check_finite(result[1])
        if isinstance(info := result[4], StepInfo):
            self._checked_observation(info.everyone.observation)
            self._over = not self._autoreset
        if closed.refusal:
            if self._compile:
                raise ConfigurationError(f"the step cannot be compiled: {closed.refusal}; or leave compile out")
            self._closed = None
            warnings.warn(f"each step waits for the device: {closed.refusal}", RuntimeWarning, stacklevel=4)
        return result

    def advance(self) -> tuple[Tensor, Tensor, Tensor]:
        """Apply the action; gives reward, terminated and truncated before any reset. Nothing waits for the device."""
        task = self.task
        self._events.advance()
        if self.lost is not None:
            self.lost.forget()
        self._seen = None
        self.actions.apply()
        self.world.step(task.decimation)
        state = self.state
        state.episode_step.add_(1)
        if self._state_updates:
            state.update(self)
        reward = self._reward()
        terminated = self._terminated()
        late = state.episode_step >= self._limit
        if self.lost is not None:
            reward, terminated, late = self.lost.end(reward, terminated, late)
        torch.logical_or(late, terminated, out=self.done)
        # Commands that only change at resets cost nothing here.
        if self.commands.changing:
            self.commands.update()  # after rewards, which judge the step by the command that it was taken under
        # Of booleans, greater means "and not", in one operation.
        return reward, terminated, torch.gt(late, terminated)

    def success(self) -> Tensor:
        """(N,) bool: whether episodes that end now reach the goal."""
        reached = self.task.success(self)
        return reached if self.lost is None else reached & ~self.lost.now

    def _take(self, action: Tensor) -> None:
        """Write the action, clipped, to where the agent reads it."""
        # The usual case, in the memory of both tensors: on few numbers NumPy's operations cost a third of torch's.
        if (
            self._clipped is not None
            and type(action) is Tensor
            and action.is_cpu
            and action.dtype is torch.float32
            and action.layout is torch.strided
            and not action.requires_grad
        ):
            given = action.numpy()
            flat = given.reshape(-1)
            # Finite if every number is; a square that overflows is looked at again below.
            if given.shape == self._clipped.shape and math.isfinite(flat.dot(flat)):
                given.clip(_LOWEST, _HIGHEST, out=self._clipped)
                return
        torch.clamp(self._checked(action), -1.0, 1.0, out=self._action)

    def _checked(self, action: Tensor) -> Tensor:
        action = as_floats(action, self.device, "action")
        expected = (self.num_envs, self.action_size)
        if action.shape != expected:
            raise ShapeError(f"the action must have shape {expected} (num_envs, components), not {tuple(action.shape)}")
        check_numbers(action, FINITE, "action")
        return action

    def _observe(self) -> Observation:
        """Return the observation of the present state, computed once."""
        if self._seen is None:
            self._seen = self._checked_observation(self.observer())
        return {**self._seen}

    def _checked_observation(self, observation: Observation) -> Observation:
        if self._checks:
            check_observation(observation, self.observation)
        return observation

    def _observe_new(self, began: Tensor) -> Observation:
        """Return the observation with new rows where an episode began; the other environments keep theirs.

        Args:
            began: (N,) bool.
        """
        before = self._observe()
        with self.world.selector.only(began):
            # Terms measure all environments; only the rows of new episodes are kept.
            fresh = self.observer()
        leaves = [where_rows(began, new, old) for new, old in zip(leaves_of(fresh), leaves_of(before), strict=True)]
        self._seen = self._checked_observation(observation_of(self.observation, leaves))
        return {**self._seen}

    def _reward(self) -> Tensor:
        values = self._rewards.values()
        if self.multi_agent is not None:
            self.multi_agent.earn(values)
        return self._rewards.total(values)

    def _terminated(self) -> Tensor:
        ended: Tensor | None = None
        for name, term in self.termination_terms.items():
            value = term.function(self)
            if type(value) is not Tensor or value.dtype is not torch.bool or value.shape != self.done.shape:
                value = _checked_end(value, f"termination term '{name}'", self.num_envs)
            ended = value if ended is None else torch.logical_or(ended, value)
        return self._never.clone() if ended is None else ended

    def _everyone(self, observation: Observation) -> EpisodeEnd:
        """Return the results of every environment's episode as if it ended at this step."""
        return EpisodeEnd(
            env_ids=self.all_ids,
            observation=observation,
            success=self.success(),
            metrics=self.metrics(),
            rewards=dict(zip(self.reward_terms, self.reward_sums.unbind(), strict=True)),
            steps=self.state.episode_step,
        )

    def metrics(self) -> dict[str, Tensor]:
        """The task's, which premises held at the episode's start, and the difficulty where a curriculum sets it."""
        metrics = {**self.task.metrics(self), **self.premises.metrics()}
        if self.starts is not None:
            metrics |= self.starts.metrics()
        return {**metrics, "difficulty": self.state.difficulty} if self._curriculum else metrics

    def progress(self) -> None:
        """Let episodes that have just ended decide how difficult the next will be."""
        if self._curriculum:
            changes = [term.function(self) for term in self._curriculum.values()]
            # Changes of several terms add up, and the sum is clamped once, so that their order does not matter.
            following = torch.stack([self.state.difficulty, *changes]).sum(0).clamp(0.0, 1.0)
            counted = self.done if self.lost is None else self.done & ~self.lost.now
            write_rows(self.state.difficulty, following, counted)

    def begin(self, env_ids: Tensor | None) -> None:
        """New episodes in some environments, by index, or by mask where the step is traced."""
        if env_ids is None:
            self._seen = None
        # The world first: everything else may read its state.
        self.world.reset(env_ids)
        self.state.reset(env_ids)
        self.actions.reset(env_ids)
        self.observer.reset(env_ids)
        self._rewards.reset(env_ids)
        # Commands after events: a goal may depend on where things were placed.
        self._events.reset(env_ids)
        self.commands.reset(env_ids)
        self.premises.begin(env_ids)
        if self.starts is not None:
            self.starts.begin(env_ids)


def _checked_end(value: object, what: str, num_envs: int) -> Tensor:
    value = per_environment(value, what, num_envs)
    if value.dtype != torch.bool:
        raise ConfigurationError(f"{what} gives {value.dtype}: its function must give torch.bool")
    return value
