"""Where several robots act: whose each part of an environment's observation, action and reward is."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import check_shape
from orbit_core.envs.task import Task
from orbit_core.envs.terms import ObservationTerm, RewardTerm, terms_of
from orbit_core.interfaces import UnknownNameError, World


class MultiAgentView:
    """Tells apart what is each agent's, by the terms that name it; what names no agent is everyone's.

    An agent earns its own terms and, in full, those that all share. So the environment's reward is the sum of the
    agents' rewards, the shared terms counted once.

    Args:
        world: that the terms look at.
        task: whose agents they are; it has started.
        step_dt: seconds in a step of the environment.
    """

    def __init__(self, world: World, task: Task, step_dt: float) -> None:
        self.agents = task.agents
        self._actions = task.actions
        observations = terms_of(task.observations, ObservationTerm).values()
        rewards = terms_of(task.rewards, RewardTerm).values()
        owners = [term.agent for term in observations for _ in range(term.function(world, task).shape[1])]
        self._columns = {
            agent: torch.tensor([i for i, owner in enumerate(owners) if owner in (None, agent)], device=world.device)
            for agent in self.agents
        }
        weights = [
            [term.weight * step_dt if term.agent in (None, agent) else 0.0 for term in rewards] for agent in self.agents
        ]
        self._weights = torch.tensor(weights, device=world.device)
        self._rewards = torch.zeros(len(self.agents), world.num_envs, device=world.device)

    @property
    def observation_sizes(self) -> dict[str, int]:
        """Components of what each agent sees."""
        return {agent: len(columns) for agent, columns in self._columns.items()}

    @property
    def action_sizes(self) -> dict[str, int]:
        """Components of each agent's action."""
        return {agent: part.stop - part.start for agent, part in self._actions.items()}

    def observations(self, observation: Tensor) -> dict[str, Tensor]:
        """What each agent sees (N, O_agent) of the whole observation (N, O)."""
        return {agent: observation[:, columns] for agent, columns in self._columns.items()}

    def action(self, actions: Mapping[str, Tensor]) -> Tensor:
        """The whole action (N, A) of all agents' actions (N, A_agent).

        Raises:
            UnknownNameError: an action is for nobody, or an agent has none.
            ShapeError: an agent's action is not (N, A_agent).
        """
        for name in {*actions} ^ {*self.agents}:
            raise UnknownNameError("agent", name, self.agents, "the task; each needs an action")
        for agent, size in self.action_sizes.items():
            check_shape(actions[agent], (len(self._rewards[0]), size), f"action of '{agent}'")
        return torch.cat([actions[agent] for agent in self.agents], dim=1)

    def rewards(self) -> dict[str, Tensor]:
        """What each agent earned (N,) in the last step."""
        return dict(zip(self.agents, self._rewards.clone().unbind(), strict=True))

    def earn(self, values: Tensor) -> None:
        """Take in a step's reward terms, unweighted (terms, N)."""
        self._rewards.copy_(self._weights @ values)


def check_owners(task: Task) -> None:
    """Refuse terms that name an agent that the task does not have.

    Raises:
        UnknownNameError: names it.
    """
    observations, rewards = terms_of(task.observations, ObservationTerm), terms_of(task.rewards, RewardTerm)
    for term in (*observations.values(), *rewards.values()):
        if term.agent is not None and term.agent not in task.agents:
            raise UnknownNameError("agent", term.agent, task.agents, f"a term of task {type(task).__name__}")
