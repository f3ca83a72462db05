"""Who acts, by the name that a user gives: an agent's, a kept policy's, or the file of a learned policy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from orbit_core.interfaces.errors import UnknownNameError
from orbit_core.policies import kept_policies, policy_path
from orbit_core.tasks.agents import AGENTS, make_agent

if TYPE_CHECKING:
    from orbit_core.tasks.agents import Agent
    from orbit_core.tasks.environment import Environment


def check_actor(name: str) -> None:
    """Refuse a name that no agent and no kept policy bears and that is no file or folder.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in AGENTS and not Path(name).exists() and name not in kept_policies():
        raise UnknownNameError("agent or policy", name, {*AGENTS, *kept_policies()})


def make_actor(name: str, environment: Environment, seed: int) -> Agent:
    """The agent of that name, the policy in that file or folder, or the kept policy of that name.

    Raises:
        UnknownNameError: there is none.
        ConfigurationError: the policy was learned for another environment.
    """
    check_actor(name)
    if name in AGENTS:
        return make_agent(name, environment, seed)
    from orbit_core.learning.policy import PolicyAgent

    return PolicyAgent(environment, policy_path(name))
