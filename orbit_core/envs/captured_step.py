"""Environment steps without their Python, resets by mask: for compiled steps, and for devices that must not wait."""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import torch
from torch import Tensor
from torch.utils._pytree import keystr, tree_leaves_with_path

from orbit_core.capture.python_state import REMEDY, Holder, PythonState
from orbit_core.capture.replay import CapturedFunction, ComposedFunction, ScheduledFunction, check_compiler
from orbit_core.envs.action_manager import ActionManager
from orbit_core.envs.command_manager import CommandManager
from orbit_core.envs.episode import EpisodeEnd, StepInfo
from orbit_core.envs.observation_layout import GroupLayout, Observation, leaves_of, observation_of
from orbit_core.envs.observation_manager import ObservationManager
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import Task
from orbit_core.envs.terms import CommandTerm, ObservationGroup, RewardTerm, Term
from orbit_core.interfaces import World


class CapturableEnvironment(Protocol):
    """The parts of a step, which an environment runs one by one or has captured. None of them waits for the device."""

    world: World
    """World that is stepped."""
    actions: ActionManager
    """Manager of the action terms."""
    commands: CommandManager
    """Manager of the command terms."""
    device: torch.device
    """Device of all tensors."""
    observer: ObservationManager
    """Manager of the observation groups."""
    observation: dict[str, GroupLayout]
    """Layout of each group of the observation, by name."""
    reward_terms: dict[str, RewardTerm]
    """The rewards, by name."""
    reward_sums: Tensor
    """(rewards, N) of each term over the episode."""
    max_episode_steps: int
    """Steps of an episode."""
    all_ids: Tensor
    """(N,) indices of all environments."""
    done: Tensor
    """(N,) whose episode ended in the last step."""

    @property
    def task(self) -> Task:
        """Configuration of the environment."""
        ...

    @property
    def state(self) -> TaskState:
        """Memory of the run."""
        ...

    def observe(self) -> Observation:
        """Return what a policy sees of the present state."""
        ...

    def advance(self) -> tuple[Tensor, Tensor, Tensor]:
        """Apply the action; gives reward (N,), terminated (N,) and truncated (N,); sets :attr:`done`."""
        ...

    def success(self) -> Tensor:
        """(N,) bool: whether episodes that end now reach the goal."""
        ...

    def metrics(self) -> dict[str, Tensor]:
        """The task's measures (N,) of the episode so far, by name."""
        ...

    def progress(self) -> None:
        """Let episodes that have just ended decide how difficult the next will be."""
        ...

    def begin(self, env_ids: Tensor | None) -> None:
        """New episodes in some environments: by index (n,) int64, by mask (N,) bool, or in all of them if None."""
        ...


_OFTEN = 8
# Most phases of a schedule that is captured: each costs a trace, and where asked a compilation.
MOST_PHASES = 64
StepResult = tuple[Observation, Tensor, Tensor, Tensor, Mapping[str, EpisodeEnd]]


