"""An environment's step without its Python, resets by mask: for compiled steps, and for devices that must not wait."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.utils._pytree import keystr, tree_leaves_with_path

from orbit_core.agent import Cut
from orbit_core.capture.replay import CapturedFunction
from orbit_core.envs.episode import EpisodeEnd, Observation, StepInfo
from orbit_core.envs.task import Task
from orbit_core.interfaces import World

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

StepResult = tuple[Observation, Tensor, Tensor, Tensor, Mapping[str, EpisodeEnd]]


class CapturedStep:
    """The environment's step in parts that are traced once.

    Args:
        environment: that steps.
        compile: whether to compile the parts.
        whole: whether the resets are in the step, so that nothing waits for the device; else they are another part, run
            only where an episode ended, which on a CPU costs nothing to know.
    """

    def __init__(self, environment: Environment, compile: bool, whole: bool) -> None:
        self._environment = environment
        self._observed = torch.zeros(environment.num_envs, environment.observation_size, device=environment.device)
        self._metrics: tuple[str, ...] = ()
        self._ended = environment.done if whole else environment.done.numpy()
        parts = (self._play_and_renew,) if whole else (self._play, self._renew)
        memory = lambda: remembered(environment.task, environment.cut)  # noqa: E731
        self.parts = [CapturedFunction(environment.world, part, memory, compile) for part in parts]

    def __call__(self) -> StepResult:
        """One step; the first makes all parts ready, and so does for no environment what resets do."""
        environment = self._environment
        graph, clock = environment.cut.graph, environment.world.clock
        count, steps, decimation = graph.step_count, clock.steps, environment.task.decimation
        outputs = self.parts[0]()
        environment.cut.acted(count)
        environment.world.repeated(steps + decimation - clock.steps)
        if len(self.parts) > 1 and self.parts[1].ready and not self._ended.any():
            observation, reward, terminated, truncated = [output.clone() for output in outputs[:4]]
            return {"policy": observation}, reward, terminated, truncated, {}
        observation, reward, terminated, truncated, *end = [output.clone() for output in outputs]
        if len(self.parts) > 1:
            end.append(observation)
            observation = self.parts[1]()[0].clone()
            environment.world.repeated(0)
        return {"policy": observation}, reward, terminated, truncated, self._info(end)

    @property
    def refusal(self) -> str:
        """Why the step cannot be repeated without Python; empty if it can, as far as is known."""
        return next((part.refusal for part in self.parts if part.refusal), "")

    def _info(self, end: list[Tensor]) -> StepInfo:
        done, success, steps, rewards, *metrics, last = end
        everyone = EpisodeEnd(
            env_ids=self._environment.all_ids,
            observation={"policy": last},
            success=success,
            metrics=dict(zip(self._metrics, metrics, strict=True)),
            rewards=dict(zip(self._environment.reward_terms, rewards.unbind(), strict=True)),
            steps=steps,
        )
        return StepInfo(done, everyone)

    def _play(self) -> tuple[Tensor, ...]:
        """A step before resets: observation, reward, terminated, truncated, then what :meth:`_info` needs."""
        environment, task, world = self._environment, self._environment.task, self._environment.world
        outcome = environment.advance()
        observation = environment.observer()
        self._observed.copy_(observation)
        metrics = environment.metrics()
        self._metrics = tuple(metrics)
        # Copies, for resets write the same memory before anyone looks.
        end = (environment.done, task.success(world), task.episode_step, environment.reward_sums, *metrics.values())
        return (observation, *outcome, *(tensor.clone() for tensor in end))

    def _renew(self) -> tuple[Tensor]:
        """New episodes where one ended, and the observation with theirs."""
        environment, done = self._environment, self._environment.done
        environment.progress()
        environment.begin(done)
        with environment.world.masking.only(done):
            observation = environment.observer()
        return (torch.where(done[:, None], observation, self._observed),)

    def _play_and_renew(self) -> tuple[Tensor, ...]:
        """What :meth:`_play` gives with the new observation in the place of the last, which comes at the end."""
        last, *rest = self._play()
        return (*self._renew(), *rest, last)


def remembered(task: Task, cut: Cut) -> dict[str, Tensor]:
    """What a task and its agent's nodes remember from step to step, by name."""
    own = {name: value for name, value in vars(task).items() if name != "cache"}
    memory = {f"node '{r.node.name}'": dict(r.node.memory()) for r in cut.graph.runners}
    leaves = tree_leaves_with_path({type(task).__name__: own, "memory": memory})
    return {keystr(path): leaf for path, leaf in leaves if isinstance(leaf, Tensor)}


def needs_python(world: World, cut: Cut) -> str:
    """What of a step Python has to do each time anew; empty if nothing."""
    for name, reason in world.untraceable_sensors().items():
        return f"sensor '{name}' {reason}"
    if world.actuators.delayed:
        return "an actuator's delay"
    for runner in cut.graph.runners:
        if runner.period != 1:
            return f"node '{runner.node.name}' has a rate of its own"
    return ""
