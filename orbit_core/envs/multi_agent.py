"""Several robots in one environment: each one's part of the observation, the action and the reward."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import check_shape
from orbit_core.envs.observation_layout import POLICY, GroupLayout, Observation, groups_of, terms_of_group
from orbit_core.envs.task import Task
from orbit_core.envs.terms import RewardTerm, terms_of, weight_of
from orbit_core.interfaces import UnknownNameError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


class MultiAgentView:
    """View of observation, action and reward per agent: terms that name an agent are its own, others are shared.

    An agent earns its own terms and, in full, those that all share. So the environment's reward is the sum of the
    agents' rewards, the shared terms counted once.

    Args:
        env: whose agents they are.
        layout: of the group ``"policy"``.
    """

    def __init__(self, env: Environment, layout: GroupLayout) -> None:
        task = env.task
        self.agents = task.agents
        """Names of the robots that act, in the order of the action."""
        self._actions = env.actions.slices
        self._task, self._step_dt = task, env.step_dt
        owners = {name: term.agent for name, term in terms_of_group(groups_of(task)[POLICY]).items()}
        self.layouts = {
            agent: replace(layout, terms={n: t for n, t in layout.terms.items() if owners[n] in (None, agent)})
            for agent in self.agents
        }
        """What each agent's part of the group ``"policy"`` is like."""
        self._columns = {
            agent: _columns(layout, own).to(env.device) for agent, own in self.layouts.items() if layout.concatenated
        }
        self._weights = torch.tensor(self._weights_now(), device=env.device)
        self._rewards = torch.zeros(len(self.agents), env.num_envs, device=env.device)

    def refresh(self) -> None:
        """Take the weights that the task has now; a captured step sees them too."""
        self._weights.copy_(torch.tensor(self._weights_now()))

    def _weights_now(self) -> list[list[float]]:
        """Return (agents, terms) what each agent earns of each term."""
        terms = terms_of(self._task.rewards, RewardTerm)
        scaled = {name: weight_of(name, term) * self._step_dt for name, term in terms.items()}
        return [
            [weight if terms[name].agent in (None, agent) else 0.0 for name, weight in scaled.items()]
            for agent in self.agents
        ]

    @property
    def action_sizes(self) -> dict[str, int]:
        """Components of each agent's action."""
        return {agent: part.stop - part.start for agent, part in self._actions.items()}

    def observations(self, policy: Tensor | dict[str, Tensor]) -> Observation:
        """Return each agent's part of the group ``"policy"``: its columns (N, O_agent), or its terms by name."""
        if isinstance(policy, dict):
            return {agent: {name: policy[name] for name in own.terms} for agent, own in self.layouts.items()}
        return {agent: policy[:, columns] for agent, columns in self._columns.items()}

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
        """Return each agent's reward (N,) of the last step."""
        return dict(zip(self.agents, self._rewards.clone().unbind(), strict=True))

    def earn(self, values: Tensor) -> None:
        """Take in a step's reward terms, unweighted (terms, N)."""
        self._rewards.copy_(self._weights @ values)


def _columns(layout: GroupLayout, own: GroupLayout) -> Tensor:
    """Return the indices of one agent's components in a concatenated group."""
    chosen = [layout.columns[name] for name in own.terms]
    return torch.tensor([i for columns in chosen for i in range(columns.start, columns.stop)], dtype=torch.int64)


def check_owners(task: Task) -> None:
    """Refuse terms that name an agent that the task does not have.

    Raises:
        UnknownNameError: names it.
    """
    seen = [term for group in groups_of(task).values() for term in terms_of_group(group).values()]
    for term in (*seen, *terms_of(task.rewards, RewardTerm).values()):
        if term.agent is not None and term.agent not in task.agents:
            raise UnknownNameError("agent", term.agent, task.agents, f"a term of task {type(task).__name__}")