class CapturedStep:
    """The environment's step in parts that are traced once.

    Args:
        environment: that steps.
        compile: whether to compile the parts.
        whole: whether the resets are in the step, so that nothing waits for the device; else they are another part, run
            only where an episode ended, which on a CPU costs nothing to know.
        settles: whether time passes in a reset, which then is Python; each step waits to know whether an episode ended.
        renews: whether the next episode begins in the step that ends one; else it waits for a reset, and so does the
            step.

    Raises:
        ConfigurationError: it should be compiled, and nothing compiles here.
    """

    def __init__(
        self, environment: CapturableEnvironment, compile: bool, whole: bool, settles: bool = False, renews: bool = True
    ) -> None:
        if compile:
            check_compiler(environment.device)
        self._environment = environment
        # The last observation of all environments, for the part that renews it where episodes begin.
        self._observed: list[Tensor] = [torch.empty_like(leaf) for leaf in leaves_of(environment.observer())]
        self._leaves = len(self._observed)
        self._metrics: tuple[str, ...] = ()
        self._settles, self._renews = settles, renews
        # Python values that the captured parts took as they were; None before the first capture.
        self._python: PythonState | None = None
        # Steps at which such values had changed.
        self._captures: deque[int] = deque(maxlen=_OFTEN)
        self._steps = 0
        # Whether an episode ended, and whether a number is not finite, found by the step itself: two bytes of memory
        # cost less to read than arrays. On a GPU they would cost kernels, and waiting.
        on_host = environment.device.type == "cpu"
        self._flags = torch.zeros(2, dtype=torch.bool, device=environment.device) if on_host else None
        self._noted = None if self._flags is None else self._flags.numpy()
        self.doubtful = True
        """True if a number of the last step may not be finite; always so where a look would wait for the device."""
        alone = settles or not renews
        parts = (self._play,) if alone else (self._play_and_renew,) if whole else (self._play, self._renew)
        self.parts = [self._scheduled(part, compile) for part in parts]
        """Step, then reset where that is a part of its own; each is traced when it first runs."""

    def _scheduled(self, part: Callable[[], tuple[Tensor, ...]], compile: bool) -> ScheduledFunction:
        world, actions = self._environment.world, self._environment.actions

        def capture() -> CapturedFunction:
            return CapturedFunction(world, part, compile, self._look)

        schedules = [schedule for schedule in (world.schedule, actions.schedule) if schedule is not None]
        return ScheduledFunction(schedules, capture)

    def __call__(self) -> StepResult:
        """One step; the first makes all parts ready, and so does for no environment what resets do."""
        outputs = self.parts[0]()
        if self._python is None:
            self._python = self._look()
        ready = self._settles or not self._renews or (len(self.parts) > 1 and self.parts[1].ready)
        ended, self.doubtful = (None, True) if self._noted is None else self._noted.tolist()
        running = ready and not (self._environment.done.any() if ended is None else ended)
        copies = [output.clone() for output in (outputs[: self._leaves + 3] if running else outputs)]
        seen, (reward, terminated, truncated, *end) = copies[: self._leaves], copies[self._leaves :]
        if running:
            return self._tree(seen), reward, terminated, truncated, {}
        self.doubtful = True  # observations of new episodes are not looked at here
        if not self._renews:
            end += seen
            self._environment.progress()
        elif self._settles:
            end += seen
            seen = self._renew_in_python()
        elif len(self.parts) > 1:
            end += seen
            seen = [output.clone() for output in self.parts[1]()]
        return self._tree(seen), reward, terminated, truncated, self._info(end)

    @property
    def composable(self) -> bool:
        """True if a step is one captured part that nothing on the host divides, and its next operations are known."""
        return len(self.parts) == 1 and self._renews and not self._settles and self.parts[0].ready

    def composed(self, compose: Callable[[Callable[[], StepResult]], None]) -> Callable[[], None]:
        """Return a function that takes a step as ``compose`` does, as :class:`ComposedFunction` records it.

        Args:
            compose: calls the step that it is given once; what the step returns holds until it returns.
        """

        def run(operations: Callable[[], tuple[Tensor, ...]]) -> None:
            compose(lambda: self._result(operations()))

        return ComposedFunction(self._environment.world, self.parts[0], run)

    def _result(self, tensors: Sequence[Tensor]) -> StepResult:
        seen, (reward, terminated, truncated, *end) = tensors[: self._leaves], tensors[self._leaves :]
        return self._tree(seen), reward, terminated, truncated, self._info(end)

    def holds(self) -> bool:
        """Return True if every value of plain Python that was captured is the one that it was, terms included."""
        self._steps += 1
        return self._python is not None and self._python.unchanged()

    def look_again(self) -> None:
        """Capture all parts again if a value of plain Python was changed between steps, other than a weight."""
        if self._python is None:
            return
        changes = [change for change in self._python.changes() if not _is_live(*change)]
        if not changes:
            self._python.update()
            return
        changed, self._python = self._python.describe(changes[0]), None
        for part in self.parts:
            part.forget()
        self._captures.append(self._steps)
        if len(self._captures) == _OFTEN and self._captures[-1] - self._captures[0] < 10 * _OFTEN:
            self._captures.clear()
            warnings.warn(
                f"{changed} changes between steps, {_OFTEN} times of late, and each time the step is captured again, "
                f"which is slow: {REMEDY}",
                RuntimeWarning,
                stacklevel=5,
            )

    def _look(self) -> PythonState:
        task, state = self._environment.task, self._environment.state
        nodes = {f"node '{generator.name}'": generator for generator in self._environment.actions.generators}
        own = {type(task).__name__: task, type(state).__name__: state}
        return PythonState({**own, **nodes, **self._environment.world.python_laws}, (Term, ObservationGroup))

    @property
    def refusal(self) -> str:
        """Reason for which the step cannot be repeated without Python; empty if it can, as far as is known."""
        for part in self.parts:
            if part.refusal:
                return part.refusal
        return ""

    def _tree(self, leaves: Sequence[Tensor]) -> Observation:
        return observation_of(self._environment.observation, leaves)

    def _info(self, end: list[Tensor]) -> StepInfo:
        done, success, steps, rewards = end[:4]
        metrics, last = end[4 : -self._leaves], end[-self._leaves :]
        everyone = EpisodeEnd(
            env_ids=self._environment.all_ids,
            observation=self._tree(last),
            success=success,
            metrics=dict(zip(self._metrics, metrics, strict=True)),
            rewards=dict(zip(self._environment.reward_terms, rewards.unbind(), strict=True)),
            steps=steps,
        )
        return StepInfo(done, everyone)

    def _play(self) -> tuple[Tensor, ...]:
        """A step before resets: observation, reward, terminated, truncated, then what :meth:`_info` needs."""
        environment = self._environment
        outcome = environment.advance()
        seen = leaves_of(environment.observer())
        for observed, leaf in zip(self._observed, seen, strict=True):
            observed.copy_(leaf)
        if self._flags is not None:
            self._flags.copy_(torch.stack((environment.done.any(), _any_not_finite((*seen, outcome[0])))))
        metrics = environment.metrics()
        self._metrics = tuple(metrics)
        # Copies, for resets write the same memory before anyone looks.
        end = (
            environment.done,
            environment.success(),
            environment.state.episode_step,
            environment.reward_sums,
            *metrics.values(),
        )
        return (*self._observed, *outcome, *(tensor.clone() for tensor in end))

    def _renew(self) -> tuple[Tensor, ...]:
        """New episodes where one ended, and the observation with theirs."""
        environment, done = self._environment, self._environment.done
        environment.progress()
        environment.begin(done)
        with environment.world.selector.only(done):
            seen = leaves_of(environment.observer())
        return tuple(where_rows(done, new, last) for new, last in zip(seen, self._observed, strict=True))

    def _renew_in_python(self) -> list[Tensor]:
        """Begin new episodes as :meth:`_renew` does, by index and outside of any trace."""
        environment, done = self._environment, self._environment.done
        environment.progress()
        environment.begin(done.nonzero().squeeze(-1))
        with environment.world.selector.only(done):
            seen = leaves_of(environment.observer())
        return [where_rows(done, new, last) for new, last in zip(seen, self._observed, strict=True)]

    def _play_and_renew(self) -> tuple[Tensor, ...]:
        """Return the outputs of :meth:`_play` with the new observation in the place of the last, which is appended."""
        played = self._play()
        return (*self._renew(), *played[self._leaves :], *played[: self._leaves])


