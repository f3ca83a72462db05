"""Episodes that begin on the expert's way, so that learning meets states that a beginner reaches late.

Why: Nair et al., Overcoming Exploration in Reinforcement Learning with Demonstrations (2018), whose episodes begin at
states of demonstrations; Florensa et al., Reverse Curriculum Generation for Reinforcement Learning (2017): what is
learned near the goal spreads backwards from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import is_mask, write_rows
from orbit_core.dynamics.linear import SingleThreaded
from orbit_core.envs.captured_step import CapturableEnvironment
from orbit_core.envs.episode import EXPERT_START
from orbit_core.envs.observation_layout import POLICY
from orbit_core.interfaces import ConfigurationError, Object

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

# States that are kept at most, drawn from all that were recorded.
MOST_STATES = 2**16
# Steps from one state that is kept to the next.
_STRIDE = 4
# Deviation of what is added to the expert's actions, so that states beside its way, and how it comes back to it, are
# among those kept: Laskey et al., DART: Noise Injection for Robust Imitation Learning (2017).
_STRAYING = 0.1
# Names of what is kept of each moment beside the state.
_SEEN, _DONE = "seen", "done"


class ExpertStarts:
    """Start of a share of all episodes at states that the task's expert passes in this very engine.

    The expert plays one episode in every environment once, when the environment is made. Kept are states of those
    episodes in which it reached the goal, up to there: joint and root positions and velocities, those of deformables'
    particles, what motion generators remember, the last action, and the episode's step, so that as much time is left as
    the expert had. The rest of a task's memory, and what a solver starts from, begins as in every episode.

    Args:
        env: whose task is learned, with :attr:`~orbit_core.envs.Task.expert_starts` above zero.

    Raises:
        ConfigurationError: the share is not between 0 and 1, or nothing is simulated.
    """

    def __init__(self, env: Environment) -> None:
        world, task = env.world, env.task
        share = task.expert_starts
        if not 0.0 <= share <= 1.0:
            raise ConfigurationError(f"expert_starts is the share of episodes, between 0 and 1, not {share:g}")
        self._env, self._world, self._task, self._share = env, world, task, share
        self._entities: list[Object] = [*world.robots.values(), *world.objects.values()]
        # (K, ...) of each part of a state that differs between states; empty until they are recorded.
        self._states: dict[str, Tensor] = {}
        self.seen, self.done = torch.empty(0), torch.empty(0)
        """(M, O) what a policy would have seen in those episodes, to their ends, so that it also sees what is done at
        the goal, and (M, A) what the expert did; empty where the observation is a dictionary."""
        self.began_there = torch.zeros(world.num_envs, dtype=torch.bool, device=world.device)
        """(N,) whether the present episode began on the expert's way."""

    def record(self, environment: CapturableEnvironment, action: Tensor) -> None:
        """Let the expert play an episode, and keep the states that it comes by; random streams go on as if nothing had
        been drawn.

        Args:
            environment: that this belongs to.
            action: (N, A) that the environment's next step does.

        Raises:
            ConfigurationError: the task has no expert, or it reached the goal in no environment.
        """  # fmt: skip
        streams = self._world.random.save_state()
        environment.begin(None)
        steps, moments = environment.max_episode_steps, list[Mapping[str, Tensor]]()
        failed, reached = self.began_there.clone(), self.began_there.clone()
        reached_at = torch.full_like(self._env.state.episode_step, steps)
        generator = torch.Generator(action.device).manual_seed(0)
        with torch.no_grad(), SingleThreaded():
            expert = self._task.expert(self._env)
            for step in range(steps - 1):
                observed = environment.observe()[POLICY]
                wanted = expert.compute({})["action"]
                if step % _STRIDE == 0:
                    shown = {_SEEN: observed, _DONE: wanted} if isinstance(observed, Tensor) else {}
                    moments.append({name: part.clone() for name, part in (self._parts() | shown).items()})
                strays = torch.randn(action.shape, generator=generator, device=action.device)
                action.copy_((wanted + _STRAYING * strays).clamp(-1.0, 1.0))
                _, terminated, _ = environment.advance()
                failed |= terminated
                new = self._task.success(self._env) & ~reached
                reached_at[new] = step + 1
                reached |= new
        self._keep(moments, reached & ~failed, reached_at)
        self._world.random.load_state(streams)

    def _keep(self, moments: Sequence[Mapping[str, Tensor]], good: Tensor, until: Tensor) -> None:
        """Keep the states of good episodes (N,) up to their steps ``until`` (N,), of all that were recorded."""
        if not bool(good.any()):
            raise ConfigurationError(
                f"episodes of task {type(self._task).__name__} cannot begin on its expert's way: on backend "
                f"'{self._world.backend}' it reached the goal in none of {len(good)}; leave expert_starts out"
            )
        begun = torch.arange(len(moments), device=self._world.device)[:, None] * _STRIDE
        starts, shown = _some(good & (begun <= until)), _some(good & (begun >= 0))
        for name in moments[0]:
            values = torch.stack([moment[name] for moment in moments])
            if name == _SEEN:
                self.seen = values[shown]
            elif name == _DONE:
                self.done = values[shown]
            elif bool((values[starts] != values[starts][:1]).any()):
                self._states[name] = values[starts]

    def begin(self, env_ids: Tensor | None) -> None:
        """After the events of a reset: put some of these environments on the expert's way.

        Args:
            env_ids: environments by index, by mask in a traced step, or all if None.
        """
        write_rows(self.began_there, False, env_ids)
        if not self._states:
            return
        world = self._world
        if is_mask(env_ids):
            with world.selector.only(env_ids):
                draw = world.random.uniform((2,))
            chosen = env_ids & (draw[:, 0] < self._share)
            with world.selector.only(chosen):
                self._place(draw[:, 1], None, chosen)
        else:
            rows = torch.arange(world.num_envs, device=world.device) if env_ids is None else env_ids
            draw = world.random.uniform((2,), env_ids=rows)
            there = draw[:, 0] < self._share
            if bool(there.any()):
                self._place(draw[there, 1], rows[there], rows[there])
        world.clock.touch()

    def metrics(self) -> Mapping[str, Tensor]:
        """(N,) by the metric's name."""
        return {EXPERT_START: self.began_there.float()}

    def _place(self, draw: Tensor, env_ids: Tensor | None, rows: Tensor) -> None:
        """Write the states that numbers (n,) in [0, 1) choose; ``rows`` are the environments by index or mask."""
        count = len(next(iter(self._states.values())))
        chosen = (draw * count).to(torch.int64)
        values = {name: states[chosen] for name, states in self._states.items()}
        for thing in self._entities:
            if (pose := values.get(f"{thing.name} pose")) is not None:
                thing.set_root_pose(pose, env_ids)
            if (velocity := values.get(f"{thing.name} velocity")) is not None:
                thing.set_root_velocity(velocity, env_ids)
            if (positions := values.get(f"{thing.name} joints")) is not None:
                thing.set_joint_state(positions, values.get(f"{thing.name} joint velocities"), env_ids=env_ids)
        for name, body in self._world.deformables.items():
            if (particles := values.get(f"{name} particles")) is not None:
                body.set_state(particles, values.get(f"{name} particle velocities"), env_ids)
        for name, memory in self._memories().items():
            if name in values:
                write_rows(memory, values[name], rows)
        write_rows(self.began_there, True, rows)

    def _parts(self) -> dict[str, Tensor]:
        """Return the state tensors, (N, ...) each: entities first, then the agent."""
        parts: dict[str, Tensor] = {}
        for thing in self._entities:
            parts[f"{thing.name} pose"] = thing.root_pose
            if not thing.spec.fixed_base:
                parts[f"{thing.name} velocity"] = thing.root_velocity
            if thing.joint_names:
                parts[f"{thing.name} joints"] = thing.joint_positions
                parts[f"{thing.name} joint velocities"] = thing.joint_velocities
        for name, body in self._world.deformables.items():
            parts[f"{name} particles"], parts[f"{name} particle velocities"] = body.positions, body.velocities
        return parts | self._memories()

    def _memories(self) -> dict[str, Tensor]:
        """The tensors (N, ...) that the agent remembers from step to step, by name."""
        state = self._env.state
        memories = {"step": state.episode_step, "last action": state.last_action, "action before": state.action_before}
        for number, generator in enumerate(self._env.actions.generators):
            held = generator.memory().items()
            memories |= {f"{number} {name}": each for name, each in held if each.shape[:1] == (self._env.num_envs,)}
        return memories


def _some(wanted: Tensor) -> tuple[Tensor, Tensor]:
    """Moments (K,) and environments (K,) that are wanted (moments, N), :data:`MOST_STATES` of them at most."""
    kept = wanted.nonzero()
    if len(kept) > MOST_STATES:
        chosen = torch.randperm(len(kept), generator=torch.Generator().manual_seed(0))[:MOST_STATES]
        kept = kept[chosen.to(kept.device)]
    return kept[:, 0], kept[:, 1]
