"""One timed computation of an agent."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Port:
    """A named input or output; ``shape`` leaves out the leading num_envs."""

    name: str
    """Name within its node."""
    shape: tuple[int, ...]


class Node(ABC):
    """Turns inputs (num_envs, ...) into outputs (num_envs, ...).

    ``rate`` in Hz must divide the agent's; between its turns the agent holds the node's last outputs. ``None`` runs
    at the agent's own rate.
    """

    name: str
    """Name within the agent."""
    inputs: tuple[Port, ...] = ()
    """Ports of the values that it needs."""
    outputs: tuple[Port, ...] = ()
    """Ports of the values that it gives."""
    # None and not a number, because a node does not know the rate of its agent.
    rate: float | None = None

    @abstractmethod
    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        """Compute the outputs of one turn from its inputs."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        """Forget the past of some environments."""

    def memory(self) -> Mapping[str, Tensor]:
        """Return the node's own tensors (num_envs, ...) that the next turn depends on, by name.

        The agent writes into them to restore a snapshot, and to undo a turn for environments that it was not for.
        """
        return {}