def _any_not_finite(tensors: Sequence[Tensor]) -> Tensor:
    """Return () bool: whether any number of any tensor is NaN or infinite."""
    finite = [tensor.isfinite().all() for tensor in tensors if tensor.is_floating_point()]
    return ~torch.stack(finite).all()


def _is_live(holder: Holder, key: object) -> bool:
    """Return True for configuration that managers hold in a tensor: weights of rewards, ranges of commands."""
    owner = holder.owner
    return (isinstance(owner, RewardTerm) and key == "weight") or (isinstance(owner, CommandTerm) and key in owner.live)


def where_rows(mask: Tensor, values: Tensor, otherwise: Tensor) -> Tensor:
    """Rows (N, ...) of ``values`` where the mask (N,) is set."""
    return torch.where(mask.view(-1, *(1 for _ in values.shape[1:])), values, otherwise)


def remembered(environment: CapturableEnvironment) -> dict[str, Tensor]:
    """Return the tensors that the state, the commands and motion generators keep from step to step, by name."""
    own = {**environment.state.memory(), **environment.commands.memory()}
    # The names are those that recordings have kept their states by since before states had a class of their own.
    memory = {type(environment.task).__name__: own, "memory": environment.actions.node_memory}
    return {keystr(path): leaf for path, leaf in tree_leaves_with_path(memory) if isinstance(leaf, Tensor)}


def needs_python(world: World, actions: ActionManager, decimation: int) -> str:
    """Return the reason why a step cannot be captured; empty if it can."""
    schedules = world.schedule, actions.schedule
    if schedules[0] is None:
        return f"{type(world).__name__} has no engine"
    agent = 1 if schedules[1] is None else schedules[1].period
    keys = math.lcm(schedules[0].period, decimation * agent) // decimation
    if keys <= MOST_PHASES:
        return ""
    return (
        f"what is due repeats after {keys} steps only, and each of them would be captured, of {MOST_PHASES} at most: "
        "choose rates of sensors and nodes that divide the rate of the environment's steps"
    )
